//! The daemon's settings: each is declared once, here. [`gnomon_settings`] reads them.

use std::{
    fmt,
    net::{IpAddr, Ipv4Addr, SocketAddr},
    num::NonZeroUsize,
    path::PathBuf,
    str::FromStr,
    time::Duration,
};

use gnomon_settings::{Bounds as _, SettingsError, Switch};
use thiserror::Error;

pub use crate::visibility::engine::BackendChoice as Backend;
use crate::{
    limits, names,
    operate::{admin::hosts::AdminHosts, otlp::collector::Collector},
    origins::Origins,
};

/// Everything that an operator can choose. Doc comments are the `--help` texts.
#[derive(Debug, Clone, PartialEq, clap::Args)]
pub struct ServerConfig {
    /// Scene to trace: .gltf, .glb, or a packed scene from a client's cache
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,
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
    /// Names of the nodes that clients may move and hide, with commas between, or `all`; lights may always be changed
    /// [default: none]
    #[arg(long, value_name = "NAME[,NAME…]")]
    pub editable: Option<String>,
    /// Show all clients one scene and one clock: what one changes, all see
    #[arg(long)]
    pub shared_world: bool,
    /// Name or number of the material variant to show [default: none]
    #[arg(long, value_name = "NAME")]
    pub variant: Option<String>,
    /// Address to listen on; port 0 takes a free port
    #[arg(long, value_name = "ADDR:PORT", default_value = "127.0.0.1:4433")]
    pub listen: SocketAddr,
    /// Host, and port if it differs, to print in the URL [default: this machine's own address]
    #[arg(long, value_name = "HOST[:PORT]", value_parser = names::advertised)]
    pub advertise: Option<String>,
    /// Transport of the sessions; the lab transports are unencrypted and listen on loopback only
    #[arg(long, value_enum, default_value_t = Transport::Quic)]
    pub transport: Transport,
    /// Serve browsers, too, by WebTransport (h3) on the same port; `--browsers=false` leaves the native protocol only
    #[arg(long, default_value_t = true)]
    pub browsers: bool,
    /// What traces the rays
    #[arg(long, value_enum, default_value_t = Backend::Auto)]
    pub backend: Backend,
    /// Part of the name of the graphics adapter to trace on
    #[arg(long, value_name = "NAME")]
    pub adapter: Option<String>,
    /// Let the ray-query and compute back ends run on a software adapter
    #[arg(long)]
    pub allow_software: bool,
    /// Threads of the cpu back end [default: one per core]
    #[arg(long, value_name = "N", bounds(NonZeroUsize::MIN, limits::MAX_THREADS))]
    pub threads: Option<NonZeroUsize>,
    /// Devices to trace on [default: all adapters of the best kind; one for the cpu back end]
    #[arg(long, value_name = "N", bounds(NonZeroUsize::MIN, limits::MAX_DEVICES))]
    pub devices: Option<NonZeroUsize>,
    /// Tracing time per device and second, in ms, that admitted sessions may need; sessions beyond it are refused
    #[arg(long, value_name = "MS", default_value_t = 900, bounds(1, 1_000_000_u32))]
    pub device_budget_ms: u32,
    /// Encoding time of all cores per second, in ms, that admitted sessions may need; sessions beyond it are refused
    /// [default: 800 per core]
    #[arg(long, value_name = "MS", bounds(1, 1_000_000_u32))]
    pub cores_budget_ms: Option<u32>,
    /// Bandwidth in Mbit/s that admitted sessions may need; sessions beyond it are refused [default: unlimited]
    #[arg(long, value_name = "MBIT", bounds(1, 10_000_000_u32))]
    pub network_budget_mbit: Option<u32>,
    /// Memory in MB that admitted sessions may come to hold; sessions beyond it are refused [default: half of what is
    /// free at the start]
    #[arg(long, value_name = "MB", bounds(16, 100_000_000_u32))]
    pub memory_budget_mb: Option<u32>,
    /// Admit only clients with a token from this file; `gnomon-server token` makes its entries [default: admit
    /// everyone]
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,
    /// Most sessions at once
    #[arg(long, value_name = "N", default_value_t = 64, bounds(1, limits::MAX_SESSIONS))]
    pub max_sessions: usize,
    /// Most sessions at once from one address; loopback is exempt, as a local proxy makes all clients share it
    #[arg(long, value_name = "N", default_value_t = 16, bounds(1, limits::MAX_SESSIONS))]
    pub max_sessions_per_address: usize,
    /// End a session whose peer has been silent for this many ms
    #[arg(long, value_name = "MS", default_value_t = 10_000, bounds(100, 600_000_u64))]
    pub idle_timeout_ms: u64,
    /// Most time from a peer's first packet to its Hello, in ms
    #[arg(long, value_name = "MS", default_value_t = 5_000, bounds(100, 60_000_u64))]
    pub handshake_timeout_ms: u64,
    /// Time for clients to move elsewhere when the server drains, in ms
    #[arg(long, value_name = "MS", default_value_t = 1_000, bounds(0, 3_600_000_u32))]
    pub drain_ms: u32,
    /// Server that clients of a draining server should move to: the URL that it prints
    #[arg(long, value_name = "URL", value_parser = names::alternative)]
    pub alternative: Option<String>,
    /// First congestion window of a connection, in bytes: too large overflows narrow paths, too small starts slowly
    #[arg(long, value_name = "BYTES", default_value_t = 64 * 1024, bounds(16 * 1024, 64 * 1024 * 1024_u64))]
    pub initial_window_bytes: u64,
    /// Format of the logs; RUST_LOG filters them
    #[arg(long, value_enum, default_value_t = LogFormat::Pretty)]
    pub log: LogFormat,
    /// File to append logs to, reopened on SIGHUP [default: standard error]
    #[arg(long, value_name = "FILE")]
    pub log_file: Option<PathBuf>,
    /// Address for /live, /ready, /metrics and /sessions, or off; a port alone is on loopback [default: off]
    #[arg(long, value_name = "[ADDR:]PORT")]
    pub admin: Option<AdminAddress>,
    /// Names that the admin address answers to, besides localhost and addresses
    #[arg(long, value_name = "HOST[,HOST…]")]
    pub admin_hosts: Option<AdminHosts>,
    /// OpenTelemetry collector to send metrics to, as OTLP over HTTP [default: none]
    #[arg(long, value_name = "http://HOST[:4318]")]
    pub otlp: Option<Collector>,
    /// Report health to the Agones sidecar; needs a build with --features agones
    #[arg(long)]
    pub agones: bool,
    /// Address of the page for browsers, and of /gnomon.json, where pages find port and certificate hashes; a port
    /// alone is on loopback. Other addresses need --cert-file, and answer over HTTPS [default: none]
    #[arg(long, value_name = "[ADDR:]PORT")]
    pub web: Option<AdminAddress>,
    /// Folder of the page for browsers, as `make web` builds it [default: the one in this program, if it was built with
    /// --features page]
    #[arg(long, value_name = "DIR")]
    pub web_root: Option<PathBuf>,
    /// Origins of web pages that may connect, with commas between [default: every origin]
    #[arg(long, value_name = "https://HOST,…")]
    pub origins: Option<Origins>,
    /// Folder for the self-signed certificate and its key [default: the user's state folder]
    #[arg(long, value_name = "DIR")]
    pub cert_dir: Option<PathBuf>,
    /// Certificate chain in PEM, reread on SIGHUP [default: a self-signed certificate, which clients pin]
    #[arg(long, value_name = "FILE")]
    pub cert_file: Option<PathBuf>,
    /// Private key of --cert-file in PEM, reread on SIGHUP
    #[arg(long, value_name = "FILE")]
    pub key_file: Option<PathBuf>,
    /// Certificate in PEM that will follow, reread on SIGHUP: the URL announces it beside the present one [default:
    /// spare.pem in --cert-dir, if `gnomon-server certificate spare` made it]
    #[arg(long, value_name = "FILE")]
    pub next_cert_file: Option<PathBuf>,
}

