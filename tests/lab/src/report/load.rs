//! `lab load`: many clients without graphics on one server, and the service that each gets.

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use gnomon_client::{
    app::probe::{ProbeOptions, ProbeReport, run_probe},
    camera_path::PathSpec,
    headless::stats::percentile,
    link::url::ServerUrl,
};
use gnomon_protocol::codec::CodecId;
use serde::Serialize;

use super::scene_args::size;
use crate::rig::Ask;

#[derive(Debug, Clone, clap::Args)]
pub struct LoadOptions {
    /// The server's printed URL.
    pub url: ServerUrl,
    /// Token, if the server requires one.
    #[arg(long, env = "GNOMON_TOKEN", hide_env_values = true)]
    pub token: Option<String>,
    /// Number of clients.
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub clients: u32,
    /// Camera path, FILE or FILE#NAME; clients start at different places of it.
    #[arg(long)]
    pub path: PathSpec,
    /// Size of the masks, WIDTHxHEIGHT.
    #[arg(long, value_parser = size, default_value = "640x360")]
    pub size: (u32, u32),
    /// Poses per client.
    #[arg(long, default_value_t = 600)]
    pub frames: u32,
    /// Poses a second of each client [default: a pose whenever the mask of the one before has arrived].
    #[arg(long)]
    pub fps: Option<f64>,
    /// How masks are coded.
    #[arg(long, default_value = "planes-lz4")]
    pub codec: CodecId,
    /// File for the figures as JSON, besides printing them.
    #[arg(long)]
    pub out: Option<PathBuf>,
}

#[derive(Debug, Clone, Serialize)]
pub struct LoadReport {
    pub backend: String,
    pub clients: u32,
    pub size: (u32, u32),
    /// Poses a second of each client; null if each waited for its masks.
    pub fps: Option<f64>,
    pub poses: u64,
    pub masks: u64,
    pub incomplete: u64,
    pub masks_per_s: f64,
    pub slowest_client_masks_per_s: f64,
    /// Median time from pose to decoded mask, in milliseconds.
    pub response_ms_p50: Option<f64>,
    /// 99th percentile, in milliseconds.
    pub response_ms_p99: Option<f64>,
    /// Mean size of an encoded mask, in bytes.
    pub payload_bytes_mean: f64,
    /// Per mask.
    pub packets_mean: f64,
}

pub fn run(options: &LoadOptions) -> Result<LoadReport> {
    let path = options.path.load().context("the camera path")?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().context("the network's threads")?;
    let handle = runtime.handle();
    let reports: Vec<ProbeReport> = std::thread::scope(|scope| {
        let probes: Vec<_> = (0..options.clients)
            .map(|client| {
                let ask = Ask { size: options.size, fps: options.fps, frames: options.frames };
                let probe = ProbeOptions {
                    token: options.token.clone(),
                    codec: options.codec,
                    start_time_s: path.duration_s() * f64::from(client) / f64::from(options.clients),
                    ..ask.of(&options.url)
                };
                let path = &path;
                scope.spawn(move || run_probe(handle, &probe, path).with_context(|| format!("client {client}")))
            })
            .collect();
        probes
            .into_iter()
            .map(|probe| probe.join().unwrap_or_else(|_| Err(anyhow::anyhow!("a client's thread panicked"))))
            .collect::<Result<_>>()
    })?;
    let report = summarise(options, &reports);
    if let Some(file) = &options.out {
        let json = serde_json::to_vec_pretty(&report)?;
        std::fs::write(file, json).with_context(|| format!("{}", file.display()))?;
    }
    Ok(report)
}

#[expect(clippy::cast_precision_loss, reason = "counts far below 2⁵³")]
fn summarise(options: &LoadOptions, reports: &[ProbeReport]) -> LoadReport {
    let sum = |of: fn(&ProbeReport) -> u64| reports.iter().map(of).sum::<u64>();
    let rate = |report: &ProbeReport| report.masks as f64 / report.duration.as_secs_f64().max(1e-9);
    let responses: Vec<f64> = reports.iter().flat_map(|report| report.responses_ms.iter().copied()).collect();
    let masks = sum(|report| report.masks);
    let mean = |total: u64| total as f64 / masks.max(1) as f64;
    LoadReport {
        backend: reports.first().map(|report| report.backend.clone()).unwrap_or_default(),
        clients: options.clients,
        size: options.size,
        fps: options.fps,
        poses: sum(|report| report.poses.into()),
        masks,
        incomplete: sum(|report| report.incomplete),
        masks_per_s: reports.iter().map(rate).sum(),
        slowest_client_masks_per_s: reports.iter().map(rate).fold(f64::INFINITY, f64::min),
        response_ms_p50: percentile(&responses, 0.5),
        response_ms_p99: percentile(&responses, 0.99),
        payload_bytes_mean: mean(sum(|report| report.payload_bytes)),
        packets_mean: mean(sum(|report| report.packets)),
    }
}
