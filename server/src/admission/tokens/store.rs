//! The loaded tokens, and which single-use tokens are spent.

use std::{
    collections::HashSet,
    path::{Path, PathBuf},
};

use parking_lot::Mutex;
use subtle::ConstantTimeEq as _;
use thiserror::Error;
use tokio::sync::watch;

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
    /// Counts reloads. Changes only while `state` is locked.
    reloads: watch::Sender<u64>,
}

#[derive(Debug)]
struct State {
    listed: Vec<Listed>,
    /// Contains listed tokens only, so the file bounds its size.
    spent: HashSet<Digest>,
}

/// A token that was good for a session.
#[derive(Debug)]
pub(super) struct Claimed {
    pub(super) digest: Digest,
    /// The token's name in the file, for people.
    pub(super) name: String,
    pub(super) expires_unix_s: Option<i64>,
    /// It has the scope edit.
    pub(super) may_edit: bool,
    /// This claim spent the token.
    pub(super) refundable: bool,
    /// Counts reloads of the file.
    pub(super) reloads: watch::Receiver<u64>,
    /// Reloads when the token was last looked up.
    pub(super) seen_reloads: u64,
}

impl TokenStore {
    /// Errors if the file cannot be read, an entry is malformed, or no token has the scope session.
    pub(crate) fn read(path: &Path) -> Result<Self, TokenError> {
        let state = Mutex::new(State { listed: file::read(path)?, spent: HashSet::new() });
        Ok(Self { path: path.to_owned(), state, reloads: watch::Sender::new(0) })
    }

    /// Rereads the file and returns the number of tokens in it. Sessions whose token is no longer listed end. An
    /// unusable file changes nothing.
    /// Errors as [`Self::read`].
    pub(crate) fn reload(&self) -> Result<usize, TokenError> {
        let listed = file::read(&self.path)?;
        let mut state = self.state.lock();
        state.spent.retain(|digest| listed.iter().any(|token| token.digest == *digest));
        state.listed = listed;
        self.reloads.send_modify(|reloads| *reloads += 1);
        Ok(state.listed.len())
    }

    /// Returns whether any listed token has `scope`.
    pub(crate) fn has(&self, scope: Scope) -> bool {
        self.state.lock().listed.iter().any(|token| token.scopes.contains(&scope))
    }

    /// Checks a token for one use, and spends it if it is single-use. Errors if it does not grant `scope` now.
    pub(crate) fn admit(&self, token: Option<&str>, scope: Scope) -> Result<(), TokenRejection> {
        let mut state = self.state.lock();
        let Listed { digest, once, .. } = *state.examine(token, scope, unix_s(clock::wall()))?;
        if once && !state.spent.insert(digest) { Err(TokenRejection::Spent) } else { Ok(()) }
    }

    /// Checks a session's token, and spends it if it is single-use, in one step. `resumes`: the token was spent on the
    /// session that its client resumes.
    pub(super) fn claim(&self, token: Option<&str>, resumes: bool, now_unix_s: i64) -> Result<Claimed, TokenRejection> {
        let mut state = self.state.lock();
        let Listed { digest, name, expires_unix_s, once, scopes } =
            state.examine(token, Scope::Session, now_unix_s)?.clone();
        let refundable = once && state.spent.insert(digest);
        if once && !refundable && !resumes {
            return Err(TokenRejection::Spent);
        }
        let (reloads, seen_reloads) = (self.reloads.subscribe(), *self.reloads.borrow());
        drop(state);
        let may_edit = scopes.contains(&Scope::Edit);
        Ok(Claimed { digest, name, expires_unix_s, may_edit, refundable, reloads, seen_reloads })
    }

    pub(super) fn give_back(&self, digest: Digest) {
        self.state.lock().spent.remove(&digest);
    }

    /// Returns the expiry of a session token in Unix time, if it has one. Errors if it is not listed any more.
    pub(super) fn expiry_of(&self, digest: Digest) -> Result<Option<i64>, TokenRejection> {
        let state = self.state.lock();
        let listed = state.listed.iter().find(|token| token.digest == digest).ok_or(TokenRejection::Unknown)?;
        if listed.scopes.contains(&Scope::Session) { Ok(listed.expires_unix_s) } else { Err(TokenRejection::Scope) }
    }
}

impl State {
    fn examine(&self, token: Option<&str>, scope: Scope, now_unix_s: i64) -> Result<&Listed, TokenRejection> {
        let digest = sha256(token.ok_or(TokenRejection::Missing)?.as_bytes());
        // Compares with every entry in constant time, so that timing does not reveal a near match.
        let found = self
            .listed
            .iter()
            .fold(None, |found, listed| if bool::from(listed.digest.ct_eq(&digest)) { Some(listed) } else { found });
        let found = found.ok_or(TokenRejection::Unknown)?;
        if found.expires_unix_s.is_some_and(|expires| now_unix_s >= expires) {
            return Err(TokenRejection::Expired);
        }
        if found.scopes.contains(&scope) { Ok(found) } else { Err(TokenRejection::Scope) }
    }
}

#[cfg(test)]
mod tests;
