//! `lab network`: the real client behind several kinds of networks, and without a server, in turns.
//!
//! The promise is that no network slows the client down, and that its pictures stay nearly right. Client and server get
//! a core each, the link runs on the server's, and every run behind a network is compared with a run without a server
//! just before it.

use std::{ffi::OsString, net::SocketAddr, path::Path};

use anyhow::{Context, Result, ensure};
use core_affinity::CoreId;
use gnomon_client::{
    headless::stats::percentile,
    mode::{Mode, State},
};
use serde::Deserialize as _;
use serde_json::Value;
use tokio::runtime::Runtime;

use super::{
    plot::{Axis, Plot, Series},
    recorded_error::Judge,
    scene_args::SceneArgs,
    shown::Shown,
    statistics::median,
    table::Table,
};
use crate::{
    link::{self, LinkCounts, LinkSettings, profiles::Profile},
    rig::{ClientJob, PATIENCE, ServerProcess},
};

#[derive(Debug, Clone, clap::Args)]
pub struct NetworkOptions {
    /// Scene, path, size, frames a run, and the folder for `network.csv` and the plots.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Networks: profiles of `lab link`.
    #[arg(long, value_delimiter = ',', default_value = "lan,wifi,5g,lte,bad,outage")]
    pub profile: Vec<String>,
    /// Runs per network; figures are medians, plots show the last run.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    pub runs: u32,
    /// Seed of the links.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Modes of the client: sequential, concurrent, auto.
    #[arg(long, value_delimiter = ',', default_value = "auto")]
    pub mode: Vec<Mode>,
    /// Pictures for the referee to judge, from an extra recorded run behind each network.
    #[arg(long, default_value_t = 8)]
    pub samples: u32,
    /// Transport: quic or lab-udp.
    #[arg(long, default_value = "quic")]
    pub transport: String,
    /// Frames a second of the client [default: as fast as it can].
    #[arg(long)]
    pub fps: Option<f64>,
    /// The server's back end: auto, compute or cpu.
    #[arg(long, default_value = "auto")]
    pub backend: String,
    /// Allow software adapters.
    #[arg(long)]
    pub allow_software: bool,
}

#[derive(Debug, Clone, Default)]
struct Run {
    client_fps: f64,
    visibility_fps: Option<f64>,
    frames: Vec<Shown>,
}

impl Run {
    fn read(summary: &Value, stats: &[Value]) -> Result<Self> {
        let client_fps = summary["client_fps"].as_f64().context("the client's summary lacks client_fps")?;
        let frames =
            stats.iter().map(Shown::deserialize).collect::<Result<_, _>>().context("the client's statistics")?;
        Ok(Self { client_fps, visibility_fps: summary["visibility_fps"].as_f64(), frames })
    }

    /// Returns a quantile of the lag over pictures with a mask, in frames.
    fn lag(&self, share: f64) -> Option<f64> {
        let lags: Vec<f64> = self.frames.iter().filter_map(|frame| frame.lag.map(f64::from)).collect();
        percentile(&lags, share)
    }

    #[expect(clippy::cast_precision_loss, reason = "frames of a run")]
    fn degraded_share(&self) -> Option<f64> {
        let degraded = self.frames.iter().filter(|frame| frame.state == State::Degraded).count();
        (!self.frames.is_empty()).then(|| degraded as f64 / self.frames.len() as f64)
    }

    /// Seconds since the first frame, and milliseconds to the next frame.
    fn frame_times(&self) -> Vec<(f64, f64)> {
        self.frames.windows(2).map(|pair| (pair[0].t_ms / 1e3, pair[1].t_ms - pair[0].t_ms)).collect()
    }

    /// Seconds since the first frame, and lag in frames; NaN without a mask.
    fn lags(&self) -> Vec<(f64, f64)> {
        self.frames.iter().map(|frame| (frame.t_ms / 1e3, frame.lag.map_or(f64::NAN, f64::from))).collect()
    }
}

