//! The engine's thread: takes up sessions, starts frames in turn, and hands masks out.

use std::{
    collections::{HashMap, VecDeque},
    sync::{Arc, atomic::Ordering, mpsc::Receiver},
    time::Duration,
};

use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_shaders::camera::Camera;
use tokio::sync::mpsc::OwnedPermit;

use super::{
    TraceCost, TraceRequest, TracedMask,
    backend::{
        BackendError,
        compute::{ComputeBackend, RING_FRAMES},
        cpu::CpuBackend,
    },
    engine::{Seat, Shared},
    port::{EnginePort, OUTSTANDING_MASKS},
    scheduler::{Scheduler, SessionKey},
};

/// How long the thread waits for the device before it looks for new poses, while there is room for another frame. A
/// frame takes a GPU milliseconds, so this costs little time and few wake-ups, and none when nothing is in flight.
const GLANCE: Duration = Duration::from_micros(500);

/// How long it waits when the ring is full: nothing could be started anyway, but a shutdown should be noticed.
const FULL_RING_WAIT: Duration = Duration::from_millis(100);

/// What traces.
pub(super) enum Backend {
    /// Kernels on a device, with or without its ray queries.
    Compute(Box<ComputeBackend>),
    Cpu(Box<CpuBackend>),
}

/// A session that wants to be taken up.
#[derive(Debug)]
pub(super) struct Opening {
    pub(super) shape: MaskShape,
    pub(super) port: EnginePort,
    #[expect(dead_code, reason = "its drop frees the place")]
    pub(super) seat: Seat,
}

/// A frame that is being traced.
struct Job {
    session: SessionKey,
    request: TraceRequest,
    mask: Mask,
    /// The place in the session's channel that the mask will take.
    place: OwnedPermit<TracedMask>,
}

pub(super) struct Worker {
    backend: Backend,
    openings: Receiver<Opening>,
    shared: Arc<Shared>,
    sessions: HashMap<SessionKey, Opening>,
    next_key: SessionKey,
    scheduler: Scheduler,
    flying: VecDeque<Job>,
}

impl Worker {
    pub(super) fn new(backend: Backend, openings: Receiver<Opening>, shared: Arc<Shared>) -> Self {
        Self {
            backend,
            openings,
            shared,
            sessions: HashMap::new(),
            next_key: 0,
            scheduler: Scheduler::new(OUTSTANDING_MASKS),
            flying: VecDeque::with_capacity(RING_FRAMES),
        }
    }

    /// Traces until the engine is stopped or the device fails. Ports close when this returns.
    pub(super) fn run(mut self) {
        while !self.shared.stop.load(Ordering::Acquire) {
            if let Err(error) = self.turn() {
                tracing::error!(%error, sessions = self.sessions.len(), "tracing has ended");
                self.shared.end(error.to_string());
                return;
            }
        }
    }

    /// One round: whatever can be done now, or else a wait. A wake-up during the round makes `park` return at once, so
    /// none is lost between looking and waiting.
    fn turn(&mut self) -> Result<(), BackendError> {
        self.remove_closed();
        self.take_up_openings()?;
        let mut started = false;
        while let Some(job) = self.next_job() {
            started = true;
            match &mut self.backend {
                Backend::Compute(backend) => {
                    backend.submit(&job.request.camera, job.mask.shape())?;
                    self.flying.push_back(job);
                }
                Backend::Cpu(backend) => {
                    let mut job = job;
                    let cost = backend.trace(&job.request.camera, &mut job.mask);
                    self.finish(job, cost);
                    // Sessions come, go and are stopped between two masks.
                    break;
                }
            }
        }
        if self.flying.is_empty() {
            if !started {
                self.give_back_memory()?;
                std::thread::park();
            }
            return Ok(());
        }
        let patience = if self.flying.len() < RING_FRAMES { GLANCE } else { FULL_RING_WAIT };
        self.land(patience)
    }

    /// Forgets sessions whose ports were dropped.
    fn remove_closed(&mut self) {
        let scheduler = &mut self.scheduler;
        self.sessions.retain(|&key, session| {
            let open = !session.port.is_closed();
            if !open {
                tracing::debug!(engine_session = key, "session closed");
                scheduler.remove(key);
            }
            open
        });
    }

