//! `lab loss`: what lost packets do to the masks that a client shows, under either policy of the reassembler.
//!
//! A model of one session, on a clock of its own: 60 poses a second go up, the mask of each comes down, as packets of
//! 1161 bytes through [`Impairment`], and the client shows the newest that it has. There is no tracing time, no pacing and no
//! prediction, so that what differs between rows is loss alone. What the client says of the masks that it has is lost as often.
//! Losses are seeded: a second run gives the same figures.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use anyhow::{Context, Result, ensure};
use bytes::Bytes;
use gnomon_protocol::{
    acknowledgement::Acknowledgement,
    codec::{CodecId, DecodeError, Decoder, Encoder},
    frame::Frame,
    header::PacketHeader,
    ids::FrameNumber,
    limits::MAX_PACKET_BYTES,
    mask::{Mask, MaskShape},
    packetizer::Packetizer,
    reassembler::{Deadline, Policy, Progress, Reassembler},
    references::{KeptMasks, SentMasks},
};

use super::{scene_args::SceneArgs, table::Table};
use crate::{
    backends::BackendName,
    link::{
        Counts,
        impairment::{Delivery, Direction, Impairment},
        settings::{Burst, Settings},
    },
};

/// Poses a second.
const FPS: f64 = 60.0;

/// Between two packets of a frame.
const PACKET_GAP: Duration = Duration::from_micros(50);

/// What to measure.
#[derive(Debug, Clone, clap::Args)]
pub struct LossOptions {
    /// Scene, path, size, and how many frames of the path are sent, from its beginning.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Losses, in per cent of the packets.
    #[arg(long, value_delimiter = ',', default_value = "0,1,5")]
    pub loss: Vec<f64>,
    /// Mean lengths of the bursts in which packets are lost; 1 for losses each for itself.
    #[arg(long, value_delimiter = ',', default_value = "1,8")]
    pub burst: Vec<f64>,
    /// Round trip, in milliseconds.
    #[arg(long, default_value_t = 40.0)]
    pub rtt_ms: f64,
    /// Codecs; those whose frames are sliced are measured under both policies.
    #[arg(long, value_delimiter = ',', default_value = "planes-lz4,tiles-small,tiles-fast")]
    pub codecs: Vec<CodecId>,
    /// Seed of the losses.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// What a session came to.
#[derive(Debug, Default)]
struct Outcome {
    frames_whole: u32,
    /// Packets' worth of tiles that were shown in time, and all.
    packets_used: u64,
    packets: u64,
    wrong_bits: u64,
    bits: u64,
    /// Bytes of all packets.
    bytes: u64,
}

/// The client's side.
struct Viewer {
    reassembler: Reassembler,
    decoder: Decoder,
    references: KeptMasks,
    said: Option<Acknowledgement>,
    policy: Policy,
    shown: Mask,
    /// When the frame at hand comes out as it is, on a clock that began then.
    deadline: Deadline,
    begun: Instant,
    /// The frame that came out last, and its packets.
    counted: Option<(FrameNumber, u16)>,
    outcome: Outcome,
}

impl Viewer {
    fn new(policy: Policy, shape: MaskShape) -> Self {
        Self {
            reassembler: Reassembler::new(policy),
            decoder: Decoder::new(),
            references: KeptMasks::default(),
            said: None,
            policy,
            shown: Mask::new(shape),
            deadline: Deadline::default(),
            begun: Instant::now(),
            counted: None,
            outcome: Outcome::default(),
        }
    }

    /// Lets time pass.
    fn wait_until(&mut self, now: Duration) -> Result<()> {
        if self.deadline.due().is_some_and(|due| due <= self.begun + now) {
            self.deadline.given();
            if self.reassembler.so_far() {
                self.take()?;
            }
        }
        Ok(())
    }

    fn receive(&mut self, delivery: &Delivery) -> Result<()> {
        self.wait_until(delivery.due)?;
        let progress = self.reassembler.push(&delivery.bytes)?;
        if let (Some(frame), Policy::Slices) = (PacketHeader::decode(&delivery.bytes)?.0.frame, self.policy)
            && !matches!(progress, Progress::Ignored(_))
        {
            self.deadline.stored(self.begun + delivery.due, frame, progress == Progress::Complete);
        }
        self.take()
    }

