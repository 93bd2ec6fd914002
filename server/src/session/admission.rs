//! Who gets in: a fixed number of sessions, and nobody once the server drains.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use gnomon_protocol::{ids::SessionId, message::Refusal};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::limits::RETRY_AFTER;

/// The slots of a server.
#[derive(Debug)]
pub(crate) struct Admission {
    slots: Arc<Semaphore>,
    capacity: usize,
    next_id: AtomicU64,
}

/// A session's place. Dropping it makes room for another.
#[derive(Debug)]
pub(crate) struct Slot {
    /// The session's name.
    pub(crate) id: SessionId,
    _permit: OwnedSemaphorePermit,
}

impl Admission {
    /// Slots for `capacity` sessions.
    pub(crate) fn new(capacity: usize) -> Self {
        Self { slots: Arc::new(Semaphore::new(capacity)), capacity, next_id: AtomicU64::new(1) }
    }

    /// Takes a slot.
    ///
    /// # Errors
    /// [`Refusal::Full`] without a free one, [`Refusal::Draining`] after [`Self::close`].
    pub(crate) fn admit(&self) -> Result<Slot, Refusal> {
        match Arc::clone(&self.slots).try_acquire_owned() {
            Ok(permit) => Ok(Slot { id: SessionId(self.next_id.fetch_add(1, Ordering::Relaxed)), _permit: permit }),
            Err(tokio::sync::TryAcquireError::Closed) => Err(Refusal::Draining),
            Err(tokio::sync::TryAcquireError::NoPermits) => Err(self.full()),
        }
    }

    /// What a client hears for which there is no room.
    pub(crate) fn full(&self) -> Refusal {
        Refusal::Full {
            sessions: u32::try_from(self.capacity).unwrap_or(u32::MAX),
            retry_after_ms: u32::try_from(RETRY_AFTER.as_millis()).unwrap_or(u32::MAX),
        }
    }

    /// Admits nobody any more. Slots that are taken stay.
    pub(crate) fn close(&self) {
        self.slots.close();
    }

    /// Slots that are taken.
    pub(crate) fn taken(&self) -> usize {
        self.capacity - self.slots.available_permits()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slot_is_for_one_and_comes_back() {
        let admission = Admission::new(2);
        let (first, second) = (admission.admit().unwrap(), admission.admit().unwrap());
        assert_ne!(first.id, second.id);
        assert_eq!(admission.admit().unwrap_err(), Refusal::Full { sessions: 2, retry_after_ms: 5000 });
        assert_eq!(admission.taken(), 2);
        drop(first);
        assert_eq!(admission.taken(), 1);
        let third = admission.admit().unwrap();
        assert_ne!(third.id, second.id);
        admission.close();
        drop(third);
        assert_eq!(admission.admit().unwrap_err(), Refusal::Draining);
        assert_eq!(admission.taken(), 1, "a session that was admitted keeps its slot");
    }
}
