//! Reports to Agones: readiness, health while tracing works, and ended sessions, which decrease a session counter.
//!
//! Talks to the sidecar's HTTP gateway on loopback, with the paths of Agones' `sdk.proto` and `beta.proto`. gRPC would
//! add protoc and tonic to the build for four calls. Failed calls are repeated. Sessions do not depend on them.

use std::{net::Ipv4Addr, sync::Arc, time::Duration};

use http_body_util::Full;
use hyper::{
    Method, Request,
    body::Bytes,
    header::{CONTENT_TYPE, HOST},
};

use crate::{
    metrics::registry::{Metrics, Snapshot},
    operate::{
        http::{SendError, send},
        readiness::{Readiness, Stage},
    },
};

/// Default port of the gateway, without `AGONES_SDK_HTTP_PORT`.
const GATEWAY_PORT: u16 = 9358;

/// Less than half of `health.periodSeconds`, which is 5 s in our fleet.
const HEARTBEAT: Duration = Duration::from_secs(2);

const TIMEOUT: Duration = Duration::from_secs(1);

/// Name of the counter in the fleet.
const COUNTER: &str = "sessions";

#[derive(Debug, Clone, Copy)]
struct Sidecar {
    port: u16,
}

impl Sidecar {
    async fn call(self, method: Method, path: &str, body: &'static str) -> Result<(), SendError> {
        let request = Request::builder()
            .method(method)
            .uri(path)
            .header(HOST, "localhost")
            .header(CONTENT_TYPE, "application/json")
            .body(Full::new(Bytes::from_static(body.as_bytes())))?;
        send((Ipv4Addr::LOCALHOST, self.port), request, TIMEOUT).await
    }

    async fn post(self, path: &str) -> Result<(), SendError> {
        self.call(Method::POST, path, "{}").await
    }

    /// Decrements the counter for an ended session. Allocation increments it.
    async fn count_down(self) -> Result<(), SendError> {
        let path = format!("/v1beta1/counters/{COUNTER}");
        self.call(Method::PATCH, &path, "{\"countDiff\":\"-1\"}").await
    }
}

impl Sidecar {
    fn from_environment() -> Self {
        let port = std::env::var("AGONES_SDK_HTTP_PORT").ok().and_then(|port| port.parse().ok());
        Self { port: port.unwrap_or(GATEWAY_PORT) }
    }
}

/// `answers` returns whether no engine hangs.
pub(crate) async fn run(readiness: Readiness, metrics: Arc<Metrics>, answers: impl Fn() -> bool + Send) {
    let sidecar = Sidecar::from_environment();
    let mut reported = Reported::default();
    let mut tick = tokio::time::interval(HEARTBEAT);
    tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        tick.tick().await;
        reported.heartbeat(sidecar, &readiness.get(), &metrics.snapshot(), answers()).await;
    }
}

/// Asks Agones to delete the pod.
pub(crate) async fn shutdown() {
    logged_ok("shutdown", &Sidecar::from_environment().post("/shutdown").await);
}

#[derive(Debug, Default)]
struct Reported {
    ready: bool,
    /// Ended sessions already reported to Agones.
    counted_down: u64,
}

impl Reported {
    /// `answers`: no engine hangs. Poses without frames would not show that: a client that does not take its masks gets
    /// none, and the server is well.
    async fn heartbeat(&mut self, sidecar: Sidecar, stage: &Stage, now: &Snapshot, answers: bool) {
        if *stage == Stage::Ready && !self.ready {
            self.ready = logged_ok("ready", &sidecar.post("/ready").await);
        }
        let ended: u64 = now.closed.iter().sum();
        while self.counted_down < ended && logged_ok("counter", &sidecar.count_down().await) {
            self.counted_down += 1;
        }
        if matches!(stage, Stage::Ready | Stage::Draining) && answers {
            logged_ok("health", &sidecar.post("/health").await);
        }
    }
}

