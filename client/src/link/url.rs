//! Server URLs: transport, address, and the certificate to expect.

use std::{
    borrow::Cow,
    fmt,
    net::{IpAddr, Ipv6Addr},
    path::PathBuf,
    str::FromStr,
};

use serde::Deserialize;
use thiserror::Error;
use url::{Host, Url};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Transport {
    Quic,
    /// Plain UDP on loopback: the baseline.
    LabUdp,
    /// Plain TCP on loopback: the baseline.
    LabTcp,
}

impl Transport {
    /// As in command lines and summaries.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Quic => "quic",
            Self::LabUdp => "lab-udp",
            Self::LabTcp => "lab-tcp",
        }
    }

    pub(super) const fn scheme(self) -> &'static str {
        match self {
            Self::Quic => "gnomon",
            Self::LabUdp => "gnomon+lab-udp",
            Self::LabTcp => "gnomon+lab-tcp",
        }
    }
}

/// Most certificates that a URL may name: today's, and spares.
pub(super) const MAX_PINS: usize = 8;

/// Longest URL, in bytes: a path of authorities, or [`MAX_PINS`] digests.
const MAX_URL_BYTES: usize = 8192;

#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub struct ServerUrl {
    pub transport: Transport,
    /// Host name or address; IPv6 without brackets, a link-local one with this machine's interface: `fe80::1%eth0`.
    pub host: String,
    /// UDP port (QUIC), or TCP port of the control stream (lab transports).
    pub port: u16,
    /// SHA-256 of every certificate that the server may show: today's, and those that it announced. Empty with `ca`, on
    /// a first visit (`?cert=first-use`), and for lab transports.
    pub certificates: Vec<[u8; 32]>,
    /// Local PEM file with the authorities that may sign the server's certificate.
    pub ca: Option<PathBuf>,
}

#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum UrlError {
    #[error("{0:?} is not a URL: use the line that the server printed, gnomon://HOST:PORT/?cert=SHA256")]
    Malformed(String),
    #[error("the URL has {0} bytes, at most {MAX_URL_BYTES} are read: use the line that the server printed")]
    TooLong(usize),
    #[error("unknown scheme {0}://: use gnomon://, gnomon+lab-udp:// or gnomon+lab-tcp://")]
    Scheme(String),
    #[error("the URL has no host")]
    Host,
    #[error("the URL has no port: use the line that the server printed, gnomon://HOST:PORT/?cert=SHA256")]
    Port,
    #[error(
        "the URL lacks ?cert=SHA256, which identifies the server: use the line that the server printed, or name the \
         PEM file of its authority as ?ca=FILE"
    )]
    NoCertificate,
    #[error("cert={0:?} is not a SHA-256: it must have 64 hexadecimal digits")]
    Certificate(String),
    #[error("cert=first-use and a certificate: choose one, since the first visit is for who has none")]
    FirstUseAndPin,
    #[error("the URL names {0} certificates, at most {MAX_PINS} are kept")]
    TooManyPins(usize),
    #[error("unknown part of the URL: {0:?}")]
    Unknown(String),
    #[error("{0} is not this machine: the lab transports are not encrypted, and work on loopback only")]
    NotLoopback(String),
    #[error("{0} is a link-local address: add the interface of this machine that it is behind, [{0}%25eth0]")]
    NoZone(Ipv6Addr),
    #[error("{0} has a zone, but only a link-local address (fe80::/10) has one: leave out what follows the %")]
    NotLinkLocal(Ipv6Addr),
    #[error("{0:?} is no zone: it must be the name or number of a network interface, such as eth0")]
    Zone(String),
}

impl FromStr for ServerUrl {
    type Err = UrlError;

