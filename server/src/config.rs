//! The daemon's configuration: defaults < TOML < environment < flags. The last two are [`crate::cli::Flags`].

use std::{
    fmt,
    net::{IpAddr, Ipv4Addr, SocketAddr},
    num::NonZeroUsize,
    path::{Path, PathBuf},
    str::FromStr,
    time::Duration,
};

use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use crate::visibility::engine::BackendChoice as Backend;
use crate::{files, limits, operate::otlp::collector::Collector};

/// Everything that an operator can choose. A key that is not listed here is an error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ServerConfig {
    /// The scene, `.gltf` or `.glb`.
    pub scene: Option<PathBuf>,
    /// A JSON file with lights, for a scene that has none.
    pub lights_from: Option<PathBuf>,
    /// Keeps the first lights only.
    pub lights: Option<u32>,
    /// Address to listen on; port 0 takes a free one.
    pub listen: SocketAddr,
    /// Host name or address to print in the URL, where the listen address is not the one that clients reach.
    pub advertise: Option<String>,
    /// What carries sessions.
    pub transport: Transport,
    /// What traces.
    pub backend: Backend,
    /// Part of the name of the graphics adapter to trace on.
    pub adapter: Option<String>,
    /// Lets `ray-query` and `compute` run on a software adapter.
    pub allow_software: bool,
    /// Threads of the `cpu` back end; all cores without it.
    pub threads: Option<NonZeroUsize>,
    /// Devices to trace on; all adapters of the best kind without a number, and one for the `cpu` back end.
    pub devices: Option<NonZeroUsize>,
    /// Time of each device that admitted sessions may need in a second, in milliseconds. A client that would need more is refused.
    pub device_budget_ms: u32,
    /// Time of all cores together that admitted sessions' encoding may need in a second, in milliseconds; 800 of each core without it.
    pub cores_budget_ms: Option<u32>,
    /// What admitted sessions may be sent in a second, in Mbit; without it the network is not budgeted.
    pub network_budget_mbit: Option<u32>,
    /// File with the tokens that admit a client, one a line; without it everybody is admitted.
    pub token_file: Option<PathBuf>,
    /// Sessions that are served at once.
    pub max_sessions: usize,
    /// Sessions of one address at once. Loopback is exempt: behind a proxy on this machine everybody has its address.
    pub max_sessions_per_address: usize,
    /// Silence of a peer after which its session is gone, in milliseconds.
    pub idle_timeout_ms: u64,
    /// Time from a peer's first packet to its Hello, in milliseconds.
    pub handshake_timeout_ms: u64,
    /// Time that clients get to move elsewhere when the server drains, in milliseconds.
    pub drain_ms: u32,
    /// URL of a server to name to the clients of a draining one.
    pub alternative: Option<String>,
    /// Bytes in flight that a connection starts with; more overflow narrow paths, and fewer take some round trips longer.
    pub initial_window_bytes: u64,
    /// Form of the logs.
    pub log: LogFormat,
    /// File that the logs are appended to, opened anew on SIGHUP; standard error without it.
    pub log_file: Option<PathBuf>,
    /// Address for `/live`, `/ready`, `/metrics` and `/sessions`; without it there is none.
    pub admin: Option<AdminAddress>,
    /// OpenTelemetry collector that is sent what `/metrics` shows; without it none is.
    pub otlp: Option<Collector>,
    /// Whether Agones' sidecar is told how the server is; wants the cargo feature of that name.
    pub agones: bool,
    /// Folder where the certificate and its key are kept; the user's state folder without it.
    pub cert_dir: Option<PathBuf>,
    /// Certificate chain in PEM, of a name that a CA vouches for; without it the server makes its own, which clients pin.
    pub cert_file: Option<PathBuf>,
    /// Private key of `cert_file`, in PEM.
    pub key_file: Option<PathBuf>,
}

impl Default for ServerConfig {
    fn default() -> Self {
        Self {
            scene: None,
            lights_from: None,
            lights: None,
            listen: SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 4433),
            advertise: None,
            transport: Transport::Quic,
            backend: Backend::Auto,
            adapter: None,
            allow_software: false,
            threads: None,
            devices: None,
            device_budget_ms: 900,
            cores_budget_ms: None,
            network_budget_mbit: None,
            token_file: None,
            max_sessions: 64,
            max_sessions_per_address: 16,
            idle_timeout_ms: 10_000,
            handshake_timeout_ms: 5_000,
            drain_ms: 1_000,
            alternative: None,
            initial_window_bytes: 64 * 1024,
            log: LogFormat::Pretty,
            log_file: None,
            admin: None,
            otlp: None,
            agones: false,
            cert_dir: None,
            cert_file: None,
            key_file: None,
        }
    }
}

