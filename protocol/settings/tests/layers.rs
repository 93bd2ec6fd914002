//! A small program through every layer.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::path::PathBuf;

use clap::Parser;
use gnomon_settings::{Bounds as _, Layers, Loaded, SettingsError, Source};

/// A program.
#[derive(Debug, Parser)]
#[command(name = "program")]
struct Program {
    /// File with settings
    #[arg(long, env = "GNOMON_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
    #[command(flatten)]
    settings: Settings,
}

#[derive(Debug, PartialEq, clap::Args)]
struct Settings {
    /// Address to visit
    #[arg(value_name = "URL")]
    url: Option<String>,
    /// Time to drain, in ms
    #[arg(long, value_name = "MS", default_value_t = 64, bounds(1, 4096_u32))]
    drain_ms: u32,
    /// Fade, in s
    #[arg(long, value_name = "S", default_value_t = 0.25, bounds(0.0, 60.0))]
    fade: f64,
    /// Wait for each frame
    #[arg(long)]
    wait: bool,
    /// Output folder
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Secret
    #[arg(long, hide_env_values = true)]
    token: Option<String>,
}

struct Case<'a> {
    file: &'a str,
    environment: &'a [(&'a str, &'a str)],
    flags: &'a [&'a str],
}

impl Case<'_> {
    fn load(&self) -> Result<Loaded<Program>, SettingsError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("settings.toml");
        std::fs::write(&path, self.file).unwrap();
        let arguments: Vec<_> = ["program"].iter().chain(self.flags).copied().collect();
        Layers { own_file: Some(path), ..Layers::of(&arguments, self.environment) }.load::<Program, Settings>()
    }

    fn error(&self) -> String {
        let error = self.load().unwrap_err().to_string();
        assert!(!error.contains('\n'), "{error}");
        error
    }
}

#[test]
fn flags_beat_variables_which_beat_the_file_which_beats_defaults() {
    let (file, environment, flags) = ("drain_ms = 2", [("GNOMON_DRAIN_MS", "3")], ["--drain-ms", "4"]);
    let variable = Source::Environment("GNOMON_DRAIN_MS".to_owned());
    for (case, expected, source) in [
        (Case { file: "", environment: &[], flags: &[] }, 64, Source::Default),
        (Case { file, environment: &[], flags: &[] }, 2, Source::File),
        (Case { file, environment: &environment, flags: &[] }, 3, variable.clone()),
        (Case { file: "", environment: &environment, flags: &[] }, 3, variable),
        (Case { file, environment: &environment, flags: &flags }, 4, Source::Flag),
        (Case { file, environment: &[], flags: &flags }, 4, Source::Flag),
        // A flag counts even if it repeats the default.
        (Case { file, environment: &environment, flags: &["--drain-ms=64"] }, 64, Source::Flag),
    ] {
        let loaded = case.load().unwrap();
        assert_eq!((loaded.program.settings.drain_ms, &loaded.sources["drain_ms"]), (expected, &source));
        assert_eq!(loaded.values["drain_ms"], expected);
    }
}

#[test]
fn a_flag_switches_off_what_the_file_switches_on() {
    let wait = |flags| Case { file: "wait = true", environment: &[], flags }.load().unwrap().program.settings.wait;
    assert!(wait(&[]) && wait(&["--wait"]) && !wait(&["--wait=false"]));
    assert!(
        Case { file: "", environment: &[("GNOMON_WAIT", "true")], flags: &[] }.load().unwrap().program.settings.wait
    );
}

#[test]
fn an_empty_variable_is_unset() {
    let empty = [("GNOMON_DRAIN_MS", ""), ("GNOMON_OUT", ""), ("GNOMON_CONFIG", ""), ("GNOMON_NONSENSE", "")];
    let loaded = Case { file: "drain_ms = 2", environment: &empty, flags: &[] }.load().unwrap();
    assert_eq!((loaded.program.settings.drain_ms, loaded.program.settings.out), (2, None));
}

#[test]
fn an_unknown_variable_is_an_error_that_names_the_nearest() {
    let error =
        |name| Case { file: "", environment: &[(name, "1")], flags: &[] }.load().map_err(|error| error.to_string());
    for name in [
        "GNOMON_DRAIN",
        "GNOMON_DRIAN_MS",
        "GNOMON_DRAIN_MSS",
        "GNOMON_DRAINS_MS",
        "gnomon_drain_ms",
        "Gnomon_Drain_Ms",
        "GNOMON_DRAIN_PORT",
        "GNOMON_DRAIN_PORT_MS",
    ] {
        let expected = format!("unknown environment variable {name}; did you mean GNOMON_DRAIN_MS?");
        assert_eq!(error(name).unwrap_err(), expected);
    }
    // Of our other programs, Kubernetes, and others.
    for name in ["GNOMON_SCENES", "GNOMON_MAX_SESSIONS", "GNOMON_PORT_4433_UDP", "GNOMON_SERVICE_HOST", "DRAIN_MS"] {
        error(name).unwrap();
    }
    let service = [
        ("GNOMON_PORT", "udp://10.0.0.1:4433"),
        ("GNOMON_X_PORT", "tcp://10.0.0.1:9464"),
        ("GNOMON_PORT_4433_UDP_ADDR", "10.0.0.1"),
        ("GNOMON_X_SERVICE_PORT_ADMIN", "9464"),
    ];
    Case { file: "", environment: &service, flags: &[] }.load().unwrap();
}

