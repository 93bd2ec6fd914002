//! `lab loss`: what lost packets do to the masks that a client shows, by what is done about them.
//!
//! `model` is a model of one session, on a clock of its own: 60 poses a second go up, the mask of each comes down, as packets of
//! 1161 bytes through [`Impairment`], and the client shows the newest that it has. There is no tracing time, no pacing and no
//! prediction, so that what differs between rows is loss alone. What the client says of its masks and packets is lost as often.
//! Losses are seeded: a second run gives the same figures. `quic` is the real server and the real client ([`transport`]).

mod transport;

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use anyhow::{Context, Result, ensure};
use bytes::Bytes;
use gnomon_protocol::{
    acknowledgement::Acknowledgement,
    codec::{CodecId, DecodeError, Encoder},
    coverage::Coverage,
    fec::{PARITY_ROOM_BYTES, ParityEncoder, parity_packets},
    ids::FrameNumber,
    limits::MAX_PACKET_BYTES,
    loss::{LossEstimate, LossFeedback},
    mask::{Mask, MaskShape},
    packetizer::Packetizer,
    reassembler::Policy,
    receive::{BadFrame, BadFrameReason, FrameReceiver, ReceiverConfig},
    references::SentMasks,
};

use gnomon_client::link::receive_options::Packets;

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

/// The transport that is none.
const MODEL: &str = "model";

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
    /// What carries the masks: model, quic or lab-udp.
    #[arg(long, value_delimiter = ',', default_value = "model")]
    pub transport: Vec<String>,
    /// What is done about lost packets: whole-frame, slices, parity. Codecs whose frames are not sliced know whole frames only.
    #[arg(long, value_delimiter = ',', default_value = "whole-frame,slices,parity")]
    pub packets: Vec<Packets>,
    /// Frames at the beginning that do not count: what is lost has to be measured first.
    #[arg(long, default_value_t = 120)]
    pub warm_up: u32,
    /// The real server's back end: auto, compute or cpu.
    #[arg(long, default_value = "auto")]
    pub backend: String,
    /// More of the link, both ways, as `lab link` takes it: rate=10Mbit queue=100ms for instance.
    #[arg(long, default_value = "", hide_default_value = true)]
    pub link: String,
    /// Pictures of each real run that the referee judges.
    #[arg(long, default_value_t = 40)]
    pub samples: u32,
    /// Lets the real programs use a software adapter.
    #[arg(long)]
    pub allow_software: bool,
    /// Codecs.
    #[arg(long, value_delimiter = ',', default_value = "planes-lz4,tiles-small,tiles-fast")]
    pub codecs: Vec<CodecId>,
    /// Seed of the losses.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// What a session came to.
#[derive(Debug, Default)]
struct Outcome {
    frames: u32,
    frames_whole: u32,
    /// Packets' worth of tiles that were shown in time, and all.
    packets_used: u64,
    packets: u64,
    wrong_bits: u64,
    bits: u64,
    /// Bytes of all packets.
    bytes: u64,
    /// Of real runs: frames that masks were older than their pictures, 99 times of 100, and datagrams that the link's queue dropped
    /// of those that came to it.
    lag_p99: Option<f64>,
    dropped: [u64; 2],
}

/// The client's side.
struct Viewer {
    receiver: FrameReceiver,
    /// Start of the receiver's clock.
    begun: Instant,
    warm_up: u32,
    shown: Mask,
    coverage: Coverage,
    /// The frame that was delivered last, and its packets.
    counted: Option<(FrameNumber, u16)>,
    outcome: Outcome,
}

impl Viewer {
    fn new(packets: Packets, warm_up: u32, shape: MaskShape) -> Self {
        let receiver = FrameReceiver::new(ReceiverConfig {
            policy: if packets == Packets::WholeFrame { Policy::WholeFrame } else { Policy::Slices },
            largest: shape,
            keeps_references: true,
            reports_losses: packets == Packets::Parity,
        });
        Self {
            receiver,
            begun: Instant::now(),
            warm_up,
            shown: Mask::new(shape),
            coverage: Coverage::whole(shape),
            counted: None,
            outcome: Outcome::default(),
        }
    }

