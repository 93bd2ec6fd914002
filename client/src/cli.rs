//! The command line, and the run that it requests.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use clap::Parser;
use etcetera::BaseStrategy as _;
use gnomon_protocol::limits::MAX_TOKEN_BYTES;
use gnomon_scene::LoadOptions;
use gnomon_settings::{
    Bounds as _, Layers, Loaded, SettingsError, Shell, Switch,
    files::{read_bounded, read_small},
};
use thiserror::Error;

use crate::{
    app::{local_server::LocalScene, servers::KnownServers},
    config::ClientSettings,
    error::ClientError,
    options::{HeadlessOptions, Source, WindowOptions},
    target::Target,
};

/// The version, and the commit that the program is built from.
pub const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), env!("GNOMON_COMMIT"));

/// Thin client of a Gnomon server: rasterises a scene and shades it with visibility that the server traces
///
/// A setting is a flag, an environment variable or a key of the TOML file (the flag's name with underscores).
/// Flags override variables, which override the file.
#[derive(Debug, Clone, Parser)]
#[command(name = "gnomon-client", version = VERSION, max_term_width = 120)]
pub struct Arguments {
    #[command(flatten)]
    pub settings: ClientSettings,
    /// Draw into files instead of a window
    #[arg(long, help_heading = "Picture")]
    pub headless: bool,
    /// Start the gnomon-server beside this program with a built-in scene, and show it
    #[arg(long, conflicts_with_all = ["url", "offline", "headless"], help_heading = "Picture")]
    pub demo: bool,
    /// Draw this glTF scene without a server: every light reaches everything
    #[arg(long, value_name = "SCENE", help_heading = "Picture")]
    pub offline: Option<PathBuf>,
    #[command(flatten)]
    pub reading: Reading,
    /// Record the run into this file; `lab replay` draws it again
    #[arg(long, value_name = "FILE", help_heading = "Picture")]
    pub record: Option<PathBuf>,
    /// Close the window after S seconds, for scripts
    #[arg(long, value_name = "S", help_heading = "Window", bounds(0.0, 1e9))]
    pub exit_after: Option<f64>,
    /// File with the token, one line, instead of --token; - reads standard input
    #[arg(
        long,
        env = "GNOMON_CLIENT_TOKEN_FILE",
        value_name = "FILE",
        conflicts_with = "token",
        help_heading = "Server"
    )]
    pub token_file: Option<PathBuf>,
    /// Remove all cached scenes, and exit
    #[arg(long, help_heading = "Server")]
    pub clear_cache: bool,
    /// TOML file with settings [default: gnomon/client.toml in the user's configuration folder]
    #[arg(long, env = "GNOMON_CLIENT_CONFIG", value_name = "FILE", help_heading = "Program")]
    pub config: Option<PathBuf>,
    /// Print every setting with its source as JSON, and exit
    #[arg(long, help_heading = "Program")]
    pub check_config: bool,
    /// Print completions for this shell, and exit
    #[arg(long, value_name = "SHELL", help_heading = "Program")]
    pub completions: Option<Shell>,
    /// Print a man page, and exit
    #[arg(long, help_heading = "Program")]
    pub man: bool,
    /// Filter of the log on standard error, in tracing's syntax
    #[arg(long, env = "RUST_LOG", value_name = "FILTER", default_value = "warn", help_heading = "Program")]
    pub log: String,
}

/// How a scene on this machine is read: the settings that a server has, under the same names.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Scene's file, also with --offline")]
pub struct Reading {
    /// JSON file with lights, for a scene without any
    #[arg(long, value_name = "FILE")]
    pub lights_from: Option<PathBuf>,
    /// Keep only the first N lights that are on
    #[arg(long, value_name = "N", bounds(1, gnomon_protocol::limits::MAX_LIGHTS))]
    pub lights: Option<u32>,
    /// Give a scene without lights a sun
    #[arg(long, value_enum, default_value_t = Switch::On)]
    pub default_light: Switch,
    /// Name or number of the scene to show, of a file with several [default: the file's]
    #[arg(long, value_name = "NAME")]
    pub scene_name: Option<String>,
    /// Name or number of the animation that moves the scene; `all` takes all together, `off` the pose of the file
    /// [default: off]
    #[arg(long, value_name = "NAME")]
    pub animation: Option<String>,
    /// Name or number of the material variant to show [default: none]
    #[arg(long, value_name = "NAME")]
    pub variant: Option<String>,
    /// Names of the nodes that may be moved and hidden, with commas between, or `all` [default: none]
    #[arg(long, value_name = "NAME[,NAME…]")]
    pub editable: Option<String>,
}

