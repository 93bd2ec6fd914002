//! Answers requests to the admin address.

use http_body_util::Full;
use hyper::{
    Method, Request, Response, StatusCode,
    body::Bytes,
    header::{ALLOW, AUTHORIZATION, CACHE_CONTROL, CONTENT_TYPE, HeaderValue, WWW_AUTHENTICATE},
};
use serde_json::json;

use crate::{
    admission::tokens::scope::Scope,
    metrics::page,
    operate::{readiness::Stage, status::Status},
};

const TEXT: &str = "text/plain; charset=utf-8";
const JSON: &str = "application/json";

type Answer = Response<Full<Bytes>>;

/// Never reads the request's body.
pub(super) fn answer<B>(request: &Request<B>, status: &Status) -> Answer {
    if request.method() != Method::GET && request.method() != Method::HEAD {
        let mut answer = plain(StatusCode::METHOD_NOT_ALLOWED, TEXT, "only GET\n".to_owned());
        answer.headers_mut().insert(ALLOW, HeaderValue::from_static("GET, HEAD"));
        return answer;
    }
    match request.uri().path() {
        "/live" => plain(StatusCode::OK, TEXT, "alive\n".to_owned()),
        "/ready" => ready(status),
        "/metrics" | "/sessions" if !authorized(request, status) => {
            let mut answer =
                plain(StatusCode::UNAUTHORIZED, TEXT, "a token with the scope admin is required\n".to_owned());
            answer.headers_mut().insert(WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
            answer
        }
        "/metrics" => metrics(status),
        "/sessions" => match serde_json::to_string(&json!({ "sessions": status.metrics.list() })) {
            Ok(list) => plain(StatusCode::OK, JSON, list),
            Err(error) => plain(StatusCode::INTERNAL_SERVER_ERROR, TEXT, format!("{error}\n")),
        },
        _ => plain(StatusCode::NOT_FOUND, TEXT, "/live /ready /metrics /sessions\n".to_owned()),
    }
}

/// `/metrics` and `/sessions` need a token once the file lists one with scope admin. `/live` and `/ready` never do.
fn authorized<B>(request: &Request<B>, status: &Status) -> bool {
    let Some(tokens) = status.tokens.as_ref().filter(|tokens| tokens.has(Scope::Admin)) else { return true };
    let given = request.headers().get(AUTHORIZATION).and_then(|value| value.to_str().ok());
    let token = given.and_then(|value| value.strip_prefix("Bearer "));
    tokens.admit(token.map(str::trim), Scope::Admin).is_ok()
}

fn ready(status: &Status) -> Answer {
    let (code, body) = match status.readiness.get() {
        Stage::Ready => (StatusCode::OK, json!({ "ready": true, "backend": status.backend.get() })),
        Stage::Starting => (StatusCode::SERVICE_UNAVAILABLE, json!({ "ready": false, "reason": "starting" })),
        Stage::Draining => (StatusCode::SERVICE_UNAVAILABLE, json!({ "ready": false, "reason": "draining" })),
        Stage::Failed(why) => {
            (StatusCode::SERVICE_UNAVAILABLE, json!({ "ready": false, "reason": "failed", "why": why }))
        }
    };
    plain(code, JSON, body.to_string())
}

fn metrics(status: &Status) -> Answer {
    match status.page().text() {
        Ok(text) => plain(StatusCode::OK, page::CONTENT_TYPE, text),
        Err(error) => plain(StatusCode::INTERNAL_SERVER_ERROR, TEXT, format!("{error}\n")),
    }
}

fn plain(code: StatusCode, kind: &'static str, body: String) -> Answer {
    let mut answer = Response::new(Full::new(Bytes::from(body)));
    *answer.status_mut() = code;
    answer.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    answer.headers_mut().insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    answer
}
