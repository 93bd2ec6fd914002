//! The URL that the server prints for its clients.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};

use crate::{config::ServerConfig, net::certificate::Certificates};

/// The URL without certificates.
pub(super) fn base(config: &ServerConfig, local_addr: SocketAddr) -> String {
    let authority = match &config.advertise {
        Some(host) => authority(host, local_addr.port()),
        None => reachable(local_addr).to_string(),
    };
    format!("{}://{authority}/", config.transport.scheme())
}

/// The port in a URL that [`base`] made.
pub(super) fn port(base: &str, local_addr: SocketAddr) -> u16 {
    let written = base.trim_end_matches('/').rsplit_once(':').and_then(|(_, port)| port.parse().ok());
    written.unwrap_or_else(|| local_addr.port())
}

/// Adds the certificates that a client may trust: the present one, and the announced one.
pub(super) fn pinning(base: &str, certificates: &Certificates) -> String {
    let present = certificates.permanent_sha256();
    let next = certificates.next_sha256().map(|sha256| format!("&cert={sha256}")).unwrap_or_default();
    format!("{base}?cert={present}{next}")
}

/// Completes `HOST[:PORT]` with the port, and puts brackets around a bare IPv6 address.
fn authority(host: &str, port: u16) -> String {
    match host.rsplit_once(':') {
        _ if host.parse::<Ipv6Addr>().is_ok() => format!("[{host}]:{port}"),
        Some((before, after)) if !before.is_empty() && after.parse::<u16>().is_ok() => host.to_owned(),
        _ => format!("{host}:{port}"),
    }
}

/// Replaces an unspecified address by this machine's address towards others, so that the URL works here
/// and elsewhere. Connecting a UDP socket sends nothing.
fn reachable(address: SocketAddr) -> SocketAddr {
    if !address.ip().is_unspecified() {
        return address;
    }
    let (from, to): (SocketAddr, SocketAddr) = (
        (Ipv4Addr::UNSPECIFIED, 0).into(),
        // TEST-NET-1 (RFC 5737): routed like any distant address, but assigned to nobody.
        (Ipv4Addr::new(192, 0, 2, 1), 9).into(),
    );
    let outward = UdpSocket::bind(from).and_then(|socket| socket.connect(to).and_then(|()| socket.local_addr()));
    let ip = outward.map_or(Ipv4Addr::LOCALHOST.into(), |outward| outward.ip());
    SocketAddr::new(ip, address.port())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Transport;

    #[test]
    fn urls_name_host_and_port() {
        for (host, expected) in [
            ("edge.example", "edge.example:7"),
            ("edge.example:99", "edge.example:99"),
            ("192.0.2.7", "192.0.2.7:7"),
            ("2001:db8::1", "[2001:db8::1]:7"),
            ("[2001:db8::1]", "[2001:db8::1]:7"),
            ("[2001:db8::1]:99", "[2001:db8::1]:99"),
        ] {
            assert_eq!(authority(host, 7), expected);
        }
        let config = ServerConfig { transport: Transport::LabUdp, ..ServerConfig::default() };
        assert_eq!(base(&config, "127.0.0.1:7".parse().unwrap()), "gnomon+lab-udp://127.0.0.1:7/");
        assert_eq!(base(&config, "[::1]:7".parse().unwrap()), "gnomon+lab-udp://[::1]:7/");
        let advertised = |host: &str| ServerConfig { advertise: Some(host.to_owned()), ..ServerConfig::default() };
        for (host, expected) in [("edge.example", 7), ("edge.example:99", 99), ("2001:db8::1", 7)] {
            let local = "127.0.0.1:7".parse().unwrap();
            assert_eq!(port(&base(&advertised(host), local), local), expected);
        }
    }

    #[test]
    fn an_unspecified_address_is_replaced_by_a_reachable_one() {
        for any in ["0.0.0.0:7", "[::]:7"] {
            let printed = reachable(any.parse().unwrap());
            assert!(!printed.ip().is_unspecified() && printed.port() == 7, "{printed}");
        }
    }
}
