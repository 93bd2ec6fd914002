//! What a run is told, from all sides: defaults < TOML file < environment < flags.

use std::{
    io::Read as _,
    path::{Path, PathBuf},
    time::Duration,
};

use etcetera::BaseStrategy as _;
use gnomon_protocol::codec::CodecId;
use serde::Deserialize;
use thiserror::Error;

use crate::{
    app::servers::KnownServers,
    camera_path::PathSpec,
    cli::{Arguments, Size},
    guard::Guard,
    link::{receive_options::Packets, url::ServerUrl},
    mode::{Mode, Thresholds},
    options::{HeadlessOptions, Source, WindowOptions},
    predictor::Predictor,
};

/// Largest configuration file that is read, in bytes.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// The configuration file. Its keys are the flags' names, with `_` for `-`.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileConfig {
    url: Option<ServerUrl>,
    #[serde(default, deserialize_with = "parsed")]
    path: Option<PathSpec>,
    frames: Option<u32>,
    fps: Option<f64>,
    start_time: Option<f64>,
    #[serde(default, deserialize_with = "parsed")]
    size: Option<Size>,
    out: Option<PathBuf>,
    stats: Option<PathBuf>,
    summary: Option<PathBuf>,
    save_masks: Option<PathBuf>,
    mask_log: Option<PathBuf>,
    token: Option<String>,
    #[serde(default, deserialize_with = "parsed")]
    codec: Option<CodecId>,
    lossy: Option<f64>,
    packets: Option<Packets>,
    adapter: Option<String>,
    allow_software: Option<bool>,
    wait: Option<bool>,
    predict: Option<Predictor>,
    mode: Option<Mode>,
    guard: Option<Guard>,
    predict_pose: Option<bool>,
    sequential_lag: Option<u32>,
    calm_frames: Option<u32>,
    prediction_lag: Option<u32>,
    fade: Option<f64>,
    exposure: Option<f32>,
    cache_dir: Option<PathBuf>,
    connect_timeout: Option<f64>,
    vsync: Option<bool>,
    full_screen: Option<bool>,
}

/// What is to be done.
#[derive(Debug, Clone, PartialEq)]
pub enum Run {
    /// Draw into files.
    Headless(HeadlessOptions),
    /// Draw into a window.
    Window(WindowOptions),
}

/// Why there is nothing to run.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read configuration {}: {source}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// The file is not what is expected.
    #[error("configuration {}: {reason}", file.display())]
    Malformed {
        /// The file.
        file: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// Neither a server nor a scene.
    #[error(
        "which server? Pass the URL that gnomon-server printed, --demo to start one here, or --offline SCENE to draw without one"
    )]
    NoSource,
    /// Both a server and a scene.
    #[error("a URL and --offline: choose one")]
    TwoSources,
    /// Something that a window does not do.
    #[error("--{0}: with --headless only")]
    HeadlessOnly(&'static str),
    /// A time to leave that is none.
    #[error("--exit-after: {0} s: 0 to 1e9 are possible")]
    ExitAfter(f64),
    /// A timeout that is none.
    #[error("--connect-timeout: {0} s: 0.001 to 3600 are possible")]
    Timeout(f64),
}

/// A value that is written as text.
fn parsed<'de, D: serde::Deserializer<'de>, T: std::str::FromStr<Err: std::fmt::Display>>(
    deserializer: D,
) -> Result<Option<T>, D::Error> {
    String::deserialize(deserializer)?.parse().map(Some).map_err(serde::de::Error::custom)
}

impl FileConfig {
    /// Reads a file.
    ///
    /// # Errors
    /// When it cannot be read, or has a key or value that is not known.
    pub fn load(file: &Path) -> Result<Self, ConfigError> {
        let read = |source| ConfigError::Read { file: file.into(), source };
        let mut text = String::new();
        let opened = std::fs::File::open(file).map_err(read)?;
        let bytes = opened.take(MAX_FILE_BYTES + 1).read_to_string(&mut text).map_err(read)?;
        let malformed = |reason| ConfigError::Malformed { file: file.into(), reason };
        if bytes as u64 > MAX_FILE_BYTES {
            return Err(malformed(format!("more than {MAX_FILE_BYTES} bytes")));
        }
        toml::from_str(&text).map_err(|error| malformed(error.to_string().trim_end().replace('\n', " ")))
    }
}

