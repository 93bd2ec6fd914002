//! `lab codec`: bytes and time of each codec for the masks along a camera path.
//!
//! The cpu back end traces the masks, of a scene that moves at the path's time. Every codec must restore each of them
//! exactly, and is timed on one core: the least of several rounds, since other programs only add time. Bytes are bytes
//! on the wire, with packet and frame headers. zstd compresses the same planes as `planes-lz4`; it is not a codec of
//! the product.
//!
//! Codecs with references are measured without one, and with the mask of N frames before at 60 frames a second: 1 is
//! the least possible, 3 is what a round trip of 40 ms gives.
//!
//! With `--wrong-ppm`, sliced codecs are also measured on simplified masks, as sent to clients that allow wrong bits.
//! The time of simplifying is included; irrelevant bits count like relevant ones.

use std::time::Instant;

use anyhow::{Context, Result, ensure};
use gnomon_protocol::{
    codec::{CodecId, Decoder, EncodedFrame, Encoder, Reference, Simplifier},
    ids::FrameNumber,
    limits::MAX_PACKET_BYTES,
    mask::{Mask, MaskShape},
    packetizer::Packetizer,
};

use super::{scene_args::SceneArgs, statistics::mean, table::Table};
use crate::backends::BackendName;

const HEAD: &str = "scene | path | lights | codec | reference | mean_bytes \
     | p99_bytes | packets_mean | encode_ms | decode_ms | wrong_relevant_bits";

const ZSTD_LEVEL: i32 = 3;

#[derive(Debug, Clone, clap::Args)]
pub struct CodecOptions {
    /// Scene, path, size, and how many frames of the path are measured.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Rounds per mask.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    pub rounds: u32,
    /// Ages of the references, in frames at 60 frames a second.
    #[arg(long, value_delimiter = ',', default_value = "1,3")]
    pub lags: Vec<u32>,
    /// Wrong bits to allow, in parts per million; each value makes its own rows.
    #[arg(long, value_delimiter = ',')]
    pub wrong_ppm: Vec<u16>,
    /// Append to codec.csv, for a table of several scenes.
    #[arg(long)]
    pub append: bool,
}

enum Subject {
    Own(Box<Own>),
    Zstd(Box<Zstd>),
}

struct Own {
    encoder: Encoder,
    decoder: Decoder,
    /// Age of the reference in frames, and the reference.
    reference: Option<(u32, Reference)>,
    /// Wrong bits allowed, in parts per million.
    wrong_ppm: u16,
    simplifier: Simplifier,
    mask: Mask,
}

impl Own {
    fn new(codec: CodecId, lag: Option<u32>, wrong_ppm: u16, shape: MaskShape) -> Self {
        Self {
            encoder: Encoder::new(codec),
            decoder: Decoder::new(),
            reference: lag.map(|lag| (lag, Reference::new())),
            wrong_ppm,
            simplifier: Simplifier::default(),
            mask: Mask::new(shape),
        }
    }

    fn encode(&mut self, frame: &mut EncodedFrame, with_reference: bool) -> Result<()> {
        self.simplifier.simplify(&mut self.mask, self.wrong_ppm);
        let reference = self.reference.as_ref().filter(|_| with_reference).map(|(_, reference)| reference);
        Ok(self.encoder.encode_for(None, reference, &self.mask, frame)?)
    }
}

struct Zstd {
    compressor: zstd::bulk::Compressor<'static>,
    decompressor: zstd::bulk::Decompressor<'static>,
    planes: Vec<u8>,
}

