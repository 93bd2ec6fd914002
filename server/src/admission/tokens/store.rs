//! The loaded tokens, and which single-use tokens are spent.

use std::{
    collections::HashSet,
    path::{Path, PathBuf},
};

use parking_lot::Mutex;
use subtle::ConstantTimeEq as _;
use thiserror::Error;

use super::{
    expiry::unix_s,
    file::{self, Digest, Listed, TokenError, sha256},
    scope::Scope,
};
use crate::clock;

/// Why a token is rejected. Logged, but not sent to the client.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub(crate) enum TokenRejection {
    #[error("no token")]
    Missing,
    #[error("an unknown token")]
    Unknown,
    #[error("an expired token")]
    Expired,
    #[error("a token without this scope")]
    Scope,
    #[error("a single-use token that is spent")]
    Spent,
}

#[derive(Debug)]
pub(crate) struct TokenStore {
    path: PathBuf,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    listed: Vec<Listed>,
    /// Contains listed tokens only, so the file bounds its size.
    spent: HashSet<Digest>,
}

impl TokenStore {
    /// Errors if the file cannot be read, an entry is malformed, or no token has the scope session.
    pub(crate) fn read(path: &Path) -> Result<Self, TokenError> {
        let state = Mutex::new(State { listed: file::read(path)?, spent: HashSet::new() });
        Ok(Self { path: path.to_owned(), state })
    }

    /// Rereads the file and returns the number of tokens in it. Open sessions stay. An unusable file changes nothing.
    /// Errors as [`Self::read`].
    pub(crate) fn reload(&self) -> Result<usize, TokenError> {
        let listed = file::read(&self.path)?;
        let mut state = self.state.lock();
        state.spent.retain(|digest| listed.iter().any(|token| token.digest == *digest));
        state.listed = listed;
        Ok(state.listed.len())
    }

    /// Returns whether any listed token has `scope`.
    pub(crate) fn has(&self, scope: Scope) -> bool {
        self.state.lock().listed.iter().any(|token| token.scopes.contains(&scope))
    }

    /// Checks a token, and spends it if it is single-use. Errors if the token does not grant `scope` now.
    pub(crate) fn admit(&self, token: Option<&str>, scope: Scope) -> Result<(), TokenRejection> {
        self.examine(token, scope, unix_s(clock::wall()), true)
    }

    /// As [`Self::admit`], without spending.
    pub(crate) fn check(&self, token: Option<&str>, scope: Scope) -> Result<(), TokenRejection> {
        self.examine(token, scope, unix_s(clock::wall()), false)
    }

    fn examine(&self, token: Option<&str>, scope: Scope, now_unix_s: i64, spend: bool) -> Result<(), TokenRejection> {
        let digest = sha256(token.ok_or(TokenRejection::Missing)?.as_bytes());
        let mut state = self.state.lock();
        // Compares with every entry in constant time, so that timing does not reveal a near match.
        let found = state
            .listed
            .iter()
            .fold(None, |found, listed| if bool::from(listed.digest.ct_eq(&digest)) { Some(listed) } else { found });
        let found = found.ok_or(TokenRejection::Unknown)?;
        if found.expires_unix_s.is_some_and(|expires| now_unix_s >= expires) {
            return Err(TokenRejection::Expired);
        }
        if !found.scopes.contains(&scope) {
            return Err(TokenRejection::Scope);
        }
        let once = found.once;
        if once && (state.spent.contains(&digest) || spend && !state.spent.insert(digest)) {
            return Err(TokenRejection::Spent);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
