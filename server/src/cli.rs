//! The command line.

use std::path::PathBuf;

use clap::Parser;
use gnomon_settings::{Layers, Loaded, SettingsError, Shell};

use crate::{
    admission::tokens::scope::Scope,
    config::{AdminAddress, ServerConfig},
};

/// Ray-traces visibility at the edge, for thin clients that render their own frames
///
/// Prints one line on standard output when it listens: the URL for gnomon-client. Logs go to standard error.
/// A setting is a flag, an environment variable or a key of the TOML file (the flag's name with underscores).
/// Flags override variables, which override the file.
#[derive(Debug, Parser)]
#[command(name = "gnomon-server", version, max_term_width = 120)]
pub struct Cli {
    /// TOML file with settings; relative paths in it start from its folder
    #[arg(long, env = "GNOMON_CONFIG", value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Load settings and scene, print what was found, and exit
    #[arg(long)]
    pub check: bool,
    /// Print every setting with its source as JSON, and exit
    #[arg(long, conflicts_with = "check")]
    pub check_config: bool,
    /// Print completions for this shell, and exit
    #[arg(long, value_name = "SHELL")]
    pub completions: Option<Shell>,
    /// Print a man page, and exit
    #[arg(long)]
    pub man: bool,
    #[command(subcommand)]
    pub command: Option<Command>,
    #[command(flatten)]
    pub settings: ServerConfig,
}

/// A command other than serving.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// Make a bearer token: prints the client's secret, then its entry for --token-file
    Token {
        /// Name of the token's owner, only a label
        #[arg(long, default_value = "")]
        name: String,
        /// Days until the token expires [default: never]
        #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=36_500))]
        days: Option<u32>,
        /// What the token permits
        #[arg(long, value_enum, default_values = ["session"])]
        scope: Vec<Scope>,
        /// Admit one session only
        #[arg(long)]
        once: bool,
    },
    /// Make or replace the self-signed certificate; prints its SHA-256, which clients pin
    Certificate {
        #[arg(value_enum)]
        action: CertificateAction,
        /// Folder of the certificate [default: the server's own]
        #[arg(long = "cert-dir", value_name = "DIR")]
        folder: Option<PathBuf>,
    },
    /// List the sessions of a running server, or end one, through its admin address
    Sessions {
        /// Admin address of the server [default: that of --admin]
        #[arg(long, value_name = "[ADDR:]PORT")]
        admin: Option<AdminAddress>,
        /// File with the secret of a token with the scope admin; - reads standard input
        #[arg(long, value_name = "FILE")]
        secret: Option<PathBuf>,
        #[command(subcommand)]
        action: Option<SessionsAction>,
    },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum CertificateAction {
    /// Make the certificate, unless there is one
    Identity,
    /// Make the one that will follow, unless there is one; SIGHUP announces it in the server's URL
    Spare,
    /// Put the spare one into its place; SIGHUP uses it
    UseSpare,
}

/// What to do with sessions instead of listing them.
#[derive(Debug, clap::Subcommand)]
pub enum SessionsAction {
    /// End a session; its client is told, and stays away for a while
    End {
        /// Number of the session, as listed
        id: u64,
    },
}

