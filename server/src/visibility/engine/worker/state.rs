//! State of the engine's thread between rounds.

use std::{
    collections::HashMap,
    sync::{Arc, mpsc::Receiver},
};

use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::camera::Camera;

use super::session::{ActiveSession, SplitThreshold};
use crate::visibility::{
    backend::BackendError,
    engine::{
        port::OUTSTANDING_MASKS,
        shared::{PendingSession, Shared},
        tracer::Tracer,
    },
    schedule::scheduler::{Scheduler, SessionKey},
};

/// Reopens a lost tracer.
pub(super) type Reopen = Box<dyn FnMut() -> Result<Tracer, BackendError> + Send>;

pub(in super::super) struct Worker {
    pub(super) tracer: Tracer,
    pub(super) open_again: Reopen,
    pub(super) pending: Receiver<PendingSession>,
    pub(super) shared: Arc<Shared>,
    pub(super) sessions: HashMap<SessionKey, ActiveSession>,
    next_key: SessionKey,
    pub(super) scheduler: Scheduler,
    pub(super) split_threshold: SplitThreshold,
    /// Device losses since the last traced mask.
    pub(super) losses_in_a_row: u32,
}

impl Worker {
    pub(in super::super) fn new(
        tracer: Tracer,
        reopen: Reopen,
        pending: Receiver<PendingSession>,
        shared: Arc<Shared>,
    ) -> Self {
        Self {
            tracer,
            open_again: reopen,
            pending,
            shared,
            sessions: HashMap::new(),
            next_key: 0,
            scheduler: Scheduler::new(OUTSTANDING_MASKS),
            split_threshold: SplitThreshold::default(),
            losses_in_a_row: 0,
        }
    }

    /// Traces two masks without a session, to warm up the device and learn their cost. Errors if the device fails.
    pub(in super::super) fn warm_up(&mut self, camera: &Camera, shape: MaskShape) -> Result<(), BackendError> {
        let mut mask = Mask::new(shape);
        for _ in 0..2 {
            if let Some(cost) = self.tracer.trace(camera, &mut mask)? {
                self.shared.model.learn(shape.pixels(), &cost);
            }
        }
        self.shrink_buffers()
    }

    pub(super) fn insert(&mut self, session: PendingSession) -> SessionKey {
        self.scheduler.insert(self.next_key, session.costs.expected_ms());
        self.sessions.insert(self.next_key, ActiveSession::new(session));
        self.split_threshold.forget();
        self.next_key += 1;
        self.next_key - 1
    }

    /// Removes a session and so closes its port.
    pub(super) fn close(&mut self, session: SessionKey) {
        self.scheduler.remove(session);
        self.sessions.remove(&session);
        self.split_threshold.forget();
    }

    /// Removes sessions whose ports were dropped.
    pub(super) fn remove_closed(&mut self) {
        let closed = |(&key, session): (&SessionKey, &ActiveSession)| session.is_closed().then_some(key);
        let closed: Vec<SessionKey> = self.sessions.iter().filter_map(closed).collect();
        for key in closed {
            tracing::debug!(engine_session = key, "session closed");
            self.close(key);
        }
    }

    pub(super) fn shapes(&self) -> Vec<MaskShape> {
        self.sessions.values().map(|session| session.opened.shape).collect()
    }

    /// Shrinks buffers that are larger than the open sessions need.
    pub(super) fn shrink_buffers(&mut self) -> Result<(), BackendError> {
        self.tracer.fit(self.shapes())
    }
}
