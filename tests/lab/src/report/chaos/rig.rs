//! A server as a process, and probes as threads.

use std::{path::Path, thread::ScopedJoinHandle, time::Duration};

use anyhow::{Context as _, Result};
use gnomon_client::{
    ClientError, HeadlessOptions, Source,
    app::probe::{ProbeOptions, ProbeReport, run_probe},
    camera_path::CameraPath,
    config::Size,
    link::url::ServerUrl,
};
use tokio::runtime::{Builder, Runtime};

use crate::{
    report::scene_args::SceneArgs,
    rig::{Ask, ServerProcess},
};

/// Stack size of a probe's thread, of which there may be a thousand.
const STACK_BYTES: usize = 256 * 1024;

/// Options of every part.
#[derive(Debug, Clone, clap::Args)]
pub struct ServerArgs {
    /// Scene and path; each part sets its own size and frames.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// The server's back end: auto, compute, ray-query or cpu.
    #[arg(long, default_value = "auto")]
    pub backend: String,
    /// Allow a software adapter.
    #[arg(long)]
    pub allow_software: bool,
    /// Number of devices [default: all].
    #[arg(long)]
    pub devices: Option<u32>,
    /// Time of each device that sessions may use per second, in milliseconds.
    #[arg(long, default_value_t = 900)]
    pub device_budget_ms: u32,
}

impl ServerArgs {
    pub(super) fn start(&self, more: &[&str]) -> Result<ServerProcess> {
        let mut arguments: Vec<std::ffi::OsString> = vec!["--backend".into(), (&self.backend).into()];
        arguments.extend(["--device-budget-ms".into(), self.device_budget_ms.to_string().into()]);
        arguments.extend(["--max-sessions".into(), "4096".into()]);
        if self.allow_software {
            arguments.push("--allow-software".into());
        }
        if let Some(devices) = self.devices {
            arguments.extend(["--devices".into(), devices.to_string().into()]);
        }
        arguments.extend(self.scene.light_arguments());
        arguments.extend(more.iter().map(Into::into));
        ServerProcess::start(&self.scene.file.scene, &arguments)
    }
}

/// The runtime of a measurement's probes, and their path.
pub(super) struct Probes {
    runtime: Runtime,
    path: CameraPath,
    url: ServerUrl,
}

pub(super) type Running<'scope> = ScopedJoinHandle<'scope, Result<ProbeReport, ClientError>>;

impl Probes {
    pub(super) fn of(server: &ServerArgs, url: &str) -> Result<Self> {
        let runtime = Builder::new_multi_thread().enable_all().build().context("the network's threads")?;
        Ok(Self { runtime, path: server.scene.load_path()?, url: url.parse()? })
    }

    pub(super) fn handle(&self) -> &tokio::runtime::Handle {
        self.runtime.handle()
    }

    /// Runs a probe to its end; `number` selects its start on the path.
    pub(super) fn run(&self, ask: Ask, number: u32) -> Result<ProbeReport, ClientError> {
        self.run_at(&self.url, ask, number, ProbeOptions::CONNECT_TIMEOUT)
    }

    pub(super) fn run_at(
        &self,
        url: &ServerUrl,
        ask: Ask,
        number: u32,
        connect_timeout: Duration,
    ) -> Result<ProbeReport, ClientError> {
        let start_time_s = self.path.duration_s() * f64::from(number % 97) / 97.0;
        let options = ProbeOptions { start_time_s, connect_timeout, ..ask.of(url) };
        run_probe(self.runtime.handle(), &options, &self.path)
    }

    pub(super) fn spawn<'scope>(
        &'scope self,
        scope: &'scope std::thread::Scope<'scope, '_>,
        ask: Ask,
        number: u32,
    ) -> Result<Running<'scope>> {
        let builder = std::thread::Builder::new().stack_size(STACK_BYTES);
        builder.spawn_scoped(scope, move || self.run(ask, number)).context("a thread for a probe")
    }
}

/// A client that draws 64×36 pictures of the server's path, with its scene cache in `folder`.
pub(super) fn headless(
    server: &ServerArgs,
    url: ServerUrl,
    fps: f64,
    frames: u32,
    folder: &Path,
) -> Result<HeadlessOptions> {
    let mut options = HeadlessOptions::new(Source::Server(url));
    let settings = &mut options.settings;
    settings.size = Size { width: 64, height: 36 };
    (settings.fps, settings.frames) = (Some(fps), Some(frames));
    settings.path = Some(server.scene.path_text().to_str().context("a path that is no UTF-8")?.parse()?);
    settings.cache_dir = Some(folder.join("cache"));
    settings.allow_software = true;
    Ok(options)
}

pub(super) fn joined(probe: Running<'_>) -> Result<ProbeReport> {
    let report = probe.join().map_err(|_| anyhow::anyhow!("a probe's thread panicked"))?;
    Ok(report?)
}

#[expect(clippy::cast_precision_loss, reason = "sizes far below 2⁵³")]
pub(super) fn mib(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 20)
}
