//! State of the engine's thread between rounds.

use std::{
    collections::HashMap,
    sync::{Arc, mpsc::Receiver},
    time::{Duration, Instant},
};

use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{SceneAt, camera::Camera};

use super::session::{ActiveSession, SplitThreshold};
use crate::visibility::{
    TraceCost,
    backend::BackendError,
    engine::{
        port::OUTSTANDING_MASKS,
        shared::{PendingSession, Shared},
        tracer::Tracer,
    },
    schedule::{
        price::RayPrice,
        scheduler::{Scheduler, SessionKey},
    },
};

/// How long each view is traced for warming up.
const WARM_UP: Duration = Duration::from_millis(100);

/// Masks that are traced even if that takes longer.
const WARM_UP_MASKS: u32 = 4;

/// Time of the scene between them, in seconds.
const WARM_UP_STEP_S: f64 = 1.0 / 60.0;

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
    pub(super) price: RayPrice,
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
            price: RayPrice::new(Instant::now()),
        }
    }

    /// Traces masks of `views` without a session, to warm up the device and to learn what they cost when it is busy.
    /// Each view but the first is left out if it would take too long. Errors if the device fails.
    pub(in super::super) fn warm_up(&mut self, views: &[(Camera, MaskShape)]) -> Result<(), BackendError> {
        let mut per_pixel_ms = 0.0;
        for (camera, shape) in views {
            let pixels = shape.pixels() as f64;
            if per_pixel_ms * pixels > WARM_UP.as_secs_f64() * 1e3 / f64::from(WARM_UP_MASKS) {
                break;
            }
            let Some(cost) = self.usual_cost(camera, *shape)? else { break };
            per_pixel_ms = cost.device_ms() / pixels;
            self.price.calibrate(&cost);
            self.shared.model.calibrate(shape.pixels(), cost.device_ms());
        }
        self.shrink_buffers()
    }

    /// Returns the median cost of the second half of the masks that are traced in [`WARM_UP`], one after the other.
    fn usual_cost(&mut self, camera: &Camera, shape: MaskShape) -> Result<Option<TraceCost>, BackendError> {
        let (mut mask, began) = (Mask::new(shape), Instant::now());
        let mut costs = Vec::new();
        while costs.len() < WARM_UP_MASKS as usize || began.elapsed() < WARM_UP {
            // Each mask has a time of its own, so that what moves is moved for it.
            let scene = SceneAt::from(costs.len() as f64 * WARM_UP_STEP_S);
            let Some(cost) = self.tracer.trace(camera, &scene, &mut mask)? else { return Ok(None) };
            costs.push(cost);
            self.shared.pulse.beat();
            // A slow device: its clock is not what makes it slow.
            if began.elapsed() > 2 * WARM_UP {
                break;
            }
        }
        let warm = costs.len() / 2;
        let mut warm: Vec<TraceCost> = costs.split_off(warm);
        warm.sort_by(|one, other| one.device_ms().total_cmp(&other.device_ms()));
        Ok(warm.get(warm.len() / 2).copied())
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
