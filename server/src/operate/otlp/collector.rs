//! The address of an OpenTelemetry collector.

use std::{fmt, str::FromStr};

const DEFAULT_PORT: u16 = 4318;

/// `http://HOST[:PORT][/PATH]`, by default port 4318 and `/v1/metrics`. Without TLS, since a collector runs beside the
/// server and itself uses TLS to remote services.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Collector {
    pub(super) host: String,
    pub(super) port: u16,
    pub(super) path: String,
}

impl FromStr for Collector {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let url = url::Url::parse(text).map_err(|error| format!("{text:?} is not a URL: {error}"))?;
        let (host, authority) = url
            .host_str()
            .filter(|_| url.scheme() == "http")
            .zip(text.split_once("://").map(|(_, rest)| rest.split(['/', '\\']).next().unwrap_or_default()))
            .ok_or_else(|| format!("{text:?} is not of the form http://HOST:4318"))?;
        let more = [
            (!url.username().is_empty() || url.password().is_some(), "user or password"),
            (url.query().is_some(), "query"),
            (url.fragment().is_some(), "fragment"),
        ];
        if let Some((_, what)) = more.into_iter().find(|(there, _)| *there) {
            return Err(format!("a collector's URL has no {what}: it would not be sent"));
        }
        let path = if url.path() == "/" { "/v1/metrics" } else { url.path() };
        // `url` drops the scheme's default port, so an explicit 80 is read from the text.
        let written = authority.trim_end().rsplit_once(':').and_then(|(_, port)| port.parse().ok());
        let port = url.port().or(written).unwrap_or(DEFAULT_PORT);
        let host = host.to_owned();
        Ok(Self { host, port, path: path.to_owned() })
    }
}

impl fmt::Display for Collector {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "http://{}:{}{}", self.host, self.port, self.path)
    }
}
