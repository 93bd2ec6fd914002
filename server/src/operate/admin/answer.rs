//! The answers of the admin address.

use std::{
    net::SocketAddr,
    sync::{Arc, OnceLock},
};

use http_body_util::Full;
use hyper::{
    Method, Request, Response, StatusCode,
    body::Bytes,
    header::{ALLOW, AUTHORIZATION, CACHE_CONTROL, CONTENT_TYPE, HeaderValue, WWW_AUTHENTICATE},
};
use serde_json::json;

use crate::{
    admission::tokens::store::{Scope, TokenStore},
    metrics::{page, process, registry::Metrics},
    operate::{
        logs::sink,
        readiness::{Readiness, Stage},
    },
};

/// What the answers are made of.
pub(crate) struct Sources {
    pub(crate) metrics: Arc<Metrics>,
    pub(crate) readiness: Readiness,
    /// What traces, once that is known.
    pub(crate) backend: OnceLock<String>,
    pub(crate) capacity: usize,
    /// Where datagrams arrive.
    pub(crate) socket: Option<SocketAddr>,
    /// Who may look, when one of the tokens is for that.
    pub(crate) tokens: Option<Arc<TokenStore>>,
}

const TEXT: &str = "text/plain; charset=utf-8";
const JSON: &str = "application/json";

type Answer = Response<Full<Bytes>>;

/// Answers a request. Nothing of its body is read.
pub(super) fn answer<B>(request: &Request<B>, sources: &Sources) -> Answer {
    if request.method() != Method::GET && request.method() != Method::HEAD {
        let mut answer = plain(StatusCode::METHOD_NOT_ALLOWED, TEXT, "only GET\n".to_owned());
        answer.headers_mut().insert(ALLOW, HeaderValue::from_static("GET, HEAD"));
        return answer;
    }
    match request.uri().path() {
        "/live" => plain(StatusCode::OK, TEXT, "alive\n".to_owned()),
        "/ready" => ready(sources),
        "/metrics" | "/sessions" if !may_look(request, sources) => {
            let mut answer =
                plain(StatusCode::UNAUTHORIZED, TEXT, "a token with the scope admin is wanted\n".to_owned());
            answer.headers_mut().insert(WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
            answer
        }
        "/metrics" => metrics(sources),
        "/sessions" => match serde_json::to_string(&json!({ "sessions": sources.metrics.list() })) {
            Ok(list) => plain(StatusCode::OK, JSON, list),
            Err(error) => plain(StatusCode::INTERNAL_SERVER_ERROR, TEXT, format!("{error}\n")),
        },
        _ => plain(StatusCode::NOT_FOUND, TEXT, "/live /ready /metrics /sessions\n".to_owned()),
    }
}

/// `/live` and `/ready` are for anybody who can reach them. The rest is too, until the token file has a token for it.
fn may_look<B>(request: &Request<B>, sources: &Sources) -> bool {
    let Some(tokens) = sources.tokens.as_ref().filter(|tokens| tokens.has(Scope::Admin)) else { return true };
    let given = request.headers().get(AUTHORIZATION).and_then(|value| value.to_str().ok());
    let token = given.and_then(|value| value.strip_prefix("Bearer "));
    tokens.admit(token.map(str::trim), Scope::Admin).is_ok()
}

fn ready(sources: &Sources) -> Answer {
    let (status, body) = match sources.readiness.get() {
        Stage::Ready => (StatusCode::OK, json!({ "ready": true, "backend": sources.backend.get() })),
        Stage::Starting => (StatusCode::SERVICE_UNAVAILABLE, json!({ "ready": false, "reason": "starting" })),
        Stage::Draining => (StatusCode::SERVICE_UNAVAILABLE, json!({ "ready": false, "reason": "draining" })),
        Stage::Failed(why) => {
            (StatusCode::SERVICE_UNAVAILABLE, json!({ "ready": false, "reason": "failed", "why": why }))
        }
    };
    plain(status, JSON, body.to_string())
}

impl Sources {
    /// All that is counted, now.
    pub(crate) fn page(&self) -> page::Page {
        let stage = self.readiness.get();
        page::Page {
            ready: stage == Stage::Ready,
            draining: stage == Stage::Draining,
            version: env!("CARGO_PKG_VERSION"),
            backend: self.backend.get().cloned().unwrap_or_default(),
            capacity: self.capacity,
            retries: self.metrics.socket.retries(),
            log_lines_lost: sink::lines_lost(),
            process: process::read(self.socket),
            counts: self.metrics.snapshot(),
        }
    }
}

fn metrics(sources: &Sources) -> Answer {
    match sources.page().text() {
        Ok(text) => plain(StatusCode::OK, page::CONTENT_TYPE, text),
        Err(error) => plain(StatusCode::INTERNAL_SERVER_ERROR, TEXT, format!("{error}\n")),
    }
}

fn plain(status: StatusCode, kind: &'static str, body: String) -> Answer {
    let mut answer = Response::new(Full::new(Bytes::from(body)));
    *answer.status_mut() = status;
    answer.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    answer.headers_mut().insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    answer
}
