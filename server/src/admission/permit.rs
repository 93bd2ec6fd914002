//! Session permits: a fixed number, and none while draining. A client that resumes a session takes over its permit.
//!
//! Resuming has three steps, so that nothing is decided twice. [`SessionPermits::claim`] reserves the session for one
//! client; everybody else who names it is a new client meanwhile. Admission then judges the claimant as if the old
//! session were gone ([`Holding`]). [`SessionPermit::take_over`] ends the old session at last. A claim that is dropped
//! before leaves the old session as it was.

use std::{
    collections::{HashMap, VecDeque},
    sync::{
        Arc, Weak,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use gnomon_protocol::{
    ids::{ResumeToken, SessionId},
    message::Refusal,
};
use parking_lot::Mutex;
use rustls::crypto::SecureRandom;
use tokio::sync::watch;

use super::{addresses::AddressPermit, capacity::Share, end_reason::EndReason, tokens::file::Digest};
use crate::{
    limits::{DISMISSED_FOR, MAX_DISMISSED, RETRY_AFTER},
    visibility::schedule::costs::SessionCosts,
};

/// What a session was granted. A client that resumes it is judged without it.
#[derive(Debug)]
pub(crate) struct Holding {
    /// SHA-256 of the token that admitted it; `None` on a server without tokens.
    pub(crate) token: Option<Digest>,
    pub(crate) address: Arc<AddressPermit>,
    /// Its need of device time.
    pub(crate) costs: Arc<SessionCosts>,
    /// Its need of cores, network and memory.
    pub(crate) share: Arc<Share>,
}

#[derive(Debug)]
pub(crate) struct SessionPermits {
    capacity: usize,
    next_id: AtomicU64,
    random: &'static dyn SecureRandom,
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    draining: bool,
    places_taken: usize,
    /// Admitted sessions by resume token.
    sessions: HashMap<ResumeToken, Entry>,
    /// Resume tokens of sessions that an operator ended, oldest first.
    dismissed: VecDeque<(ResumeToken, Instant)>,
}

#[derive(Debug)]
struct Entry {
    id: SessionId,
    place: Weak<Place>,
    holding: Arc<Holding>,
    /// A client is about to resume it.
    claimed: bool,
    ended: watch::Sender<Option<EndReason>>,
}

/// Two sessions share one while a client moves from a lost connection to a new one.
#[derive(Debug)]
pub(crate) struct Place {
    state: Arc<Mutex<State>>,
}

/// The right to resume a session. One client has it at a time.
#[derive(Debug)]
pub(crate) struct ResumeClaim {
    pub(crate) holding: Arc<Holding>,
    token: ResumeToken,
    place: Arc<Place>,
    state: Arc<Mutex<State>>,
}

/// Lets one session run. Dropping it makes room for another.
#[derive(Debug)]
pub(crate) struct SessionPermit {
    pub(crate) id: SessionId,
    /// Secret that lets the client resume the session.
    pub(crate) resume: ResumeToken,
    ended: watch::Receiver<Option<EndReason>>,
    /// The session that it is to replace.
    replaces: Option<ResumeClaim>,
    _holding: Arc<Holding>,
    _place: Arc<Place>,
    state: Arc<Mutex<State>>,
}

impl SessionPermits {
    pub(crate) fn new(capacity: usize) -> Self {
        Self {
            capacity,
            next_id: AtomicU64::new(1),
            random: rustls::crypto::ring::default_provider().secure_random,
            state: Arc::default(),
        }
    }

    /// Claims the session that `resume` names, if it was admitted with the same token and nobody else claims it.
    /// Errors if an operator has ended it.
    pub(crate) fn claim(
        &self,
        resume: Option<ResumeToken>,
        token: Option<Digest>,
    ) -> Result<Option<ResumeClaim>, Refusal> {
        let Some(resume) = resume else { return Ok(None) };
        let mut state = self.state.lock();
        if let Some(left) = state.dismissed_for(resume, Instant::now()) {
            let retry_after_ms = u32::try_from(left.as_millis()).unwrap_or(u32::MAX);
            return Err(Refusal::Busy { reason: EndReason::Operator.to_string().into(), retry_after_ms });
        }
        let Some(entry) = state.sessions.get_mut(&resume) else { return Ok(None) };
        if entry.claimed || entry.holding.token != token {
            return Ok(None);
        }
        let Some(place) = entry.place.upgrade() else { return Ok(None) };
        entry.claimed = true;
        let holding = Arc::clone(&entry.holding);
        drop(state);
        Ok(Some(ResumeClaim { holding, token: resume, place, state: Arc::clone(&self.state) }))
    }

    /// Returns the place of the claimed session, or takes a free one. Errors: [`Refusal::Full`] if none is free,
    /// [`Refusal::Draining`] after [`Self::close`].
    pub(crate) fn place(&self, claim: Option<&ResumeClaim>) -> Result<Arc<Place>, Refusal> {
        let mut state = self.state.lock();
        if state.draining {
            return Err(Refusal::Draining);
        }
        if let Some(claim) = claim {
            return Ok(Arc::clone(&claim.place));
        }
        if state.places_taken >= self.capacity {
            return Err(self.full());
        }
        state.places_taken += 1;
        Ok(Arc::new(Place { state: Arc::clone(&self.state) }))
    }

    /// Registers a session with all that it was granted. The session of `replaces` lives on until
    /// [`SessionPermit::take_over`]. Errors if the system has no random numbers.
    pub(crate) fn register(
        &self,
        place: Arc<Place>,
        holding: Holding,
        replaces: Option<ResumeClaim>,
    ) -> Result<SessionPermit, Refusal> {
        let mut resume = ResumeToken([0; 16]);
        // Does not fail where TLS works.
        self.random.fill(&mut resume.0).map_err(|_| self.full())?;
        let id = SessionId(self.next_id.fetch_add(1, Ordering::Relaxed));
        let (sender, ended) = watch::channel(None);
        let holding = Arc::new(holding);
        let entry =
            Entry { id, place: Arc::downgrade(&place), holding: Arc::clone(&holding), claimed: false, ended: sender };
        self.state.lock().sessions.insert(resume, entry);
        let state = Arc::clone(&self.state);
        Ok(SessionPermit { id, resume, ended, replaces, _holding: holding, _place: place, state })
    }

    /// Ends a session and tells its client the reason. Returns whether there was one with this id.
    pub(crate) fn end(&self, id: SessionId, reason: EndReason) -> bool {
        let mut state = self.state.lock();
        let Some(token) = state.sessions.iter().find(|(_, entry)| entry.id == id).map(|(token, _)| *token) else {
            return false;
        };
        let entry = state.sessions.remove(&token);
        if reason == EndReason::Operator {
            state.dismiss(token, Instant::now());
        }
        drop(state);
        if let Some(entry) = entry {
            entry.ended.send_replace(Some(reason));
        }
        true
    }

    pub(crate) fn full(&self) -> Refusal {
        Refusal::Full {
            sessions: u32::try_from(self.capacity).unwrap_or(u32::MAX),
            retry_after_ms: u32::try_from(RETRY_AFTER.as_millis()).unwrap_or(u32::MAX),
        }
    }

    /// Makes a refusal for a client whose load would disturb the others.
    pub(crate) fn busy(&self, reason: String) -> Refusal {
        let retry_after_ms = u32::try_from(RETRY_AFTER.as_millis()).unwrap_or(u32::MAX);
        Refusal::Busy { reason: reason.into(), retry_after_ms }
    }

    /// Refuses every client from now on. Permits in use stay valid.
    pub(crate) fn close(&self) {
        self.state.lock().draining = true;
    }

    pub(crate) fn in_use(&self) -> usize {
        self.state.lock().places_taken
    }
}

impl State {
    fn dismiss(&mut self, token: ResumeToken, now: Instant) {
        self.dismissed.push_back((token, now));
        while self.dismissed.len() > MAX_DISMISSED {
            self.dismissed.pop_front();
        }
    }

    /// How long the client of an ended session is still asked to stay away.
    fn dismissed_for(&mut self, token: ResumeToken, now: Instant) -> Option<Duration> {
        let left = |at: Instant| DISMISSED_FOR.checked_sub(now.saturating_duration_since(at));
        while self.dismissed.front().is_some_and(|(_, at)| left(*at).is_none()) {
            self.dismissed.pop_front();
        }
        self.dismissed.iter().find(|(other, _)| *other == token).and_then(|(_, at)| left(*at))
    }
}

impl SessionPermit {
    /// Ends the session that this one replaces, if any. Call it when nothing can refuse this one any more.
    pub(crate) fn take_over(&mut self) {
        let Some(claim) = self.replaces.take() else { return };
        let mut state = self.state.lock();
        let old = state.sessions.remove(&claim.token);
        // If an operator ended the old session meanwhile, that holds for the new one.
        let dismissed = old.is_none() && state.dismissed_for(claim.token, Instant::now()).is_some();
        let ours = if dismissed { state.sessions.remove(&self.resume) } else { None };
        if dismissed {
            state.dismiss(self.resume, Instant::now());
        }
        drop(state);
        for (entry, reason) in [(old, EndReason::Superseded), (ours, EndReason::Operator)] {
            if let Some(entry) = entry {
                entry.ended.send_replace(Some(reason));
            }
        }
    }

    /// Waits until the session is ended from outside.
    pub(crate) async fn ended(&mut self) -> EndReason {
        // The sender is dropped without a reason only when `self` is.
        let reason = self.ended.wait_for(Option::is_some).await.ok().and_then(|reason| *reason);
        match reason {
            Some(reason) => reason,
            None => std::future::pending().await,
        }
    }
}

impl Drop for SessionPermit {
    fn drop(&mut self) {
        let entry = self.state.lock().sessions.remove(&self.resume);
        drop(entry);
    }
}

impl Drop for ResumeClaim {
    fn drop(&mut self) {
        if let Some(entry) = self.state.lock().sessions.get_mut(&self.token) {
            entry.claimed = false;
        }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.state.lock().places_taken -= 1;
    }
}

#[cfg(test)]
mod tests;