    fn take_up_openings(&mut self) -> Result<(), BackendError> {
        while let Ok(opening) = self.openings.try_recv() {
            let needs_room = matches!(&self.backend, Backend::Compute(backend) if !backend.fits(opening.shape));
            if needs_room {
                // Larger buffers replace the ring, so it must be empty.
                while !self.flying.is_empty() {
                    self.land(FULL_RING_WAIT)?;
                }
                let shapes: Vec<MaskShape> = self.sessions.values().map(|session| session.shape).collect();
                let Backend::Compute(backend) = &mut self.backend else { continue };
                if let Err(error) = backend.fit(shapes.iter().copied().chain([opening.shape])) {
                    tracing::warn!(%error, shape = ?opening.shape, "no memory for a session");
                    // The others had room before. The new session's port closes as it is dropped here.
                    backend.fit(shapes)?;
                    continue;
                }
            }
            tracing::debug!(engine_session = self.next_key, shape = ?opening.shape, "session opened");
            self.scheduler.insert(self.next_key);
            self.sessions.insert(self.next_key, opening);
            self.next_key += 1;
        }
        Ok(())
    }

    /// The newest pose of the session whose turn it is, if there is room in the ring.
    fn next_job(&mut self) -> Option<Job> {
        while self.flying.len() < RING_FRAMES {
            let sessions = &self.sessions;
            let key = self.scheduler.next(|key| {
                sessions.get(&key).is_some_and(|session| {
                    session.port.newest.has_changed().unwrap_or(false) && session.port.masks.capacity() > 0
                })
            })?;
            let session = self.sessions.get_mut(&key)?;
            // Only this thread takes places, so the one that was there just now still is, unless the port closed.
            let place = session.port.masks.clone().try_reserve_owned();
            let request = *session.port.newest.borrow_and_update();
            let (Ok(place), Some(request)) = (place, request) else { continue };
            let Some(shape) = within(session.shape, &request.camera) else {
                let largest = session.shape;
                tracing::warn!(engine_session = key, camera = ?request.camera, ?largest, "a pose of a larger size is dropped");
                continue;
            };
            let used = session.port.used.try_iter().find(|mask| mask.shape() == shape);
            self.scheduler.started(key);
            return Some(Job { session: key, request, mask: used.unwrap_or_else(|| Mask::new(shape)), place });
        }
        None
    }

    /// Waits up to `patience` for the oldest frame in flight, then hands out all that have landed.
    fn land(&mut self, mut patience: Duration) -> Result<(), BackendError> {
        while let (Some(job), Backend::Compute(backend)) = (self.flying.front_mut(), &mut self.backend) {
            let Some(cost) = backend.collect(patience, &mut job.mask)? else { break };
            patience = Duration::ZERO;
            if let Some(job) = self.flying.pop_front() {
                self.finish(job, cost);
            }
        }
        Ok(())
    }

    fn finish(&mut self, job: Job, cost: TraceCost) {
        self.scheduler.finished(job.session);
        let TraceRequest { frame, ahead, received_at, .. } = job.request;
        tracing::debug!(
            engine_session = job.session,
            frame = frame.0,
            primary_ms = cost.primary_ms,
            shadow_ms = cost.shadow_ms,
            readback_ms = cost.readback_ms,
            shadow_rays = cost.shadow_rays,
            age_ms = received_at.elapsed().as_secs_f64() * 1e3,
            "mask traced"
        );
        job.place.send(TracedMask { frame, mask: job.mask, ahead, received_at, cost });
    }

    /// Before a sleep: buffers no larger than the open sessions need.
    fn give_back_memory(&mut self) -> Result<(), BackendError> {
        if let Backend::Compute(backend) = &mut self.backend {
            backend.fit(self.sessions.values().map(|session| session.shape))?;
        }
        Ok(())
    }
}

/// The shape of a mask for this camera, when it is no larger than the session's.
fn within(largest: MaskShape, camera: &Camera) -> Option<MaskShape> {
    let fits = camera.width <= largest.width() && camera.height <= largest.height();
    MaskShape::new(camera.width, camera.height, largest.lights()).ok().filter(|_| fits)
}
