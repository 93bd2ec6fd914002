//! The format and checks of the token file.

use std::path::{Path, PathBuf};

use ring::digest;
use serde::Deserialize;
use thiserror::Error;

use super::{expiry, scope::Scope};
use crate::{files, hex, limits};

/// SHA-256 of a token.
pub(crate) type Digest = [u8; 32];

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Entry {
    #[serde(default)]
    pub(super) name: String,
    pub(super) sha256: String,
    #[serde(default)]
    pub(super) expires: Option<toml::value::Datetime>,
    #[serde(default = "session_only")]
    pub(super) scopes: Vec<Scope>,
    #[serde(default)]
    pub(super) once: bool,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    token: Vec<Entry>,
}

fn session_only() -> Vec<Scope> {
    vec![Scope::Session]
}

#[derive(Debug, Clone)]
pub(crate) struct Listed {
    pub(super) name: String,
    pub(super) digest: Digest,
    pub(super) expires_unix_s: Option<i64>,
    pub(super) scopes: Vec<Scope>,
    pub(super) once: bool,
}

#[derive(Debug, Error)]
pub enum TokenError {
    #[error("cannot read the token file {path}: {reason}")]
    Read { path: PathBuf, reason: std::io::Error },
    /// `reason` names a line, but quotes nothing: an old file may contain bare tokens.
    #[error("token file {path}: {reason}; `gnomon-server token` makes entries")]
    Malformed { path: PathBuf, reason: String },
    /// No client could ever connect.
    #[error(
        "{0} lists no token with the scope session: make one with `gnomon-server token`, or leave out --token-file to \
         admit everybody"
    )]
    Empty(PathBuf),
    #[error("the system provides no random numbers")]
    Random,
}

/// Errors as [`parse`], and if the file cannot be read.
pub(super) fn read(path: &Path) -> Result<Vec<Listed>, TokenError> {
    let bytes = files::read_small(path, limits::MAX_TOKEN_FILE_BYTES)
        .map_err(|reason| TokenError::Read { path: path.to_owned(), reason })?;
    parse(path, bytes)
}

/// Errors if an entry is malformed, or if no token has the scope session.
pub(crate) fn parse(path: &Path, bytes: Vec<u8>) -> Result<Vec<Listed>, TokenError> {
    let malformed = |reason: String| TokenError::Malformed { path: path.to_owned(), reason };
    let text = String::from_utf8(bytes).map_err(|_| malformed("it is not UTF-8".to_owned()))?;
    // The parser's message quotes the text, which may be a bare token, so report only the line.
    let file: File = toml::from_str(&text).map_err(|error| malformed(gnomon_settings::line_of(error.span(), &text)))?;
    if file.token.len() > limits::MAX_TOKENS {
        return Err(malformed(format!("{} tokens; at most {} are allowed", file.token.len(), limits::MAX_TOKENS)));
    }
    let check = |(index, entry): (usize, Entry)| {
        let wrong = |what: &str| malformed(format!("token {}: {what}", index + 1));
        let digest = hex::decode(&entry.sha256).ok_or_else(|| wrong("sha256 has 64 hexadecimal digits"))?;
        let expires = entry
            .expires
            .map(|at| expiry::from_toml(&at).ok_or_else(|| wrong("expires has a date, a time and an offset")));
        Ok(Listed {
            name: entry.name,
            digest,
            expires_unix_s: expires.transpose()?,
            scopes: entry.scopes,
            once: entry.once,
        })
    };
    let listed: Vec<_> = file.token.into_iter().enumerate().map(check).collect::<Result<_, _>>()?;
    let usable = listed.iter().any(|token| token.scopes.contains(&Scope::Session));
    if usable { Ok(listed) } else { Err(TokenError::Empty(path.to_owned())) }
}

pub(crate) fn sha256(bytes: &[u8]) -> Digest {
    let mut digest = Digest::default();
    digest.copy_from_slice(digest::digest(&digest::SHA256, bytes).as_ref());
    digest
}