impl Subject {
    fn all(lags: &[u32], wrong_ppm: &[u16], shape: MaskShape) -> Result<Vec<Self>> {
        let own = CodecId::ALL.into_iter().flat_map(|codec| {
            let lossy = wrong_ppm.iter().copied().filter(move |_| codec.is_sliced());
            [0].into_iter().chain(lossy).flat_map(move |wrong_ppm| {
                let lags = lags.iter().filter(move |_| codec.has_references()).map(|lag| Some(*lag));
                let own = move |lag| Self::Own(Box::new(Own::new(codec, lag, wrong_ppm, shape)));
                [None].into_iter().chain(lags).map(own)
            })
        });
        let zstd = Zstd {
            compressor: zstd::bulk::Compressor::new(ZSTD_LEVEL)?,
            decompressor: zstd::bulk::Decompressor::new()?,
            planes: Vec::new(),
        };
        Ok(own.chain([Self::Zstd(Box::new(zstd))]).collect())
    }

    fn name(&self) -> String {
        match self {
            Self::Own(own) if own.wrong_ppm > 0 => format!("{}-{}ppm", own.encoder.codec(), own.wrong_ppm),
            Self::Own(own) => own.encoder.codec().to_string(),
            Self::Zstd(_) => format!("planes-zstd-{ZSTD_LEVEL}"),
        }
    }

    fn reference(&self) -> String {
        match self {
            Self::Own(own) => own.reference.as_ref().map_or("none".into(), |(lag, _)| lag.to_string()),
            Self::Zstd(_) => "none".into(),
        }
    }

    /// Keeps the mask of the right age as reference; `earlier` has masks of earlier frames with their ages.
    fn refer(&mut self, earlier: &[(u32, Mask)]) -> Result<()> {
        let Self::Own(own) = self else { return Ok(()) };
        let Some((lag, _)) = own.reference else { return Ok(()) };
        let (_, mask) = earlier.iter().find(|(age, _)| *age == lag).context("no mask of this age")?;
        own.mask.clone_from(mask);
        own.encode(&mut EncodedFrame::default(), false)?;
        let Own { encoder, reference: Some((_, reference)), .. } = &mut **own else { return Ok(()) };
        ensure!(encoder.keep(FrameNumber(0), reference), "the mask is no reference");
        Ok(())
    }

    /// Copies the mask to encode, outside the timed part.
    fn take(&mut self, mask: &Mask) {
        if let Self::Own(own) = self {
            own.mask.clone_from(mask);
        }
    }

    fn encode(&mut self, mask: &Mask, frame: &mut EncodedFrame) -> Result<()> {
        match self {
            Self::Own(own) => own.encode(frame, true)?,
            Self::Zstd(zstd) => {
                zstd.planes.clear();
                zstd.planes.extend(mask.words().iter().flat_map(|word| word.to_le_bytes()));
                *frame = zstd.compressor.compress(&zstd.planes)?.into();
            }
        }
        Ok(())
    }

    fn decode(&mut self, body: &[u8], mask: &mut Mask) -> Result<()> {
        match self {
            Self::Own(own) => {
                let reference = own.reference.as_ref().map(|(_, reference)| reference);
                own.decoder.decode_against(reference, body, mask)?;
            }
            Self::Zstd(zstd) => {
                zstd.planes.resize(mask.words().len() * 8, 0);
                let bytes = zstd.decompressor.decompress_to_buffer(body, &mut zstd.planes[..])?;
                ensure!(bytes == zstd.planes.len(), "zstd gave {bytes} bytes back");
                for (word, bytes) in mask.words_mut().iter_mut().zip(zstd.planes.as_chunks().0) {
                    *word = u64::from_le_bytes(*bytes);
                }
            }
        }
        Ok(())
    }
}

/// One value per frame.
#[derive(Default)]
struct Tally {
    bytes: Vec<f64>,
    packets: Vec<f64>,
    encode_ms: Vec<f64>,
    decode_ms: Vec<f64>,
    wrong_bits: u64,
}

