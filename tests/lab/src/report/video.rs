//! `lab video`: the same walk sent as pictures, and as visibility for the client to shade.
//!
//! Each shown picture is compared with the picture without a network. A video shows the picture of one round trip ago.
//! Our client draws the newest pose with predicted visibility of one round trip ago. Lag is counted in frames and
//! nothing is lost, which favours video.

mod stream;

pub use self::stream::VideoCodec;

use std::{collections::VecDeque, num::NonZero, path::PathBuf};

use anyhow::{Context, Result, ensure};
use gnomon_client::{camera_path::CameraPath, predictor::Predictor};
use gnomon_protocol::{
    codec::{CodecId, EncodedFrame, Encoder, Reference},
    ids::FrameNumber,
    limits::MAX_PACKET_BYTES,
    mask::Mask,
    packetizer::Packetizer,
};
use gnomon_scene::{camera::Camera, motion::Motion};
use image::RgbImage;
use rayon::prelude::*;

use self::stream::Stream;
use super::{
    plot::{Axis, Plot, Series},
    predict_rig::PredictRig,
    scene_args::SceneArgs,
    table::Table,
};
use crate::metrics::{image::compare, vmaf::vmaf};

/// Earlier poses that the server's extrapolation has seen.
const POSES_BEFORE: u32 = 12;

/// Visibility of the predicted view, as servers send it by default.
const AHEAD: &str = "visibility";
/// Visibility of the newest known view.
const BEHIND: &str = "visibility, not looking ahead";

#[derive(Debug, Clone, clap::Args)]
pub struct VideoOptions {
    /// Scene, path, size, and number of consecutive frames to measure.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Frames a second.
    #[arg(long, default_value_t = NonZero::<u32>::MIN.saturating_add(59))]
    pub fps: NonZero<u32>,
    /// Round trips, in milliseconds.
    #[arg(long, value_delimiter = ',', default_value = "0,60")]
    pub rtt: Vec<u32>,
    /// Video codecs: x264, x265.
    #[arg(long, value_delimiter = ',', default_value = "x264,x265")]
    pub video: Vec<VideoCodec>,
    /// Rates of the video, in Mbit/s.
    #[arg(long, value_delimiter = ',', default_value = "2,5,10,20,40")]
    pub rates: Vec<f64>,
    /// Preset of the video encoders.
    #[arg(long, default_value = "veryfast")]
    pub preset: String,
    /// Codecs of visibility.
    #[arg(long, value_delimiter = ',', default_value = "planes-lz4,tiles-fast,tiles-small")]
    pub codecs: Vec<CodecId>,
    /// Frames of video before the first measured one: the first is coded without a reference at the same rate.
    #[arg(long, default_value_t = 30)]
    pub warm: u32,
    /// ffmpeg for the video codecs; needs libvmaf for VMAF.
    #[arg(long, env = crate::metrics::vmaf::FFMPEG_VARIABLE, default_value = "ffmpeg")]
    pub ffmpeg: PathBuf,
    /// Allow a software adapter.
    #[arg(long)]
    pub allow_software: bool,
}

impl VideoOptions {
    /// Returns a round trip in frames, rounded up.
    fn lag(&self, rtt_ms: u32) -> u32 {
        (rtt_ms * self.fps.get()).div_ceil(1000)
    }
}

#[derive(Debug, Clone)]
struct Row {
    method: &'static str,
    setting: String,
    rtt_ms: u32,
    lag: u32,
    frame_bytes: f64,
    mbit_per_s: f64,
    quality: Quality,
}

#[derive(Debug, Clone)]
struct Quality {
    /// From the mean square error over all frames; infinite if all are exact.
    psnr_db: f64,
    ssim: f64,
    flip: f64,
    vmaf: Option<f64>,
}

