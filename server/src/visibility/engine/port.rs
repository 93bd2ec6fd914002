//! A session's end of the engine: newest pose in, masks out, and nothing ever waits on a device.
//!
//! Poses go through a `watch` channel, so that a new one replaces one that was not taken yet. Masks come through a
//! bounded channel in which the engine reserves a place before it starts a trace: while the session leaves its masks
//! unread nothing is traced for it, and the pose that waits stays the newest.

use std::{
    sync::{
        Arc, Mutex, PoisonError,
        mpsc::{SyncSender, TrySendError, sync_channel},
    },
    thread::Thread,
};

use gnomon_protocol::mask::Mask;
use tokio::sync::{mpsc, watch};

use crate::visibility::{TraceRequest, TracedMask, schedule::costs::SessionCosts};

/// Masks of one session that are being traced or wait to be read. Two: one is encoded while the next is traced.
pub const OUTSTANDING_MASKS: usize = 2;

/// Both ends that a session holds. Dropping either closes the session in the engine.
#[derive(Debug)]
pub struct SessionPort {
    /// Poses to trace, and memory to give back.
    pub requests: RequestSender,
    /// Traced masks.
    pub masks: MaskReceiver,
    /// What they have cost.
    pub costs: Arc<SessionCosts>,
}

/// Where a session hands over its newest pose.
#[derive(Debug)]
pub struct RequestSender {
    newest: watch::Sender<Option<TraceRequest>>,
    used: SyncSender<Mask>,
    waker: EngineWaker,
}

/// Where a session's masks arrive.
#[derive(Debug)]
pub struct MaskReceiver {
    masks: mpsc::Receiver<TracedMask>,
    waker: EngineWaker,
}

/// Wakes the thread of the engine that a session is with, when it is parked; costs next to nothing when it is not.
#[derive(Debug, Clone)]
pub(super) struct EngineWaker(Arc<Mutex<Thread>>);

/// The engine's ends of one [`SessionPort`].
#[derive(Debug)]
pub(super) struct EnginePort {
    pub(super) newest: watch::Receiver<Option<TraceRequest>>,
    pub(super) masks: mpsc::Sender<TracedMask>,
    pub(super) used: std::sync::mpsc::Receiver<Mask>,
    /// The session's own.
    pub(super) waker: EngineWaker,
}

impl EngineWaker {
    pub(super) fn new(thread: Thread) -> Self {
        Self(Arc::new(Mutex::new(thread)))
    }

    pub(super) fn wake(&self) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).unpark();
    }

    /// The session is with the engine of that thread now.
    pub(super) fn move_to(&self, thread: Thread) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = thread;
        self.wake();
    }
}

/// The two halves of a new session.
pub(super) fn session_port(thread: Thread, costs: Arc<SessionCosts>) -> (SessionPort, EnginePort) {
    let waker = EngineWaker::new(thread);
    let (newest, newest_end) = watch::channel(None);
    let (masks_end, masks) = mpsc::channel(OUTSTANDING_MASKS);
    // One more than can be outstanding: a session may hold its last mask while it gives older ones back.
    let (used, used_end) = sync_channel(OUTSTANDING_MASKS + 1);
    (
        SessionPort {
            requests: RequestSender { newest, used, waker: waker.clone() },
            masks: MaskReceiver { masks, waker: waker.clone() },
            costs,
        },
        EnginePort { newest: newest_end, masks: masks_end, used: used_end, waker },
    )
}

impl SessionPort {
    /// As [`RequestSender::request`].
    pub fn request(&self, request: TraceRequest) {
        self.requests.request(request);
    }

    /// As [`RequestSender::recycle`].
    pub fn recycle(&self, mask: Mask) {
        self.requests.recycle(mask);
    }
}

impl RequestSender {
    /// Asks for a mask. It replaces an earlier request that the engine has not taken up. The picture must be no larger than
    /// the session was opened for; a larger one is logged and dropped.
    pub fn request(&self, request: TraceRequest) {
        self.newest.send_replace(Some(request));
        self.waker.wake();
    }

    /// Gives a mask's memory back for a later one.
    pub fn recycle(&self, mask: Mask) {
        match self.used.try_send(mask) {
            // Full or gone: the memory is simply freed.
            Ok(()) | Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => {}
        }
    }
}

impl MaskReceiver {
    /// The next mask, or `None` when the engine has stopped. Cancel safe.
    pub async fn recv(&mut self) -> Option<TracedMask> {
        let mask = self.masks.recv().await;
        self.waker.wake();
        mask
    }

    /// The next mask if there is one already.
    ///
    /// # Errors
    /// When there is none yet, or never again because the engine has stopped.
    pub fn try_recv(&mut self) -> Result<TracedMask, mpsc::error::TryRecvError> {
        let mask = self.masks.try_recv();
        self.waker.wake();
        mask
    }

    /// Masks that wait to be read.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.masks.len()
    }

    /// As [`Self::recv`], for threads outside an async runtime.
    ///
    /// # Panics
    /// When it is called inside one.
    pub fn blocking_recv(&mut self) -> Option<TracedMask> {
        let mask = self.masks.blocking_recv();
        self.waker.wake();
        mask
    }
}

impl Drop for RequestSender {
    fn drop(&mut self) {
        // Fields are dropped after this function: the channel must be closed before the engine wakes and looks.
        let (other, _) = watch::channel(None);
        drop(std::mem::replace(&mut self.newest, other));
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
    /// Whether the session has dropped one of its ends.
    pub(super) fn is_closed(&self) -> bool {
        self.masks.is_closed() || self.newest.has_changed().is_err()
    }
}
