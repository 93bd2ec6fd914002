//! Where the attacks come from and go to.

use std::net::{IpAddr, SocketAddr};

use anyhow::{Result, ensure};

#[derive(Debug, Clone)]
pub(super) struct Addresses {
    /// Addresses to attack from, each with the server's address for it.
    pairs: Vec<(IpAddr, SocketAddr)>,
}

impl Addresses {
    /// Errors if the server has no address of a source's family.
    pub(super) fn new(sources: &[IpAddr], server: &[IpAddr], port: u16) -> Result<Self> {
        let pair = |source: &IpAddr| {
            let to = server.iter().find(|server| server.is_ipv4() == source.is_ipv4());
            to.map(|to| (*source, SocketAddr::new(*to, port)))
        };
        let pairs: Option<Vec<_>> = sources.iter().map(pair).collect();
        let pairs = pairs.unwrap_or_default();
        ensure!(!pairs.is_empty(), "--sources and --at need addresses of the same families");
        Ok(Self { pairs })
    }

    pub(super) fn pairs(&self) -> impl ExactSizeIterator<Item = (IpAddr, SocketAddr)> + Clone + '_ {
        self.pairs.iter().copied()
    }

    /// The first address to attack from, and the server's for it.
    pub(super) fn first(&self) -> (IpAddr, SocketAddr) {
        self.pairs[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_source_attacks_the_servers_address_of_its_family() {
        let ips = |texts: &[&str]| texts.iter().map(|text| text.parse().unwrap()).collect::<Vec<IpAddr>>();
        let found = Addresses::new(&ips(&["fd00::2", "10.0.0.2"]), &ips(&["10.0.0.1", "fd00::1"]), 9).unwrap();
        let text = found.pairs().map(|(from, to)| format!("{from} {to}")).collect::<Vec<_>>();
        assert_eq!(text, ["fd00::2 [fd00::1]:9", "10.0.0.2 10.0.0.1:9"]);
        assert!(Addresses::new(&ips(&["fd00::2"]), &ips(&["10.0.0.1"]), 9).is_err());
    }
}