impl Quality {
    fn of(shown: &[RgbImage], truths: &[RgbImage], fps: f64) -> Result<Self> {
        let errors: Vec<_> = shown.par_iter().zip(truths).map(|(shown, truth)| compare(shown, truth)).collect();
        #[expect(clippy::cast_precision_loss, reason = "some frames")]
        let mean = |of: &dyn Fn(usize) -> f64| (0..errors.len()).map(of).sum::<f64>() / errors.len() as f64;
        Ok(Self {
            psnr_db: -10.0 * mean(&|i| 10.0_f64.powf(-errors[i].psnr_db / 10.0)).log10(),
            ssim: mean(&|i| errors[i].ssim),
            flip: mean(&|i| errors[i].flip),
            vmaf: vmaf(shown, truths, fps)?,
        })
    }
}

/// Measures, writes `video.csv` and its plots, and reports each row to `progress`.
pub fn measure(options: &VideoOptions, mut progress: impl FnMut(&str)) -> Result<Table> {
    ensure!(!options.rtt.is_empty(), "--rtt needs a value");
    for codec in &options.video {
        stream::check(&options.ffmpeg, *codec)?;
    }
    let mut bench = Bench::new(options)?;
    progress(&format!("{} frames drawn without a network", bench.truths.len()));
    let mut rows = Vec::new();
    for &codec in &options.video {
        for &rate in &options.rates {
            rows.extend(bench.video(codec, rate)?);
            progress(&format!("{codec} at {rate} Mbit/s"));
        }
    }
    for &rtt_ms in &options.rtt {
        rows.extend(bench.split(rtt_ms, AHEAD)?);
        if options.lag(rtt_ms) > 0 {
            rows.extend(bench.split(rtt_ms, BEHIND)?);
        }
        progress(&format!("visibility, {rtt_ms} ms"));
    }
    rows.push(bench.without_server()?);
    let table = table(options, bench.path.name(), &rows);
    options.scene.write("video.csv", &table.csv())?;
    draw(options, &rows)?;
    Ok(table)
}

/// An encoder, and the masks that the client has not acknowledged.
struct Sender {
    encoder: Encoder,
    packetizer: Packetizer,
    body: EncodedFrame,
    /// Masks in flight, oldest first. The oldest is acknowledged once there are as many as a round trip takes, plus
    /// one.
    sent: VecDeque<Reference>,
    acknowledged_after: usize,
}

impl Sender {
    fn new(codec: CodecId, lag: u32) -> Self {
        Self {
            encoder: Encoder::new(codec),
            packetizer: Packetizer::new(MAX_PACKET_BYTES),
            body: EncodedFrame::default(),
            sent: VecDeque::new(),
            acknowledged_after: lag as usize + 1,
        }
    }

    /// Returns the mask's bytes on the wire, with headers.
    fn send(&mut self, frame: FrameNumber, mask: &Mask) -> Result<f64> {
        let reference = self.sent.front().filter(|_| self.sent.len() == self.acknowledged_after);
        self.encoder.encode_for(None, reference, mask, &mut self.body)?;
        let mut reference =
            if self.sent.len() == self.acknowledged_after { self.sent.pop_front() } else { None }.unwrap_or_default();
        if self.encoder.keep(frame, &mut reference) {
            self.sent.push_back(reference);
        }
        #[expect(clippy::cast_precision_loss, reason = "bytes of a frame")]
        let bytes = self.packetizer.wire_bytes(&self.body) as f64;
        Ok(bytes)
    }
}

struct Bench<'a> {
    options: &'a VideoOptions,
    rig: PredictRig,
    path: CameraPath,
    /// Covers all frames, measured or not.
    truths: Vec<RgbImage>,
    first: u32,
}

impl<'a> Bench<'a> {
    fn new(options: &'a VideoOptions) -> Result<Self> {
        let path = options.scene.load_path()?;
        let lag = options.rtt.iter().map(|&rtt| options.lag(rtt)).max().unwrap_or(0);
        let first = options.warm.max(POSES_BEFORE) + lag;
        let frames = first + options.scene.frames;
        let duration_s = f64::from(frames) / f64::from(options.fps.get());
        ensure!(
            duration_s <= path.duration_s(),
            "{frames} frames (--warm, the lag and --frames) take {duration_s:.2} s, camera path {:?} only {:.2} s",
            path.name(),
            path.duration_s()
        );
        let mut rig = PredictRig::new(&options.scene.load_scene()?, options.scene.size, options.allow_software)?;
        let mut truth = |frame: u32| {
            rig.set_time(time_s(options, frame));
            rig.true_picture(&camera(&path, options, frame))
        };
        let truths = (0..frames).map(&mut truth).collect::<Result<_>>()?;
        Ok(Self { options, rig, path, truths, first })
    }

