//! What an engine, its thread and the other engines of a server all know of it.

use std::{
    sync::{
        Arc, Mutex, MutexGuard, OnceLock, PoisonError, Weak,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{SyncSender, TrySendError},
    },
    thread::Thread,
};

use tokio::sync::watch;

use super::worker::Opening;
use crate::visibility::schedule::{
    capacity::Need,
    costs::{CostModel, SessionCosts},
};

/// See the fields.
#[derive(Debug, Default)]
pub(super) struct Shared {
    /// The thread shall end.
    pub(super) stop: AtomicBool,
    /// The device is lost, and not back yet.
    pub(super) lost: AtomicBool,
    /// How often it was lost.
    pub(super) losses: AtomicU64,
    /// What masks cost here.
    pub(super) model: CostModel,
    #[cfg(any(test, feature = "faults"))]
    pub(super) faults: super::faults::Faults,
    /// The other engines.
    pub(super) peers: OnceLock<Vec<Peer>>,
    /// Open sessions: one entry for each seat.
    sessions: Mutex<Vec<Arc<SessionCosts>>>,
    /// Why the thread has ended.
    pub(super) ended: watch::Sender<Option<String>>,
}

/// Another engine, which takes sessions over when this one's device is lost.
#[derive(Debug)]
pub(super) struct Peer {
    pub(super) shared: Weak<Shared>,
    pub(super) openings: SyncSender<Opening>,
    pub(super) thread: Thread,
}

/// A place among an engine's sessions, free again when it is dropped.
#[derive(Debug)]
pub(super) struct Seat {
    shared: Arc<Shared>,
    costs: Arc<SessionCosts>,
}

impl Shared {
    pub(super) fn end(&self, reason: String) {
        // The first reason stays.
        self.ended.send_if_modified(|ended| {
            let is_first = ended.is_none();
            ended.get_or_insert(reason);
            is_first
        });
    }

    pub(super) fn end_reason(&self) -> Option<String> {
        self.ended.borrow().clone()
    }

    /// Open sessions.
    pub(super) fn sessions(&self) -> MutexGuard<'_, Vec<Arc<SessionCosts>>> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What its sessions need in a second, in milliseconds of the device.
    pub(super) fn load_ms(&self) -> f64 {
        self.sessions().iter().map(|costs| costs.need().per_second_ms()).sum()
    }

    /// Whether its device can trace now.
    pub(super) fn is_well(&self) -> bool {
        !self.lost.load(Ordering::Acquire) && self.ended.borrow().is_none() && !self.stop.load(Ordering::Acquire)
    }

    /// Gives a session to the least loaded of the other engines whose devices are well; back comes one that none takes.
    pub(super) fn hand_over(&self, mut opening: Opening) -> Option<Opening> {
        let peers = self.peers.get().map(Vec::as_slice).unwrap_or_default();
        let well = |peer: &Peer| peer.shared.upgrade().filter(|shared| shared.is_well());
        let least = peers
            .iter()
            .filter_map(|peer| well(peer).map(|shared| (peer, shared.load_ms(), shared)))
            .min_by(|(_, a, _), (_, b, _)| a.total_cmp(b));
        let Some((peer, _, shared)) = least else { return Some(opening) };
        // It has served the session's rate on a like device, so it is not asked whether it bears it: late is better than lost.
        let ours = std::mem::replace(&mut opening.seat, Seat::add(&shared, Arc::clone(&opening.costs)));
        let waker = opening.port.waker.clone();
        match peer.openings.try_send(opening) {
            Ok(()) => {
                drop(ours);
                waker.move_to(peer.thread.clone());
                None
            }
            Err(TrySendError::Full(mut opening) | TrySendError::Disconnected(mut opening)) => {
                opening.seat = ours;
                Some(opening)
            }
        }
    }
}

impl Seat {
    /// A seat, if `fits` agrees with what the other sessions need.
    ///
    /// # Errors
    /// Those of `fits`.
    pub(super) fn take<E>(
        shared: &Arc<Shared>,
        costs: &Arc<SessionCosts>,
        fits: impl FnOnce(&[Need]) -> Result<(), E>,
    ) -> Result<Self, E> {
        let mut sessions = shared.sessions();
        let needs: Vec<Need> = sessions.iter().map(|costs| costs.need()).collect();
        fits(&needs)?;
        sessions.push(Arc::clone(costs));
        drop(sessions);
        Ok(Self { shared: Arc::clone(shared), costs: Arc::clone(costs) })
    }

    fn add(shared: &Arc<Shared>, costs: Arc<SessionCosts>) -> Self {
        shared.sessions().push(Arc::clone(&costs));
        Self { shared: Arc::clone(shared), costs }
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        let mut sessions = self.shared.sessions();
        if let Some(place) = sessions.iter().position(|costs| Arc::ptr_eq(costs, &self.costs)) {
            sessions.swap_remove(place);
        }
    }
}