/// One core for each side; the same one on a single-core machine.
#[derive(Debug, Clone, Copy)]
struct Cores {
    client: CoreId,
    server: CoreId,
}

impl Cores {
    fn of_this_machine() -> Result<Self> {
        let cores = core_affinity::get_core_ids().context("the operating system does not say which cores there are")?;
        let (Some(&client), Some(&server)) = (cores.first(), cores.last()) else {
            anyhow::bail!("this machine has no cores that a program may choose from");
        };
        Ok(Self { client, server })
    }
}

/// Starts a process on a core: children inherit the affinity of the thread that starts them.
fn on_core<T: Send>(core: CoreId, start: impl FnOnce() -> Result<T> + Send) -> Result<T> {
    std::thread::scope(|scope| {
        let pinned = scope.spawn(move || {
            ensure!(core_affinity::set_for_current(core), "cannot run on core {}", core.id);
            start()
        });
        pinned.join().unwrap_or_else(|_| Err(anyhow::anyhow!("a starting thread panicked")))
    })
}

struct Stage<'a> {
    options: &'a NetworkOptions,
    cores: Cores,
    server: ServerProcess,
    runtime: Runtime,
    /// Clients' scene cache: without it, fetching over a slow network would take the whole run.
    cache: tempfile::TempDir,
}

impl<'a> Stage<'a> {
    fn new(options: &'a NetworkOptions) -> Result<Self> {
        let cores = Cores::of_this_machine()?;
        let arguments = options.scene.server_arguments(&options.transport, &options.backend, options.allow_software);
        let server = on_core(cores.server, || ServerProcess::start(&options.scene.file.scene, &arguments))?;
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .on_thread_start(move || {
                // If this fails, pinning the server failed already.
                core_affinity::set_for_current(cores.server);
            })
            .enable_all()
            .build()
            .context("the link's threads")?;
        let cache = tempfile::tempdir().context("making a temporary folder")?;
        let stage = Self { options, cores, server, runtime, cache };
        let arguments = stage.online_arguments(Mode::Auto);
        stage.client(Some(stage.server.url()), arguments, 2).context("fetching the scene")?;
        Ok(stage)
    }

    fn online_arguments(&self, mode: Mode) -> Vec<OsString> {
        vec!["--cache-dir".into(), self.cache.path().into(), "--mode".into(), mode.to_string().into()]
    }

    fn offline(&self) -> Result<Run> {
        let scene = &self.options.scene;
        let mut arguments: Vec<OsString> = vec!["--offline".into(), (&scene.file.scene).into()];
        arguments.extend(scene.light_arguments());
        self.client(None, arguments, scene.frames).context("without a server")
    }

    fn behind(&self, settings: LinkSettings, mode: Mode, recording: Option<&Path>) -> Result<(Run, LinkCounts)> {
        let free = SocketAddr::from(([127, 0, 0, 1], 0));
        let link = self.runtime.block_on(link::server::start(free, self.server.url(), settings))?;
        let url = link.url(self.server.url())?;
        let mut arguments = self.online_arguments(mode);
        arguments.extend(recording.into_iter().flat_map(|file| ["--record".into(), file.into()]));
        let run = self.client(Some(&url), arguments, self.options.scene.frames)?;
        Ok((run, link.counts()))
    }

    fn client(&self, url: Option<&str>, mut arguments: Vec<OsString>, frames: u32) -> Result<Run> {
        let folder = tempfile::tempdir().context("making a temporary folder")?;
        arguments.extend(self.options.fps.into_iter().flat_map(|fps| ["--fps".into(), fps.to_string().into()]));
        let job = self.options.scene.client_job(url, folder.path(), arguments, self.options.allow_software);
        let job = ClientJob { frames, ..job };
        on_core(self.cores.client, || job.start())?.finish(PATIENCE)?.success()?;
        Run::read(&job.summary()?, &job.stats()?)
    }
}