/// Reads flags, environment and TOML file.
///
/// # Errors
/// Names the flag, variable or key that is wrong.
pub fn load(layers: Layers) -> Result<Loaded<Cli>, SettingsError> {
    Layers { paths_from_file: true, ..layers }.load::<Cli, ServerConfig>()
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroUsize;

    use super::*;
    use gnomon_settings::Switch;

    use crate::config::{Backend, LogFormat, Transport};

    fn load_with(arguments: &[&str], environment: &[(&str, &str)]) -> Result<Loaded<Cli>, SettingsError> {
        load(Layers::of(arguments, environment))
    }

    #[test]
    fn every_setting_has_all_its_forms() {
        let problems = gnomon_settings::problems::<Cli, ServerConfig>(gnomon_settings::variables::SERVER);
        assert!(problems.is_empty(), "{problems:#?}");
    }

    #[test]
    fn paths_in_a_file_start_from_its_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("gnomon.toml");
        std::fs::write(&path, "scene = \"a.glb\"\ntoken_file = \"/etc/tokens\"\n").unwrap();
        let config = |path: &std::path::Path| load_with(&["gnomon-server", "--config", path.to_str().unwrap()], &[]);
        let settings = config(&path).unwrap().program.settings;
        assert_eq!(settings.scene, Some(folder.path().join("a.glb")));
        assert_eq!(settings.token_file, Some("/etc/tokens".into()));
        assert!(config(&folder.path().join("none.toml")).unwrap_err().to_string().contains("none.toml"));
    }

    #[test]
    fn every_flag_reaches_its_setting() {
        let alternative = format!("gnomon://b:1/?cert={}", "0f".repeat(32));
        let arguments = [
            "gnomon-server",
            "--scene=a.glb",
            "--lights-from=l.json",
            "--lights=3",
            "--default-light=off",
            "--scene-name=hall",
            "--animation=all",
            "--editable=door,lamp",
            "--shared-world",
            "--variant=2",
            "--listen=127.0.0.1:9",
            "--advertise=edge",
            "--transport=lab-tcp",
            "--browsers=false",
            "--backend=cpu",
            "--adapter=H100",
            "--allow-software",
            "--threads=2",
            "--devices=3",
            "--device-budget-ms=600",
            "--cores-budget-ms=500",
            "--network-budget-mbit=400",
            "--memory-budget-mb=2000",
            "--token-file=t",
            "--max-sessions=5",
            "--max-sessions-per-address=4",
            "--idle-timeout-ms=700",
            "--handshake-timeout-ms=800",
            "--drain-ms=900",
            &format!("--alternative={alternative}"),
            "--initial-window-bytes=100000",
            "--log=json",
            "--log-file=l",
            "--admin=9",
            "--admin-hosts=edge,gnomon",
            "--otlp=http://collector",
            "--agones=false",
            "--web=8",
            "--web-root=r",
            "--origins=https://a.example",
            "--cert-dir=c",
            "--cert-file=f",
            "--key-file=k",
            "--next-cert-file=n",
        ];
        let expected = ServerConfig {
            scene: Some("a.glb".into()),
            lights_from: Some("l.json".into()),
            lights: Some(3),
            default_light: Switch::Off,
            scene_name: Some("hall".into()),
            animation: Some("all".into()),
            editable: Some("door,lamp".into()),
            shared_world: true,
            variant: Some("2".into()),
            listen: "127.0.0.1:9".parse().unwrap(),
            advertise: Some("edge".into()),
            transport: Transport::LabTcp,
            browsers: false,
            backend: Backend::Cpu,
            adapter: Some("H100".into()),
            allow_software: true,
            threads: NonZeroUsize::new(2),
            devices: NonZeroUsize::new(3),
            device_budget_ms: 600,
            cores_budget_ms: Some(500),
            network_budget_mbit: Some(400),
            memory_budget_mb: Some(2000),
            token_file: Some("t".into()),
            max_sessions: 5,
            max_sessions_per_address: 4,
            idle_timeout_ms: 700,
            handshake_timeout_ms: 800,
            drain_ms: 900,
            alternative: Some(alternative.clone()),
            initial_window_bytes: 100_000,
            log: LogFormat::Json,
            log_file: Some("l".into()),
            admin: Some("127.0.0.1:9".parse().unwrap()),
            admin_hosts: Some("edge,gnomon".parse().unwrap()),
            otlp: Some("http://collector".parse().unwrap()),
            agones: false,
            web: Some("127.0.0.1:8".parse().unwrap()),
            web_root: Some("r".into()),
            origins: Some("https://a.example".parse().unwrap()),
            cert_dir: Some("c".into()),
            cert_file: Some("f".into()),
            key_file: Some("k".into()),
            next_cert_file: Some("n".into()),
        };
        assert_eq!(load_with(&arguments, &[]).unwrap().program.settings, expected);
    }
}