/// Where the admin address is: `ADDR:PORT`, or a port alone, which is on loopback.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct AdminAddress(pub SocketAddr);

impl FromStr for AdminAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let on_loopback = text.parse().map(|port| SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), port));
        on_loopback.or_else(|_| text.parse()).map(Self).map_err(|_| format!("{text:?} is neither ADDR:PORT nor a port"))
    }
}

impl TryFrom<String> for AdminAddress {
    type Error = String;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

impl From<AdminAddress> for String {
    fn from(address: AdminAddress) -> Self {
        address.0.to_string()
    }
}

/// What carries sessions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Transport {
    /// QUIC datagrams, and WebTransport for browsers on the same port.
    Quic,
    /// The dissertation's raw UDP (§3.1): no encryption, loopback only, for measurements.
    LabUdp,
    /// The dissertation's baseline, TCP: no encryption, loopback only, for measurements.
    LabTcp,
}

impl Transport {
    /// The scheme of its URLs.
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

/// Form of the logs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum LogFormat {
    /// One JSON object a line.
    Json,
    /// For people.
    Pretty,
}

/// Why a configuration cannot be used.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read the configuration {path}: {reason}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: std::io::Error,
    },
    /// The file is no TOML, or has an unknown key or a bad value.
    #[error("{path}: {message}")]
    Parse {
        /// The file.
        path: PathBuf,
        /// Line, column and reason.
        message: String,
    },
    /// A value is out of its range.
    #[error("{key} is {value}: it must be {allowed}")]
    Range {
        /// The key.
        key: &'static str,
        /// What it was set to.
        value: String,
        /// What it may be.
        allowed: String,
    },
    /// The program does not know Agones.
    #[error("--agones wants a gnomon-server that was built with --features agones")]
    NoAgones,
    /// A certificate without its key, or the other way round.
    #[error("--cert-file and --key-file belong together")]
    HalfACertificate,
    /// A lab transport on an address that others can reach.
    #[error(
        "--transport {transport} sends everything unencrypted and unauthenticated, so it listens on loopback only, \
         not on {listen}: use --listen 127.0.0.1:PORT, or --transport quic"
    )]
    LabBeyondLoopback {
        /// The transport.
        transport: Transport,
        /// The address asked for.
        listen: SocketAddr,
    },
}

impl FromStr for ServerConfig {
    type Err = String;

    /// Reads TOML over the defaults.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        toml::from_str(text).map_err(|error| one_line(&error, text))
    }
}

/// A TOML error on one line: the parser's own message draws a picture of several.
fn one_line(error: &toml::de::Error, text: &str) -> String {
    let reason = error.message().trim().replace('\n', " ");
    format!("{}: {reason}", place_of(error, text))
}

/// Where a TOML error is, without a word of what is there.
pub(crate) fn place_of(error: &toml::de::Error, text: &str) -> String {
    match error.span().and_then(|span| text.get(..span.start)) {
        Some(before) => format!("line {}", before.matches('\n').count() + 1),
        None => "some line".to_owned(),
    }
}

impl ServerConfig {
    /// Reads a TOML file over the defaults. Relative paths inside it are relative to the file's folder.
    ///
    /// # Errors
    /// When the file cannot be read, is no TOML, or has an unknown key or a bad value.
    pub fn from_file(path: &Path) -> Result<Self, ConfigError> {
        let text = files::read_small(path, limits::MAX_SMALL_FILE_BYTES)
            .map_err(|reason| ConfigError::Read { path: path.to_owned(), reason })?;
        let mut config: Self = String::from_utf8_lossy(&text)
            .parse()
            .map_err(|message| ConfigError::Parse { path: path.to_owned(), message })?;
        if let Some(folder) = path.parent() {
            let paths = [
                &mut config.scene,
                &mut config.lights_from,
                &mut config.token_file,
                &mut config.log_file,
                &mut config.cert_dir,
                &mut config.cert_file,
                &mut config.key_file,
            ];
            for path in paths.into_iter().flatten() {
                *path = folder.join(&*path);
            }
        }
        Ok(config)
    }