#[test]
fn an_unknown_key_or_flag_is_an_error_that_names_the_nearest() {
    let file = Case { file: "\ndrain = 1", environment: &[], flags: &[] }.error();
    assert!(file.ends_with("settings.toml: line 2: unknown key \"drain\"; did you mean drain_ms?"), "{file}");
    let flag = Case { file: "", environment: &[], flags: &["--drain-m=1"] }.error();
    assert!(
        flag.starts_with("unexpected argument '--drain-m' found; a similar argument exists: '--drain-ms'"),
        "{flag}"
    );
}

#[test]
fn an_error_names_where_its_value_comes_from() {
    for (case, expected) in [
        (Case { file: "", environment: &[], flags: &["--drain-ms", "0"] }, "--drain-ms 0: must be 1 to 4096"),
        (
            Case { file: "", environment: &[("GNOMON_DRAIN_MS", "x")], flags: &[] },
            "GNOMON_DRAIN_MS=x: must be 1 to 4096",
        ),
        (
            Case { file: "\ndrain_ms = 5000", environment: &[], flags: &[] },
            "settings.toml: line 2: drain_ms = 5000: must be 1 to 4096",
        ),
        // An overridden layer is checked too.
        (
            Case { file: "fade = nan", environment: &[("GNOMON_FADE", "1")], flags: &["--fade", "2"] },
            "settings.toml: line 1: fade = nan: must be 0 to 60",
        ),
        (Case { file: "wait = 1", environment: &[], flags: &[] }, "line 1: wait must be true or false, not integer"),
        (
            Case { file: "", environment: &[("GNOMON_WAIT", "yes")], flags: &[] },
            "GNOMON_WAIT=yes: must be one of true, false",
        ),
        (Case { file: "drain_ms = 0x1_0\ndrain_ms = 2", environment: &[], flags: &[] }, "line 2: duplicate key"),
        (Case { file: "", environment: &[], flags: &["--drain-ms"] }, "a value is required for '--drain-ms <MS>'"),
    ] {
        let error = case.error();
        assert!(error.contains(expected), "{error}");
    }
    let hexadecimal = Case { file: "drain_ms = 0x1_0", environment: &[], flags: &[] }.load().unwrap();
    assert_eq!(hexadecimal.program.settings.drain_ms, 16);
}

#[test]
fn config_names_the_file_as_a_flag_or_a_variable() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("other.toml");
    std::fs::write(&path, "out = \"pictures\"").unwrap();
    let path = path.to_str().unwrap();
    let layers = |arguments: &[&str], environment: &[(&str, &str)]| Layers::of(arguments, environment);
    for layers in [layers(&["program", "--config", path], &[]), layers(&["program"], &[("GNOMON_CONFIG", path)])] {
        let out = |layers: Layers| layers.load::<Program, Settings>().unwrap().program.settings.out;
        assert_eq!(out(layers.clone()), Some("pictures".into()));
        assert_eq!(out(Layers { paths_from_file: true, ..layers }), Some(folder.path().join("pictures")));
    }
    let missing = layers(&["program", "--config", "/nowhere.toml"], &[]).load::<Program, Settings>().unwrap_err();
    assert!(missing.to_string().starts_with("cannot read the configuration /nowhere.toml: No such file"), "{missing}");
}

#[test]
fn the_help_has_unit_bounds_variable_and_default() {
    let Err(SettingsError::Answer(help)) = Case { file: "drain_ms = 5", environment: &[], flags: &["--help"] }.load()
    else {
        panic!("no help");
    };
    let help = help.to_string();
    assert!(help.contains("--drain-ms <MS>"), "{help}");
    assert!(help.contains("Time to drain, in ms [1 to 4096] [env: GNOMON_DRAIN_MS] [default: 64]"), "{help}");
    let problems = gnomon_settings::problems::<Program, Settings>("CONFIG DRAIN_MS FADE OUT TOKEN URL");
    assert_eq!(problems, ["GNOMON_WAIT: not in gnomon_settings::variables"]);
}

#[test]
fn the_report_has_values_and_sources_and_no_secret() {
    let environment = [("GNOMON_TOKEN", "hush"), ("GNOMON_URL", "7")];
    let loaded = Case { file: "fade = 1", environment: &environment, flags: &["--wait"] }.load().unwrap();
    let report: serde_json::Value = serde_json::from_str(&loaded.to_json()).unwrap();
    let expected = serde_json::json!({
        "drain_ms": 64, "fade": 1, "out": null, "token": "(hidden)", "url": "7", "wait": true,
        "sources": {
            "drain_ms": "default", "fade": "file", "out": "default",
            "token": "GNOMON_TOKEN", "url": "GNOMON_URL", "wait": "flag",
        },
    });
    assert_eq!(report, expected);
}