fn logged_ok(what: &str, called: &Result<(), SendError>) -> bool {
    if let Err(error) = called {
        tracing::warn!(what, %error, "a call to Agones failed");
    }
    called.is_ok()
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use http_body_util::BodyExt as _;
    use hyper::{Response, StatusCode, server::conn::http1 as server, service::service_fn};
    use hyper_util::rt::TokioIo;
    use tokio::net::TcpListener;

    use super::*;

    /// Answers like Agones' gateway, records requests, and fails on demand.
    struct Gateway {
        sidecar: Sidecar,
        requests: Arc<Mutex<Vec<String>>>,
        broken: Arc<Mutex<bool>>,
    }

    impl Gateway {
        async fn start() -> Self {
            let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
            let sidecar = Sidecar { port: listener.local_addr().unwrap().port() };
            let (requests, broken) = (Arc::<Mutex<Vec<String>>>::default(), Arc::<Mutex<bool>>::default());
            let gateway = Self { sidecar, requests: Arc::clone(&requests), broken: Arc::clone(&broken) };
            tokio::spawn(async move {
                loop {
                    let (stream, _) = listener.accept().await.unwrap();
                    let (requests, broken) = (Arc::clone(&requests), Arc::clone(&broken));
                    let service = service_fn(move |request: Request<hyper::body::Incoming>| {
                        let (requests, broken) = (Arc::clone(&requests), Arc::clone(&broken));
                        async move {
                            let line = format!("{} {}", request.method(), request.uri().path());
                            let body = request.into_body().collect().await.unwrap().to_bytes();
                            let _: serde_json::Value = serde_json::from_slice(&body).unwrap();
                            let known =
                                ["POST /ready", "POST /health", "POST /shutdown", "PATCH /v1beta1/counters/sessions"];
                            let status = if *broken.lock().unwrap() {
                                StatusCode::SERVICE_UNAVAILABLE
                            } else if known.contains(&line.as_str()) {
                                StatusCode::OK
                            } else {
                                StatusCode::NOT_FOUND
                            };
                            requests.lock().unwrap().push(format!("{line} {}", String::from_utf8_lossy(&body)));
                            let mut answer = Response::new(Full::new(Bytes::from_static(b"{}")));
                            *answer.status_mut() = status;
                            Ok::<_, std::convert::Infallible>(answer)
                        }
                    });
                    tokio::spawn(server::Builder::new().serve_connection(TokioIo::new(stream), service));
                }
            });
            gateway
        }

        fn requests(&self) -> Vec<String> {
            std::mem::take(&mut self.requests.lock().unwrap())
        }
    }

    #[tokio::test]
    async fn agones_learns_readiness_health_and_ended_sessions() {
        let gateway = Gateway::start().await;
        let (mut reported, mut now) = (Reported::default(), Snapshot::default());
        reported.heartbeat(gateway.sidecar, &Stage::Starting, &now, true).await;
        assert!(gateway.requests().is_empty(), "a starting server is neither ready nor healthy");
        reported.heartbeat(gateway.sidecar, &Stage::Ready, &now, true).await;
        assert_eq!(gateway.requests(), ["POST /ready {}", "POST /health {}"]);
        now.closed[0] = 2;
        reported.heartbeat(gateway.sidecar, &Stage::Ready, &now, true).await;
        let down = "PATCH /v1beta1/counters/sessions {\"countDiff\":\"-1\"}";
        assert_eq!(gateway.requests(), [down, down, "POST /health {}"]);
        // An engine that hangs: unhealthy. A client that takes no frames: healthy.
        reported.heartbeat(gateway.sidecar, &Stage::Ready, &now, false).await;
        assert!(gateway.requests().is_empty());
        (now.open, now.sum.totals.poses) = (1, 10);
        reported.heartbeat(gateway.sidecar, &Stage::Draining, &now, true).await;
        assert_eq!(gateway.requests(), ["POST /health {}"]);
        reported.heartbeat(gateway.sidecar, &Stage::Failed("lost".to_owned()), &now, true).await;
        assert!(gateway.requests().is_empty());
    }

    #[tokio::test]
    async fn failed_calls_are_repeated() {
        let gateway = Gateway::start().await;
        let (mut reported, mut now) = (Reported::default(), Snapshot::default());
        now.closed[1] = 1;
        *gateway.broken.lock().unwrap() = true;
        reported.heartbeat(gateway.sidecar, &Stage::Ready, &now, true).await;
        assert!(!reported.ready && reported.counted_down == 0);
        assert_eq!(gateway.requests().len(), 3);
        *gateway.broken.lock().unwrap() = false;
        reported.heartbeat(gateway.sidecar, &Stage::Ready, &now, true).await;
        assert!(reported.ready && reported.counted_down == 1);
        let nobody = Sidecar { port: 9 };
        reported.heartbeat(nobody, &Stage::Ready, &now, true).await;
        assert!(matches!(nobody.post("/health").await, Err(SendError::Reach(_))));
    }
}