/// Measures all networks, writes `network.csv` and the plots, and reports each run to `progress`.
pub fn measure(options: &NetworkOptions, mut progress: impl FnMut(&str)) -> Result<Table> {
    let profiles: Vec<Profile> = options.profile.iter().map(|name| Ok(Profile::named(name)?)).collect::<Result<_>>()?;
    let ways: Vec<(&Profile, Mode)> =
        profiles.iter().flat_map(|profile| options.mode.iter().map(move |mode| (profile, *mode))).collect();
    ensure!(!ways.is_empty(), "nothing to measure: --profile and --mode each need a value");
    let stage = Stage::new(options)?;
    if stage.cores.client == stage.cores.server {
        progress("one core for client and server: the server's work counts as the network's");
    }
    let mut runs: Vec<Vec<(Run, f64)>> = vec![Vec::new(); ways.len()];
    let mut alone = Run::default();
    for number in 1..=options.runs {
        for ((profile, mode), runs) in ways.iter().zip(&mut runs) {
            alone = stage.offline()?;
            let (run, counts) = stage
                .behind(profile.settings(options.seed)?, *mode, None)
                .with_context(|| format!("behind {}", profile.name))?;
            let ratio = run.client_fps / alone.client_fps;
            let (alone_fps, fps, down) = (alone.client_fps, run.client_fps, counts.down);
            progress(&format!(
                "{}, {mode}, {number}/{}: {alone_fps:.1} frames/s alone, {fps:.1} behind it ({ratio:.3}); \
                 down {} of {} delivered",
                profile.name, options.runs, down.delivered, down.arrived
            ));
            runs.push((run, ratio));
        }
    }
    // Recording slows the client, so the recorded run is not timed.
    progress("recording a run behind each network, and judging pictures of it");
    let judge = Judge::new(&options.scene, options.allow_software)?;
    let mut errors = Vec::new();
    for (profile, mode) in &ways {
        let recording = stage.cache.path().join("recording");
        stage.behind(profile.settings(options.seed)?, *mode, Some(&recording))?;
        let error = judge.error_of(&recording, (0, options.scene.frames), options.samples)?;
        errors.push(error.wrong_percent());
    }
    stage.server.stop()?;
    let mut table = Table::new(
        "profile | mode | client_fps | visibility_fps | lag_p50 | lag_p99 | bit_error | degraded_share \
         | fps_ratio_to_offline",
    );
    for (((profile, mode), runs), error) in ways.iter().zip(&runs).zip(errors) {
        table.rows.push(cells(profile.name, *mode, runs, error));
    }
    options.scene.write("network.csv", &table.csv())?;
    let last: Vec<(String, &Run)> = ways
        .iter()
        .zip(&runs)
        .filter_map(|((profile, mode), runs)| {
            let name =
                if options.mode.len() > 1 { format!("{}, {mode}", profile.name) } else { profile.name.to_owned() };
            runs.last().map(|(run, _)| (name, run))
        })
        .collect();
    write_plots(&options.scene, &last, &alone)?;
    Ok(table)
}

fn cells(profile: &str, mode: Mode, runs: &[(Run, f64)], bit_error: f64) -> Vec<String> {
    let figure = |of: fn(&Run) -> Option<f64>, decimals: usize| {
        let values: Vec<f64> = runs.iter().filter_map(|(run, _)| of(run)).collect();
        median(&values).map(|value| format!("{value:.decimals$}")).unwrap_or_default()
    };
    let ratios: Vec<f64> = runs.iter().map(|(_, ratio)| *ratio).collect();
    vec![
        profile.to_owned(),
        mode.to_string(),
        figure(|run| Some(run.client_fps), 1),
        figure(|run| run.visibility_fps, 1),
        figure(|run| run.lag(0.5), 1),
        figure(|run| run.lag(0.99), 1),
        format!("{bit_error:.4}"),
        figure(Run::degraded_share, 4),
        median(&ratios).map(|ratio| format!("{ratio:.3}")).unwrap_or_default(),
    ]
}

