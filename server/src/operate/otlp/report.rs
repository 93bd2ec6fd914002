//! `--otlp URL`: what `/metrics` shows, sent to an OpenTelemetry collector every few seconds as OTLP over HTTP in JSON
//! (opentelemetry.io/docs/specs/otlp, and the JSON mapping of `opentelemetry/proto/metrics/v1/metrics.proto`).
//!
//! The page that Prometheus reads is translated, so both show the same and nothing is counted twice. That takes the HTTP crate of the
//! admin address and no SDK. Logs stay lines, which collectors read as they are (`deploy/logs/`). A collector that does not answer costs
//! its reports and nothing else: counters are cumulative, so the next one has all.

use std::{
    sync::Arc,
    time::{Duration, UNIX_EPOCH},
};

use http_body_util::Full;
use hyper::{
    Request,
    body::Bytes,
    header::{CONTENT_TYPE, HOST},
};
use serde_json::{Value, json};
use tokio::time::MissedTickBehavior;

use super::{collector::Collector, translate};
use crate::{
    clock,
    operate::{
        admin::answer::Sources,
        http::{TellError, tell},
    },
};

/// Time between reports.
const PERIOD: Duration = Duration::from_secs(10);

/// Longest time that a collector may take for a report.
const PATIENCE: Duration = Duration::from_secs(5);

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
        let sent = send(&collector, request(&page, started_at, unix_ns()).to_string()).await;
        // Once for each time that it goes and comes back.
        match &sent {
            Ok(()) if !taken => tracing::info!(%collector, "the collector takes reports again"),
            Err(error) if taken => tracing::warn!(%collector, %error, "the collector takes no reports"),
            Ok(()) | Err(_) => {}
        }
        taken = sent.is_ok();
    }
}

async fn send(collector: &Collector, body: String) -> Result<(), TellError> {
    let request = Request::post(&collector.path)
        .header(HOST, format!("{}:{}", collector.host, collector.port))
        .header(CONTENT_TYPE, "application/json")
        .body(Full::new(Bytes::from(body)))?;
    tell((collector.host.trim_matches(['[', ']']), collector.port), request, PATIENCE).await
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
            "metrics": translate::metrics(page, started_at.min(now), now),
        }],
    }] })
}

#[cfg(test)]
mod tests;
