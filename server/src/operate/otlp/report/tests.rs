//! A minimal collector, which receives the server's reports.

use std::sync::{Mutex, OnceLock, atomic::AtomicBool};

use http_body_util::BodyExt as _;
use hyper::{Response, StatusCode, body::Incoming, server, service::service_fn};
use hyper_util::rt::TokioIo;
use tokio::{net::TcpListener, time::timeout};

use super::*;
use crate::{
    metrics::{registry::Metrics, reloads::Reloads},
    operate::{admin::hosts::AdminHosts, readiness::Readiness},
};

fn status() -> Arc<Status> {
    let backend = OnceLock::new();
    backend.set("cpu: a \"quoted\" name".to_owned()).unwrap();
    Arc::new(Status {
        metrics: Arc::new(Metrics::default()),
        readiness: Readiness::default(),
        backend,
        services: OnceLock::new(),
        capacity: 7,
        socket: None,
        tokens: None,
        had_admin_token: AtomicBool::new(false),
        open: false,
        hosts: AdminHosts::default(),
        reloads: Reloads::default(),
    })
}

/// Metric `name` of a report.
fn metric<'a>(report: &'a Value, name: &str) -> &'a Value {
    let metrics = report["resourceMetrics"][0]["scopeMetrics"][0]["metrics"].as_array().unwrap();
    metrics.iter().find(|metric| metric["name"] == name).unwrap_or_else(|| panic!("no {name} in {report}"))
}

/// Refuses the first report and keeps the others.
async fn collect(listener: TcpListener, reports: Arc<Mutex<Vec<Value>>>) {
    let mut refused = false;
    loop {
        let (stream, _) = listener.accept().await.unwrap();
        let refuses = !std::mem::replace(&mut refused, true);
        let reports = Arc::clone(&reports);
        let service = service_fn(move |request: Request<Incoming>| {
            let reports = Arc::clone(&reports);
            async move {
                assert_eq!((request.method().as_str(), request.uri().path()), ("POST", "/v1/metrics"));
                assert_eq!(request.headers()[CONTENT_TYPE], "application/json");
                let body = request.into_body().collect().await.unwrap().to_bytes();
                let status = if refuses { StatusCode::SERVICE_UNAVAILABLE } else { StatusCode::OK };
                if !refuses {
                    reports.lock().unwrap().push(serde_json::from_slice(&body).unwrap());
                }
                let answer = Response::builder().status(status).body(Full::new(Bytes::from_static(b"{}")));
                Ok::<_, std::convert::Infallible>(answer.unwrap())
            }
        });
        server::conn::http1::Builder::new().serve_connection(TokioIo::new(stream), service).await.unwrap();
    }
}

#[tokio::test]
async fn a_collector_gets_the_pages_values_even_after_an_outage() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let collector: Collector = format!("http://{}", listener.local_addr().unwrap()).parse().unwrap();
    let (reports, status) = (Arc::new(Mutex::new(Vec::new())), status());
    let collecting = tokio::spawn(collect(listener, Arc::clone(&reports)));
    status.metrics.refused(crate::metrics::causes::RefusalCause::Full);
    let reporting = tokio::spawn(report_every(Duration::from_millis(20), collector, Arc::clone(&status)));
    let waiting = async {
        while reports.lock().unwrap().len() < 2 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    timeout(Duration::from_secs(60), waiting).await.unwrap();
    reporting.abort();
    collecting.abort();
    let reports = reports.lock().unwrap();
    for report in reports.iter() {
        let refusals = &metric(report, "gnomon_refusals_total")["sum"];
        assert_eq!((&refusals["isMonotonic"], &refusals["aggregationTemporality"]), (&json!(true), &json!(2)));
        let full = refusals["dataPoints"]
            .as_array()
            .unwrap()
            .iter()
            .find(|point| point["attributes"] == json!([{ "key": "cause", "value": { "stringValue": "full" } }]));
        assert_eq!(full.unwrap()["asInt"], "1");
        assert_eq!(metric(report, "gnomon_sessions_capacity")["gauge"]["dataPoints"][0]["asInt"], "7");
        let info = &metric(report, "gnomon_build_info")["gauge"]["dataPoints"][0]["attributes"];
        assert_eq!(info[1]["value"]["stringValue"], "cpu: a \"quoted\" name");
    }
    // The report has every metric of the page.
    let page = status.page().text().unwrap();
    let named = page.lines().filter_map(|line| line.strip_prefix("# TYPE ")?.split_once(' ')).count();
    let sent = reports[0]["resourceMetrics"][0]["scopeMetrics"][0]["metrics"].as_array().unwrap().len();
    assert!(sent == named && sent > 20, "{sent} of {named}");
}