    fn wait_until(&mut self, now: Duration) -> Result<()> {
        self.receiver.handle_timeout(self.begun + now);
        self.show_frame()
    }

    fn receive(&mut self, delivery: &Delivery) -> Result<()> {
        self.wait_until(delivery.due)?;
        self.receiver.push(&delivery.bytes, self.begun + delivery.due)?;
        self.show_frame()
    }

    /// Shows the frame that was delivered, if one was.
    fn show_frame(&mut self) -> Result<()> {
        let frame = match self.receiver.poll_frame(&mut self.shown, &mut self.coverage) {
            Ok(Some(frame)) => frame,
            Ok(None) | Err(BadFrame { reason: BadFrameReason::Decode(DecodeError::Reference(_)), .. }) => return Ok(()),
            Err(error) => return Err(error.into()),
        };
        if frame.frame.0 < self.warm_up {
            return Ok(());
        }
        self.outcome.frames_whole += u32::from(frame.missing == 0);
        // Of a frame that is delivered again, only the new packets.
        let before = self.counted.filter(|(number, _)| *number == frame.frame).map_or(0, |(_, packets)| packets);
        self.outcome.packets_used += u64::from(frame.packets - before);
        self.counted = Some((frame.frame, frame.packets));
        Ok(())
    }

    /// Acknowledgements and loss feedback to send.
    fn feedback(&mut self) -> impl Iterator<Item = Bytes> {
        let acknowledgement = self.receiver.poll_acknowledgement().map(|word| Bytes::copy_from_slice(&word.encode()));
        let losses = self.receiver.poll_loss_feedback().map(|word| Bytes::copy_from_slice(&word.encode()));
        acknowledgement.into_iter().chain(losses)
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
    losses: LossEstimate,
    parity: ParityEncoder,
    begun: Instant,
    down: Impairment,
    up: Impairment,
    counts: Counts,
    body: Vec<u8>,
}

impl Sender {
    fn new(codec: CodecId, settings: &Settings, seed: u64) -> Self {
        Self {
            encoder: Encoder::new(codec).for_packets_of(MAX_PACKET_BYTES - PARITY_ROOM_BYTES),
            packetizer: Packetizer::new(MAX_PACKET_BYTES),
            references: SentMasks::default(),
            losses: LossEstimate::default(),
            parity: ParityEncoder::default(),
            begun: Instant::now(),
            down: Impairment::new(settings.clone(), seed, Direction::Down),
            up: Impairment::new(settings.clone(), seed, Direction::Up),
            counts: Counts::default(),
            body: Vec::new(),
        }
    }

    /// Hears what the client says.
    fn hear(&mut self, heard: &Delivery) -> Result<()> {
        if let Ok(feedback) = LossFeedback::decode(&heard.bytes) {
            self.losses.hear(self.begun + heard.due, feedback);
        } else {
            self.references.acknowledge(Acknowledgement::decode(&heard.bytes)?);
        }
        Ok(())
    }