impl Default for ServerConfig {
    fn default() -> Self {
        gnomon_settings::defaults()
    }
}

/// Address for HTTP: `ADDR:PORT`, `PORT` on loopback, or `off`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AdminAddress {
    Off,
    At(SocketAddr),
}

impl AdminAddress {
    #[must_use]
    pub const fn address(self) -> Option<SocketAddr> {
        match self {
            Self::Off => None,
            Self::At(address) => Some(address),
        }
    }
}

impl FromStr for AdminAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        if text == "off" {
            return Ok(Self::Off);
        }
        let on_loopback = text.parse().map(|port| SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), port));
        let address = on_loopback.or_else(|_| text.parse());
        address.map(Self::At).map_err(|_| format!("{text:?} is neither ADDR:PORT nor a port, nor off"))
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Transport {
    /// QUIC datagrams, and WebTransport for browsers on the same port
    Quic,
    /// The dissertation's raw UDP (§3.1), for measurements: unencrypted, loopback only
    LabUdp,
    /// The dissertation's TCP baseline, for measurements: unencrypted, loopback only
    LabTcp,
}

impl Transport {
    #[must_use]
    pub const fn scheme(self) -> &'static str {
        match self {
            Self::Quic => "gnomon",
            Self::LabUdp => "gnomon+lab-udp",
            Self::LabTcp => "gnomon+lab-tcp",
        }
    }
}

