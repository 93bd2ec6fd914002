//! Answers requests to the admin address.

use http_body_util::Full;
use hyper::{
    Method, Request, Response, StatusCode,
    body::Bytes,
    header::{ALLOW, AUTHORIZATION, CACHE_CONTROL, CONTENT_TYPE, HeaderValue, WWW_AUTHENTICATE},
};
use serde_json::{Value, json};

use crate::{
    admission::tokens::scope::Scope,
    metrics::page,
    operate::{
        logs::escape::{self, Form},
        readiness::Stage,
        status::Status,
    },
};

const TEXT: &str = "text/plain; charset=utf-8";
const JSON: &str = "application/json";

type Answer = Response<Full<Bytes>>;

/// Never reads the request's body.
pub(super) fn answer<B>(request: &Request<B>, status: &Status) -> Answer {
    if !status.hosts.answers(request) {
        let why = "the Host header names another host: use an address or localhost, or list the name in --admin-hosts";
        return plain(StatusCode::MISDIRECTED_REQUEST, TEXT, format!("{why}\n"));
    }
    if let Some(session) = session_to_end(request.uri().path()) {
        return if request.method() == Method::POST { end(request, status, session) } else { only("POST") };
    }
    if request.method() != Method::GET && request.method() != Method::HEAD {
        return only("GET, HEAD");
    }
    match request.uri().path() {
        "/live" => plain(StatusCode::OK, TEXT, "alive\n".to_owned()),
        "/ready" => ready(status),
        "/metrics" | "/sessions" if status.requires_token() && !is_admin(request, status) => token_required(),
        "/metrics" => metrics(status),
        "/sessions" => json_of(StatusCode::OK, &json!({ "sessions": status.metrics.list() })),
        _ => plain(StatusCode::NOT_FOUND, TEXT, "/live /ready /metrics /sessions\n".to_owned()),
    }
}

fn session_to_end(path: &str) -> Option<&str> {
    path.strip_prefix("/sessions/")?.strip_suffix("/end")
}

fn is_admin<B>(request: &Request<B>, status: &Status) -> bool {
    let given = request.headers().get(AUTHORIZATION).and_then(|value| value.to_str().ok());
    let token = given.and_then(|value| value.strip_prefix("Bearer ")).map(str::trim);
    status.tokens.as_ref().is_some_and(|tokens| tokens.admit(token, Scope::Admin).is_ok())
}

/// Ends a session. Unlike reading, this always needs a token: any program on the node reaches loopback.
fn end<B>(request: &Request<B>, status: &Status, session: &str) -> Answer {
    if !is_admin(request, status) {
        return token_required();
    }
    match session.parse().ok().filter(|id| status.end_session(*id)) {
        Some(id) => {
            tracing::info!(session = id, "an operator ends a session");
            plain(StatusCode::OK, TEXT, format!("session {id} ends\n"))
        }
        None => plain(StatusCode::NOT_FOUND, TEXT, "there is no such session: /sessions lists them\n".to_owned()),
    }
}

fn ready(status: &Status) -> Answer {
    let open = status.open;
    let not_ready = |why: Value| (StatusCode::SERVICE_UNAVAILABLE, why);
    let (code, body) = match status.readiness.get() {
        Stage::Ready => (StatusCode::OK, json!({ "ready": true, "open": open, "backend": status.backend.get() })),
        Stage::Starting => not_ready(json!({ "ready": false, "open": open, "reason": "starting" })),
        Stage::Draining => not_ready(json!({ "ready": false, "open": open, "reason": "draining" })),
        Stage::Failed(why) => not_ready(json!({ "ready": false, "open": open, "reason": "failed", "why": why })),
    };
    json_of(code, &body)
}

fn metrics(status: &Status) -> Answer {
    match status.page().text() {
        Ok(text) => plain(StatusCode::OK, page::CONTENT_TYPE, text),
        Err(error) => plain(StatusCode::INTERNAL_SERVER_ERROR, TEXT, format!("{error}\n")),
    }
}

/// Peers wrote some of the texts, and people read them in terminals, so hidden characters are escaped.
fn json_of(code: StatusCode, value: &Value) -> Answer {
    plain(code, JSON, escape::escaped(&value.to_string(), Form::Json))
}

fn token_required() -> Answer {
    let mut answer = plain(StatusCode::UNAUTHORIZED, TEXT, "a token with the scope admin is required\n".to_owned());
    answer.headers_mut().insert(WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
    answer
}

fn only(methods: &'static str) -> Answer {
    let mut answer = plain(StatusCode::METHOD_NOT_ALLOWED, TEXT, format!("only {methods}\n"));
    answer.headers_mut().insert(ALLOW, HeaderValue::from_static(methods));
    answer
}

fn plain(code: StatusCode, kind: &'static str, body: String) -> Answer {
    let mut answer = Response::new(Full::new(Bytes::from(body)));
    *answer.status_mut() = code;
    answer.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    answer.headers_mut().insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    answer
}