/// Puts everything together.
///
/// # Errors
/// When the configuration file is wrong, or it is not clear what to draw.
pub fn resolve(arguments: Arguments) -> Result<Run, ConfigError> {
    let file = match arguments.config.clone().or_else(own_file) {
        Some(file) => FileConfig::load(&file)?,
        None => FileConfig::default(),
    };
    let headless = arguments.headless;
    let vsync = arguments.vsync.or(file.vsync).unwrap_or(true);
    let full_screen = arguments.full_screen || file.full_screen.unwrap_or(false);
    let exit_after = arguments.exit_after;
    let exit_after = exit_after
        .map(|after_s| match after_s {
            0.0..=1e9 => Ok(Duration::from_secs_f64(after_s)),
            _ => Err(ConfigError::ExitAfter(after_s)),
        })
        .transpose()?;
    let demo = arguments.demo;
    let only = [
        (arguments.wait, "wait"),
        (arguments.frames.is_some(), "frames"),
        (arguments.fps.is_some(), "fps"),
        (arguments.summary.is_some(), "summary"),
    ];
    let mut run = resolve_run(arguments, file)?;
    if headless {
        return Ok(Run::Headless(run));
    }
    if let Some((_, name)) = only.into_iter().find(|(given, _)| *given) {
        return Err(ConfigError::HeadlessOnly(name));
    }
    // What the file says of headless runs is not about this one.
    (run.wait, run.frames, run.fps, run.summary) = (false, None, None, None);
    run.remember = !demo;
    Ok(Run::Window(WindowOptions { run, vsync, full_screen, exit_after }))
}

/// The file in the platform's place, if there is one.
fn own_file() -> Option<PathBuf> {
    let folder = etcetera::choose_base_strategy().ok()?.config_dir().join("gnomon");
    Some(folder.join("client.toml")).filter(|file| file.is_file())
}

