//! State shared by an engine, its thread and the server's other engines, and the sessions that they hand over.

use std::{
    sync::{
        Arc, Mutex, MutexGuard, OnceLock, PoisonError, Weak,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{SyncSender, TrySendError},
    },
    thread::Thread,
};

use gnomon_protocol::mask::MaskShape;
use tokio::sync::watch;

use super::{port::EnginePort, pulse::Pulse};
use crate::visibility::{
    TraceRequest,
    schedule::{
        capacity::Need,
        costs::{CostModel, SessionCosts},
    },
};

/// Most sessions waiting for the engine's thread to open them.
pub(super) const WAITING_SESSIONS: usize = 64;

#[derive(Debug, Default)]
pub(super) struct Shared {
    /// Tells the thread to end.
    pub(super) stop: AtomicBool,
    /// The device is lost and not yet reopened.
    pub(super) lost: AtomicBool,
    /// Number of times that the device was lost.
    pub(super) losses: AtomicU64,
    /// Expected cost of masks on this device.
    pub(super) model: CostModel,
    pub(super) pulse: Pulse,
    #[cfg(any(test, feature = "faults"))]
    pub(super) faults: super::faults::Faults,
    pub(super) peers: OnceLock<Vec<Peer>>,
    /// Open sessions, one for each [`SessionPermit`].
    sessions: Mutex<Vec<Arc<SessionCosts>>>,
    /// Why the thread has ended.
    pub(super) ended: watch::Sender<Option<String>>,
}

/// Another engine, which takes over sessions when this one's device is lost.
#[derive(Debug)]
pub(super) struct Peer {
    pub(super) shared: Weak<Shared>,
    pub(super) pending: SyncSender<PendingSession>,
    pub(super) thread: Thread,
}

/// A session on its way to an engine's thread: new, or handed over by an engine that lost its device.
#[derive(Debug)]
pub(super) struct PendingSession {
    /// The largest mask that the session may request.
    pub(super) shape: MaskShape,
    pub(super) port: EnginePort,
    pub(super) costs: Arc<SessionCosts>,
    pub(super) permit: SessionPermit,
    /// A request whose trace was lost with the device.
    pub(super) retry: Option<TraceRequest>,
}

/// A place among an engine's sessions, freed on drop.
#[derive(Debug)]
pub(super) struct SessionPermit {
    shared: Arc<Shared>,
    costs: Arc<SessionCosts>,
}

impl Shared {
    /// Records why the thread has ended. Keeps the first reason.
    pub(super) fn end(&self, reason: String) {
        self.ended.send_if_modified(|ended| {
            let is_first = ended.is_none();
            ended.get_or_insert(reason);
            is_first
        });
    }

    pub(super) fn end_reason(&self) -> Option<String> {
        self.ended.borrow().clone()
    }

    pub(super) fn sessions(&self) -> MutexGuard<'_, Vec<Arc<SessionCosts>>> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Device time that the sessions need, in milliseconds per second.
    pub(super) fn load_ms(&self) -> f64 {
        self.load_without_ms(None)
    }

    /// As [`Self::load_ms`], without the session with the costs `left_out`.
    pub(super) fn load_without_ms(&self, left_out: Option<&Arc<SessionCosts>>) -> f64 {
        self.sessions().iter().filter(|costs| counts(left_out, costs)).map(|costs| costs.need().per_second_ms()).sum()
    }

    /// Returns whether the device can trace now.
    pub(super) fn is_well(&self) -> bool {
        !self.lost.load(Ordering::Acquire) && self.ended.borrow().is_none() && !self.stop.load(Ordering::Acquire)
    }

    /// Hands a session to the least loaded engine that still has its device. Returns the session if none takes it.
    pub(super) fn hand_over(&self, mut session: PendingSession) -> Option<PendingSession> {
        let peers = self.peers.get().map(Vec::as_slice).unwrap_or_default();
        let well = |peer: &Peer| peer.shared.upgrade().filter(|shared| shared.is_well());
        let least = peers
            .iter()
            .filter_map(|peer| well(peer).map(|shared| (peer, shared.load_ms(), shared)))
            .min_by(|(_, a, _), (_, b, _)| a.total_cmp(b));
        let Some((peer, _, shared)) = least else { return Some(session) };
        // No admission test: a late session is better than a lost one.
        let ours = std::mem::replace(&mut session.permit, SessionPermit::add(&shared, Arc::clone(&session.costs)));
        let waker = session.port.waker.clone();
        match peer.pending.try_send(session) {
            Ok(()) => {
                drop(ours);
                waker.move_to(peer.thread.clone());
                None
            }
            Err(TrySendError::Full(mut session) | TrySendError::Disconnected(mut session)) => {
                session.permit = ours;
                Some(session)
            }
        }
    }
}

/// Returns whether a session counts beside one that is judged as if `replaced` were gone.
fn counts(replaced: Option<&Arc<SessionCosts>>, costs: &Arc<SessionCosts>) -> bool {
    !costs.has_left() && replaced.is_none_or(|replaced| !Arc::ptr_eq(replaced, costs))
}

impl SessionPermit {
    /// Adds a session if `fits` accepts it beside the needs of the other sessions, `replaced` not among them. Errors
    /// are those of `fits`.
    pub(super) fn acquire<E>(
        shared: &Arc<Shared>,
        costs: &Arc<SessionCosts>,
        replaced: Option<&Arc<SessionCosts>>,
        fits: impl FnOnce(&[Need]) -> Result<(), E>,
    ) -> Result<Self, E> {
        let mut sessions = shared.sessions();
        let needs: Vec<Need> =
            sessions.iter().filter(|costs| counts(replaced, costs)).map(|costs| costs.need()).collect();
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

impl Drop for SessionPermit {
    fn drop(&mut self) {
        let mut sessions = self.shared.sessions();
        if let Some(place) = sessions.iter().position(|costs| Arc::ptr_eq(costs, &self.costs)) {
            sessions.swap_remove(place);
        }
    }
}