impl Reading {
    /// Returns the first flag that was given.
    fn first_given(&self) -> Option<&'static str> {
        let given = [
            (self.lights_from.is_some(), "lights-from"),
            (self.lights.is_some(), "lights"),
            (!self.default_light.is_on(), "default-light"),
            (self.scene_name.is_some(), "scene-name"),
            (self.animation.is_some(), "animation"),
            (self.variant.is_some(), "variant"),
            (self.editable.is_some(), "editable"),
        ];
        given.into_iter().find_map(|(is_given, flag)| is_given.then_some(flag))
    }

    fn scene(self, file: PathBuf) -> LocalScene {
        let options = LoadOptions {
            lights_from: self.lights_from,
            max_lights: self.lights,
            default_light: self.default_light.is_on(),
            scene: self.scene_name,
            animation: self.animation,
            variant: self.variant,
            editable: self.editable.iter().flat_map(|names| names.split(',')).map(str::to_owned).collect(),
        };
        LocalScene { file, options }
    }
}

#[derive(Debug, Clone, PartialEq)]
pub enum Run {
    Headless(HeadlessOptions),
    Window(WindowOptions),
}

impl Run {
    /// Checks settings before anything is opened.
    ///
    /// # Errors
    /// Names the first conflicting settings.
    pub fn validate(&self) -> Result<(), ClientError> {
        match self {
            Self::Headless(options) => options.validate(),
            Self::Window(options) => options.run.validate(),
        }
    }
}