    /// Shows the frame that has come out, if one has.
    fn take(&mut self) -> Result<()> {
        let Some(frame) = self.reassembler.frame() else { return Ok(()) };
        let named = Frame::parse(frame.body)?.head.reference;
        let reference = named.and_then(|name| self.references.reference(name));
        let decoded = match self.policy {
            Policy::WholeFrame => self.decoder.decode_against(reference, frame.body, &mut self.shown),
            Policy::Slices if frame.known_bytes == 0 => {
                self.decoder.decode_onto(reference, frame.body, &mut self.shown)
            }
            Policy::Slices => self.decoder.decode_more(reference, &frame.body[frame.known_bytes..], &mut self.shown),
        };
        match decoded {
            Err(DecodeError::Reference(_)) => {
                self.said = Some(self.references.lose());
                return Ok(());
            }
            decoded => decoded?,
        };
        self.said = self.references.keep(&self.decoder, frame.frame).or(self.said);
        self.outcome.frames_whole += u32::from(frame.missing == 0);
        // Of a frame that comes out once more, what is new.
        let before = self.counted.filter(|(number, _)| *number == frame.frame).map_or(0, |(_, packets)| packets);
        self.outcome.packets_used += u64::from(frame.packets - before);
        self.counted = Some((frame.frame, frame.packets));
        Ok(())
    }

    fn compare(&mut self, truth: &Mask) {
        let differ = self.shown.words().iter().zip(truth.words()).map(|(a, b)| u64::from((a ^ b).count_ones()));
        self.outcome.wrong_bits += differ.sum::<u64>();
        self.outcome.bits += truth.shape().pixels() as u64 * u64::from(truth.shape().lights());
    }
}

/// The server's side, and the link between both.
struct Sender {
    encoder: Encoder,
    packetizer: Packetizer,
    references: SentMasks,
    down: Impairment,
    up: Impairment,
    counts: Counts,
    body: Vec<u8>,
}

impl Sender {
    fn new(codec: CodecId, settings: &Settings, seed: u64) -> Self {
        Self {
            encoder: Encoder::new(codec),
            packetizer: Packetizer::new(MAX_PACKET_BYTES),
            references: SentMasks::default(),
            down: Impairment::new(settings.clone(), seed, Direction::Down),
            up: Impairment::new(settings.clone(), seed, Direction::Up),
            counts: Counts::default(),
            body: Vec::new(),
        }
    }

