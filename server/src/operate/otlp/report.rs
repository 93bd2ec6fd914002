//! Sends the metrics to a collector every 10 s as OTLP over HTTP in JSON (opentelemetry.io/docs/specs/otlp, and the
//! JSON mapping of `opentelemetry/proto/metrics/v1/metrics.proto`).
//!
//! Translates the Prometheus page, so both show the same values. Uses the admin address's HTTP crate and no SDK.
//! Collectors read the log lines directly (`deploy/logs/`). A failed report loses nothing: counters are cumulative.

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
        http::{SendError, send},
        logs::escape::{self, Form},
        status::Status,
    },
};

const PERIOD: Duration = Duration::from_secs(10);

const TIMEOUT: Duration = Duration::from_secs(5);

pub(crate) async fn run(collector: Collector, status: Arc<Status>) {
    report_every(PERIOD, collector, status).await;
}

async fn report_every(period: Duration, collector: Collector, status: Arc<Status>) {
    let started_at = unix_ns();
    let mut tick = tokio::time::interval(period);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut reachable = true;
    loop {
        tick.tick().await;
        let Ok(page) = status.page().text() else { continue };
        let sent = post(&collector, body(&page, started_at, unix_ns())).await;
        // Logs only changes.
        match &sent {
            Ok(()) if !reachable => tracing::info!(%collector, "the collector accepts reports again"),
            Err(error) if reachable => tracing::warn!(%collector, %error, "the collector accepts no reports"),
            Ok(()) | Err(_) => {}
        }
        reachable = sent.is_ok();
    }
}

async fn post(collector: &Collector, body: String) -> Result<(), SendError> {
    let request = Request::post(&collector.path)
        .header(HOST, format!("{}:{}", collector.host, collector.port))
        .header(CONTENT_TYPE, "application/json")
        .body(Full::new(Bytes::from(body)))?;
    send((collector.host.trim_matches(['[', ']']), collector.port), request, TIMEOUT).await
}

/// The request as JSON. Drivers and operators wrote some of its texts, so hidden characters are escaped.
fn body(page: &str, started_at: u64, now: u64) -> String {
    escape::escaped(&request(page, started_at, now).to_string(), Form::Json)
}

/// By the wall clock, which may step: collectors accept any time stamps.
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
            // The clock may have been set back since the start.
            "metrics": translate::metrics(page, started_at.min(now), now),
        }],
    }] })
}

#[cfg(test)]
mod tests;