/// Conflicting flags.
#[derive(Debug, Error)]
pub enum ConfigError {
    #[error(
        "which server? Pass the URL that gnomon-server printed, a scene's file or --demo to start one here, or \
         --offline SCENE to draw without one"
    )]
    NoSource,
    #[error("a URL or file and --offline: choose one")]
    TwoSources,
    /// A flag about a scene that the server has loaded.
    #[error("--{0}: with a scene's file or --offline only")]
    FileOnly(&'static str),
    #[error("--token-file {}: {reason}", file.display())]
    TokenFile { file: PathBuf, reason: String },
    /// A flag that has no meaning in a window.
    #[error("--{0}: with --headless only")]
    HeadlessOnly(&'static str),
}

/// Reads flags, environment and TOML file.
///
/// # Errors
/// Names the invalid flag, variable or key.
pub fn load(layers: Layers) -> Result<Loaded<Arguments>, SettingsError> {
    let folder = etcetera::choose_base_strategy().ok().map(|base| base.config_dir().join("gnomon"));
    let own_file = folder.map(|folder| folder.join("client.toml")).filter(|file| file.is_file());
    Layers { own_file, ..layers }.load::<Arguments, ClientSettings>()
}

/// Returns the run that the command line requests.
///
/// # Errors
/// Errors if it is unclear what to draw, or a headless setting is given for a window.
pub fn resolve(loaded: Loaded<Arguments>) -> Result<Run, ConfigError> {
    let Loaded { program: arguments, sources, .. } = loaded;
    let is_flag = |key: &&str| sources.get(*key) == Some(&gnomon_settings::Source::Flag);
    let mut settings = arguments.settings;
    if let Some(file) = arguments.token_file {
        settings.token = Some(read_token(&file).map_err(|reason| ConfigError::TokenFile { file, reason })?);
    }
    let source = match (arguments.offline, settings.url.clone()) {
        (Some(file), None) => Source::Offline(arguments.reading.scene(file)),
        (None, Some(Target::File(file))) => Source::File(arguments.reading.scene(file)),
        (None, _) if let Some(flag) = arguments.reading.first_given() => return Err(ConfigError::FileOnly(flag)),
        (None, Some(Target::Server(url))) => Source::Server(url),
        // A window returns to the last server.
        (None, None) => match KnownServers::load().servers().first() {
            Some(url) if !arguments.headless && !arguments.check_config => Source::Server(url.clone()),
            _ => return Err(ConfigError::NoSource),
        },
        (Some(_), Some(_)) => return Err(ConfigError::TwoSources),
    };
    if !arguments.headless {
        if let Some(name) = ["wait", "frames", "fps", "summary"].into_iter().find(is_flag) {
            return Err(ConfigError::HeadlessOnly(name));
        }
        // The file and the environment may set these for headless runs.
        (settings.wait, settings.frames, settings.fps, settings.summary) = (false, None, None, None);
    }
    let remember = !arguments.headless && !arguments.demo;
    let run = HeadlessOptions { source, settings, record: arguments.record, remember, progress: true };
    if arguments.headless {
        return Ok(Run::Headless(run));
    }
    Ok(Run::Window(WindowOptions { run, exit_after: arguments.exit_after.map(Duration::from_secs_f64) }))
}

/// Reads a token from a file, or from standard input if the file is `-`.
fn read_token(file: &Path) -> Result<String, String> {
    // An end of line may follow.
    let limit = MAX_TOKEN_BYTES as u64 + 2;
    let bytes =
        if file == Path::new("-") { read_bounded(std::io::stdin().lock(), limit) } else { read_small(file, limit) };
    let text = bytes.map_err(|error| match error.kind() {
        std::io::ErrorKind::InvalidData => format!("a token has at most {MAX_TOKEN_BYTES} bytes, this is longer"),
        _ => error.to_string(),
    })?;
    let text = String::from_utf8(text).map_err(|_| "this is no text".to_owned())?;
    let token = text.trim_end_matches(['\r', '\n']);
    match token {
        "" => Err("there is no token in it".to_owned()),
        token if token.contains(char::is_control) => Err("it must have one line, the token".to_owned()),
        token if token.len() > MAX_TOKEN_BYTES => Err(format!("a token has at most {MAX_TOKEN_BYTES} bytes")),
        token => Ok(token.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use gnomon_protocol::codec::CodecId;

    use super::*;
    use crate::{
        config::Size,
        guard::Guard,
        mode::{Mode, Thresholds},
        predictor::Predictor,
    };

    const URL: &str = "gnomon+lab-udp://127.0.0.1:5";

    fn run_with(file: &str, line: &str) -> Result<Run, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("client.toml");
        std::fs::write(&path, file).unwrap();
        let arguments: Vec<_> = ["gnomon-client"].into_iter().chain(line.split_whitespace()).collect();
        let layers = Layers { own_file: Some(path), ..Layers::of(&arguments, &[]) };
        let loaded = layers.load::<Arguments, ClientSettings>().map_err(|error| error.to_string())?;
        resolve(loaded).map_err(|error| error.to_string())
    }

    fn options_with(file: &str, line: &str) -> Result<HeadlessOptions, String> {
        run_with(file, line).map(|run| match run {
            Run::Headless(options) => options,
            Run::Window(options) => options.run,
        })
    }

    #[test]
    fn every_setting_has_all_its_forms() {
        let problems = gnomon_settings::problems::<Arguments, ClientSettings>(gnomon_settings::variables::CLIENT);
        assert!(problems.is_empty(), "{problems:#?}");
        let command = gnomon_settings::command::<Arguments, ClientSettings>();
        let loose: Vec<_> = (command.get_arguments())
            .filter(|argument| argument.get_help_heading().is_none() && argument.get_long().is_some())
            .map(|argument| argument.get_id().to_string())
            .collect();
        assert!(loose.is_empty(), "flags without a heading in the help: {loose:?}");
    }

    #[test]
    fn flags_reach_their_settings() {
        let options = options_with("", "gnomon+lab-udp://127.0.0.1:5 --headless --size 640x360 --wait").unwrap();
        assert_eq!(options.settings.size, Size { width: 640, height: 360 });
        assert!(options.settings.wait && options.settings.allow_software);
        let options = options_with("", "--allow-software --offline a.gltf --exposure -3.5").unwrap();
        assert_eq!((options.settings.allow_software, options.settings.exposure), (true, Some(-3.5)));
        assert!(!options_with("", &format!("{URL} --allow-software=false")).unwrap().settings.allow_software);
        let line = format!("{URL} --mode sequential --guard 128x72 --predict none --predict-pose --fade 0");
        let settings = options_with("", &line).unwrap().settings;
        assert_eq!((settings.mode, settings.predict), (Mode::Sequential, Predictor::None));
        assert_eq!((settings.predict_pose, settings.fade), (Some(true), 0.0));
        assert_eq!(settings.guard.to_string(), "128x72");
    }

    #[test]
    fn a_file_is_opened_with_a_server_of_its_own() {
        let file = |max_lights| LocalScene {
            file: "a/room.glb".into(),
            options: LoadOptions { max_lights, ..LoadOptions::default() },
        };
        assert_eq!(options_with("", "a/room.glb --headless --wait").unwrap().source, Source::File(file(None)));
        assert_eq!(options_with("", "a/room.glb --lights 2").unwrap().source, Source::File(file(Some(2))));
        let line =
            "--default-light off --scene-name=-2 --animation=-all --variant red --lights-from l.json --editable=a,b";
        let Source::File(chosen) = options_with("", &format!("a/room.glb {line}")).unwrap().source else {
            panic!("no file");
        };
        assert_eq!(
            chosen.options,
            LoadOptions {
                lights_from: Some("l.json".into()),
                max_lights: None,
                default_light: false,
                scene: Some("-2".to_owned()),
                animation: Some("-all".to_owned()),
                variant: Some("red".to_owned()),
                editable: vec!["a".to_owned(), "b".to_owned()],
            }
        );
        // The server is told the same.
        let words = ["--scene", "a/room.glb", "--lights-from=l.json", "--default-light=off", "--scene-name=-2"];
        let told = chosen.server_arguments();
        assert_eq!(
            told.iter().map(|word| word.to_str().unwrap()).collect::<Vec<_>>(),
            [&words[..], &["--animation=-all", "--variant=red", "--editable=a,b"]].concat()
        );
        assert_eq!(
            options_with("", &format!("{URL} --variant red")).unwrap_err(),
            "--variant: with a scene's file or --offline only"
        );
        assert_eq!(
            options_with("", &format!("{URL} --animation all")).unwrap_err(),
            "--animation: with a scene's file or --offline only"
        );
        let configured = options_with("url = \"a/room.glb\"", "--headless").unwrap();
        assert_eq!(configured.source, Source::File(file(None)));
    }

    #[test]
    fn without_headless_there_is_a_window() {
        let Run::Window(options) =
            run_with("vsync = false\n", &format!("{URL} --exit-after 2.5 --full-screen")).unwrap()
        else {
            panic!("no window");
        };
        assert_eq!((options.run.settings.vsync, options.run.settings.full_screen), (false, true));
        assert_eq!(options.exit_after, Some(Duration::from_millis(2500)));
        assert!(matches!(run_with("", &format!("{URL} --headless")), Ok(Run::Headless(_))));
        let Run::Window(options) = run_with("wait = true\nframes = 7\n", URL).unwrap() else { panic!("no window") };
        assert_eq!((options.run.settings.wait, options.run.settings.frames, options.run.remember), (false, None, true));
    }

    #[test]
    fn flags_go_before_the_file_and_the_file_before_defaults() {
        let file = format!("url = \"{URL}\"\nsize = \"64x36\"\ncodec = \"words\"\nwait = true\nframes = 7\n");
        let options = options_with(&file, "--headless --frames 9").unwrap();
        assert_eq!((options.settings.size, options.settings.codec), (Size { width: 64, height: 36 }, CodecId::Words));
        assert_eq!((options.settings.frames, options.settings.wait), (Some(9), true));
        assert!(matches!(options.source, Source::Server(url) if url.port == 5));
        assert_eq!(options_with("", &format!("{URL} --headless")).unwrap().settings.size.width, 1280);
    }

    #[test]
    fn what_hides_the_network_is_configuration() {
        let file = format!(
            "url = \"{URL}\"\nmode = \"sequential\"\nguard = \"auto\"\npredict = \"none\"\npredict_pose = true\n\
             sequential_lag = 2\ncalm_frames = 5\nprediction_lag = 0.5\nfade = 0.5\n"
        );
        let options = options_with(&file, "--headless --mode concurrent --fade 0.125 --predict-pose=false").unwrap();
        let settings = &options.settings;
        assert_eq!((settings.mode, settings.guard, settings.predict), (Mode::Concurrent, Guard::Auto, Predictor::None));
        let expected = Thresholds { sequential_lag: 2, calm_frames: 5, prediction_lag_s: 0.5, fade_s: 0.125 };
        assert_eq!((settings.thresholds(), settings.predict_pose), (expected, Some(false)));
        let default = options_with("", &format!("{URL} --headless")).unwrap().settings;
        assert_eq!((default.mode, default.thresholds()), (Mode::Auto, Thresholds::default()));
        assert_eq!((default.guard, default.predict_pose), (Guard::default(), None));
    }

    #[test]
    fn a_token_is_read_from_a_file_of_one_line() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("token");
        let read = |text: &[u8]| {
            std::fs::write(&file, text).unwrap();
            let options =
                options_with("token = \"other\"", &format!("{URL} --headless --token-file {}", file.display()));
            options.map(|options| options.settings.token.unwrap())
        };
        let longest = "x".repeat(MAX_TOKEN_BYTES);
        for text in ["s3cret", "s3cret\n", "s3cret\r\n"] {
            assert_eq!(read(text.as_bytes()), Ok("s3cret".to_owned()));
        }
        assert_eq!(read(format!("{longest}\n").as_bytes()), Ok(longest.clone()));
        for (text, expected) in [
            (&b""[..], "no token"),
            (b"\n\n", "no token"),
            (b"s3cret\n[[token]]\n", "one line"),
            (b"\xff\n", "no text"),
            (format!("{longest}x").as_bytes(), "at most 512 bytes"),
            (format!("{longest}xyz").as_bytes(), "at most 512 bytes"),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.starts_with("--token-file /") && error.contains(expected), "{error}");
            assert!(!error.contains("s3cret") && !error.contains('\n'), "{error}");
        }
        let zero = options_with("", &format!("{URL} --headless --token-file /dev/zero")).unwrap_err();
        assert!(zero.contains("not a regular file"), "{zero}");
        let both =
            options_with("", &format!("{URL} --headless --token a --token-file {}", file.display())).unwrap_err();
        assert!(both.contains("cannot be used with"), "{both}");
    }

    #[test]
    fn mistakes_say_what_to_do() {
        for (file, line, expected) in [
            ("", "--headless", "which server?"),
            ("", "gnomon+lab-udp://127.0.0.1:5 --wait", "--headless"),
            ("", "gnomon+lab-udp://127.0.0.1:5 --exit-after 1e12", "--exit-after 1e12: must be 0 to 1000000000"),
            ("", "gnomon+lab-udp://127.0.0.1:5 --headless --offline a.gltf", "choose one"),
            ("", "--mode fast", "--mode fast: must be one of auto, concurrent, sequential"),
            ("", "--guard 63x36", "even"),
            ("", "--predict all", "must be one of none, dissertation"),
            ("", "--size 640", "WIDTHxHEIGHT"),
            ("", "--size=-1x3", "--size -1x3: must be WIDTHxHEIGHT"),
            ("", "--codec zip", "must be one of words, words-lz4"),
            ("", "--lights 3", "--offline"),
            ("", "gnomon+lab-udp://127.0.0.1:5 --lights 3", "--lights: with a scene's file or --offline only"),
            ("", "room --headless", "neither a URL"),
            ("", "room.glb --headless --offline a.gltf", "choose one"),
            ("", "http://x:1", "gnomon://"),
            ("", "--colour", "'--colour'"),
            ("", "--frames 0", "--frames 0: must be 1 to 10000000"),
            ("", "--fps 0", "--fps 0: must be 0.001 to 100000"),
            ("", "--start-time=-1", "--start-time -1: must be"),
            ("", "--start-time nan", "--start-time nan: must be 0 to 1000000000"),
            ("", "--exposure 41", "--exposure 41: must be -40 to 40"),
            ("", "--fade 61", "--fade 61: must be 0 to 60"),
            ("", "--prediction-lag 100", "--prediction-lag 100: must be 0 to 4"),
            ("", "--lossy 1.5", "--lossy 1.5: must be 0 to 1"),
            ("colour = 1", "--headless", "unknown key \"colour\""),
            ("guard = \"63x36\"", "--headless", "even"),
            ("mode = \"fast\"", "--headless", "sequential"),
            ("size = \"big\"", "--headless", "WIDTHxHEIGHT"),
            ("url = \"gnomon://a:1\"", "--headless", "cert"),
            (
                "connect_timeout = 0",
                "--headless --offline a.gltf",
                "line 1: connect_timeout = 0: must be 0.001 to 3600",
            ),
        ] {
            let error = run_with(file, line).unwrap_err();
            assert!(error.contains(expected) && !error.contains('\n'), "{file:?} {line:?}: {error}");
        }
    }
}