    fn fps(&self) -> f64 {
        f64::from(self.options.fps.get())
    }

    fn measured(&self) -> std::ops::Range<usize> {
        self.first as usize..self.truths.len()
    }

    /// Measures video after each round trip.
    fn video(&self, codec: VideoCodec, rate: f64) -> Result<Vec<Row>> {
        let options = self.options;
        let stream = Stream::encode(&options.ffmpeg, codec, (rate, &options.preset), self.fps(), &self.truths)?;
        let frames = stream.decode()?;
        let measured = self.measured();
        let bytes = &stream.frame_bytes()[measured.clone()];
        #[expect(clippy::cast_precision_loss, reason = "bytes of a frame")]
        let bytes = bytes.iter().map(|&bytes| bytes as f64).sum::<f64>() / bytes.len() as f64;
        let seen = |rtt_ms: u32| {
            let lag = options.lag(rtt_ms);
            let shown = &frames[measured.start - lag as usize..measured.end - lag as usize];
            let quality = Quality::of(shown, &self.truths[measured.clone()], self.fps())?;
            Ok(self.row("video", format!("{codec} {rate} Mbit/s"), rtt_ms, bytes, quality))
        };
        options.rtt.iter().map(|&rtt_ms| seen(rtt_ms)).collect()
    }

    /// Measures visibility from a server one round trip away. Every codec shows the same pictures.
    fn split(&mut self, rtt_ms: u32, method: &'static str) -> Result<Vec<Row>> {
        let options = self.options;
        let lag = options.lag(rtt_ms);
        let mut senders: Vec<Sender> = options.codecs.iter().map(|&codec| Sender::new(codec, lag)).collect();
        let mut bytes = vec![0.0; senders.len()];
        let mut shown = Vec::new();
        for frame in self.first..self.first + options.scene.frames {
            let traced_for = self.traced_for(frame, lag, method);
            self.rig.set_time(time_s(options, frame));
            // The server looks ahead in time, too.
            self.rig.set_mask_time(time_s(options, if method == BEHIND { frame - lag } else { frame }));
            let mask: Mask = self.rig.trace(&traced_for)?;
            for (sender, bytes) in senders.iter_mut().zip(&mut bytes) {
                *bytes += sender.send(FrameNumber(frame), &mask)? / f64::from(options.scene.frames);
            }
            let camera = camera(&self.path, options, frame);
            shown.push(self.rig.draw(&camera, Predictor::Surface, Some((&mask, &traced_for)))?.0);
        }
        let quality = Quality::of(&shown, &self.truths[self.measured()], self.fps())?;
        let row = |(codec, bytes): (&CodecId, f64)| self.row(method, codec.to_string(), rtt_ms, bytes, quality.clone());
        Ok(options.codecs.iter().zip(bytes).map(row).collect())
    }

    fn without_server(&mut self) -> Result<Row> {
        let mut shown = Vec::new();
        for frame in self.first..self.first + self.options.scene.frames {
            let camera = camera(&self.path, self.options, frame);
            self.rig.set_time(time_s(self.options, frame));
            shown.push(self.rig.draw(&camera, Predictor::Surface, None)?.0);
        }
        let quality = Quality::of(&shown, &self.truths[self.measured()], self.fps())?;
        Ok(self.row("no server", "shadow maps".to_owned(), 0, 0.0, quality))
    }

