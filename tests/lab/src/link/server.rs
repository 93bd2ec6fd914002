//! A link in front of a server, for any transport.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use anyhow::{Context, Result, bail};
use url::Url;

use super::{handle::Relay, lab_udp, settings::LinkSettings, udp};

/// Listens on `listen`. `server` is the URL that the server printed or, for QUIC and any other UDP, its address. Needs
/// a tokio runtime.
pub async fn start(listen: SocketAddr, server: &str, settings: LinkSettings) -> Result<Relay> {
    let address = server_address(server)?;
    Ok(match server.split_once("://").map(|(scheme, _)| scheme) {
        None | Some("gnomon") => udp::start(listen, address, settings)?,
        Some("gnomon+lab-udp") => lab_udp::start(listen, address, settings).await?,
        Some(scheme) => bail!("{scheme}:// carries no datagrams: use gnomon or gnomon+lab-udp"),
    })
}

impl Relay {
    /// Returns the server's URL or address, redirected to this link.
    pub fn url(&self, server: &str) -> Result<String> {
        if !server.contains("://") {
            return Ok(self.address().to_string());
        }
        let mut url = Url::parse(server)?;
        url.set_ip_host(self.address().ip()).ok().context("this URL takes no address")?;
        url.set_port(Some(self.address().port())).ok().context("this URL takes no port")?;
        Ok(url.into())
    }
}

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