#[test]
fn a_cumulative_histogram_becomes_separate_buckets() {
    let page = "# HELP t_seconds Time.\n# TYPE t_seconds histogram\n\
        t_seconds_sum{stage=\"a\"} 1.5\nt_seconds_count{stage=\"a\"} 9\n\
        t_seconds_bucket{stage=\"a\",le=\"0.5\"} 2\nt_seconds_bucket{stage=\"a\",le=\"1.0\"} 7\n\
        t_seconds_bucket{stage=\"a\",le=\"+Inf\"} 9\n\
        t_seconds_sum{stage=\"b\"} 0.0\nt_seconds_count{stage=\"b\"} 0\n\
        t_seconds_bucket{stage=\"b\",le=\"0.5\"} 0\nt_seconds_bucket{stage=\"b\",le=\"+Inf\"} 0\n# EOF\n";
    let found = translate::metrics(page, 5, 8);
    let [metric] = found.as_slice() else { panic!("{found:?}") };
    assert_eq!((&metric["name"], &metric["description"]), (&json!("t_seconds"), &json!("Time.")));
    let points = metric["histogram"]["dataPoints"].as_array().unwrap();
    assert_eq!(points.len(), 2);
    let first = &points[0];
    assert_eq!((&first["count"], &first["sum"]), (&json!("9"), &json!(1.5)));
    assert_eq!(first["explicitBounds"], json!([0.5, 1.0]));
    assert_eq!(first["bucketCounts"], json!(["2", "5", "2"]));
    assert_eq!(first["attributes"], json!([{ "key": "stage", "value": { "stringValue": "a" } }]));
    assert_eq!((&first["startTimeUnixNano"], &first["timeUnixNano"]), (&json!("5"), &json!("8")));
    assert_eq!(points[1]["bucketCounts"], json!(["0", "0"]));
}

#[test]
fn a_collectors_url_is_understood_or_refused() {
    for (text, meant) in [
        ("http://127.0.0.1:4318", "http://127.0.0.1:4318/v1/metrics"),
        ("http://collector", "http://collector:4318/v1/metrics"),
        ("HTTP://collector:80", "http://collector:80/v1/metrics"),
        ("http://collector:80\\x", "http://collector:80/x"),
        ("http://[::80]", "http://[::80]:4318/v1/metrics"),
        ("http://[::1]:80/x/v1/metrics", "http://[::1]:80/x/v1/metrics"),
    ] {
        let collector: Collector = text.parse().unwrap();
        assert_eq!(collector.to_string(), meant);
        assert_eq!(meant.parse::<Collector>().unwrap(), collector);
    }
    for (text, why) in [
        ("", "not a URL"),
        ("collector:4318", "not of the form http://HOST:4318"),
        ("https://collector", "not of the form"),
        ("http:collector:80", "not of the form"),
        ("grpc://collector:4317", "not of the form"),
        ("http://user@collector", "no user or password"),
        ("http://:secret@collector", "no user or password"),
        ("http://collector/v1/metrics?key=secret", "no query"),
        ("http://collector#here", "no fragment"),
    ] {
        let error = text.parse::<Collector>().unwrap_err();
        assert!(error.contains(why) && !error.contains("secret"), "{text}: {error}");
    }
}

#[test]
fn a_report_has_no_hidden_character() {
    let every: String = (0..=0x2fff).filter_map(char::from_u32).collect();
    let page = crate::metrics::page::Page { version: "1", backend: every.clone(), ..Default::default() };
    let body = body(&page.text().unwrap(), 5, 8);
    let hidden = body.chars().find(|shown| shown.escape_debug().len() != 1 && !"'\"\\".contains(*shown));
    assert_eq!(hidden, None);
    let report: Value = serde_json::from_str(&body).unwrap();
    let info = &metric(&report, "gnomon_build_info")["gauge"]["dataPoints"][0]["attributes"];
    assert!(info[1]["value"]["stringValue"] == every.as_str(), "nothing is lost");
}
