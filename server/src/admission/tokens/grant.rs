//! A session's hold on the token that admitted it.

use std::{sync::Arc, time::Duration};

use super::{
    expiry::unix_s,
    store::{Claimed, TokenRejection, TokenStore},
};
use crate::{admission::end_reason::EndReason, clock};

/// How often an expiry is compared with the wall clock.
const EXPIRY_CHECK: Duration = Duration::from_secs(1);

/// Lasts as long as the session. Gives a single-use token back unless it is kept. The token may be withdrawn or expire
/// meanwhile: see [`Self::ended`].
#[derive(Debug)]
pub(crate) struct Grant {
    store: Arc<TokenStore>,
    claimed: Claimed,
}

impl Grant {
    /// Checks a session's token, and spends it if it is single-use, in one step. `resumes`: the token was spent on the
    /// session that its client resumes.
    pub(crate) fn claim(store: &Arc<TokenStore>, token: Option<&str>, resumes: bool) -> Result<Self, TokenRejection> {
        Self::claim_at(store, token, resumes, unix_s(clock::wall()))
    }

    pub(super) fn claim_at(
        store: &Arc<TokenStore>,
        token: Option<&str>,
        resumes: bool,
        now_unix_s: i64,
    ) -> Result<Self, TokenRejection> {
        let claimed = store.claim(token, resumes, now_unix_s)?;
        Ok(Self { store: Arc::clone(store), claimed })
    }

    /// The token's name in the file.
    pub(crate) fn name(&self) -> &str {
        &self.claimed.name
    }

    /// Whether its sessions may change the scene.
    pub(crate) const fn may_edit(&self) -> bool {
        self.claimed.may_edit
    }

    /// The client is admitted: a single-use token stays spent.
    pub(crate) const fn keep(&mut self) {
        self.claimed.refundable = false;
    }

    /// Waits until the token is withdrawn or expires. A spent token stays good for its session. Cancel-safe.
    pub(crate) async fn ended(&mut self) -> EndReason {
        loop {
            let reloads = *self.claimed.reloads.borrow_and_update();
            if reloads != self.claimed.seen_reloads {
                self.claimed.seen_reloads = reloads;
                match self.store.expiry_of(self.claimed.digest) {
                    Ok(expires_unix_s) => self.claimed.expires_unix_s = expires_unix_s,
                    Err(_) => return EndReason::TokenWithdrawn,
                }
            }
            let left_s = self.claimed.expires_unix_s.map(|expires| expires - unix_s(clock::wall()));
            if left_s.is_some_and(|left| left <= 0) {
                return EndReason::TokenExpired;
            }
            tokio::select! {
                // The store lives as long as `self`, so this does not fail.
                _ = self.claimed.reloads.changed() => {}
                // The wall clock may be set, so one timer until the expiry would not do.
                () = tokio::time::sleep(EXPIRY_CHECK), if left_s.is_some() => {}
            }
        }
    }
}

impl Drop for Grant {
    fn drop(&mut self) {
        if self.claimed.refundable {
            self.store.give_back(self.claimed.digest);
        }
    }
}
