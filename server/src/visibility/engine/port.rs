//! A session's port to the engine: poses in, masks out. No call waits for the device.
//!
//! Poses go through a `watch` channel, so a new pose replaces one that the engine has not taken. Masks come through a
//! bounded channel, in which the engine reserves a place before it starts a trace. While a session does not read its
//! masks, the engine traces nothing for it and keeps its newest pose.

use std::{
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        mpsc::{SyncSender, TrySendError, sync_channel},
    },
    thread::Thread,
};

use gnomon_protocol::mask::Mask;
use tokio::sync::{mpsc, watch};

use crate::visibility::{TraceRequest, TracedMask, schedule::costs::SessionCosts};

/// Masks of one session that are being traced or unread. Two: one is encoded while the next is traced.
pub const OUTSTANDING_MASKS: usize = 2;

/// The session's channel ends. Dropping either closes the session in the engine.
#[derive(Debug)]
pub struct SessionPort {
    pub requests: RequestSender,
    pub masks: MaskReceiver,
    pub costs: Arc<SessionCosts>,
}

/// Sends a session's newest pose, and the memory of masks that it has read.
#[derive(Debug)]
pub struct RequestSender {
    newest: watch::Sender<Option<TraceRequest>>,
    used: SyncSender<Mask>,
    waker: EngineWaker,
    costs: Arc<SessionCosts>,
}

/// Receives a session's traced masks.
#[derive(Debug)]
pub struct MaskReceiver {
    masks: mpsc::Receiver<TracedMask>,
    waker: EngineWaker,
}

/// Wakes the engine's thread if it is parked. Costs next to nothing if it is not.
#[derive(Debug, Clone)]
pub(super) struct EngineWaker(Arc<Mutex<Thread>>);

/// The engine's ends of a [`SessionPort`]'s channels.
#[derive(Debug)]
pub(super) struct EnginePort {
    pub(super) newest: watch::Receiver<Option<TraceRequest>>,
    pub(super) masks: mpsc::Sender<TracedMask>,
    pub(super) used: std::sync::mpsc::Receiver<Mask>,
    pub(super) waker: EngineWaker,
}

impl EngineWaker {
    pub(super) fn new(thread: Thread) -> Self {
        Self(Arc::new(Mutex::new(thread)))
    }

    pub(super) fn wake(&self) {
        self.thread().unpark();
    }

    /// Wakes this thread, of another engine, from now on.
    pub(super) fn move_to(&self, thread: Thread) {
        *self.thread() = thread;
        self.wake();
    }

    fn thread(&self) -> MutexGuard<'_, Thread> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Both sides of a new session.
pub(super) fn session_port(thread: Thread, costs: Arc<SessionCosts>) -> (SessionPort, EnginePort) {
    let waker = EngineWaker::new(thread);
    let (newest, newest_end) = watch::channel(None);
    let (masks_end, masks) = mpsc::channel(OUTSTANDING_MASKS);
    // One more than can be outstanding: a session may hold its last mask while it returns older ones.
    let (used, used_end) = sync_channel(OUTSTANDING_MASKS + 1);
    (
        SessionPort {
            requests: RequestSender { newest, used, waker: waker.clone(), costs: Arc::clone(&costs) },
            masks: MaskReceiver { masks, waker: waker.clone() },
            costs,
        },
        EnginePort { newest: newest_end, masks: masks_end, used: used_end, waker },
    )
}

impl SessionPort {
    pub fn request(&self, request: TraceRequest) {
        self.requests.request(request);
    }

    pub fn recycle(&self, mask: Mask) {
        self.requests.recycle(mask);
    }
}

impl RequestSender {
    /// Requests a mask. Replaces an earlier request that the engine has not taken. A view larger than the session was
    /// opened for is logged and dropped.
    pub fn request(&self, request: TraceRequest) {
        self.newest.send_replace(Some(request));
        self.waker.wake();
    }

    /// Returns a mask's memory for a later mask.
    pub fn recycle(&self, mask: Mask) {
        match self.used.try_send(mask) {
            // If the channel is full or closed, the memory is freed.
            Ok(()) | Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => {}
        }
    }
}

impl MaskReceiver {
    /// Waits for the next mask. `None` when the engine has stopped. Cancel safe.
    pub async fn recv(&mut self) -> Option<TracedMask> {
        let mask = self.masks.recv().await;
        self.waker.wake();
        mask
    }

    /// Returns the next mask without waiting.
    ///
    /// # Errors
    /// If there is none yet, or the engine has stopped.
    pub fn try_recv(&mut self) -> Result<TracedMask, mpsc::error::TryRecvError> {
        let mask = self.masks.try_recv();
        self.waker.wake();
        mask
    }

    /// Number of unread masks.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.masks.len()
    }

    /// As [`Self::recv`], for threads outside an async runtime.
    ///
    /// # Panics
    /// If called inside an async runtime.
    pub fn blocking_recv(&mut self) -> Option<TracedMask> {
        let mask = self.masks.blocking_recv();
        self.waker.wake();
        mask
    }
}

impl Drop for RequestSender {
    fn drop(&mut self) {
        // Fields are dropped after this function, but the channel must close before the engine wakes.
        let (other, _) = watch::channel(None);
        drop(std::mem::replace(&mut self.newest, other));
        self.costs.leave();
        self.waker.wake();
    }
}

impl Drop for MaskReceiver {
    fn drop(&mut self) {
        self.masks.close();
        self.waker.wake();
    }
}

impl EnginePort {
    /// Returns whether the session has dropped one of its ends.
    pub(super) fn is_closed(&self) -> bool {
        self.masks.is_closed() || self.newest.has_changed().is_err()
    }
}
