//! The command line and the environment: each flag overrides its variable, which overrides the configuration file.

use std::{net::SocketAddr, num::NonZeroUsize, path::PathBuf};

use clap::Parser;

use crate::config::{AdminAddress, Backend, ConfigError, LogFormat, ServerConfig, Transport};
use crate::{admission::tokens::store::Scope, operate::otlp::collector::Collector};

/// Ray-traces visibility at the edge, for thin clients that render their own frames.
///
/// Prints one line on standard output when it listens: the URL for gnomon-client. Logs go to standard error.
/// Every flag has an environment variable, and both have a key in the configuration file, with underscores:
/// defaults < file < environment < flags.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 120)]
pub struct Cli {
    /// TOML file with defaults for everything below
    #[arg(long, env = "GNOMON_CONFIG", value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Load configuration and scene, print what was found, and exit
    #[arg(long)]
    pub check: bool,
    /// Load the configuration, print it whole, and exit
    #[arg(long, conflicts_with = "check")]
    pub check_config: bool,
    /// What to do instead of serving.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// Everything that overrides the file.
    #[command(flatten)]
    pub flags: Flags,
}

/// What to do instead of serving.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// Make a bearer token: the first line is the client's secret, what follows is its entry for --token-file
    Token {
        /// Whose it is, for people
        #[arg(long, default_value = "")]
        name: String,
        /// Days until it ends [default: never]
        #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=36_500))]
        days: Option<u32>,
        /// What it is good for
        #[arg(long, value_enum, default_values = ["session"])]
        scope: Vec<Scope>,
        /// It admits one session, and then nobody
        #[arg(long)]
        once: bool,
    },
}

