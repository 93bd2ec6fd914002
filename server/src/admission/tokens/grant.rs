//! A session's hold on the token that admitted it.

use std::{sync::Arc, time::Duration};

use tokio::sync::watch;

use super::{expiry::unix_s, file::Digest, store::TokenStore};
use crate::{admission::end_reason::EndReason, clock};

/// How often an expiry is compared with the wall clock.
const EXPIRY_CHECK: Duration = Duration::from_secs(1);

/// Lasts as long as the session. The token may be withdrawn or expire meanwhile: see [`Self::ended`].
#[derive(Debug)]
pub(crate) struct Grant {
    pub(super) store: Arc<TokenStore>,
    pub(super) digest: Digest,
    /// The token's name in the file, for people.
    pub(super) name: String,
    pub(super) expires_unix_s: Option<i64>,
    /// This grant spent the token, and gives it back unless it is kept.
    pub(super) refundable: bool,
    /// Counts reloads of the file.
    pub(super) reloads: watch::Receiver<u64>,
    /// Reloads when the token was last looked up.
    pub(super) seen_reloads: u64,
}

impl Grant {
    /// The token's name in the file.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// The client is admitted: a single-use token stays spent.
    pub(crate) const fn keep(&mut self) {
        self.refundable = false;
    }

    /// Waits until the token is withdrawn or expires. A spent token stays good for its session. Cancel-safe.
    pub(crate) async fn ended(&mut self) -> EndReason {
        loop {
            let reloads = *self.reloads.borrow_and_update();
            if reloads != self.seen_reloads {
                self.seen_reloads = reloads;
                match self.store.expiry_of(self.digest) {
                    Ok(expires_unix_s) => self.expires_unix_s = expires_unix_s,
                    Err(_) => return EndReason::TokenWithdrawn,
                }
            }
            let left_s = self.expires_unix_s.map(|expires| expires - unix_s(clock::wall()));
            if left_s.is_some_and(|left| left <= 0) {
                return EndReason::TokenExpired;
            }
            tokio::select! {
                // The store lives as long as `self`, so this does not fail.
                _ = self.reloads.changed() => {}
                // The wall clock may be set, so one timer until the expiry would not do.
                () = tokio::time::sleep(EXPIRY_CHECK), if left_s.is_some() => {}
            }
        }
    }
}

impl Drop for Grant {
    fn drop(&mut self) {
        if self.refundable {
            self.store.give_back(self.digest);
        }
    }
}