    /// Parses what a person, a file or a variable says. What a server says has a parser of its own,
    /// [`super::alternative`].
    fn from_str(text: &str) -> Result<Self, UrlError> {
        if text.len() > MAX_URL_BYTES {
            return Err(UrlError::TooLong(text.len()));
        }
        let (text, zone) = split_zone(text);
        let malformed = || UrlError::Malformed(text.clone().into_owned());
        let url = Url::parse(&text).map_err(|_| malformed())?;
        let transport = [Transport::Quic, Transport::LabUdp, Transport::LabTcp]
            .into_iter()
            .find(|transport| transport.scheme() == url.scheme())
            .ok_or_else(|| UrlError::Scheme(url.scheme().to_owned()))?;
        let host = match (url.host().ok_or(UrlError::Host)?, zone) {
            (Host::Domain(""), _) => return Err(UrlError::Host),
            // No name has escapes, and what follows a % would look like a zone.
            (Host::Domain(name), _) if name.contains('%') => return Err(malformed()),
            (Host::Domain(name), _) => name.to_owned(),
            (Host::Ipv4(address), _) => address.to_string(),
            (Host::Ipv6(address), None) if address.is_unicast_link_local() => return Err(UrlError::NoZone(address)),
            (Host::Ipv6(address), None) => address.to_string(),
            (Host::Ipv6(address), Some(_)) if !address.is_unicast_link_local() => {
                return Err(UrlError::NotLinkLocal(address));
            }
            (Host::Ipv6(address), Some(zone)) => format!("{address}%{}", checked_zone(zone)?),
        };
        let port = url.port().ok_or(UrlError::Port)?;
        if !matches!(url.path(), "" | "/") {
            return Err(UrlError::Unknown(url.path().to_owned()));
        }
        if !url.username().is_empty() || url.fragment().is_some() {
            return Err(UrlError::Unknown(url.fragment().unwrap_or(url.username()).to_owned()));
        }
        let (mut certificates, mut ca, mut first_use) = (Vec::new(), None, false);
        for (key, value) in url.query_pairs() {
            match key.as_ref() {
                "cert" if value == "first-use" => first_use = true,
                "cert" => certificates.push(digest(&value).ok_or_else(|| UrlError::Certificate(value.into_owned()))?),
                "ca" if !value.is_empty() => ca = Some(PathBuf::from(value.as_ref())),
                _ => return Err(UrlError::Unknown(format!("{key}={value}"))),
            }
        }
        match transport {
            Transport::Quic if first_use && !certificates.is_empty() => return Err(UrlError::FirstUseAndPin),
            Transport::Quic if certificates.is_empty() && ca.is_none() && !first_use => {
                return Err(UrlError::NoCertificate);
            }
            Transport::LabUdp | Transport::LabTcp if !is_loopback(&host) => return Err(UrlError::NotLoopback(host)),
            Transport::Quic | Transport::LabUdp | Transport::LabTcp => {}
        }
        if certificates.len() > MAX_PINS {
            return Err(UrlError::TooManyPins(certificates.len()));
        }
        Ok(Self { transport, host, port, certificates, ca })
    }
}

impl ServerUrl {
    /// Returns whether nothing says which certificate the server has: the first visit shows it.
    #[must_use]
    pub const fn is_first_use(&self) -> bool {
        matches!(self.transport, Transport::Quic) && self.certificates.is_empty() && self.ca.is_none()
    }

    /// Returns the host as a certificate names it: no certificate has a zone.
    pub(super) fn name(&self) -> &str {
        self.host.split('%').next().unwrap_or_default()
    }
}

impl TryFrom<String> for ServerUrl {
    type Error = UrlError;

    fn try_from(text: String) -> Result<Self, UrlError> {
        text.parse()
    }
}

impl fmt::Display for ServerUrl {
    /// Omits the certificates, which are too long to read.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = self.transport.scheme();
        match self.host.split_once('%') {
            Some((address, zone)) => write!(f, "{scheme}://[{address}%25{zone}]:{}", self.port),
            None if self.host.contains(':') => write!(f, "{scheme}://[{}]:{}", self.host, self.port),
            None => write!(f, "{scheme}://{}:{}", self.host, self.port),
        }
    }
}

/// Takes the zone out of `[fe80::1%25eth0]` (RFC 6874) or `[fe80::1%eth0]` (as people write it): URLs have none.
fn split_zone(text: &str) -> (Cow<'_, str>, Option<&str>) {
    let inside = || {
        let authority = text.find("://")? + 3;
        let open = authority + text.get(authority..)?.starts_with('[').then_some(1)?;
        let close = open + text.get(open..)?.find(']')?;
        let percent = open + text.get(open..close)?.find('%')?;
        let zone = text.get(percent + 1..close)?;
        let zone = zone.strip_prefix("25").filter(|zone| !zone.is_empty()).unwrap_or(zone);
        Some((Cow::Owned(format!("{}{}", &text[..percent], &text[close..])), Some(zone)))
    };
    inside().unwrap_or((Cow::Borrowed(text), None))
}

/// Only what RFC 6874 lets stand unescaped, and no longer than any system's names.
fn checked_zone(zone: &str) -> Result<&str, UrlError> {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-._~".contains(&byte);
    if (1..=64).contains(&zone.len()) && zone.bytes().all(plain) {
        Ok(zone)
    } else {
        Err(UrlError::Zone(zone.to_owned()))
    }
}

/// Returns the SHA-256 that 64 hexadecimal digits say.
pub(super) fn digest(text: &str) -> Option<[u8; 32]> {
    let digits = text.as_bytes();
    let mut digest = [0; 32];
    if digits.len() != 2 * digest.len() {
        return None;
    }
    for (byte, pair) in digest.iter_mut().zip(digits.chunks_exact(2)) {
        let [high, low] = [pair[0], pair[1]].map(|digit| char::from(digit).to_digit(16));
        *byte = u8::try_from(high? << 4 | low?).ok()?;
    }
    Some(digest)
}

