//! A good citizen of Agones: ready when clients may come, healthy as long as it can trace, and a counter of sessions that goes down when one ends.
//!
//! It talks to the sidecar's HTTP gateway (port 9358 on loopback, or `AGONES_SDK_HTTP_PORT`), whose paths are those of Agones' `sdk.proto` and
//! `beta.proto`: the gRPC way would bring protoc and tonic into the build for four calls, and this uses the HTTP crate that the admin address
//! uses already. A sidecar that does not answer is asked again: sessions do not depend on it.

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
        http::{TellError, tell},
        readiness::{Readiness, Stage},
    },
};

/// Port of the gateway unless `AGONES_SDK_HTTP_PORT` says otherwise.
const GATEWAY_PORT: u16 = 9358;

/// Well below half of the period after which Agones misses it (`health.periodSeconds`, 5 s in our fleet).
const BEAT: Duration = Duration::from_secs(2);

/// Longest time that the sidecar may take for an answer.
const PATIENCE: Duration = Duration::from_secs(1);

/// The counter's name in the fleet.
const COUNTER: &str = "sessions";

/// The sidecar.
#[derive(Debug, Clone, Copy)]
struct Sidecar {
    port: u16,
}

impl Sidecar {
    async fn call(self, method: Method, path: &str, body: &'static str) -> Result<(), TellError> {
        let request = Request::builder()
            .method(method)
            .uri(path)
            .header(HOST, "localhost")
            .header(CONTENT_TYPE, "application/json")
            .body(Full::new(Bytes::from_static(body.as_bytes())))?;
        tell((Ipv4Addr::LOCALHOST, self.port), request, PATIENCE).await
    }

    async fn post(self, path: &str) -> Result<(), TellError> {
        self.call(Method::POST, path, "{}").await
    }

    /// A session has ended: its place may be allocated again. Allocation is what counts up.
    async fn count_down(self) -> Result<(), TellError> {
        let path = format!("/v1beta1/counters/{COUNTER}");
        self.call(Method::PATCH, &path, "{\"countDiff\":\"-1\"}").await
    }
}

impl Sidecar {
    fn here() -> Self {
        let port = std::env::var("AGONES_SDK_HTTP_PORT").ok().and_then(|port| port.parse().ok());
        Self { port: port.unwrap_or(GATEWAY_PORT) }
    }
}

/// Keeps Agones informed. It ends with its task.
pub(crate) async fn run(readiness: Readiness, metrics: Arc<Metrics>) {
    keep(Sidecar::here(), readiness, metrics, BEAT).await;
}

/// Asks for the pod to be taken away: the last session is gone.
pub(crate) async fn shutdown() {
    went_well("shutdown", &Sidecar::here().post("/shutdown").await);
}

/// What the last beat saw.
#[derive(Debug, Default)]
struct Seen {
    told_ready: bool,
    /// Ended sessions that have been counted down.
    counted_down: u64,
    poses: u64,
    frames: u64,
}

async fn keep(sidecar: Sidecar, readiness: Readiness, metrics: Arc<Metrics>, beat: Duration) {
    let mut seen = Seen::default();
    let mut tick = tokio::time::interval(beat);
    tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        tick.tick().await;
        seen.beat(sidecar, &readiness.get(), &metrics.snapshot()).await;
    }
}

impl Seen {
    async fn beat(&mut self, sidecar: Sidecar, stage: &Stage, now: &Snapshot) {
        if *stage == Stage::Ready && !self.told_ready {
            self.told_ready = went_well("ready", &sidecar.post("/ready").await);
        }
        let ended: u64 = now.closed.iter().sum();
        while self.counted_down < ended && went_well("counter", &sidecar.count_down().await) {
            self.counted_down += 1;
        }
        // Clients that send poses and get no frames have a server that is not healthy, whatever its process says.
        let (poses, frames) = (now.sum.totals.poses, now.sum.totals.frames_traced);
        let stuck = now.open > 0 && poses > self.poses && frames == self.frames;
        (self.poses, self.frames) = (poses, frames);
        if matches!(stage, Stage::Ready | Stage::Draining) && !stuck {
            went_well("health", &sidecar.post("/health").await);
        }
    }
}

