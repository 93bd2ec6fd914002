//! Answers requests to the web address.

use std::sync::Arc;

use gnomon_protocol::PROTOCOL_VERSION;
use http_body_util::Full;
use hyper::{
    Method, Request, Response, StatusCode,
    body::Bytes,
    header::{
        ACCESS_CONTROL_ALLOW_METHODS, ACCESS_CONTROL_ALLOW_ORIGIN, ALLOW, CACHE_CONTROL, CONTENT_TYPE, HeaderMap,
        HeaderValue, ORIGIN, VARY, X_CONTENT_TYPE_OPTIONS,
    },
};
use serde_json::json;

use crate::{net::certificate::Certificates, origins::Origins};

const METHODS: &str = "GET, HEAD, OPTIONS";

type Answer = Response<Full<Bytes>>;

pub(crate) struct Page {
    /// Of WebTransport, as clients reach it.
    pub(crate) port: u16,
    pub(crate) scene: String,
    pub(crate) certificates: Arc<Certificates>,
    /// `None` allows every origin.
    pub(crate) origins: Option<Origins>,
}

/// Never reads the request's body.
pub(super) fn answer<B>(request: &Request<B>, page: &Page) -> Answer {
    let mut answer = match (request.uri().path(), request.method()) {
        ("/gnomon.json", &Method::GET | &Method::HEAD) => with(StatusCode::OK, "application/json", page.json()),
        // A browser asks this first if the page's request has headers of its own.
        ("/gnomon.json", &Method::OPTIONS) => with(StatusCode::NO_CONTENT, "text/plain", String::new()),
        ("/gnomon.json", _) => with(StatusCode::METHOD_NOT_ALLOWED, "text/plain", "only GET\n".to_owned()),
        _ => with(StatusCode::NOT_FOUND, "text/plain", "/gnomon.json\n".to_owned()),
    };
    let headers = answer.headers_mut();
    if headers.get(CONTENT_TYPE) != Some(&HeaderValue::from_static("application/json")) {
        headers.insert(ALLOW, HeaderValue::from_static(METHODS));
    }
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    page.share(request.headers().get(ORIGIN), headers);
    answer
}

impl Page {
    fn json(&self) -> String {
        json!({
            "port": self.port,
            "protocol_version": PROTOCOL_VERSION,
            "scene": self.scene,
            "certificate_sha256": self.certificates.browser_hashes(),
        })
        .to_string()
    }

    /// Lets pages of the allowed origins read the answer.
    fn share(&self, origin: Option<&HeaderValue>, headers: &mut HeaderMap) {
        let allowed = match &self.origins {
            None => Some(HeaderValue::from_static("*")),
            Some(origins) => {
                headers.insert(VARY, HeaderValue::from_static("origin"));
                origin.filter(|origin| origins.allow(origin.as_bytes())).cloned()
            }
        };
        if let Some(allowed) = allowed {
            headers.insert(ACCESS_CONTROL_ALLOW_ORIGIN, allowed);
            headers.insert(ACCESS_CONTROL_ALLOW_METHODS, HeaderValue::from_static(METHODS));
        }
    }
}

fn with(code: StatusCode, kind: &'static str, body: String) -> Answer {
    let mut answer = Response::new(Full::new(Bytes::from(body)));
    *answer.status_mut() = code;
    answer.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    answer
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ServerConfig;

    fn page(folder: &std::path::Path, origins: Option<&str>) -> Page {
        let config = ServerConfig { cert_dir: Some(folder.to_owned()), ..ServerConfig::default() };
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        Page {
            port: 4433,
            scene: "cloister".to_owned(),
            certificates: Arc::new(Certificates::open(&config, provider).unwrap()),
            origins: origins.map(|origins| origins.parse().unwrap()),
        }
    }

    fn ask(page: &Page, method: Method, path: &str, origin: Option<&str>) -> Answer {
        let mut request = Request::builder().method(method).uri(path);
        if let Some(origin) = origin {
            request = request.header(ORIGIN, origin);
        }
        answer(&request.body(()).unwrap(), page)
    }

    #[test]
    fn only_pages_of_listed_origins_may_read_the_answer() {
        let folder = tempfile::tempdir().unwrap();
        let [open, listed] = [None, Some("https://a.example")].map(|origins| page(folder.path(), origins));
        for (page, origin, allowed) in [
            (&open, None, Some("*")),
            (&open, Some("https://b.example"), Some("*")),
            (&listed, Some("https://a.example"), Some("https://a.example")),
            (&listed, Some("https://b.example"), None),
            (&listed, Some("null"), None),
            (&listed, None, None),
        ] {
            for method in [Method::GET, Method::OPTIONS] {
                let answer = ask(page, method, "/gnomon.json", origin);
                assert!(answer.status().is_success());
                let found = answer.headers().get(ACCESS_CONTROL_ALLOW_ORIGIN).map(|value| value.to_str().unwrap());
                assert_eq!(found, allowed, "{origin:?}");
                assert_eq!(answer.headers()[CACHE_CONTROL], "no-store");
                assert_eq!(answer.headers().contains_key(VARY), page.origins.is_some());
            }
        }
    }

    #[test]
    fn there_is_one_page_to_read() {
        let folder = tempfile::tempdir().unwrap();
        let page = page(folder.path(), None);
        assert_eq!(ask(&page, Method::GET, "/", None).status(), StatusCode::NOT_FOUND);
        assert_eq!(ask(&page, Method::GET, "/gnomon.json/", None).status(), StatusCode::NOT_FOUND);
        let refused = ask(&page, Method::POST, "/gnomon.json", None);
        assert_eq!(refused.status(), StatusCode::METHOD_NOT_ALLOWED);
        assert_eq!(refused.headers()[ALLOW], METHODS);
    }
}
