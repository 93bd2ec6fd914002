//! The web pages that may use the server.

use std::{fmt, str::FromStr};

use url::Url;

/// Origins of pages, as browsers send them in `Origin` headers: `https://a.example`, `https://b.example:8443`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Origins(Vec<String>);

impl Origins {
    /// Pages without an origin of their own send `null`, which no list has.
    pub(crate) fn allow(&self, origin: &[u8]) -> bool {
        self.0.iter().any(|allowed| allowed.as_bytes() == origin)
    }
}

impl Origins {
    pub(crate) fn list(&self) -> &[String] {
        &self.0
    }
}

impl FromStr for Origins {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        text.split(',').map(|origin| serialized(origin.trim())).collect::<Result<_, _>>().map(Self)
    }
}

/// As browsers write it: lower case, without the scheme's own port, non-ASCII hosts in Punycode.
fn serialized(text: &str) -> Result<String, String> {
    let url = Url::parse(text).ok().filter(|url| {
        let bare = Url::parse(&url.origin().ascii_serialization());
        matches!(url.scheme(), "https" | "http") && bare.as_ref() == Ok(url)
    });
    url.map(|url| url.origin().ascii_serialization()).ok_or_else(|| {
        format!("{text:?} is not an origin: write https://HOST or https://HOST:PORT, with commas between")
    })
}

impl fmt::Display for Origins {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.join(","))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origins_are_compared_as_browsers_write_them() {
        let origins: Origins =
            "https://A.example, https://b.example:8443,http://[::1]:80/,https://ü.example:443".parse().unwrap();
        assert_eq!(
            origins.to_string(),
            "https://a.example,https://b.example:8443,http://[::1],https://xn--tda.example"
        );
        assert_eq!(origins.to_string().parse(), Ok(origins.clone()));
        for (origin, allowed) in [
            ("https://a.example", true),
            ("https://b.example:8443", true),
            ("http://a.example", false),
            ("https://a.example:8443", false),
            ("https://a.example.evil.example", false),
            ("https://sub.a.example", false),
            ("https://A.example", false),
            ("null", false),
            ("", false),
        ] {
            assert_eq!(origins.allow(origin.as_bytes()), allowed, "{origin}");
        }
    }

    #[test]
    fn what_no_browser_sends_is_refused() {
        for wrong in [
            "",
            "a.example",
            "*",
            "null",
            "https://",
            "https://a.example/path",
            "https://a.example/?q",
            "https://a.example#f",
            "https://u@a.example",
            "ftp://a.example",
            "https://a.example,",
        ] {
            let error = wrong.parse::<Origins>().unwrap_err();
            assert!(error.contains("write https://HOST"), "{wrong:?}: {error}");
        }
    }
}
