//! Answers requests to the web address.

use std::sync::Arc;

use gnomon_protocol::PROTOCOL_VERSION;
use http_body_util::Full;
use hyper::{
    Method, Request, Response, StatusCode,
    body::Bytes,
    header::{
        ACCEPT_ENCODING, ACCESS_CONTROL_ALLOW_METHODS, ACCESS_CONTROL_ALLOW_ORIGIN, ALLOW, CACHE_CONTROL,
        CONTENT_ENCODING, CONTENT_TYPE, ETAG, HOST, HeaderMap, HeaderValue, IF_NONE_MATCH, ORIGIN, VARY,
        X_CONTENT_TYPE_OPTIONS,
    },
};
use serde_json::json;

use super::{
    files::{Asset, Files},
    headers::protect,
    socket::Arrivals,
};
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
    /// `None` if the server has no page of its own.
    pub(crate) files: Option<Files>,
    /// Where sessions over WebSockets go.
    pub(crate) arrivals: Arrivals,
}

/// Never reads the request's body.
pub(super) fn answer<B>(request: &Request<B>, page: &Page) -> Answer {
    let reads = matches!(*request.method(), Method::GET | Method::HEAD);
    if let Some(answer) = page.files.as_ref().filter(|_| reads).and_then(|files| file(request, files, page.port)) {
        return answer;
    }
    let mut answer = match (request.uri().path(), request.method()) {
        ("/gnomon.json", &Method::GET | &Method::HEAD) => with(StatusCode::OK, "application/json", page.json()),
        // A browser asks this first if the page's request has headers of its own.
        ("/gnomon.json", &Method::OPTIONS) => with(StatusCode::NO_CONTENT, "text/plain", ""),
        ("/gnomon.json", _) => with(StatusCode::METHOD_NOT_ALLOWED, "text/plain", "only GET\n"),
        _ => with(StatusCode::NOT_FOUND, "text/plain", "/gnomon.json\n"),
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

/// Returns the page or one of its files; `None` if the path names none.
fn file<B>(request: &Request<B>, files: &Files, port: u16) -> Option<Answer> {
    let mut answer = match (request.uri().path(), files.asset(request.uri().path())) {
        ("/", _) => index(request.headers(), files),
        (_, Some(asset)) => whole(asset, accepts_gzip(request.headers())),
        _ => return None,
    };
    protect(answer.headers_mut(), request.headers().get(HOST), port);
    Some(answer)
}

/// Asked for each time, and sent if it is new: it names the files of this version.
fn index(asked: &HeaderMap, files: &Files) -> Answer {
    let tag = format!("\"{}\"", files.digest());
    let known = asked.get(IF_NONE_MATCH).is_some_and(|known| known.as_bytes() == tag.as_bytes());
    let mut answer = if known {
        with(StatusCode::NOT_MODIFIED, "text/html; charset=utf-8", Bytes::new())
    } else {
        with(StatusCode::OK, "text/html; charset=utf-8", files.index().clone())
    };
    if let Ok(tag) = HeaderValue::try_from(tag) {
        answer.headers_mut().insert(ETAG, tag);
    }
    answer.headers_mut().insert(CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    answer
}

/// Kept for good: another content has another path.
fn whole(asset: &Asset, accepts_gzip: bool) -> Answer {
    let compressed = asset.compressed.as_ref().filter(|_| accepts_gzip);
    let mut answer = with(StatusCode::OK, asset.kind, compressed.unwrap_or(&asset.plain).clone());
    let headers = answer.headers_mut();
    if compressed.is_some() {
        headers.insert(CONTENT_ENCODING, HeaderValue::from_static("gzip"));
    }
    headers.insert(VARY, HeaderValue::from_static("accept-encoding"));
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("public, max-age=31536000, immutable"));
    answer
}

fn accepts_gzip(asked: &HeaderMap) -> bool {
    let listed = asked.get(ACCEPT_ENCODING).and_then(|list| list.to_str().ok()).unwrap_or_default();
    listed.split(',').any(|coding| {
        let (name, weight) = coding.split_once(';').unwrap_or((coding, "q=1"));
        let weight = weight.trim().strip_prefix("q=").and_then(|weight| weight.parse::<f32>().ok());
        name.trim().eq_ignore_ascii_case("gzip") && weight.is_some_and(|weight| weight > 0.0)
    })
}

impl Page {
    fn json(&self) -> String {
        json!({
            "port": self.port,
            "protocol_version": PROTOCOL_VERSION,
            "scene": self.scene,
            "websocket": super::socket::PATH,
            "certificate_sha256": self.certificates.browser_hashes(),
            "origins": self.origins.as_ref().map(Origins::list),
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

fn with(code: StatusCode, kind: &'static str, body: impl Into<Bytes>) -> Answer {
    let mut answer = Response::new(Full::new(body.into()));
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
            files: None,
            arrivals: tokio::sync::mpsc::channel(1).0,
        }
    }

    fn with_files(folder: &std::path::Path) -> Page {
        Page { files: Some(Files::read(super::super::files::tests::folder().path()).unwrap()), ..page(folder, None) }
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

    #[test]
    fn the_page_is_asked_for_again_and_its_files_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let page = with_files(folder.path());
        let index = ask(&page, Method::GET, "/", None);
        assert_eq!(
            (index.status(), &index.headers()[CACHE_CONTROL]),
            (StatusCode::OK, &HeaderValue::from_static("no-cache"))
        );
        let tag = index.headers()[ETAG].to_str().unwrap().to_owned();
        for (known, status) in [(&*tag, StatusCode::NOT_MODIFIED), ("\"other\"", StatusCode::OK)] {
            let request = Request::get("/").header(IF_NONE_MATCH, known).body(()).unwrap();
            assert_eq!(answer(&request, &page).status(), status);
        }
        let path = format!("/{}/page.js", tag.trim_matches('"'));
        for (accepted, compressed) in [
            (None, false),
            (Some("br, gzip"), true),
            (Some("GZIP;q=0.5"), true),
            (Some("gzip;q=0"), false),
            (Some("identity"), false),
        ] {
            let mut request = Request::get(&path);
            if let Some(accepted) = accepted {
                request = request.header(ACCEPT_ENCODING, accepted);
            }
            let answer = answer(&request.body(()).unwrap(), &page);
            assert_eq!(answer.headers().contains_key(CONTENT_ENCODING), compressed, "{accepted:?}");
            assert!(answer.headers()[CACHE_CONTROL].to_str().unwrap().contains("immutable"));
            assert_eq!(answer.headers()[VARY], "accept-encoding");
        }
        assert_eq!(ask(&page, Method::POST, "/", None).status(), StatusCode::NOT_FOUND);
        assert_eq!(ask(&page, Method::GET, "/page.js", None).status(), StatusCode::NOT_FOUND);
        assert_eq!(ask(&page, Method::GET, "/gnomon.json", None).headers()[CACHE_CONTROL], "no-store");
    }
}