fn write_plots(scene: &SceneArgs, runs: &[(String, &Run)], alone: &Run) -> Result<()> {
    let lines = |of: fn(&Run) -> Vec<(f64, f64)>| {
        runs.iter().map(|(name, run)| Series::line(name, of(run))).collect::<Vec<_>>()
    };
    let title = |what: &str| format!("{what}, {}, {}×{}", scene.scene_name(), scene.size.0, scene.size.1);
    let time = || Axis::linear("time since the first frame, s");
    let mut frame_times = lines(Run::frame_times);
    frame_times.push(Series::line("no server", alone.frame_times()));
    let frame_times = Plot::new(&title("Frame time"), time(), Axis::log("frame time, ms"), frame_times);
    scene.write("network_frame_time.svg", &frame_times.svg()?)?;
    let lags = lines(Run::lags);
    let lags = Plot::new(&title("Lag of the visibility shown"), time(), Axis::linear("lag, frames"), lags);
    scene.write("network_lag.svg", &lags.svg()?)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::report::scene_args::parse;

    fn frames() -> Vec<Value> {
        let lags = [None, Some(2), Some(4), Some(3)];
        let line = |(frame, lag): (usize, &Option<u32>)| {
            let state = if lag.is_none() { "degraded" } else { "concurrent" };
            json!({ "t_ms": frame * 20, "lag": lag, "state": state })
        };
        lags.iter().enumerate().map(line).collect()
    }

    #[test]
    fn a_run_is_read_from_its_frames() {
        let run = Run::read(&json!({ "client_fps": 50.0, "visibility_fps": 30.0 }), &frames()).unwrap();
        assert_eq!((run.lag(0.5), run.lag(0.99), run.degraded_share()), (Some(3.0), Some(4.0), Some(0.25)));
        assert_eq!(run.frame_times().iter().map(|point| point.1.round()).collect::<Vec<_>>(), [20.0; 3]);
        assert!(run.lags()[0].1.is_nan() && (run.lags()[3].1 - 3.0).abs() < 1e-9);
        assert!(Run::read(&json!({}), &[]).unwrap_err().to_string().contains("client_fps"));
        assert!(Run::read(&json!({ "client_fps": 1.0 }), &[json!({ "t_ms": 0 })]).is_err());
        let slower = Run { client_fps: 40.0, ..run.clone() };
        let row = cells("wifi", Mode::Auto, &[(run.clone(), 1.0), (slower, 0.8)], 0.25);
        assert_eq!(row, ["wifi", "auto", "45.0", "30.0", "3.0", "4.0", "0.2500", "0.2500", "0.900"]);
        // Unknown values are empty, not 0.
        let row = cells("lan", Mode::Sequential, &[(Run { client_fps: 1.0, ..Run::default() }, 1.0)], 0.5);
        assert_eq!(row, ["lan", "sequential", "1.0", "", "", "", "0.5000", "", "1.000"]);
    }

    #[test]
    fn children_run_on_the_given_core() {
        let cores = Cores::of_this_machine().unwrap();
        for core in [cores.client, cores.server] {
            let allowed = on_core(core, || {
                let status =
                    std::process::Command::new("grep").args(["Cpus_allowed_list", "/proc/self/status"]).output();
                Ok(String::from_utf8_lossy(&status?.stdout).into_owned())
            });
            assert_eq!(allowed.unwrap().split_whitespace().last(), Some(core.id.to_string().as_str()));
        }
    }

    #[test]
    fn the_plots_are_written() {
        let folder = tempfile::tempdir().unwrap();
        let line = format!("--scene a/hall.glb --size 64x36 --frames 4 --out {}", folder.path().join("out").display());
        let scene: SceneArgs = parse(&line).unwrap();
        let run = Run::read(&json!({ "client_fps": 50.0 }), &frames()).unwrap();
        write_plots(&scene, &[("wifi".to_owned(), &run), ("lte".to_owned(), &run)], &run).unwrap();
        for file in ["network_frame_time.svg", "network_lag.svg"] {
            let text = std::fs::read_to_string(scene.out.join(file)).unwrap();
            assert!(text.contains("hall, 64×36") && text.contains("lte"), "{file}");
        }
    }
}
