//! Resolves URIs: to the bytes of a data URI, or to a file in the scene's own folder (glTF 2.0, §2.8).

use std::path::{Path, PathBuf};

use base64::{
    Engine as _,
    engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig},
};
use percent_encoding::percent_decode_str;

/// Also accepts base64 without padding, a common flaw.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &base64::alphabet::STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Target {
    Data(Vec<u8>),
    File(PathBuf),
}

/// Resolves a URI of a scene in `folder`.
/// Errors with a sentence for a network address, an absolute path, a path that leaves `folder`, or broken base64.
pub(crate) fn resolve(uri: &str, folder: &Path) -> Result<Target, String> {
    if let Some(data) = uri.strip_prefix("data:") {
        let (head, body) = data.split_once(',').ok_or("its data URI has no comma")?;
        if !head.ends_with(";base64") {
            return Ok(Target::Data(percent_decode_str(body).collect()));
        }
        return BASE64.decode(body).map(Target::Data).map_err(|error| format!("its data URI is broken: {error}"));
    }
    let shown: String = uri.chars().take(200).collect();
    if has_scheme(uri) {
        return Err(format!("URI {shown:?} is not local; only files in the scene's folder and data URIs are read"));
    }
    let decoded = percent_decode_str(uri).decode_utf8().map_err(|_| format!("URI {shown:?} is not UTF-8"))?;
    // Some exporters write backslashes. Treated as separators, they cannot hide a `..` on any system.
    let decoded = decoded.replace('\\', "/");
    if decoded.starts_with('/') || decoded.contains('\0') || has_scheme(&decoded) {
        return Err(format!("URI {shown:?} is not a path below the scene's folder"));
    }
    let mut parts = Vec::new();
    for part in decoded.split('/') {
        match part {
            "" | "." => {}
            ".." => {
                parts.pop().ok_or_else(|| format!("URI {shown:?} leaves the scene's folder"))?;
            }
            _ => parts.push(part),
        }
    }
    if parts.is_empty() {
        return Err(format!("URI {shown:?} names no file"));
    }
    Ok(Target::File(folder.join(parts.iter().collect::<PathBuf>())))
}

/// Returns whether a URI starts with a scheme (RFC 3986, §3.1). A drive letter looks like one.
fn has_scheme(uri: &str) -> bool {
    uri.split_once(':').is_some_and(|(scheme, _)| {
        !scheme.contains(['/', '?', '#'])
            && scheme.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '+' | '-' | '.'))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_the_folder_are_found() {
        let file = |uri| resolve(uri, Path::new("/scenes/a"));
        let at = |path: &str| Ok(Target::File(PathBuf::from(path)));
        assert_eq!(file("a.bin"), at("/scenes/a/a.bin"));
        assert_eq!(file("Box%20With Spaces.bin"), at("/scenes/a/Box With Spaces.bin"));
        assert_eq!(file("textures/./x/../%C3%BC.png"), at("/scenes/a/textures/ü.png"));
        assert_eq!(file("textures\\x.png"), at("/scenes/a/textures/x.png"));
        assert_eq!(file("a..b"), at("/scenes/a/a..b"));
    }

    #[test]
    fn data_uris_are_decoded() {
        let data = |uri| resolve(uri, Path::new("."));
        assert_eq!(data("data:application/octet-stream;base64,AQID"), Ok(Target::Data(vec![1, 2, 3])));
        assert_eq!(data("data:;base64,AQ=="), Ok(Target::Data(vec![1])));
        assert_eq!(data("data:;base64,AQ"), Ok(Target::Data(vec![1])));
        assert_eq!(data("data:text/plain,a%00b"), Ok(Target::Data(b"a\0b".to_vec())));
        for broken in ["data:", "data:;base64,A`", "data:;base64"] {
            assert!(data(broken).is_err(), "{broken}");
        }
    }

    #[test]
    fn other_uris_are_refused() {
        for uri in [
            "../a.bin",
            "a/../../b.bin",
            "%2e%2e/a.bin",
            "..\\a.bin",
            "%5c%5cserver/share",
            "/etc/passwd",
            "%2Fetc/passwd",
            "http://example.com/a.bin",
            "https:a.bin",
            "file:///etc/passwd",
            "C:/a.bin",
            "c%3A/a.bin",
            ":",
            "",
            ".",
            "a%00b",
            "%ff",
        ] {
            assert!(resolve(uri, Path::new("/scenes/a")).is_err(), "{uri}");
        }
    }
}
