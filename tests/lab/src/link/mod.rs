//! A network to test on: datagrams between a real client and a real server, on loopback, with the delays and losses of
//! other networks.
//!
//! [`impairment`] decides what becomes of a datagram: a state machine without a clock or a socket. [`relay`] puts one in
//! either direction of UDP flows; [`lab`] does the same for `lab-udp`, whose data port is agreed over TCP. [`profiles`]
//! has the networks by name.

mod flow;
pub mod impairment;
pub mod lab;
pub mod profiles;
pub mod relay;
pub mod settings;
pub mod trace;

use std::{
    io,
    net::{IpAddr, Ipv4Addr, SocketAddr},
    ops::AddAssign,
    sync::{Arc, Mutex, PoisonError},
};

use anyhow::{Context, Result, bail};
use url::Url;

pub use impairment::Counts;
pub use lab::LabRelay;
pub use relay::UdpRelay;
pub use settings::{LinkSettings, Settings};

/// What became of the datagrams of either direction, over all clients.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct LinkCounts {
    /// From client to server.
    pub up: Counts,
    /// From server to client.
    pub down: Counts,
    /// Datagrams or connections of clients beyond those that fit.
    pub refused: u64,
}

impl AddAssign for LinkCounts {
    fn add_assign(&mut self, other: Self) {
        self.up += other.up;
        self.down += other.down;
        self.refused += other.refused;
    }
}

/// A link in front of a server, whatever its transport.
#[derive(Debug)]
pub enum Link {
    /// QUIC, or any UDP.
    Udp(UdpRelay),
    /// `lab-udp`.
    Lab(LabRelay),
}

impl Link {
    /// Listens on `listen`, for a server that is told by the URL that it printed or, if it speaks QUIC or any other UDP, by
    /// its address. Needs a tokio runtime.
    ///
    /// # Errors
    /// When an address is not loopback, the port is taken, or the transport has no datagrams.
    pub async fn start(listen: SocketAddr, server: &str, settings: LinkSettings) -> Result<Self> {
        let address = server_address(server)?;
        match server.split_once("://").map(|(scheme, _)| scheme) {
            None | Some("gnomon") => Ok(Self::Udp(UdpRelay::start(listen, address, settings)?)),
            Some("gnomon+lab-udp") => Ok(Self::Lab(LabRelay::start(listen, address, settings).await?)),
            Some(scheme) => bail!("{scheme}:// has no datagrams for a link to carry: gnomon and gnomon+lab-udp have"),
        }
    }

    /// Where clients go.
    #[must_use]
    pub const fn address(&self) -> SocketAddr {
        match self {
            Self::Udp(relay) => relay.address(),
            Self::Lab(relay) => relay.address(),
        }
    }

    /// The server's URL, with the link in its place; of an address, the link's address.
    ///
    /// # Errors
    /// When `server` is no URL, though it looks like one.
    pub fn url(&self, server: &str) -> Result<String> {
        if !server.contains("://") {
            return Ok(self.address().to_string());
        }
        let mut url = Url::parse(server)?;
        url.set_ip_host(self.address().ip()).ok().context("this URL takes no address")?;
        url.set_port(Some(self.address().port())).ok().context("this URL takes no port")?;
        Ok(url.into())
    }

    /// What became of the datagrams so far.
    #[must_use]
    pub fn counts(&self) -> LinkCounts {
        match self {
            Self::Udp(relay) => relay.counts(),
            Self::Lab(relay) => relay.counts(),
        }
    }
}

/// The address of a server that is told by URL or by address.
fn server_address(server: &str) -> Result<SocketAddr> {
    if !server.contains("://") {
        return server.parse().with_context(|| format!("{server:?} is neither ADDRESS:PORT nor a server's URL"));
    }
    let url = Url::parse(server).with_context(|| format!("{server:?}"))?;
    let host = url.host_str().unwrap_or_default().trim_matches(['[', ']']);
    let ip = if host == "localhost" { Ok(IpAddr::V4(Ipv4Addr::LOCALHOST)) } else { host.parse() };
    let port = url.port().with_context(|| format!("{server:?} names no port"))?;
    Ok(SocketAddr::new(ip.with_context(|| format!("{host:?} is not loopback: the link takes nothing else"))?, port))
}

/// The counters, shared by all tasks of a link.
#[derive(Debug, Clone, Default)]
struct Shared(Arc<Mutex<LinkCounts>>);

impl Shared {
    fn add(&self, counts: LinkCounts) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) += counts;
    }

    fn get(&self) -> LinkCounts {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Refuses every address that other machines could reach or be reached at: a link is for tests, and forwards anything.
fn loopback_only(address: SocketAddr) -> io::Result<SocketAddr> {
    if address.ip().is_loopback() {
        return Ok(address);
    }
    Err(io::Error::new(io::ErrorKind::InvalidInput, format!("{address} is not loopback: the link takes nothing else")))
}
