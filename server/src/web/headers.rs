//! What the page's answers tell the browser to refuse.

use hyper::header::{
    CONTENT_SECURITY_POLICY, HeaderMap, HeaderName, HeaderValue, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
};

/// Adds the rules for a page that was asked for as `host`, and whose sessions go to this port.
///
/// Scripts and styles come from files of this server alone, and wasm may be compiled. The page connects to this server,
/// and to WebTransport's port on the same host; an address that the policy's grammar has no word for is any host.
pub(super) fn protect(headers: &mut HeaderMap, host: Option<&HeaderValue>, port: u16) {
    let host = host.and_then(|host| host.to_str().ok()).map(name).filter(|name| is_name(name)).unwrap_or("*");
    let policy = format!(
        "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; img-src 'self' blob:; \
         connect-src 'self' https://{host}:{port}; worker-src 'self'; base-uri 'none'; form-action 'none'; \
         frame-ancestors 'none'"
    );
    if let Ok(policy) = HeaderValue::try_from(policy) {
        headers.insert(CONTENT_SECURITY_POLICY, policy);
    }
    headers.insert(REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    for name in ["cross-origin-opener-policy", "cross-origin-resource-policy"] {
        headers.insert(HeaderName::from_static(name), HeaderValue::from_static("same-origin"));
    }
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
}

/// Returns a `Host` without its port.
fn name(host: &str) -> &str {
    host.rsplit_once(':')
        .filter(|(_, port)| port.bytes().all(|byte| byte.is_ascii_digit()))
        .map_or(host, |(name, _)| name)
}

fn is_name(name: &str) -> bool {
    !name.is_empty() && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'-'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_connects_to_its_own_host_only() {
        for (host, expected) in [
            (Some("edge.example"), "https://edge.example:4433;"),
            (Some("edge.example:8443"), "https://edge.example:4433;"),
            (Some("127.0.0.1:80"), "https://127.0.0.1:4433;"),
            (Some("[::1]:8443"), "https://*:4433;"),
            (Some("a; script-src *"), "https://*:4433;"),
            (Some(""), "https://*:4433;"),
            (None, "https://*:4433;"),
        ] {
            let mut headers = HeaderMap::new();
            let host = host.map(|host| HeaderValue::from_str(host).unwrap());
            protect(&mut headers, host.as_ref(), 4433);
            let policy = headers[CONTENT_SECURITY_POLICY].to_str().unwrap();
            assert!(policy.contains(&format!("connect-src 'self' {expected}")), "{host:?}: {policy}");
            assert!(!policy.contains("unsafe-inline") && policy.matches("script-src").count() == 1, "{policy}");
        }
    }
}