    /// Returns the camera that the server traces for `frame`, extrapolated from the poses that it knew `lag` frames
    /// before.
    fn traced_for(&self, frame: u32, lag: u32, method: &str) -> Camera {
        let newest = camera(&self.path, self.options, frame - lag);
        if method == BEHIND {
            return newest;
        }
        let mut motion = Motion::default();
        for frame in frame - lag - POSES_BEFORE..=frame - lag {
            motion.push(time_s(self.options, frame), camera(&self.path, self.options, frame));
        }
        motion.extrapolate(time_s(self.options, frame)).unwrap_or(newest)
    }

    fn row(&self, method: &'static str, setting: String, rtt_ms: u32, frame_bytes: f64, quality: Quality) -> Row {
        let lag = self.options.lag(rtt_ms);
        Row { method, setting, rtt_ms, lag, frame_bytes, mbit_per_s: frame_bytes * 8e-6 * self.fps(), quality }
    }
}

fn camera(path: &CameraPath, options: &VideoOptions, frame: u32) -> Camera {
    let (width, height) = options.scene.size;
    path.camera(time_s(options, frame), width, height)
}

fn time_s(options: &VideoOptions, frame: u32) -> f64 {
    f64::from(frame) / f64::from(options.fps.get())
}

fn table(options: &VideoOptions, path: &str, rows: &[Row]) -> Table {
    let mut table = Table::new(
        "scene | path | size | fps | method | setting | rtt_ms | lag | frame_bytes | mbit_per_s | psnr \
         | ssim | flip | vmaf",
    );
    table.rows.extend(rows.iter().map(|row| {
        vec![
            options.scene.scene_name(),
            path.to_owned(),
            format!("{}x{}", options.scene.size.0, options.scene.size.1),
            options.fps.to_string(),
            row.method.to_owned(),
            row.setting.clone(),
            row.rtt_ms.to_string(),
            row.lag.to_string(),
            format!("{:.0}", row.frame_bytes),
            format!("{:.2}", row.mbit_per_s),
            format!("{:.2}", row.quality.psnr_db),
            format!("{:.4}", row.quality.ssim),
            format!("{:.4}", row.quality.flip),
            row.quality.vmaf.map(|vmaf| format!("{vmaf:.2}")).unwrap_or_default(),
        ]
    }));
    table
}

/// Draws `video_*.svg`: quality against rate, one line per codec and round trip.
fn draw(options: &VideoOptions, rows: &[Row]) -> Result<()> {
    type Quantity = (&'static str, &'static str, fn(&Quality) -> f64);
    let quantities: [Quantity; 4] = [
        ("psnr", "PSNR, dB", |quality| quality.psnr_db),
        ("ssim", "SSIM", |quality| quality.ssim),
        ("flip", "FLIP", |quality| quality.flip),
        ("vmaf", "VMAF", |quality| quality.vmaf.unwrap_or(f64::NAN)),
    ];
    for (name, label, value) in quantities {
        let line = |title: String, wanted: &dyn Fn(&Row) -> bool| {
            let points = rows.iter().filter(|row| wanted(row)).map(|row| (row.mbit_per_s, value(&row.quality)));
            Series::line(&title, points.filter(|(_, quality)| quality.is_finite()).collect())
        };
        let mut series = Vec::new();
        for &rtt_ms in &options.rtt {
            for codec in &options.video {
                series.push(line(format!("{codec}, RTT {rtt_ms} ms"), &|row| {
                    row.rtt_ms == rtt_ms && row.method == "video" && row.setting.starts_with(&codec.to_string())
                }));
            }
            for method in [AHEAD, BEHIND] {
                series.push(line(format!("{method}, RTT {rtt_ms} ms"), &|row| {
                    row.rtt_ms == rtt_ms && row.method == method
                }));
            }
        }
        series.retain(|series| !series.points.is_empty());
        if series.is_empty() {
            continue;
        }
        let title = format!("{}: {name} against rate", options.scene.scene_name());
        let plot = Plot::new(&title, Axis::log("Mbit/s"), Axis::linear(label), series);
        options.scene.write(&format!("video_{name}.svg"), &plot.svg()?).context("the plot")?;
    }
    Ok(())
}
