//! Who gets in: a fixed number of sessions, nobody once the server drains, and whoever comes back to a session takes its place over.

use std::{
    collections::HashMap,
    sync::{
        Arc, Mutex, PoisonError, Weak,
        atomic::{AtomicU64, Ordering},
    },
};

use gnomon_protocol::{
    ids::{ResumeToken, SessionId},
    message::Refusal,
};
use rustls::crypto::SecureRandom;
use tokio::sync::{Notify, OwnedSemaphorePermit, Semaphore};

use crate::limits::RETRY_AFTER;

/// The slots of a server.
#[derive(Debug)]
pub(crate) struct Admission {
    slots: Arc<Semaphore>,
    capacity: usize,
    next_id: AtomicU64,
    random: &'static dyn SecureRandom,
    sessions: Arc<Mutex<Sessions>>,
}

/// The admitted sessions, by the secret that each was given.
type Sessions = HashMap<ResumeToken, Entry>;

#[derive(Debug)]
struct Entry {
    place: Weak<Place>,
    superseded: Arc<Notify>,
}

/// One of the server's places. While a client moves from a lost connection to a new one, two sessions share it.
#[derive(Debug)]
struct Place {
    _permit: OwnedSemaphorePermit,
}

/// A session's place. Dropping it makes room for another.
#[derive(Debug)]
pub(crate) struct Slot {
    /// The session's name.
    pub(crate) id: SessionId,
    /// With it, the session's client may take the place over.
    pub(crate) resume: ResumeToken,
    superseded: Arc<Notify>,
    _place: Arc<Place>,
    sessions: Arc<Mutex<Sessions>>,
}

impl Admission {
    /// Slots for `capacity` sessions.
    pub(crate) fn new(capacity: usize) -> Self {
        Self {
            slots: Arc::new(Semaphore::new(capacity)),
            capacity,
            next_id: AtomicU64::new(1),
            random: rustls::crypto::ring::default_provider().secure_random,
            sessions: Arc::default(),
        }
    }

    /// Takes a slot: that of the session which `resume` names, which ends then, or else a free one.
    ///
    /// # Errors
    /// [`Refusal::Full`] without a free one, [`Refusal::Draining`] after [`Self::close`].
    pub(crate) fn admit(&self, resume: Option<ResumeToken>) -> Result<Slot, Refusal> {
        if self.slots.is_closed() {
            return Err(Refusal::Draining);
        }
        let place = match resume.and_then(|token| self.take_over(token)) {
            Some(place) => place,
            None => match Arc::clone(&self.slots).try_acquire_owned() {
                Ok(permit) => Arc::new(Place { _permit: permit }),
                Err(tokio::sync::TryAcquireError::Closed) => return Err(Refusal::Draining),
                Err(tokio::sync::TryAcquireError::NoPermits) => return Err(self.full()),
            },
        };
        let mut token = ResumeToken([0; 16]);
        // It does not fail on any system that TLS works on.
        self.random.fill(&mut token.0).map_err(|_| self.full())?;
        let superseded = Arc::new(Notify::new());
        let entry = Entry { place: Arc::downgrade(&place), superseded: Arc::clone(&superseded) };
        self.lock().insert(token, entry);
        Ok(Slot {
            id: SessionId(self.next_id.fetch_add(1, Ordering::Relaxed)),
            resume: token,
            superseded,
            _place: place,
            sessions: Arc::clone(&self.sessions),
        })
    }

    /// Whether a session has this secret.
    pub(crate) fn knows(&self, token: ResumeToken) -> bool {
        self.lock().contains_key(&token)
    }

    /// The place of the session with this secret, which is told to end.
    fn take_over(&self, token: ResumeToken) -> Option<Arc<Place>> {
        let entry = self.lock().remove(&token)?;
        entry.superseded.notify_one();
        entry.place.upgrade()
    }

    /// What a client hears for which there is no room.
    pub(crate) fn full(&self) -> Refusal {
        Refusal::Full {
            sessions: u32::try_from(self.capacity).unwrap_or(u32::MAX),
            retry_after_ms: u32::try_from(RETRY_AFTER.as_millis()).unwrap_or(u32::MAX),
        }
    }

    /// What a client hears that would disturb the others.
    pub(crate) fn busy(&self, reason: String) -> Refusal {
        Refusal::Busy { reason, retry_after_ms: u32::try_from(RETRY_AFTER.as_millis()).unwrap_or(u32::MAX) }
    }

    /// Admits nobody any more. Slots that are taken stay.
    pub(crate) fn close(&self) {
        self.slots.close();
    }

    /// Slots that are taken.
    pub(crate) fn taken(&self) -> usize {
        self.capacity - self.slots.available_permits()
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Sessions> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Slot {
    /// Waits until the client has come back and taken the place over.
    pub(crate) async fn superseded(&self) {
        self.superseded.notified().await;
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.resume);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slot_is_for_one_and_comes_back() {
        let admission = Admission::new(2);
        let (first, second) = (admission.admit(None).unwrap(), admission.admit(None).unwrap());
        assert_ne!(first.id, second.id);
        assert_eq!(admission.admit(None).unwrap_err(), Refusal::Full { sessions: 2, retry_after_ms: 5000 });
        assert_eq!(admission.taken(), 2);
        drop(first);
        assert_eq!(admission.taken(), 1);
        let third = admission.admit(None).unwrap();
        assert_ne!(third.id, second.id);
        admission.close();
        drop(third);
        assert_eq!(admission.admit(None).unwrap_err(), Refusal::Draining);
        assert_eq!(admission.taken(), 1, "a session that was admitted keeps its slot");
    }

    #[tokio::test]
    async fn whoever_comes_back_takes_its_own_place_over_once() {
        let admission = Admission::new(1);
        let lost = admission.admit(None).unwrap();
        let stranger = Some(ResumeToken([1; 16]));
        assert!(matches!(admission.admit(stranger), Err(Refusal::Full { .. })));
        let token = lost.resume;
        let back = admission.admit(Some(token)).unwrap();
        lost.superseded().await;
        assert!(back.resume != token && back.id != lost.id);
        assert_eq!(admission.taken(), 1);
        assert!(matches!(admission.admit(Some(token)), Err(Refusal::Full { .. })), "a secret is good for once");
        drop(lost);
        assert_eq!(admission.taken(), 1, "the place is the new session's");
        drop(back);
        assert_eq!(admission.taken(), 0);
        assert!(admission.lock().is_empty());
    }
}