    /// Checks every value that has a range.
    ///
    /// # Errors
    /// Names the first value that is out of its range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let range = |key, value: u64, least: u64, most: u64| {
            if (least..=most).contains(&value) {
                Ok(())
            } else {
                let allowed = format!("{least} to {most}");
                Err(ConfigError::Range { key, value: value.to_string(), allowed })
            }
        };
        range("max_sessions", self.max_sessions as u64, 1, limits::MAX_SESSIONS as u64)?;
        range("max_sessions_per_address", self.max_sessions_per_address as u64, 1, limits::MAX_SESSIONS as u64)?;
        range("idle_timeout_ms", self.idle_timeout_ms, 100, 600_000)?;
        range("handshake_timeout_ms", self.handshake_timeout_ms, 100, 60_000)?;
        range("drain_ms", self.drain_ms.into(), 0, 3_600_000)?;
        range("initial_window_bytes", self.initial_window_bytes, 16 * 1024, 64 * 1024 * 1024)?;
        if let Some(lights) = self.lights {
            range("lights", lights.into(), 1, gnomon_protocol::limits::MAX_LIGHTS.into())?;
        }
        if let Some(threads) = self.threads {
            range("threads", threads.get() as u64, 1, 1024)?;
        }
        if let Some(devices) = self.devices {
            range("devices", devices.get() as u64, 1, limits::MAX_DEVICES)?;
        }
        range("device_budget_ms", self.device_budget_ms.into(), 1, 1_000_000)?;
        range("cores_budget_ms", self.cores_budget_ms.unwrap_or(1).into(), 1, 1_000_000)?;
        range("network_budget_mbit", self.network_budget_mbit.unwrap_or(1).into(), 1, 10_000_000)?;
        let text = |key, text: &Option<String>| {
            let most = gnomon_protocol::limits::MAX_TEXT_BYTES;
            match text {
                Some(text) if text.is_empty() || text.len() > most || text.chars().any(char::is_whitespace) => {
                    let allowed = format!("1 to {most} bytes without spaces");
                    Err(ConfigError::Range { key, value: format!("{text:?}"), allowed })
                }
                _ => Ok(()),
            }
        };
        text("advertise", &self.advertise)?;
        text("alternative", &self.alternative)?;
        if self.cert_file.is_some() != self.key_file.is_some() {
            return Err(ConfigError::HalfACertificate);
        }
        if self.agones && !cfg!(feature = "agones") {
            return Err(ConfigError::NoAgones);
        }
        if self.transport != Transport::Quic && !self.listen.ip().is_loopback() {
            return Err(ConfigError::LabBeyondLoopback { transport: self.transport, listen: self.listen });
        }
        Ok(())
    }

    /// [`Self::idle_timeout_ms`] as a duration.
    #[must_use]
    pub const fn idle_timeout(&self) -> Duration {
        Duration::from_millis(self.idle_timeout_ms)
    }

    /// [`Self::handshake_timeout_ms`] as a duration.
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
    fn unknown_keys_and_bad_values_are_errors_on_one_line() {
        for (text, part) in [
            ("\nmax_session = 3\n", "line 2: unknown field `max_session`"),
            ("backend = \"gpu\"", "unknown variant `gpu`"),
            ("max_sessions = -1", "line 1"),
            ("threads = 0", "line 1"),
            ("listen = \"nowhere\"", "line 1"),
            ("scene =", "line 1"),
        ] {
            let message = text.parse::<ServerConfig>().unwrap_err();
            assert!(message.contains(part) && !message.contains('\n'), "{text:?} gives {message:?}");
        }
    }

    #[test]
    fn an_admin_port_alone_is_on_loopback() {
        for (text, expected) in [("9464", "127.0.0.1:9464"), ("0.0.0.0:80", "0.0.0.0:80"), ("[::1]:0", "[::1]:0")] {
            let config: ServerConfig = format!("admin = \"{text}\"").parse().unwrap();
            assert_eq!(config.admin.unwrap().0, expected.parse().unwrap());
        }
        "admin = \"everywhere\"".parse::<ServerConfig>().unwrap_err();
    }

    #[test]
    fn ranges_are_checked_and_named() {
        let bad = |change: fn(&mut ServerConfig)| {
            let mut config = ServerConfig::default();
            change(&mut config);
            config.validate().unwrap_err().to_string()
        };
        assert_eq!(bad(|c| c.max_sessions = 0), "max_sessions is 0: it must be 1 to 4096");
        assert_eq!(bad(|c| c.lights = Some(33)), "lights is 33: it must be 1 to 32");
        assert_eq!(bad(|c| c.key_file = Some("k".into())), "--cert-file and --key-file belong together");
        assert!(bad(|c| c.idle_timeout_ms = 1).starts_with("idle_timeout_ms is 1:"));
        assert!(bad(|c| c.advertise = Some("a b".into())).starts_with("advertise is \"a b\":"));
        ServerConfig::default().validate().unwrap();
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

    #[test]
    fn paths_in_a_file_are_relative_to_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("gnomon.toml");
        std::fs::write(&path, "scene = \"a.glb\"\ntoken_file = \"/etc/tokens\"\n").unwrap();
        let config = ServerConfig::from_file(&path).unwrap();
        assert_eq!(config.scene, Some(folder.path().join("a.glb")));
        assert_eq!(config.token_file, Some("/etc/tokens".into()));
        assert!(
            ServerConfig::from_file(&folder.path().join("none.toml")).unwrap_err().to_string().contains("none.toml")
        );
    }
}
