//! A server as a process, probes of it as threads, and what the operating system says of the process.

use std::{fs, thread::ScopedJoinHandle, time::Duration};

use anyhow::{Context as _, Result};
use gnomon_client::{
    ClientError,
    app::probe::{ProbeOptions, ProbeReport, run_probe},
    camera_path::CameraPath,
    link::url::ServerUrl,
};
use gnomon_protocol::codec::CodecId;
use tokio::runtime::{Builder, Runtime};

use super::ServerArgs;
use crate::rig::ServerProcess;

/// Stack of a probe's thread: it draws nothing, and there may be a thousand.
const STACK_BYTES: usize = 256 * 1024;

impl ServerArgs {
    /// Starts the server as a process, with whatever else it is told.
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
        ServerProcess::start(&self.scene.scene, &arguments)
    }
}

/// What a probe asks for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ask {
    pub(super) size: (u32, u32),
    pub(super) fps: Option<f64>,
    pub(super) frames: u32,
}

/// The network of all probes of a measurement, and their path.
pub(super) struct Probes {
    runtime: Runtime,
    path: CameraPath,
    url: ServerUrl,
}

/// A probe on its way.
pub(super) type Running<'scope> = ScopedJoinHandle<'scope, Result<ProbeReport, ClientError>>;

impl Probes {
    pub(super) fn of(server: &ServerArgs, url: &str) -> Result<Self> {
        let runtime = Builder::new_multi_thread().enable_all().build().context("the network's threads")?;
        Ok(Self { runtime, path: server.scene.load_path()?, url: url.parse()? })
    }

    pub(super) fn handle(&self) -> &tokio::runtime::Handle {
        self.runtime.handle()
    }

    /// Runs a probe to its end; the `number` decides where on the path it begins.
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
        let options = ProbeOptions {
            url: url.clone(),
            token: None,
            width: ask.size.0,
            height: ask.size.1,
            codec: CodecId::PlanesLz4,
            frames: ask.frames,
            fps: ask.fps,
            start_time_s: self.path.duration_s() * f64::from(number % 97) / 97.0,
            connect_timeout,
        };
        run_probe(self.runtime.handle(), &options, &self.path)
    }

    /// Runs a probe in a thread of its own.
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

/// The report of a probe that was spawned.
pub(super) fn joined(probe: Running<'_>) -> Result<ProbeReport> {
    let report = probe.join().map_err(|_| anyhow::anyhow!("a probe's thread panicked"))?;
    Ok(report?)
}

/// What a process uses.
#[derive(Debug, Clone, Copy)]
pub(super) struct Usage {
    /// Resident memory, in bytes.
    pub(super) resident_bytes: u64,
    /// Open file descriptors.
    pub(super) files: usize,
    /// Processor time since its start, of all of its threads.
    pub(super) processor: Duration,
}

/// What the process uses now, as Linux says it.
pub(super) fn usage(process: u32) -> Result<Usage> {
    let read = |file: &str| {
        let path = format!("/proc/{process}/{file}");
        fs::read_to_string(&path).with_context(|| format!("reading {path}"))
    };
    let status = read("status")?;
    let kib =
        status.lines().find_map(|line| line.strip_prefix("VmRSS:")?.trim().strip_suffix(" kB")?.parse::<u64>().ok());
    let stat = read("stat")?;
    // The name in parentheses may hold blanks; utime and stime are the 12th and 13th fields behind it, in hundredths of a second.
    let behind = stat.rsplit_once(')').context("no name in stat")?.1;
    let ticks: u64 = behind.split_whitespace().skip(11).take(2).filter_map(|ticks| ticks.parse::<u64>().ok()).sum();
    let files = fs::read_dir(format!("/proc/{process}/fd")).context("listing its files")?.count();
    let resident_bytes = kib.context("no VmRSS in status")? * 1024;
    Ok(Usage { resident_bytes, files, processor: Duration::from_millis(ticks * 10) })
}

/// Mebibytes, for people.
#[expect(clippy::cast_precision_loss, reason = "sizes far below 2⁵³")]
pub(super) fn mib(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 20)
}
