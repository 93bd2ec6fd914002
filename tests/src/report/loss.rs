//! `lab loss`: what lost packets do to the masks that a client shows, under either policy of the reassembler.
//!
//! A model of one session, on a clock of its own: 60 poses a second go up, the mask of each comes down, as packets of
//! 1161 bytes through [`Impairment`], and the client shows the newest that it has. There is no tracing time, no pacing and no
//! prediction, so that what differs between rows is loss alone. Losses are seeded: a second run gives the same figures.

use std::time::Duration;

use anyhow::{Context, Result, ensure};
use gnomon_protocol::{
    codec::{CodecId, Decoder, Encoder},
    ids::FrameNumber,
    limits::MAX_PACKET_BYTES,
    mask::{Mask, MaskShape},
    packetizer::Packetizer,
    reassembler::{Policy, Progress, Reassembler},
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

/// How long the rest of a frame may take after its first packet, as in the client.
const REST_PATIENCE: Duration = Duration::from_millis(25);

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
}

/// A frame on its way to the client.
struct Arriving {
    deliveries: Vec<Delivery>,
    packets: u64,
}

/// The client's side.
struct Viewer {
    reassembler: Reassembler,
    decoder: Decoder,
    policy: Policy,
    shown: Mask,
    /// When the frame at hand comes out as it is.
    deadline: Option<Duration>,
    outcome: Outcome,
}

impl Viewer {
    fn new(policy: Policy, shape: MaskShape) -> Self {
        Self {
            reassembler: Reassembler::new(policy),
            decoder: Decoder::new(),
            policy,
            shown: Mask::new(shape),
            deadline: None,
            outcome: Outcome::default(),
        }
    }

    /// Lets time pass.
    fn wait_until(&mut self, now: Duration) -> Result<()> {
        if self.deadline.is_some_and(|deadline| deadline <= now) {
            self.deadline = None;
            if self.reassembler.end() {
                self.take()?;
            }
        }
        Ok(())
    }

    fn receive(&mut self, delivery: &Delivery) -> Result<()> {
        self.wait_until(delivery.due)?;
        let later = delivery.due + REST_PATIENCE;
        match self.reassembler.push(&delivery.bytes)? {
            Progress::Complete => self.deadline = None,
            Progress::Partial => self.deadline = Some(later),
            Progress::Stored => self.deadline = self.deadline.or(Some(later)),
            Progress::Ignored(_) => {}
        }
        self.take()
    }

    /// Shows the frame that has come out, if one has.
    fn take(&mut self) -> Result<()> {
        let Some(frame) = self.reassembler.frame() else { return Ok(()) };
        match self.policy {
            Policy::WholeFrame => drop(self.decoder.decode(frame.body, &mut self.shown)?),
            Policy::Slices => drop(self.decoder.decode_onto(None, frame.body, &mut self.shown)?),
        }
        self.outcome.frames_whole += u32::from(frame.missing == 0);
        self.outcome.packets_used += u64::from(frame.packets);
        Ok(())
    }

    fn compare(&mut self, truth: &Mask) {
        let differ = self.shown.words().iter().zip(truth.words()).map(|(a, b)| u64::from((a ^ b).count_ones()));
        self.outcome.wrong_bits += differ.sum::<u64>();
        self.outcome.bits += truth.shape().pixels() as u64 * u64::from(truth.shape().lights());
    }
}

/// Cuts every mask into packets and sends them through the link.
fn send(masks: &[Mask], codec: CodecId, settings: Settings, seed: u64, rtt: Duration) -> Result<Vec<Arriving>> {
    let (mut encoder, mut packetizer) = (Encoder::new(codec), Packetizer::new(MAX_PACKET_BYTES));
    let (mut link, mut counts) = (Impairment::new(settings, seed, Direction::Down), Counts::default());
    let mut body = Vec::new();
    (0..)
        .zip(masks)
        .map(|(number, mask)| {
            encoder.encode(mask, &mut body)?;
            let mut now = moment(number) + rtt / 2;
            let (mut deliveries, mut packets) = (Vec::new(), 0);
            for packet in packetizer.packets(FrameNumber(number), number, &body)? {
                deliveries.extend(link.push(now, packet, &mut counts).into_iter().flatten());
                now += PACKET_GAP;
                packets += 1;
            }
            Ok(Arriving { deliveries, packets })
        })
        .collect()
}

/// When the pose of a frame leaves, and the client shows the newest mask that it has.
fn moment(frame: u32) -> Duration {
    Duration::from_secs_f64(f64::from(frame) / FPS)
}

fn watch(masks: &[Mask], arriving: &[Arriving], policy: Policy, rtt: Duration) -> Result<Outcome> {
    let first = masks.first().context("no frames")?;
    let mut viewer = Viewer::new(policy, first.shape());
    let mut deliveries = arriving.iter().flat_map(|frame| &frame.deliveries).peekable();
    // Until masks come there is nothing to compare.
    let begins = rtt + REST_PATIENCE + moment(2);
    for (frame, truth) in (0..).zip(masks) {
        let now = moment(frame);
        while let Some(delivery) = deliveries.next_if(|delivery| delivery.due <= now) {
            viewer.receive(delivery)?;
        }
        viewer.wait_until(now)?;
        if now >= begins {
            viewer.compare(truth);
        }
    }
    for delivery in deliveries {
        viewer.receive(delivery)?;
    }
    viewer.wait_until(Duration::MAX)?;
    let mut outcome = viewer.outcome;
    outcome.packets = arriving.iter().map(|frame| frame.packets).sum();
    Ok(outcome)
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
            let arriving = send(&masks, codec, settings, options.seed, rtt)?;
            for policy in [Policy::WholeFrame, Policy::Slices] {
                if policy == Policy::Slices && !codec.is_sliced() {
                    continue;
                }
                let outcome = watch(&masks, &arriving, policy, rtt)?;
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