    /// Cuts a mask into packets, adds parity, and sends them through the link.
    fn send(&mut self, number: u32, mut now: Duration, mask: &Mask, outcome: &mut Outcome) -> Result<Vec<Delivery>> {
        self.encoder.encode_for(None, self.references.reference(), mask, &mut self.body)?;
        self.references.keep(&self.encoder, FrameNumber(number));
        let mut deliveries = Vec::new();
        let mut packets: Vec<Bytes> = self.packetizer.packets(FrameNumber(number), number, &self.body)?.collect();
        outcome.frames += 1;
        outcome.packets += packets.len() as u64;
        let parity = parity_packets(self.losses.model(), packets.len());
        let parity = self.parity.encode(self.packetizer.pieces(&self.body), parity);
        packets.extend(self.packetizer.parity_packets(FrameNumber(number), number, parity));
        for packet in packets {
            outcome.bytes += packet.len() as u64;
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

/// Runs a session of these masks, of which the first `warm_up` do not count.
fn run(
    masks: &[Mask],
    (codec, packets, warm_up): (CodecId, Packets, u32),
    link: (&Settings, u64),
    rtt: Duration,
) -> Result<Outcome> {
    let first = masks.first().context("no frames")?;
    let (mut viewer, mut sender) = (Viewer::new(packets, warm_up, first.shape()), Sender::new(codec, link.0, link.1));
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
            for word in viewer.feedback() {
                said.extend(sender.up.push(delivery.due, word, &mut sender.counts).into_iter().flatten());
            }
        }
        viewer.wait_until(now)?;
        if is_sent {
            while let Some(heard) = said.pop_front_if(|heard| heard.due <= now) {
                sender.hear(&heard)?;
            }
            let mut before = Outcome::default();
            let outcome = if frame < warm_up { &mut before } else { &mut viewer.outcome };
            deliveries.extend(sender.send(frame, now, mask, outcome)?);
        } else {
            viewer.receiver.request(FrameNumber(frame));
            if now >= begins && frame >= warm_up {
                viewer.compare(mask);
            }
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
    ensure!(options.warm_up < args.frames, "--warm-up leaves nothing of {} frames", args.frames);
    let (scene, path) = (args.load_scene()?, args.load_path()?);
    let lights = u32::try_from(scene.lights.len()).context("more lights than a mask has")?;
    let (width, height) = args.size;
    let mut trace = BackendName::Cpu.open(&scene)?;
    let mut masks = Vec::new();
    let modelled = if options.transport.iter().any(|name| name == MODEL) { args.frames } else { 0 };
    for frame in 0..modelled {
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
        "lag_p99",
        "queue_dropped",
    ]);
    for transport in &options.transport {
        let mut real = if transport == MODEL { None } else { Some(transport::Stage::new(options, transport)?) };
        for &codec in &options.codecs {
            for (&loss, &burst) in
                options.loss.iter().flat_map(|loss| options.burst.iter().map(move |burst| (loss, burst)))
            {
                if loss == 0.0 && burst > 1.0 {
                    continue;
                }
                let share = loss / 100.0;
                let mut settings = Settings {
                    delay: rtt / 2,
                    loss: if burst > 1.0 { 0.0 } else { share },
                    burst: (burst > 1.0).then_some(Burst { share, length: burst, loss: 1.0 }),
                    ..Settings::default()
                };
                settings.set(&options.link).context("--link")?;
                for &packets in &options.packets {
                    if packets != Packets::WholeFrame && !codec.is_sliced() {
                        continue;
                    }
                    let outcome = match &mut real {
                        None => run(&masks, (codec, packets, options.warm_up), (&settings, options.seed), rtt)?,
                        Some(stage) => stage.run(codec, packets, &settings)?,
                    };
                    let [policy, fec] = match packets {
                        Packets::WholeFrame => ["whole-frame", "none"],
                        Packets::Slices => ["slices", "none"],
                        Packets::Parity => ["slices", "parity"],
                    };
                    let row = vec![
                        transport.clone(),
                        codec.to_string(),
                        policy.into(),
                        fec.into(),
                        format!("{loss}"),
                        format!("{burst}"),
                        format!("{}", options.rtt_ms),
                        share_of(outcome.frames_whole.into(), outcome.frames.into()),
                        share_of(outcome.packets_used, outcome.packets),
                        share_of(outcome.wrong_bits, outcome.bits),
                        (outcome.bytes / u64::from(outcome.frames.max(1))).to_string(),
                        outcome.lag_p99.map(|lag| lag.to_string()).unwrap_or_default(),
                        share_of(outcome.dropped[0], outcome.dropped[1]),
                    ];
                    progress(&row.join(","));
                    table.rows.push(row);
                }
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
