//! `lab load`: many clients that draw nothing on one server, and what each of them gets.

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use gnomon_client::{
    app::probe::{ProbeOptions, ProbeReport, run_probe},
    camera_path::{CameraPath, PathSpec},
    headless::stats::percentile,
    link::url::ServerUrl,
};
use gnomon_protocol::codec::CodecId;
use serde::Serialize;

use super::scene_args::size;

/// A load on a server that runs already.
#[derive(Debug, Clone, clap::Args)]
pub struct LoadOptions {
    /// The line that the server printed.
    pub url: ServerUrl,
    /// Token, for a server that wants one.
    #[arg(long, env = "GNOMON_TOKEN", hide_env_values = true)]
    pub token: Option<String>,
    /// Clients at once.
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub clients: u32,
    /// Camera path, FILE or FILE#NAME; each client starts at another place of it.
    #[arg(long)]
    pub path: PathSpec,
    /// Size of the masks, WIDTHxHEIGHT.
    #[arg(long, value_parser = size, default_value = "640x360")]
    pub size: (u32, u32),
    /// Poses of each client.
    #[arg(long, default_value_t = 600)]
    pub frames: u32,
    /// Poses a second of each client; without it, each sends a pose when the mask of the one before has come.
    #[arg(long)]
    pub fps: Option<f64>,
    /// File for the figures, as JSON; they are printed as well.
    #[arg(long)]
    pub out: Option<PathBuf>,
}

/// What a load came to.
#[derive(Debug, Clone, Serialize)]
pub struct LoadReport {
    /// What the server says traces.
    pub backend: String,
    /// Clients at once.
    pub clients: u32,
    /// Size of the masks, in pixels.
    pub size: (u32, u32),
    /// Poses a second that each client sent; null where each waited for its masks.
    pub fps: Option<f64>,
    /// Poses that all sent.
    pub poses: u64,
    /// Masks that all received.
    pub masks: u64,
    /// Frames of which only a part came.
    pub incomplete: u64,
    /// Masks a second, of all clients together.
    pub masks_per_s: f64,
    /// Masks a second of the client that got the fewest.
    pub slowest_client_masks_per_s: f64,
    /// Median time from pose to decoded mask, in milliseconds.
    pub response_ms_p50: Option<f64>,
    /// 99th percentile of the same.
    pub response_ms_p99: Option<f64>,
    /// Mean size of a coded mask, in bytes.
    pub payload_bytes_mean: f64,
    /// Mean number of packets of a mask.
    pub packets_mean: f64,
}

/// Runs the load and says what came of it.
///
/// # Errors
/// When the path cannot be read, or any client fails.
pub fn run(options: &LoadOptions) -> Result<LoadReport> {
    let path = CameraPath::load(&options.path).context("the camera path")?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().context("the network's threads")?;
    let handle = runtime.handle();
    let reports: Vec<ProbeReport> = std::thread::scope(|scope| {
        let probes: Vec<_> = (0..options.clients)
            .map(|client| {
                let probe = ProbeOptions {
                    url: options.url.clone(),
                    token: options.token.clone(),
                    width: options.size.0,
                    height: options.size.1,
                    codec: CodecId::PlanesLz4,
                    frames: options.frames,
                    fps: options.fps,
                    connect_timeout: ProbeOptions::CONNECT_TIMEOUT,
                    start_time_s: path.duration_s() * f64::from(client) / f64::from(options.clients),
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