impl fmt::Display for Transport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Quic => "quic",
            Self::LabUdp => "lab-udp",
            Self::LabTcp => "lab-tcp",
        })
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum LogFormat {
    /// One JSON object per line
    Json,
    /// Human-readable text
    Pretty,
}

/// Settings that conflict.
#[derive(Debug, Error)]
pub enum ConfigError {
    #[error("--agones needs a gnomon-server built with --features agones")]
    NoAgones,
    #[error("--cert-file and --key-file belong together")]
    HalfACertificate,
    #[error(
        "--web {0} would answer in the clear: pass --cert-file and --key-file for HTTPS, or --web PORT to answer on \
         loopback only"
    )]
    WebInTheClear(SocketAddr),
    #[error("--web-root is for the page at --web: pass both")]
    RootWithoutWeb,
    #[error("--web is for web pages, which need --transport quic")]
    WebWithoutQuic,
    #[error("--web is for web pages, which --browsers=false turns away: leave one of them out")]
    WebWithoutBrowsers,
    /// A lab transport on an address that others can reach.
    #[error(
        "--transport {transport} sends everything unencrypted and unauthenticated, so it listens on loopback only, \
         not on {listen}: use --listen 127.0.0.1:PORT, or --transport quic"
    )]
    LabBeyondLoopback { transport: Transport, listen: SocketAddr },
}

impl FromStr for ServerConfig {
    type Err = SettingsError;

    /// Reads TOML over the defaults.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        gnomon_settings::parse_toml(text)
    }
}

impl ServerConfig {
    /// Checks settings against each other. Bounds of single settings are checked when they are read.
    ///
    /// # Errors
    /// Names the first settings that conflict.
    pub fn validate(&self) -> Result<(), ConfigError> {
        if self.cert_file.is_some() != self.key_file.is_some() {
            return Err(ConfigError::HalfACertificate);
        }
        if let Some(web) = self.web.and_then(AdminAddress::address) {
            if self.transport != Transport::Quic {
                return Err(ConfigError::WebWithoutQuic);
            }
            if !self.browsers {
                return Err(ConfigError::WebWithoutBrowsers);
            }
            if self.cert_file.is_none() && !web.ip().is_loopback() {
                return Err(ConfigError::WebInTheClear(web));
            }
        }
        if self.web_root.is_some() && self.web.and_then(AdminAddress::address).is_none() {
            return Err(ConfigError::RootWithoutWeb);
        }
        if self.agones && !cfg!(feature = "agones") {
            return Err(ConfigError::NoAgones);
        }
        if self.transport != Transport::Quic && !self.listen.ip().is_loopback() {
            return Err(ConfigError::LabBeyondLoopback { transport: self.transport, listen: self.listen });
        }
        Ok(())
    }

    /// Returns whether everybody who reaches the server is admitted, and not only this machine reaches it.
    #[must_use]
    pub fn is_open(&self) -> bool {
        self.token_file.is_none() && !self.listen.ip().to_canonical().is_loopback()
    }

    #[must_use]
    pub const fn idle_timeout(&self) -> Duration {
        Duration::from_millis(self.idle_timeout_ms)
    }

