//! Session permits: a fixed number, and none while draining. A client that resumes a session takes over its permit.

use std::{
    collections::HashMap,
    sync::{
        Arc, Weak,
        atomic::{AtomicU64, Ordering},
    },
};

use gnomon_protocol::{
    ids::{ResumeToken, SessionId},
    message::Refusal,
};
use parking_lot::Mutex;
use rustls::crypto::SecureRandom;
use tokio::sync::{Notify, OwnedSemaphorePermit, Semaphore};

use crate::limits::RETRY_AFTER;

#[derive(Debug)]
pub(crate) struct SessionPermits {
    free: Arc<Semaphore>,
    capacity: usize,
    next_id: AtomicU64,
    random: &'static dyn SecureRandom,
    sessions: Arc<Mutex<Sessions>>,
}

/// Admitted sessions by resume token.
type Sessions = HashMap<ResumeToken, Entry>;

#[derive(Debug)]
struct Entry {
    place: Weak<Place>,
    superseded: Arc<Notify>,
}

/// Two sessions share one while a client moves from a lost connection to a new one.
#[derive(Debug)]
struct Place {
    _permit: OwnedSemaphorePermit,
}

/// Lets one session run. Dropping it makes room for another.
#[derive(Debug)]
pub(crate) struct SessionPermit {
    pub(crate) id: SessionId,
    /// Secret that lets the client resume the session.
    pub(crate) resume: ResumeToken,
    superseded: Arc<Notify>,
    _place: Arc<Place>,
    sessions: Arc<Mutex<Sessions>>,
}

impl SessionPermits {
    pub(crate) fn new(capacity: usize) -> Self {
        Self {
            free: Arc::new(Semaphore::new(capacity)),
            capacity,
            next_id: AtomicU64::new(1),
            random: rustls::crypto::ring::default_provider().secure_random,
            sessions: Arc::default(),
        }
    }

    /// Takes over the permit of the session that `resume` names, which then ends, or takes a free one. Errors:
    /// [`Refusal::Full`] if none is free, [`Refusal::Draining`] after [`Self::close`].
    pub(crate) fn acquire(&self, resume: Option<ResumeToken>) -> Result<SessionPermit, Refusal> {
        if self.free.is_closed() {
            return Err(Refusal::Draining);
        }
        let place = match resume.and_then(|token| self.take_over(token)) {
            Some(place) => place,
            None => match Arc::clone(&self.free).try_acquire_owned() {
                Ok(permit) => Arc::new(Place { _permit: permit }),
                Err(tokio::sync::TryAcquireError::Closed) => return Err(Refusal::Draining),
                Err(tokio::sync::TryAcquireError::NoPermits) => return Err(self.full()),
            },
        };
        let mut token = ResumeToken([0; 16]);
        // Does not fail where TLS works.
        self.random.fill(&mut token.0).map_err(|_| self.full())?;
        let superseded = Arc::new(Notify::new());
        let entry = Entry { place: Arc::downgrade(&place), superseded: Arc::clone(&superseded) };
        self.sessions.lock().insert(token, entry);
        Ok(SessionPermit {
            id: SessionId(self.next_id.fetch_add(1, Ordering::Relaxed)),
            resume: token,
            superseded,
            _place: place,
            sessions: Arc::clone(&self.sessions),
        })
    }

    /// Returns whether a session has this resume token.
    pub(crate) fn contains(&self, token: ResumeToken) -> bool {
        self.sessions.lock().contains_key(&token)
    }

    /// Ends the session with this resume token and returns its place.
    fn take_over(&self, token: ResumeToken) -> Option<Arc<Place>> {
        let entry = self.sessions.lock().remove(&token)?;
        entry.superseded.notify_one();
        entry.place.upgrade()
    }

    pub(crate) fn full(&self) -> Refusal {
        Refusal::Full {
            sessions: u32::try_from(self.capacity).unwrap_or(u32::MAX),
            retry_after_ms: u32::try_from(RETRY_AFTER.as_millis()).unwrap_or(u32::MAX),
        }
    }

    /// Makes a refusal for a client whose load would disturb the others.
    pub(crate) fn busy(&self, reason: String) -> Refusal {
        Refusal::Busy { reason, retry_after_ms: u32::try_from(RETRY_AFTER.as_millis()).unwrap_or(u32::MAX) }
    }

    /// Refuses every client from now on. Permits in use stay valid.
    pub(crate) fn close(&self) {
        self.free.close();
    }

    pub(crate) fn in_use(&self) -> usize {
        self.capacity - self.free.available_permits()
    }
}

impl SessionPermit {
    /// Waits until the client resumes this session on another connection.
    pub(crate) async fn superseded(&self) {
        self.superseded.notified().await;
    }
}

impl Drop for SessionPermit {
    fn drop(&mut self) {
        self.sessions.lock().remove(&self.resume);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dropped_permit_is_free_again() {
        let permits = SessionPermits::new(2);
        let (first, second) = (permits.acquire(None).unwrap(), permits.acquire(None).unwrap());
        assert_ne!(first.id, second.id);
        assert_eq!(permits.acquire(None).unwrap_err(), Refusal::Full { sessions: 2, retry_after_ms: 5000 });
        assert_eq!(permits.in_use(), 2);
        drop(first);
        assert_eq!(permits.in_use(), 1);
        let third = permits.acquire(None).unwrap();
        assert_ne!(third.id, second.id);
        permits.close();
        drop(third);
        assert_eq!(permits.acquire(None).unwrap_err(), Refusal::Draining);
        assert_eq!(permits.in_use(), 1, "an admitted session keeps its permit");
    }

    #[tokio::test]
    async fn a_resume_token_takes_its_session_over_once() {
        let permits = SessionPermits::new(1);
        let lost = permits.acquire(None).unwrap();
        let stranger = Some(ResumeToken([1; 16]));
        assert!(matches!(permits.acquire(stranger), Err(Refusal::Full { .. })));
        let token = lost.resume;
        let back = permits.acquire(Some(token)).unwrap();
        lost.superseded().await;
        assert!(back.resume != token && back.id != lost.id);
        assert_eq!(permits.in_use(), 1);
        assert!(matches!(permits.acquire(Some(token)), Err(Refusal::Full { .. })), "a resume token works once");
        drop(lost);
        assert_eq!(permits.in_use(), 1, "the permit is the new session's");
        drop(back);
        assert_eq!(permits.in_use(), 0);
        assert!(permits.sessions.lock().is_empty());
    }
}
