//! `--otlp URL`: what `/metrics` shows, sent to an OpenTelemetry collector every few seconds as OTLP over HTTP in JSON
//! (opentelemetry.io/docs/specs/otlp, and the JSON mapping of `opentelemetry/proto/metrics/v1/metrics.proto`).
//!
//! The page that Prometheus reads is translated, so both show the same and nothing is counted twice. That takes the HTTP crate of the
//! admin address and no SDK. Logs stay lines, which collectors read as they are (`deploy/logs/`). A collector that does not answer costs
//! its reports and nothing else: counters are cumulative, so the next one has all.

mod page;

use std::{
    fmt,
    str::FromStr,
    sync::Arc,
    time::{Duration, UNIX_EPOCH},
};

use http_body_util::Full;
use hyper::{
    Request,
    body::Bytes,
    header::{CONTENT_TYPE, HOST},
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tokio::time::MissedTickBehavior;

use crate::{
    admin::Sources,
    clock,
    http::{TellError, tell},
};

/// Port of collectors that take HTTP.
const DEFAULT_PORT: u16 = 4318;

/// Time between reports.
const PERIOD: Duration = Duration::from_secs(10);

/// Longest time that a collector may take for a report.
const PATIENCE: Duration = Duration::from_secs(5);

/// Where a collector listens: `http://HOST[:PORT][/PATH]`, 4318 and `/v1/metrics` where nothing else is said. Without TLS: a collector runs
/// beside the server, and speaks TLS to whatever is farther away.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Collector {
    host: String,
    port: u16,
    path: String,
}

impl FromStr for Collector {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let url = url::Url::parse(text).map_err(|error| format!("{text:?} is no URL: {error}"))?;
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
        // `url` forgets a port that is the scheme's own: whoever means 80 has written it.
        let written = authority.trim_end().rsplit_once(':').and_then(|(_, port)| port.parse().ok());
        let port = url.port().or(written).unwrap_or(DEFAULT_PORT);
        let host = host.to_owned();
        Ok(Self { host, port, path: path.to_owned() })
    }
}

impl TryFrom<String> for Collector {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Collector> for String {
    fn from(collector: Collector) -> Self {
        collector.to_string()
    }
}

impl fmt::Display for Collector {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "http://{}:{}{}", self.host, self.port, self.path)
    }
}

/// Reports until its task ends.
pub(crate) async fn run(collector: Collector, sources: Arc<Sources>) {
    report_every(PERIOD, collector, sources).await;
}

async fn report_every(period: Duration, collector: Collector, sources: Arc<Sources>) {
    let started_at = unix_ns();
    let mut tick = tokio::time::interval(period);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut taken = true;
    loop {
        tick.tick().await;
        let Ok(page) = sources.page().text() else { continue };
        let sent = collector.send(request(&page, started_at, unix_ns()).to_string()).await;
        // Once for each time that it goes and comes back.
        match &sent {
            Ok(()) if !taken => tracing::info!(%collector, "the collector takes reports again"),
            Err(error) if taken => tracing::warn!(%collector, %error, "the collector takes no reports"),
            Ok(()) | Err(_) => {}
        }
        taken = sent.is_ok();
    }
}

impl Collector {
    async fn send(&self, body: String) -> Result<(), TellError> {
        let request = Request::post(&self.path)
            .header(HOST, format!("{}:{}", self.host, self.port))
            .header(CONTENT_TYPE, "application/json")
            .body(Full::new(Bytes::from(body)))?;
        tell((self.host.trim_matches(['[', ']']), self.port), request, PATIENCE).await
    }
}

/// Nanoseconds since 1970 by the wall clock, which may step: a collector takes points as they are stamped.
fn unix_ns() -> u64 {
    let since = clock::wall().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}

/// The body of an `ExportMetricsServiceRequest`.
fn request(page: &str, started_at: u64, now: u64) -> Value {
    let attribute = |key: &str, value: &str| json!({ "key": key, "value": { "stringValue": value } });
    json!({ "resourceMetrics": [{
        "resource": { "attributes": [
            attribute("service.name", "gnomon-server"),
            attribute("service.version", env!("CARGO_PKG_VERSION")),
        ] },
        "scopeMetrics": [{
            "scope": { "name": "gnomon_server", "version": env!("CARGO_PKG_VERSION") },
            // A clock that was set back since the start must not make a span of negative length.
            "metrics": page::metrics(page, started_at.min(now), now),
        }],
    }] })
}

#[cfg(test)]
mod tests;
