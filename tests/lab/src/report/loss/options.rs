//! Options, and the outcome of a session.

use gnomon_client::link::receive_options::Packets;
use gnomon_protocol::codec::CodecId;

use crate::report::scene_args::SceneArgs;

/// Poses a second.
pub(super) const FPS: f64 = 60.0;

#[derive(Debug, Clone, clap::Args)]
pub struct LossOptions {
    /// Scene, path, size, and how many frames of the path are sent, from its beginning.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Losses, in per cent of the packets.
    #[arg(long, value_delimiter = ',', default_value = "0,1,5")]
    pub loss: Vec<f64>,
    /// Mean lengths of loss bursts in packets; 1 for independent losses.
    #[arg(long, value_delimiter = ',', default_value = "1,8")]
    pub burst: Vec<f64>,
    /// Round trip, in milliseconds.
    #[arg(long, default_value_t = 40.0)]
    pub rtt_ms: f64,
    /// Transports: model, quic or lab-udp.
    #[arg(long, value_delimiter = ',', default_value = "model")]
    pub transport: Vec<String>,
    /// Countermeasures: whole-frame, slices, parity. Codecs without slices support whole-frame only.
    #[arg(long, value_delimiter = ',', default_value = "whole-frame,slices,parity")]
    pub packets: Vec<Packets>,
    /// Frames at the beginning that do not count: loss must be measured first.
    #[arg(long, default_value_t = 120)]
    pub warm_up: u32,
    /// The real server's back end: auto, compute or cpu.
    #[arg(long, default_value = "auto")]
    pub backend: String,
    /// Further settings of both directions, in the format of `lab link`: "rate=10Mbit queue=100ms".
    #[arg(long, default_value = "", hide_default_value = true)]
    pub link: String,
    /// Pictures of each real run for the referee to judge.
    #[arg(long, default_value_t = 40)]
    pub samples: u32,
    /// Allow software adapters.
    #[arg(long)]
    pub allow_software: bool,
    /// Codecs.
    #[arg(long, value_delimiter = ',', default_value = "planes-lz4,tiles-small,tiles-fast")]
    pub codecs: Vec<CodecId>,
    /// Seed of the losses.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

#[derive(Debug, Default)]
pub(super) struct Outcome {
    pub(super) frames: u32,
    pub(super) frames_whole: u32,
    /// Tiles that arrived in time, counted in packets.
    pub(super) packets_used: u64,
    pub(super) packets: u64,
    pub(super) wrong_bits: u64,
    pub(super) bits: u64,
    pub(super) bytes: u64,
    /// Real runs only: 99th percentile of the lag in frames, and datagrams dropped by the link's queue out of all that
    /// arrived there.
    pub(super) lag_p99: Option<f64>,
    pub(super) dropped: [u64; 2],
}