fn resolve_run(arguments: Arguments, file: FileConfig) -> Result<HeadlessOptions, ConfigError> {
    let source = match (arguments.offline, arguments.url.or(file.url)) {
        (Some(scene), None) => Source::Offline { scene, lights_from: arguments.lights_from, lights: arguments.lights },
        (None, Some(url)) => Source::Server(url),
        // In a window, the server of the last time.
        (None, None) => match KnownServers::load().servers().first() {
            Some(url) if !arguments.headless && !arguments.check_config => Source::Server(url.clone()),
            _ => return Err(ConfigError::NoSource),
        },
        (Some(_), Some(_)) => return Err(ConfigError::TwoSources),
    };
    let default = HeadlessOptions::new(source);
    let size = arguments.size.or(file.size).unwrap_or(Size { width: default.width, height: default.height });
    let connect_timeout = match arguments.connect_timeout.or(file.connect_timeout) {
        None => default.connect_timeout,
        Some(seconds) if (0.001..=3600.0).contains(&seconds) => Duration::from_secs_f64(seconds),
        Some(seconds) => return Err(ConfigError::Timeout(seconds)),
    };
    let thresholds = Thresholds {
        sequential_lag: arguments.sequential_lag.or(file.sequential_lag).unwrap_or(default.thresholds.sequential_lag),
        calm_frames: arguments.calm_frames.or(file.calm_frames).unwrap_or(default.thresholds.calm_frames),
        prediction_lag: arguments.prediction_lag.or(file.prediction_lag).unwrap_or(default.thresholds.prediction_lag),
        fade_s: arguments.fade.or(file.fade).unwrap_or(default.thresholds.fade_s),
    };
    Ok(HeadlessOptions {
        path: arguments.path.or(file.path),
        frames: arguments.frames.or(file.frames),
        fps: arguments.fps.or(file.fps),
        start_time_s: arguments.start_time.or(file.start_time).unwrap_or(default.start_time_s),
        width: size.width,
        height: size.height,
        out: arguments.out.or(file.out),
        stats: arguments.stats.or(file.stats),
        record: arguments.record,
        summary: arguments.summary.or(file.summary),
        save_masks: arguments.save_masks.or(file.save_masks),
        mask_log: arguments.mask_log.or(file.mask_log),
        token: arguments.token.or(file.token),
        codec: arguments.codec.or(file.codec).unwrap_or(default.codec),
        lossy_percent: arguments.lossy.or(file.lossy).unwrap_or(default.lossy_percent),
        packets: arguments.packets.or(file.packets).unwrap_or(default.packets),
        adapter: arguments.adapter.or(file.adapter),
        allow_software: arguments.allow_software.or(file.allow_software).unwrap_or(default.allow_software),
        wait: arguments.wait || file.wait.unwrap_or(default.wait),
        predictor: arguments.predict.or(file.predict).unwrap_or(default.predictor),
        mode: arguments.mode.or(file.mode).unwrap_or(default.mode),
        thresholds,
        guard: arguments.guard.or(file.guard).unwrap_or(default.guard),
        predict_pose: arguments.predict_pose.or(file.predict_pose),
        exposure_ev: arguments.exposure.or(file.exposure),
        cache_dir: arguments.cache_dir.or(file.cache_dir),
        connect_timeout,
        progress: true,
        ..default
    })
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;

    fn run_with(file: &str, line: &str) -> Result<Run, ConfigError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("client.toml");
        std::fs::write(&path, file).unwrap();
        let mut arguments = Arguments::parse_from(format!("gnomon-client {line}").trim().split(' '));
        arguments.config = Some(path);
        resolve(arguments)
    }

    fn resolve_with(file: &str, line: &str) -> Result<HeadlessOptions, ConfigError> {
        run_with(file, line).map(|run| match run {
            Run::Headless(options) => options,
            Run::Window(options) => options.run,
        })
    }

    #[test]
    fn without_headless_there_is_a_window() {
        let Run::Window(options) =
            run_with("vsync = false\n", &format!("{URL} --exit-after 2.5 --full-screen")).unwrap()
        else {
            panic!("no window");
        };
        assert_eq!((options.vsync, options.full_screen), (false, true));
        assert_eq!(options.exit_after, Some(Duration::from_millis(2500)));
        assert!(matches!(run_with("", &format!("{URL} --headless")), Ok(Run::Headless(_))));
        let Run::Window(options) = run_with("wait = true\nframes = 7\n", URL).unwrap() else { panic!("no window") };
        assert_eq!((options.run.wait, options.run.frames, options.run.remember), (false, None, true));
    }

    const URL: &str = "gnomon+lab-udp://127.0.0.1:5";

    #[test]
    fn flags_go_before_the_file_and_the_file_before_defaults() {
        let file = format!("url = \"{URL}\"\nsize = \"64x36\"\ncodec = \"words\"\nwait = true\nframes = 7\n");
        let options = resolve_with(&file, "--headless --frames 9").unwrap();
        assert_eq!((options.width, options.height, options.codec), (64, 36, CodecId::Words));
        assert_eq!((options.frames, options.wait), (Some(9), true));
        assert!(matches!(options.source, Source::Server(url) if url.port == 5));
        assert_eq!(resolve_with("", &format!("{URL} --headless")).unwrap().width, 1280);
    }

    #[test]
    fn what_hides_the_network_is_configuration() {
        let file = format!(
            "url = \"{URL}\"\nmode = \"sequential\"\nguard = \"auto\"\npredict = \"none\"\npredict_pose = true\n\
             sequential_lag = 2\ncalm_frames = 5\nprediction_lag = 30\nfade = 0.5\n"
        );
        let options = resolve_with(&file, "--headless --mode concurrent --fade 0.125 --predict-pose=false").unwrap();
        assert_eq!((options.mode, options.guard, options.predictor), (Mode::Concurrent, Guard::Auto, Predictor::None));
        let expected = Thresholds { sequential_lag: 2, calm_frames: 5, prediction_lag: 30, fade_s: 0.125 };
        assert_eq!((options.thresholds, options.predict_pose), (expected, Some(false)));
        let default = resolve_with("", &format!("{URL} --headless")).unwrap();
        assert_eq!((default.mode, default.thresholds), (Mode::Auto, Thresholds::default()));
        assert_eq!((default.guard, default.predict_pose), (Guard::default(), None));
    }

    #[test]
    fn mistakes_say_what_to_do() {
        for (file, line, expected) in [
            ("", "--headless", "which server?"),
            ("", "gnomon+lab-udp://127.0.0.1:5 --wait", "--headless"),
            ("", "gnomon+lab-udp://127.0.0.1:5 --exit-after 1e12", "exit-after"),
            ("", "gnomon+lab-udp://127.0.0.1:5 --headless --offline a.gltf", "choose one"),
            ("colour = 1", "--headless", "colour"),
            ("guard = \"63x36\"", "--headless", "even"),
            ("mode = \"fast\"", "--headless", "sequential"),
            ("size = \"big\"", "--headless", "WIDTHxHEIGHT"),
            ("url = \"gnomon://a:1\"", "--headless", "cert"),
            ("connect_timeout = 0", "--headless --offline a.gltf", "connect-timeout"),
        ] {
            let error = resolve_with(file, line).unwrap_err().to_string();
            assert!(error.contains(expected) && !error.contains('\n'), "{error}");
        }
    }
}