/// What a flag or a variable overrides.
#[derive(Debug, Default, clap::Args)]
pub struct Flags {
    /// Scene to trace: .gltf, .glb, or a packed scene from a client's cache
    #[arg(long, env = "GNOMON_SCENE", value_name = "FILE")]
    pub scene: Option<PathBuf>,
    /// JSON file with lights, for a scene that has none
    #[arg(long, env = "GNOMON_LIGHTS_FROM", value_name = "FILE")]
    pub lights_from: Option<PathBuf>,
    /// Keep the first N lights only
    #[arg(long, env = "GNOMON_LIGHTS", value_name = "N")]
    pub lights: Option<u32>,
    /// Address to listen on; port 0 takes a free one [default: 127.0.0.1:4433]
    #[arg(long, env = "GNOMON_LISTEN", value_name = "ADDR:PORT")]
    pub listen: Option<SocketAddr>,
    /// Host (and port, if it differs) to print in the URL [default: what this machine is reached by]
    #[arg(long, env = "GNOMON_ADVERTISE", value_name = "HOST[:PORT]")]
    pub advertise: Option<String>,
    /// What carries sessions; the lab transports are unencrypted and listen on loopback only [default: quic]
    #[arg(long, env = "GNOMON_TRANSPORT", value_enum)]
    pub transport: Option<Transport>,
    /// What traces [default: auto]
    #[arg(long, env = "GNOMON_BACKEND", value_enum)]
    pub backend: Option<Backend>,
    /// Part of the name of the graphics adapter to trace on
    #[arg(long, env = "GNOMON_ADAPTER", value_name = "NAME")]
    pub adapter: Option<String>,
    /// Let ray-query and compute run on a software adapter
    #[arg(long, env = "GNOMON_ALLOW_SOFTWARE", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    pub allow_software: Option<bool>,
    /// Threads of the cpu back end [default: all cores]
    #[arg(long, env = "GNOMON_THREADS", value_name = "N")]
    pub threads: Option<NonZeroUsize>,
    /// Devices to trace on [default: all adapters of the best kind]
    #[arg(long, env = "GNOMON_DEVICES", value_name = "N")]
    pub devices: Option<NonZeroUsize>,
    /// Time of each device that admitted sessions may need in a second; whoever would need more is refused [default: 900]
    #[arg(long, env = "GNOMON_DEVICE_BUDGET_MS", value_name = "MS")]
    pub device_budget_ms: Option<u32>,
    /// Time of all cores that sessions' encoding may need in a second; whoever would need more is refused [default: 800 a core]
    #[arg(long, env = "GNOMON_CORES_BUDGET_MS", value_name = "MS")]
    pub cores_budget_ms: Option<u32>,
    /// What sessions may be sent in a second; whoever would need more is refused [default: no bound]
    #[arg(long, env = "GNOMON_NETWORK_BUDGET_MBIT", value_name = "MBIT")]
    pub network_budget_mbit: Option<u32>,
    /// Admit only clients with a token that this file lists; `gnomon-server token` makes its entries
    #[arg(long, env = "GNOMON_TOKEN_FILE", value_name = "FILE")]
    pub token_file: Option<PathBuf>,
    /// Sessions at once [default: 64]
    #[arg(long, env = "GNOMON_MAX_SESSIONS", value_name = "N")]
    pub max_sessions: Option<usize>,
    /// Sessions of one address at once, loopback excepted [default: 16]
    #[arg(long, env = "GNOMON_MAX_SESSIONS_PER_ADDRESS", value_name = "N")]
    pub max_sessions_per_address: Option<usize>,
    /// Silence after which a session is gone [default: 10000]
    #[arg(long, env = "GNOMON_IDLE_TIMEOUT_MS", value_name = "MS")]
    pub idle_timeout_ms: Option<u64>,
    /// Time from a peer's first packet to its Hello [default: 5000]
    #[arg(long, env = "GNOMON_HANDSHAKE_TIMEOUT_MS", value_name = "MS")]
    pub handshake_timeout_ms: Option<u64>,
    /// Time that clients get to move elsewhere when the server drains [default: 1000]
    #[arg(long, env = "GNOMON_DRAIN_MS", value_name = "MS")]
    pub drain_ms: Option<u32>,
    /// Server to name to the clients of a draining one
    #[arg(long, env = "GNOMON_ALTERNATIVE", value_name = "URL")]
    pub alternative: Option<String>,
    /// Bytes in flight that a connection starts with [default: 65536]
    #[arg(long, env = "GNOMON_INITIAL_WINDOW_BYTES", value_name = "BYTES")]
    pub initial_window_bytes: Option<u64>,
    /// Form of the logs; RUST_LOG filters them [default: pretty]
    #[arg(long, env = "GNOMON_LOG", value_enum)]
    pub log: Option<LogFormat>,
    /// File to append the logs to, opened anew on SIGHUP [default: standard error]
    #[arg(long, env = "GNOMON_LOG_FILE", value_name = "FILE")]
    pub log_file: Option<PathBuf>,
    /// Address for /live, /ready, /metrics and /sessions; a port alone is on loopback [default: none]
    #[arg(long, env = "GNOMON_ADMIN", value_name = "[ADDR:]PORT")]
    pub admin: Option<AdminAddress>,
    /// OpenTelemetry collector to send metrics to, as OTLP over HTTP [default: none]
    #[arg(long, env = "GNOMON_OTLP", value_name = "http://HOST[:4318]")]
    pub otlp: Option<Collector>,
    /// Tell Agones' sidecar how the server is; wants a server built with --features agones
    #[arg(long, env = "GNOMON_AGONES", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    pub agones: Option<bool>,
    /// Folder where the certificate is kept [default: the user's state folder]
    #[arg(long, env = "GNOMON_CERT_DIR", value_name = "DIR")]
    pub cert_dir: Option<PathBuf>,
    /// Certificate chain in PEM, read again on SIGHUP [default: a self-made one, which clients pin]
    #[arg(long, env = "GNOMON_CERT_FILE", value_name = "FILE")]
    pub cert_file: Option<PathBuf>,
    /// Private key of the certificate in PEM, read again on SIGHUP
    #[arg(long, env = "GNOMON_KEY_FILE", value_name = "FILE")]
    pub key_file: Option<PathBuf>,
}

impl Cli {
    /// The configuration: the file's over the defaults, flags and environment over both. It is validated.
    ///
    /// # Errors
    /// When the file or a value is wrong.
    pub fn resolve(&self) -> Result<ServerConfig, ConfigError> {
        let mut config = self.config.as_deref().map_or_else(|| Ok(ServerConfig::default()), ServerConfig::from_file)?;
        self.flags.apply(&mut config);
        config.validate()?;
        Ok(config)
    }
}