impl Tally {
    fn add(&mut self, subject: &mut Subject, mask: &Mask, rounds: u32) -> Result<()> {
        let (mut body, mut decoded) = (EncodedFrame::default(), Mask::new(mask.shape()));
        let (mut encode_ms, mut decode_ms) = (f64::INFINITY, f64::INFINITY);
        let packetizer = Packetizer::new(MAX_PACKET_BYTES);
        for round in 0..rounds {
            subject.take(mask);
            let begun = Instant::now();
            subject.encode(mask, &mut body)?;
            encode_ms = encode_ms.min(begun.elapsed().as_secs_f64() * 1e3);
            // Later rounds know the mask's motion already.
            if round == 0 {
                self.bytes.push(packetizer.wire_bytes(&body) as f64);
                self.packets.push(packetizer.packet_count(&body) as f64);
            }
            let begun = Instant::now();
            subject.decode(&body, &mut decoded)?;
            decode_ms = decode_ms.min(begun.elapsed().as_secs_f64() * 1e3);
        }
        self.encode_ms.push(encode_ms);
        self.decode_ms.push(decode_ms);
        let differ = mask.words().iter().zip(decoded.words()).map(|(a, b)| u64::from((a ^ b).count_ones()));
        self.wrong_bits += differ.sum::<u64>();
        Ok(())
    }

    fn cells(&mut self) -> [String; 6] {
        self.bytes.sort_by(f64::total_cmp);
        let p99 = self.bytes[(self.bytes.len() * 99).div_ceil(100) - 1];
        [
            format!("{:.0}", mean(&self.bytes)),
            format!("{p99:.0}"),
            format!("{:.1}", mean(&self.packets)),
            format!("{:.2}", mean(&self.encode_ms)),
            format!("{:.2}", mean(&self.decode_ms)),
            // Counted over all bits, which include the relevant ones.
            self.wrong_bits.to_string(),
        ]
    }
}

/// Measures, writes `codec.csv`, and returns this scene's rows.
pub fn measure(options: &CodecOptions, mut progress: impl FnMut(&str)) -> Result<Table> {
    let CodecOptions { scene: args, rounds, lags, wrong_ppm, append } = options;
    let (scene, path) = (args.load_scene()?, args.load_path()?);
    let lights = u32::try_from(scene.lights.len()).context("more lights than a mask has")?;
    let (width, height) = args.size;
    let mut trace = BackendName::Cpu.open_at(&scene)?;
    let mut mask = Mask::new(MaskShape::new(width, height, lights)?);
    let subjects = Subject::all(lags, wrong_ppm, mask.shape())?.into_iter();
    let mut tallied: Vec<_> = subjects.map(|subject| (subject, Tally::default())).collect();
    let one_core = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    for frame in 0..args.frames {
        // At the middle of each frame's share of the path: at its beginning nothing moves.
        let time_s = path.duration_s() * (f64::from(frame) + 0.5) / f64::from(args.frames);
        let mut earlier = Vec::new();
        for &lag in lags {
            let mut mask = Mask::new(mask.shape());
            let then_s = time_s - f64::from(lag) / 60.0;
            trace(&path.camera(then_s, width, height), then_s, &mut mask)?;
            earlier.push((lag, mask));
        }
        trace(&path.camera(time_s, width, height), time_s, &mut mask)?;
        for (subject, tally) in &mut tallied {
            subject.refer(&earlier)?;
            let added = one_core.install(|| tally.add(subject, &mask, *rounds));
            added.with_context(|| format!("{} at {time_s:.3} s", subject.name()))?;
        }
        progress(&format!("frame {} of {}", frame + 1, args.frames));
    }

    let mut table = Table::new(HEAD);
    for (subject, mut tally) in tallied {
        let first =
            [args.scene_name(), path.name().to_owned(), lights.to_string(), subject.name(), subject.reference()];
        table.rows.push(first.into_iter().chain(tally.cells()).collect());
    }
    let mut text = table.csv();
    if *append {
        let before = std::fs::read_to_string(args.result("codec.csv")?).context("reading the table to append to")?;
        let head = Table::new(HEAD).csv();
        ensure!(before.starts_with(&head), "codec.csv has other columns");
        text.replace_range(..head.len(), &before);
    }
    args.write("codec.csv", &text)?;
    Ok(table)
}