    /// Cuts a mask into packets and sends them through the link.
    fn send(&mut self, number: u32, mut now: Duration, mask: &Mask, outcome: &mut Outcome) -> Result<Vec<Delivery>> {
        self.encoder.encode_for(None, self.references.reference(), mask, &mut self.body)?;
        self.references.keep(&self.encoder, FrameNumber(number));
        let mut deliveries = Vec::new();
        for packet in self.packetizer.packets(FrameNumber(number), number, &self.body)? {
            (outcome.packets, outcome.bytes) = (outcome.packets + 1, outcome.bytes + packet.len() as u64);
            deliveries.extend(self.down.push(now, packet, &mut self.counts).into_iter().flatten());
            now += PACKET_GAP;
        }
        Ok(deliveries)
    }
}

/// When the pose of a frame leaves, and the client shows the newest mask that it has.
fn moment(frame: u32) -> Duration {
    Duration::from_secs_f64(f64::from(frame) / FPS)
}

fn run(masks: &[Mask], codec: CodecId, policy: Policy, link: (&Settings, u64), rtt: Duration) -> Result<Outcome> {
    let first = masks.first().context("no frames")?;
    let (mut viewer, mut sender) = (Viewer::new(policy, first.shape()), Sender::new(codec, link.0, link.1));
    let (mut deliveries, mut said) = (VecDeque::<Delivery>::new(), VecDeque::<Delivery>::new());
    // Until masks come there is nothing to compare.
    let begins = rtt + moment(3);
    // A frame is shown, and asked for; half a round trip later its mask is sent.
    let shown = (0..).zip(masks).map(|(frame, mask)| (moment(frame), frame, mask, false));
    let sent = (0..).zip(masks).map(|(frame, mask)| (moment(frame) + rtt / 2, frame, mask, true));
    let mut events: Vec<_> = shown.chain(sent).collect();
    events.sort_by_key(|(time, ..)| *time);
    for (now, frame, mask, is_sent) in events {
        while let Some(delivery) = deliveries.pop_front_if(|delivery| delivery.due <= now) {
            viewer.receive(&delivery)?;
            if let Some(word) = viewer.said.take() {
                let word = Bytes::copy_from_slice(&word.encode());
                said.extend(sender.up.push(delivery.due, word, &mut sender.counts).into_iter().flatten());
            }
        }
        viewer.wait_until(now)?;
        if is_sent {
            while let Some(heard) = said.pop_front_if(|heard| heard.due <= now) {
                sender.references.acknowledge(Acknowledgement::decode(&heard.bytes)?);
            }
            deliveries.extend(sender.send(frame, now, mask, &mut viewer.outcome)?);
        } else if now >= begins {
            viewer.compare(mask);
        }
    }
    for delivery in deliveries {
        viewer.receive(&delivery)?;
    }
    viewer.wait_until(moment(masks.len().try_into()?) + rtt * 2)?;
    Ok(viewer.outcome)
}

/// Measures, writes `loss.csv`, and tells `progress` where it is.
///
/// # Errors
/// When the scene or the path cannot be read, a frame cannot be coded, or the table cannot be written.
pub fn measure(options: &LossOptions, mut progress: impl FnMut(&str)) -> Result<Table> {
    let args = &options.scene;
    ensure!(options.loss.iter().all(|loss| (0.0..100.0).contains(loss)), "a loss is 0 to below 100 per cent");
    ensure!(options.burst.iter().all(|length| *length >= 1.0), "a burst is at least 1 packet long");
    let (scene, path) = (args.load_scene()?, args.load_path()?);
    let lights = u32::try_from(scene.lights.len()).context("more lights than a mask has")?;
    let (width, height) = args.size;
    let mut trace = BackendName::Cpu.open(&scene)?;
    let mut masks = Vec::new();
    for frame in 0..args.frames {
        let mut mask = Mask::new(MaskShape::new(width, height, lights)?);
        trace(&path.camera(f64::from(frame) / FPS, width, height), &mut mask)?;
        masks.push(mask);
        progress(&format!("frame {} of {}", frame + 1, args.frames));
    }

    let rtt = Duration::from_secs_f64(options.rtt_ms / 1e3);
    let mut table = Table::new(&[
        "transport",
        "codec",
        "policy",
        "fec",
        "loss",
        "burst",
        "rtt_ms",
        "frames_whole",
        "tiles_in_time",
        "bit_error",
        "mean_bytes",
    ]);
    for &codec in &options.codecs {
        for (&loss, &burst) in options.loss.iter().flat_map(|loss| options.burst.iter().map(move |burst| (loss, burst)))
        {
            if loss == 0.0 && burst > 1.0 {
                continue;
            }
            let share = loss / 100.0;
            let settings = Settings {
                delay: rtt / 2,
                loss: if burst > 1.0 { 0.0 } else { share },
                burst: (burst > 1.0).then_some(Burst { share, length: burst, loss: 1.0 }),
                ..Settings::default()
            };
            for policy in [Policy::WholeFrame, Policy::Slices] {
                if policy == Policy::Slices && !codec.is_sliced() {
                    continue;
                }
                let outcome = run(&masks, codec, policy, (&settings, options.seed), rtt)?;
                let policy = if policy == Policy::Slices { "slices" } else { "whole-frame" };
                table.rows.push(vec![
                    "model".into(),
                    codec.to_string(),
                    policy.into(),
                    "none".into(),
                    format!("{loss}"),
                    format!("{burst}"),
                    format!("{}", options.rtt_ms),
                    share_of(outcome.frames_whole.into(), masks.len() as u64),
                    share_of(outcome.packets_used, outcome.packets),
                    share_of(outcome.wrong_bits, outcome.bits),
                    (outcome.bytes / masks.len() as u64).to_string(),
                ]);
            }
        }
    }
    args.write("loss.csv", &table.csv())?;
    Ok(table)
}

/// A share in per cent.
fn share_of(part: u64, all: u64) -> String {
    format!("{:.4}", 100.0 * part as f64 / all.max(1) as f64)
}