impl Flags {
    fn apply(&self, config: &mut ServerConfig) {
        fn set<T: Clone>(place: &mut T, value: &Option<T>) {
            if let Some(value) = value {
                place.clone_from(value);
            }
        }
        fn set_some<T: Clone>(place: &mut Option<T>, value: &Option<T>) {
            if value.is_some() {
                place.clone_from(value);
            }
        }
        set_some(&mut config.scene, &self.scene);
        set_some(&mut config.lights_from, &self.lights_from);
        set_some(&mut config.lights, &self.lights);
        set(&mut config.listen, &self.listen);
        set_some(&mut config.advertise, &self.advertise);
        set(&mut config.transport, &self.transport);
        set(&mut config.backend, &self.backend);
        set_some(&mut config.adapter, &self.adapter);
        set(&mut config.allow_software, &self.allow_software);
        set_some(&mut config.threads, &self.threads);
        set_some(&mut config.devices, &self.devices);
        set(&mut config.device_budget_ms, &self.device_budget_ms);
        set_some(&mut config.cores_budget_ms, &self.cores_budget_ms);
        set_some(&mut config.network_budget_mbit, &self.network_budget_mbit);
        set_some(&mut config.token_file, &self.token_file);
        set(&mut config.max_sessions, &self.max_sessions);
        set(&mut config.max_sessions_per_address, &self.max_sessions_per_address);
        set(&mut config.idle_timeout_ms, &self.idle_timeout_ms);
        set(&mut config.handshake_timeout_ms, &self.handshake_timeout_ms);
        set(&mut config.drain_ms, &self.drain_ms);
        set_some(&mut config.alternative, &self.alternative);
        set(&mut config.initial_window_bytes, &self.initial_window_bytes);
        set(&mut config.log, &self.log);
        set_some(&mut config.log_file, &self.log_file);
        set_some(&mut config.admin, &self.admin);
        set_some(&mut config.otlp, &self.otlp);
        set(&mut config.agones, &self.agones);
        set_some(&mut config.cert_dir, &self.cert_dir);
        set_some(&mut config.cert_file, &self.cert_file);
        set_some(&mut config.key_file, &self.key_file);
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn every_key_of_the_file_is_a_flag_and_the_other_way_round() {
        let keys = serde_json::to_value(ServerConfig::default()).unwrap();
        let mut keys: Vec<_> = keys.as_object().unwrap().keys().map(|key| key.replace('_', "-")).collect();
        let mut flags: Vec<_> =
            Cli::command().get_arguments().filter_map(|flag| flag.get_long().map(str::to_owned)).collect();
        flags.retain(|flag| !["config", "check", "check-config"].contains(&flag.as_str()));
        keys.sort();
        flags.sort();
        assert_eq!(keys, flags);
    }

    #[test]
    fn every_flag_reaches_its_key() {
        let arguments = [
            "gnomon-server",
            "--scene=a.glb",
            "--lights-from=l.json",
            "--lights=3",
            "--listen=127.0.0.1:9",
            "--advertise=edge",
            "--transport=lab-tcp",
            "--backend=cpu",
            "--adapter=H100",
            "--allow-software",
            "--threads=2",
            "--devices=3",
            "--device-budget-ms=600",
            "--cores-budget-ms=500",
            "--network-budget-mbit=400",
            "--token-file=t",
            "--max-sessions=5",
            "--max-sessions-per-address=4",
            "--idle-timeout-ms=700",
            "--handshake-timeout-ms=800",
            "--drain-ms=900",
            "--alternative=gnomon://b:1/",
            "--initial-window-bytes=100000",
            "--log=json",
            "--log-file=l",
            "--admin=9",
            "--otlp=http://collector",
            "--agones=false",
            "--cert-dir=c",
            "--cert-file=f",
            "--key-file=k",
        ];
        let expected = ServerConfig {
            scene: Some("a.glb".into()),
            lights_from: Some("l.json".into()),
            lights: Some(3),
            listen: "127.0.0.1:9".parse().unwrap(),
            advertise: Some("edge".into()),
            transport: Transport::LabTcp,
            backend: Backend::Cpu,
            adapter: Some("H100".into()),
            allow_software: true,
            threads: NonZeroUsize::new(2),
            devices: NonZeroUsize::new(3),
            device_budget_ms: 600,
            cores_budget_ms: Some(500),
            network_budget_mbit: Some(400),
            token_file: Some("t".into()),
            max_sessions: 5,
            max_sessions_per_address: 4,
            idle_timeout_ms: 700,
            handshake_timeout_ms: 800,
            drain_ms: 900,
            alternative: Some("gnomon://b:1/".into()),
            initial_window_bytes: 100_000,
            log: LogFormat::Json,
            log_file: Some("l".into()),
            admin: Some("127.0.0.1:9".parse().unwrap()),
            otlp: Some("http://collector".parse().unwrap()),
            agones: false,
            cert_dir: Some("c".into()),
            cert_file: Some("f".into()),
            key_file: Some("k".into()),
        };
        assert_eq!(Cli::try_parse_from(arguments).unwrap().resolve().unwrap(), expected);
    }
}
