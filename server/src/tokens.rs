//! The tokens that admit a client: a file with one a line; `#` starts a comment line.

use std::path::{Path, PathBuf};

use gnomon_protocol::limits::MAX_TOKEN_BYTES;
use thiserror::Error;

use crate::{files, limits};

/// The digests of the listed tokens. Digests, so that comparing takes the same time wherever two tokens differ
/// (`blake3::Hash` compares in constant time), and so that no token stays in memory to leak into a log.
#[derive(Debug, Clone)]
pub(crate) struct Tokens(Vec<blake3::Hash>);

/// Why a token file cannot be used.
#[derive(Debug, Error)]
pub enum TokenError {
    /// It cannot be read.
    #[error("cannot read the token file {path}: {reason}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: std::io::Error,
    },
    /// A line is no token.
    #[error("{path}:{line}: a token has 1 to {MAX_TOKEN_BYTES} visible ASCII characters")]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The line, from 1. The token itself does not belong into a log.
        line: usize,
    },
    /// It lists none, so nobody could ever connect.
    #[error("{0} lists no token: add one a line, or leave out --token-file to admit everybody")]
    Empty(PathBuf),
}

impl Tokens {
    /// Reads a token file.
    ///
    /// # Errors
    /// When it cannot be read, has a malformed line, or lists no token.
    pub(crate) fn read(path: &Path) -> Result<Self, TokenError> {
        let bytes = files::read_small(path, limits::MAX_TOKEN_FILE_BYTES)
            .map_err(|reason| TokenError::Read { path: path.to_owned(), reason })?;
        let mut digests = Vec::new();
        for (index, line) in bytes.split(|byte| *byte == b'\n').enumerate() {
            let token = line.trim_ascii();
            if token.is_empty() || token.starts_with(b"#") {
                continue;
            }
            if token.len() > MAX_TOKEN_BYTES || !token.iter().all(u8::is_ascii_graphic) {
                return Err(TokenError::Malformed { path: path.to_owned(), line: index + 1 });
            }
            digests.push(blake3::hash(token));
        }
        if digests.is_empty() { Err(TokenError::Empty(path.to_owned())) } else { Ok(Self(digests)) }
    }

    /// Whether the token is listed. Looks at every entry, so that the time does not tell which one matched.
    pub(crate) fn admits(&self, token: Option<&str>) -> bool {
        let Some(token) = token else { return false };
        let digest = blake3::hash(token.as_bytes());
        self.0.iter().fold(false, |found, listed| found | (*listed == digest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &[u8]) -> Result<Tokens, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tokens");
        std::fs::write(&path, text).unwrap();
        Tokens::read(&path).map_err(|error| error.to_string())
    }

    #[test]
    fn listed_tokens_and_no_others_are_admitted() {
        let tokens = read(b"# staff\nfirst-token\r\n\n  second  \n#third\n").unwrap();
        for (token, admitted) in [
            ("first-token", true),
            ("second", true),
            ("third", false),
            ("#third", false),
            ("first-toke", false),
            ("", false),
        ] {
            assert_eq!(tokens.admits(Some(token)), admitted, "{token:?}");
        }
        assert!(!tokens.admits(None));
    }

    #[test]
    fn a_file_that_admits_nobody_is_a_mistake() {
        assert!(read(b"# nothing\n\n").unwrap_err().contains("lists no token"));
        assert!(read(b"ok\ntwo words\n").unwrap_err().contains(":2: a token has"));
        assert!(read(&[b'x'; MAX_TOKEN_BYTES + 1]).unwrap_err().contains(":1: a token has"));
        assert!(Tokens::read(Path::new("/nowhere/tokens")).unwrap_err().to_string().contains("/nowhere/tokens"));
    }
}
