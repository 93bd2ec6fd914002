//! The names that the admin address answers to.
//!
//! A web page can let its own name resolve to this machine's address (DNS rebinding), and then read what the admin
//! address says. Its requests name the page's host, so only names that are ours are answered. An address in numbers is
//! never a page's name.

use std::{fmt, net::IpAddr, str::FromStr};

use hyper::{Request, header::HOST, http::uri::Authority};

/// `HOST[,HOST…]`: names besides localhost.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct AdminHosts(Vec<String>);

impl FromStr for AdminHosts {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let name = |name: &str| match url::Host::parse(name.trim()) {
            Ok(url::Host::Domain(name)) => Ok(name),
            Ok(address) => Err(format!("{address} is an address: every address is answered, list names only")),
            Err(error) => Err(format!("{name:?} is no host name: {error}")),
        };
        text.split(',').map(name).collect::<Result<_, _>>().map(Self)
    }
}

impl fmt::Display for AdminHosts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.join(","))
    }
}

impl AdminHosts {
    /// Returns whether the request names this server. One without a name comes from no browser.
    pub(super) fn answers<B>(&self, request: &Request<B>) -> bool {
        let in_line = request.uri().host().is_none_or(|host| self.contains(host));
        in_line
            && request.headers().get_all(HOST).iter().all(|value| {
                let authority = value.to_str().ok().and_then(|text| text.parse::<Authority>().ok());
                authority.is_some_and(|authority| self.contains(authority.host()))
            })
    }

    fn contains(&self, host: &str) -> bool {
        let host = host.trim_end_matches('.').to_ascii_lowercase();
        let bare = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(&host);
        bare.parse::<IpAddr>().is_ok() || host.rsplit('.').next() == Some("localhost") || self.0.contains(&host)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_localhost_and_listed_names_are_answered() {
        let hosts: AdminHosts = "gnomon, Edge.Example".parse().unwrap();
        for (host, ours) in [
            ("127.0.0.1:9464", true),
            ("10.1.2.3", true),
            ("[::1]:9464", true),
            ("localhost:9464", true),
            ("LOCALHOST", true),
            ("x.localhost", true),
            ("gnomon:9464", true),
            ("edge.example.", true),
            ("evil.example", false),
            ("localhost.evil.example:9464", false),
            ("127.0.0.1.evil.example", false),
            ("gnomon.evil.example", false),
            ("", false),
            ("a b", false),
        ] {
            let request = Request::get("/ready").header(HOST, host).body(()).unwrap();
            assert_eq!(hosts.answers(&request), ours, "{host:?}");
        }
        assert!(hosts.answers(&Request::get("/ready").body(()).unwrap()));
        let proxied = Request::get("http://evil.example/ready").header(HOST, "127.0.0.1").body(()).unwrap();
        assert!(!hosts.answers(&proxied));
        let two = Request::get("/ready").header(HOST, "127.0.0.1").header(HOST, "evil.example").body(()).unwrap();
        assert!(!hosts.answers(&two));
    }

    #[test]
    fn names_are_checked_when_they_are_read() {
        for (text, why) in
            [("", "no host name"), ("a,,b", "no host name"), ("a b", "no host name"), ("10.0.0.1", "an address")]
        {
            let error = text.parse::<AdminHosts>().unwrap_err();
            assert!(error.contains(why), "{text}: {error}");
        }
        assert_eq!("a,b".parse::<AdminHosts>().unwrap().to_string(), "a,b");
    }
}
