//! Server URLs: transport, address, and the certificate to expect.

use std::{fmt, path::PathBuf, str::FromStr};

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

    const fn scheme(self) -> &'static str {
        match self {
            Self::Quic => "gnomon",
            Self::LabUdp => "gnomon+lab-udp",
            Self::LabTcp => "gnomon+lab-tcp",
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub struct ServerUrl {
    pub transport: Transport,
    /// Host name or address; IPv6 without brackets.
    pub host: String,
    /// UDP port (QUIC), or TCP port of the control stream (lab transports).
    pub port: u16,
    /// SHA-256 of the certificate that the server must show. `None` with `ca`, on a first visit (`?cert=first-use`),
    /// and for lab transports.
    pub certificate: Option<[u8; 32]>,
    /// Local PEM file with the authorities that may sign the server's certificate.
    pub ca: Option<PathBuf>,
}

#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum UrlError {
    #[error("{0:?} is not a URL: use the line that the server printed, gnomon://HOST:PORT/?cert=SHA256")]
    Malformed(String),
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
    #[error("unknown part of the URL: {0:?}")]
    Unknown(String),
    #[error("{0} is not this machine: the lab transports are not encrypted, and work on loopback only")]
    NotLoopback(String),
}

impl FromStr for ServerUrl {
    type Err = UrlError;

    fn from_str(text: &str) -> Result<Self, UrlError> {
        let url = Url::parse(text).map_err(|_| UrlError::Malformed(text.to_owned()))?;
        let transport = [Transport::Quic, Transport::LabUdp, Transport::LabTcp]
            .into_iter()
            .find(|transport| transport.scheme() == url.scheme())
            .ok_or_else(|| UrlError::Scheme(url.scheme().to_owned()))?;
        let host = match url.host().ok_or(UrlError::Host)? {
            Host::Domain("") => return Err(UrlError::Host),
            Host::Domain(name) => name.to_owned(),
            Host::Ipv4(address) => address.to_string(),
            Host::Ipv6(address) => address.to_string(),
        };
        let port = url.port().ok_or(UrlError::Port)?;
        if !matches!(url.path(), "" | "/") {
            return Err(UrlError::Unknown(url.path().to_owned()));
        }
        if !url.username().is_empty() || url.fragment().is_some() {
            return Err(UrlError::Unknown(url.fragment().unwrap_or(url.username()).to_owned()));
        }
        let (mut certificate, mut ca, mut first_use) = (None, None, false);
        for (key, value) in url.query_pairs() {
            match key.as_ref() {
                "cert" if value == "first-use" => first_use = true,
                "cert" => certificate = Some(digest(&value)?),
                "ca" if !value.is_empty() => ca = Some(PathBuf::from(value.as_ref())),
                _ => return Err(UrlError::Unknown(format!("{key}={value}"))),
            }
        }
        match transport {
            Transport::Quic if certificate.is_none() && ca.is_none() && !first_use => {
                return Err(UrlError::NoCertificate);
            }
            Transport::LabUdp | Transport::LabTcp if !is_loopback(&host) => return Err(UrlError::NotLoopback(host)),
            Transport::Quic | Transport::LabUdp | Transport::LabTcp => {}
        }
        Ok(Self { transport, host, port, certificate, ca })
    }
}

impl TryFrom<String> for ServerUrl {
    type Error = UrlError;

    fn try_from(text: String) -> Result<Self, UrlError> {
        text.parse()
    }
}

impl fmt::Display for ServerUrl {
    /// Omits the certificate, which is too long to read.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (open, close) = if self.host.contains(':') { ("[", "]") } else { ("", "") };
        write!(f, "{}://{open}{}{close}:{}", self.transport.scheme(), self.host, self.port)
    }
}

fn digest(text: &str) -> Result<[u8; 32], UrlError> {
    let invalid = || UrlError::Certificate(text.to_owned());
    if text.len() != 64 || !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return Err(invalid());
    }
    let mut digest = [0; 32];
    for (index, byte) in digest.iter_mut().enumerate() {
        *byte = u8::from_str_radix(&text[2 * index..2 * index + 2], 16).map_err(|_| invalid())?;
    }
    Ok(digest)
}

fn is_loopback(host: &str) -> bool {
    host == "localhost" || host.parse().is_ok_and(|address: std::net::IpAddr| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn valid_urls_are_parsed() {
        let cert = "00ff".repeat(16);
        let url: ServerUrl = format!("gnomon://edge.example:4433/?cert={cert}").parse().unwrap();
        assert_eq!((url.transport, url.host.as_str(), url.port), (Transport::Quic, "edge.example", 4433));
        assert_eq!(url.certificate.unwrap()[..4], [0, 255, 0, 255]);
        assert_eq!(url.to_string(), "gnomon://edge.example:4433");
        let url: ServerUrl = format!("gnomon://[::1]:5?cert={}", cert.to_uppercase()).parse().unwrap();
        assert_eq!((url.host.as_str(), url.to_string().as_str()), ("::1", "gnomon://[::1]:5"));
        let url: ServerUrl = "gnomon://edge.example:4433/?cert=first-use".parse().unwrap();
        assert_eq!((url.transport, url.certificate), (Transport::Quic, None));
        let url: ServerUrl = "gnomon://edge.example:4433/?ca=%2Fetc%2Fca.pem".parse().unwrap();
        assert_eq!((url.certificate, url.ca), (None, Some("/etc/ca.pem".into())));
        let url: ServerUrl = "gnomon+lab-udp://127.0.0.1:7".parse().unwrap();
        assert_eq!((url.transport, url.certificate), (Transport::LabUdp, None));
        let url: ServerUrl = "gnomon+lab-tcp://localhost:8/".parse().unwrap();
        assert_eq!(url.transport, Transport::LabTcp);
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
            ("gnomon+lab-udp://10.0.0.1:5", "not this machine"),
            ("gnomon+lab-tcp://edge:5", "not this machine"),
        ] {
            let found = text.parse::<ServerUrl>().unwrap_err().to_string();
            assert!(found.contains(error), "{text}: {found}");
        }
    }
}