    #[must_use]
    pub const fn handshake_timeout(&self) -> Duration {
        Duration::from_millis(self.handshake_timeout_ms)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn toml_overrides_defaults_and_nothing_else() {
        let config: ServerConfig = "scene = \"a.glb\"\ntransport = \"lab-udp\"\nmax_sessions = 3\n".parse().unwrap();
        let expected = ServerConfig {
            scene: Some("a.glb".into()),
            transport: Transport::LabUdp,
            max_sessions: 3,
            ..ServerConfig::default()
        };
        assert_eq!(config, expected);
    }

    #[test]
    fn bad_toml_is_one_line_that_names_the_key() {
        for (text, part) in [
            ("\nmax_session = 3\n", "line 2: unknown key \"max_session\"; did you mean max_sessions?"),
            ("backend = \"gpu\"", "line 1: backend = gpu: must be one of auto, ray-query, compute, cpu"),
            ("max_sessions = -1", "line 1: max_sessions = -1: must be 1 to 4096"),
            ("max_sessions = 0", "line 1: max_sessions = 0: must be 1 to 4096"),
            ("threads = 0", "line 1: threads = 0: must be 1 to 1024"),
            ("lights = 33", "line 1: lights = 33: must be 1 to 32"),
            ("max_sessions = \"3\"", "line 1: max_sessions must be a number, not string"),
            ("idle_timeout_ms = 1", "must be 100 to 600000"),
            ("advertise = \"a b\"", "without spaces"),
            ("advertise = \"edge:99999\"", "line 1: advertise = edge:99999: 99999 is no port"),
            ("alternative = \"gnomon://b:1/\"", "line 1: alternative = gnomon://b:1/: it lacks ?cert=SHA256"),
            ("admin_hosts = \"10.0.0.1\"", "list names only"),
            ("listen = \"nowhere\"", "line 1: listen = nowhere: invalid socket address"),
            ("admin = \"everywhere\"", "neither ADDR:PORT nor a port"),
            ("web = \"https://edge.example\"", "neither ADDR:PORT nor a port"),
            (
                "origins = \"a.example\"",
                "line 1: origins = a.example: \"a.example\" is not an origin: write https://HOST",
            ),
            ("scene =", "line 1"),
            ("scene = \"a\"\nscene = \"b\"", "line 2"),
        ] {
            let message = text.parse::<ServerConfig>().unwrap_err().to_string();
            assert!(message.contains(part) && !message.contains('\n'), "{text:?} gives {message:?}");
        }
    }

    #[test]
    fn an_admin_port_alone_is_on_loopback_and_off_is_none() {
        let admin = |text: &str| format!("admin = \"{text}\"").parse::<ServerConfig>().unwrap().admin.unwrap();
        for (text, expected) in [("9464", "127.0.0.1:9464"), ("0.0.0.0:80", "0.0.0.0:80"), ("[::1]:0", "[::1]:0")] {
            assert_eq!(admin(text).address().unwrap(), expected.parse().unwrap());
        }
        assert_eq!(admin("off").address(), None);
    }

    #[test]
    fn a_server_without_tokens_is_open_beyond_loopback() {
        for (listen, tokens, open) in [
            ("127.0.0.1:0", None, false),
            ("127.9.9.9:0", None, false),
            ("[::1]:0", None, false),
            ("[::ffff:127.0.0.1]:0", None, false),
            ("0.0.0.0:0", None, true),
            ("[::]:0", None, true),
            ("192.0.2.1:0", None, true),
            ("0.0.0.0:0", Some("tokens".into()), false),
        ] {
            let listen = listen.parse().unwrap();
            assert_eq!(
                ServerConfig { listen, token_file: tokens, ..ServerConfig::default() }.is_open(),
                open,
                "{listen}"
            );
        }
    }

    #[test]
    fn a_certificate_needs_its_key() {
        ServerConfig::default().validate().unwrap();
        let half = ServerConfig { key_file: Some("k".into()), ..ServerConfig::default() };
        assert_eq!(half.validate().unwrap_err().to_string(), "--cert-file and --key-file belong together");
    }

    #[test]
    fn the_web_address_is_on_loopback_or_encrypted() {
        let config = |text: &str| text.parse::<ServerConfig>().unwrap().validate();
        config("web = \"8080\"").unwrap();
        config("web = \"[::1]:8080\"").unwrap();
        config("web = \"0.0.0.0:443\"\ncert_file = \"c\"\nkey_file = \"k\"").unwrap();
        let clear = config("web = \"0.0.0.0:80\"").unwrap_err().to_string();
        assert!(clear.contains("0.0.0.0:80") && clear.contains("--cert-file"), "{clear}");
        let lab = config("web = \"8080\"\ntransport = \"lab-tcp\"").unwrap_err().to_string();
        assert!(lab.contains("--transport quic"), "{lab}");
        let none = config("web = \"8080\"\nbrowsers = false").unwrap_err().to_string();
        assert!(none.contains("--browsers=false"), "{none}");
        config("web = \"8080\"\nweb_root = \"page\"").unwrap();
        let rootless = config("web_root = \"page\"").unwrap_err().to_string();
        assert!(rootless.contains("--web-root") && rootless.contains("pass both"), "{rootless}");
    }

    #[test]
    fn lab_transports_stay_on_loopback() {
        for transport in [Transport::LabUdp, Transport::LabTcp] {
            for (listen, fine) in [
                ("127.0.0.1:0", true),
                ("[::1]:0", true),
                ("0.0.0.0:0", false),
                ("[::]:0", false),
                ("192.0.2.1:0", false),
            ] {
                let config = ServerConfig { transport, listen: listen.parse().unwrap(), ..ServerConfig::default() };
                assert_eq!(config.validate().is_ok(), fine, "{transport} on {listen}");
            }
        }
        let quic = ServerConfig { listen: "0.0.0.0:0".parse().unwrap(), ..ServerConfig::default() };
        quic.validate().unwrap();
    }
}