fn went_well(what: &str, called: &Result<(), TellError>) -> bool {
    if let Err(error) = called {
        tracing::warn!(what, %error, "agones");
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

    /// A sidecar's gateway that answers what Agones' own does to these paths, notes what it was asked, and can be told to fail.
    struct Gateway {
        sidecar: Sidecar,
        asked: Arc<Mutex<Vec<String>>>,
        broken: Arc<Mutex<bool>>,
    }

    impl Gateway {
        async fn start() -> Self {
            let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
            let sidecar = Sidecar { port: listener.local_addr().unwrap().port() };
            let (asked, broken) = (Arc::<Mutex<Vec<String>>>::default(), Arc::<Mutex<bool>>::default());
            let gateway = Self { sidecar, asked: Arc::clone(&asked), broken: Arc::clone(&broken) };
            tokio::spawn(async move {
                loop {
                    let (stream, _) = listener.accept().await.unwrap();
                    let (asked, broken) = (Arc::clone(&asked), Arc::clone(&broken));
                    let service = service_fn(move |request: Request<hyper::body::Incoming>| {
                        let (asked, broken) = (Arc::clone(&asked), Arc::clone(&broken));
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
                            asked.lock().unwrap().push(format!("{line} {}", String::from_utf8_lossy(&body)));
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

        fn asked(&self) -> Vec<String> {
            std::mem::take(&mut self.asked.lock().unwrap())
        }
    }

    #[tokio::test]
    async fn agones_hears_of_readiness_health_and_ended_sessions() {
        let gateway = Gateway::start().await;
        let (mut seen, mut now) = (Seen::default(), Snapshot::default());
        seen.beat(gateway.sidecar, &Stage::Starting, &now).await;
        assert!(gateway.asked().is_empty(), "a server that still starts is neither ready nor healthy");
        seen.beat(gateway.sidecar, &Stage::Ready, &now).await;
        assert_eq!(gateway.asked(), ["POST /ready {}", "POST /health {}"]);
        now.closed = [2, 0, 0, 0, 0];
        seen.beat(gateway.sidecar, &Stage::Ready, &now).await;
        let down = "PATCH /v1beta1/counters/sessions {\"countDiff\":\"-1\"}";
        assert_eq!(gateway.asked(), [down, down, "POST /health {}"]);
        // Poses without frames: no sign of life. With frames again: one.
        (now.open, now.sum.totals.poses) = (1, 10);
        seen.beat(gateway.sidecar, &Stage::Ready, &now).await;
        assert!(gateway.asked().is_empty());
        (now.sum.totals.poses, now.sum.totals.frames_traced) = (20, 5);
        seen.beat(gateway.sidecar, &Stage::Draining, &now).await;
        assert_eq!(gateway.asked(), ["POST /health {}"]);
        seen.beat(gateway.sidecar, &Stage::Failed("lost".to_owned()), &now).await;
        assert!(gateway.asked().is_empty());
    }

    #[tokio::test]
    async fn what_a_sidecar_missed_is_said_again() {
        let gateway = Gateway::start().await;
        let (mut seen, mut now) = (Seen::default(), Snapshot::default());
        now.closed = [0, 1, 0, 0, 0];
        *gateway.broken.lock().unwrap() = true;
        seen.beat(gateway.sidecar, &Stage::Ready, &now).await;
        assert!(!seen.told_ready && seen.counted_down == 0);
        assert_eq!(gateway.asked().len(), 3);
        *gateway.broken.lock().unwrap() = false;
        seen.beat(gateway.sidecar, &Stage::Ready, &now).await;
        assert!(seen.told_ready && seen.counted_down == 1);
        // Nobody listens there.
        let nobody = Sidecar { port: 9 };
        seen.beat(nobody, &Stage::Ready, &now).await;
        assert!(matches!(nobody.post("/health").await, Err(TellError::Reach(_))));
    }
}