pub(super) fn is_loopback(host: &str) -> bool {
    host == "localhost" || host.parse().is_ok_and(|address: IpAddr| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn valid_urls_are_parsed() {
        let cert = "00ff".repeat(16);
        let url: ServerUrl = format!("gnomon://edge.example:4433/?cert={cert}").parse().unwrap();
        assert_eq!((url.transport, url.host.as_str(), url.port), (Transport::Quic, "edge.example", 4433));
        assert_eq!(url.certificates[0][..4], [0, 255, 0, 255]);
        assert_eq!(url.to_string(), "gnomon://edge.example:4433");
        let url: ServerUrl = format!("gnomon://[::1]:5?cert={}", cert.to_uppercase()).parse().unwrap();
        assert_eq!((url.host.as_str(), url.to_string().as_str()), ("::1", "gnomon://[::1]:5"));
        let url: ServerUrl = "gnomon://edge.example:4433/?cert=first-use".parse().unwrap();
        assert!(url.is_first_use() && url.certificates.is_empty());
        let url: ServerUrl = "gnomon://edge.example:4433/?ca=%2Fetc%2Fca.pem".parse().unwrap();
        assert_eq!((url.certificates.len(), url.is_first_use(), url.ca), (0, false, Some("/etc/ca.pem".into())));
        let url: ServerUrl = "gnomon+lab-udp://127.0.0.1:7".parse().unwrap();
        assert_eq!((url.transport, url.is_first_use()), (Transport::LabUdp, false));
        let url: ServerUrl = "gnomon+lab-tcp://localhost:8/".parse().unwrap();
        assert_eq!(url.transport, Transport::LabTcp);
    }

    #[test]
    fn several_certificates_may_be_named() {
        let [today, spare] = ["a1".repeat(32), "b2".repeat(32)];
        let url: ServerUrl = format!("gnomon://edge:1/?cert={today}&cert={spare}").parse().unwrap();
        assert_eq!(url.certificates, [[0xA1; 32], [0xB2; 32]]);
    }

    #[test]
    fn a_link_local_address_has_a_zone() {
        for text in ["gnomon://[fe80::1%25eth0]:5/?cert=first-use", "gnomon://[fe80::1%eth0]:5/?cert=first-use"] {
            let url: ServerUrl = text.parse().unwrap();
            assert_eq!((url.host.as_str(), url.name(), url.port), ("fe80::1%eth0", "fe80::1", 5));
            assert_eq!(url.to_string(), "gnomon://[fe80::1%25eth0]:5");
            assert_eq!(format!("{url}/?cert=first-use").parse::<ServerUrl>().unwrap(), url);
        }
        let url: ServerUrl = "gnomon://[fe80::1%2]:5/?ca=a://[b%25c]".parse().unwrap();
        assert_eq!((url.host.as_str(), url.ca), ("fe80::1%2", Some("a://[b%c]".into())));
        let url: ServerUrl = "gnomon://edge:5/?ca=a://[b%25c]".parse().unwrap();
        assert_eq!(url.ca, Some("a://[b%c]".into()));
    }

    #[test]
    fn errors_say_what_to_do() {
        for (text, error) in [
            ("edge:4433", "scheme"),
            ("edge", "is not a URL"),
            ("https://edge:1", "unknown scheme"),
            ("gnomon://edge/?cert=00", "no port"),
            ("gnomon://:5/", "is not a URL"),
            ("gnomon://edge:4433", "lacks ?cert"),
            ("gnomon://edge:4433/?cert=00ff", "64 hexadecimal digits"),
            ("gnomon://edge:4433/?cert=zz", "64 hexadecimal digits"),
            ("gnomon://edge:4433/scene", "unknown part"),
            ("gnomon://edge:4433/?token=7", "unknown part"),
            ("gnomon://edge:4433/?cert=+0000000000000000000000000000000000000000000000000000000000000000", "64 hex"),
            ("gnomon://[fe80::1]:5/?cert=first-use", "[fe80::1%25eth0]"),
            ("gnomon://[2001:db8::1%25eth0]:5/?cert=first-use", "only a link-local address"),
            ("gnomon://[fe80::1%25e/0]:5/?cert=first-use", "no zone"),
            ("gnomon://edge%25eth0:5/?cert=first-use", "is not a URL"),
            ("gnomon://\u{fffd}edge:5/?cert=first-use", "is not a URL"),
            ("gnomon+lab-udp://10.0.0.1:5", "not this machine"),
            ("gnomon+lab-tcp://edge:5", "not this machine"),
        ] {
            let found = text.parse::<ServerUrl>().unwrap_err().to_string();
            assert!(found.contains(error), "{text}: {found}");
        }
        let cert = format!("cert={}", "00".repeat(32));
        for (query, error) in [
            (format!("{cert}&cert=first-use"), "choose one"),
            (vec![cert; MAX_PINS + 1].join("&"), "9 certificates"),
            ("x".repeat(MAX_URL_BYTES), "at most 8192"),
        ] {
            let found = format!("gnomon://edge:4433/?{query}").parse::<ServerUrl>().unwrap_err().to_string();
            assert!(found.contains(error), "{found}");
        }
    }
}
