//! The engine's thread: takes up sessions, starts frames in turn, and hands masks out. A panic ends the session whose frame it was;
//! what happens when the device fails is in [`recovery`].

mod recovery;

use std::{
    collections::{HashMap, VecDeque},
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, atomic::Ordering, mpsc::Receiver},
    time::{Duration, Instant},
};

use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_shaders::camera::Camera;
use tokio::sync::mpsc::OwnedPermit;

#[cfg(any(test, feature = "faults"))]
use super::faults::Fault;
use super::{
    TraceCost, TraceRequest, TracedMask,
    backend::{
        BackendError,
        compute::{ComputeBackend, RING_FRAMES},
        cpu::CpuBackend,
    },
    costs::SessionCosts,
    port::{EnginePort, OUTSTANDING_MASKS},
    scheduler::{Scheduler, SessionKey},
    shared::{Seat, Shared},
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
    /// Nothing: the device is lost, and not replaced yet.
    Gone,
}

/// Opens a back end like the one that was lost.
pub(super) type Reopen = Box<dyn FnMut() -> Result<Backend, BackendError> + Send>;

/// A session that wants to be taken up.
#[derive(Debug)]
pub(super) struct Opening {
    pub(super) shape: MaskShape,
    pub(super) port: EnginePort,
    pub(super) costs: Arc<SessionCosts>,
    pub(super) seat: Seat,
    /// A request whose trace was lost with its device.
    pub(super) retry: Option<TraceRequest>,
}

/// A session that was taken up.
struct Seated {
    opening: Opening,
    /// When the mask is due for which it waits.
    due: Option<Instant>,
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
    reopen: Reopen,
    openings: Receiver<Opening>,
    shared: Arc<Shared>,
    sessions: HashMap<SessionKey, Seated>,
    next_key: SessionKey,
    scheduler: Scheduler,
    flying: VecDeque<Job>,
    /// Times that the device was lost since it last traced a mask.
    losses: u32,
}

impl Worker {
    pub(super) fn new(backend: Backend, reopen: Reopen, openings: Receiver<Opening>, shared: Arc<Shared>) -> Self {
        Self {
            backend,
            reopen,
            openings,
            shared,
            sessions: HashMap::new(),
            next_key: 0,
            scheduler: Scheduler::new(OUTSTANDING_MASKS),
            flying: VecDeque::with_capacity(RING_FRAMES),
            losses: 0,
        }
    }

    /// Traces twice for nobody: the device is warm then, and it is known what a mask costs.
    ///
    /// # Errors
    /// When the device fails.
    pub(super) fn warm_up(&mut self, camera: &Camera, shape: MaskShape) -> Result<(), BackendError> {
        let mut mask = Mask::new(shape);
        for _ in 0..2 {
            let cost = match &mut self.backend {
                Backend::Compute(backend) => {
                    backend.fit([shape])?;
                    backend.submit(camera, shape)?;
                    loop {
                        if let Some(cost) = backend.collect(FULL_RING_WAIT, &mut mask)? {
                            break cost;
                        }
                    }
                }
                Backend::Cpu(backend) => backend.trace(camera, &mut mask),
                Backend::Gone => return Ok(()),
            };
            self.shared.model.learn(shape.pixels(), &cost);
        }
        self.give_back_memory()
    }

    /// Traces until the engine is stopped, or its device fails for good. Ports close when this returns.
    pub(super) fn run(mut self) {
        while !self.shared.stop.load(Ordering::Acquire) {
            if let Err(error) = self.turn()
                && !self.recover(error)
            {
                return;
            }
        }
    }

    /// One round: whatever can be done now, or else a wait. A wake-up during the round makes `park` return at once, so
    /// none is lost between looking and waiting.
    fn turn(&mut self) -> Result<(), BackendError> {
        #[cfg(any(test, feature = "faults"))]
        self.lose_device_if_told()?;
        self.remove_closed();
        self.take_up_openings()?;
        let mut started = false;
        while let Some(job) = self.next_job() {
            started = true;
            let (camera, shape) = (job.request.camera, job.mask.shape());
            match &mut self.backend {
                Backend::Compute(backend) => {
                    let submitted = catch_unwind(AssertUnwindSafe(|| backend.submit(&camera, shape)));
                    let session = job.session;
                    self.flying.push_back(job);
                    match submitted {
                        Ok(submitted) => submitted?,
                        // Nobody knows what state it left the device's queue in.
                        Err(_) => return Err(self.panicked(session)),
                    }
                }
                Backend::Cpu(backend) => {
                    let mut job = job;
                    // It changes nothing of its own while it traces, so a panic leaves nothing half done.
                    match catch_unwind(AssertUnwindSafe(|| backend.trace(&camera, &mut job.mask))) {
                        Ok(cost) => self.finish(job, cost),
                        Err(_) => drop(self.panicked(job.session)),
                    }
                    // Sessions come, go and are stopped between two masks.
                    break;
                }
                Backend::Gone => return Err(BackendError::Device("it is not there".to_owned())),
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

    /// Closes the session whose frame panicked, and says what became of the device.
    fn panicked(&mut self, session: SessionKey) -> BackendError {
        tracing::error!(engine_session = session, "tracing panicked: the session is closed");
        self.close(session);
        BackendError::Device("tracing panicked".to_owned())
    }

    /// Forgets a session; its port closes.
    fn close(&mut self, session: SessionKey) {
        self.scheduler.remove(session);
        self.sessions.remove(&session);
    }

    /// Forgets sessions whose ports were dropped.
    fn remove_closed(&mut self) {
        let scheduler = &mut self.scheduler;
        self.sessions.retain(|&key, session| {
            let open = !session.opening.port.is_closed();
            if !open {
                tracing::debug!(engine_session = key, "session closed");
                scheduler.remove(key);
            }
            open
        });
    }

    fn take_up_openings(&mut self) -> Result<(), BackendError> {
        while let Ok(opening) = self.openings.try_recv() {
            // Nobody wakes this thread for a session that was closed before it was taken up.
            if opening.port.is_closed() {
                continue;
            }
            let needs_room = matches!(&self.backend, Backend::Compute(backend) if !backend.fits(opening.shape));
            if needs_room {
                // Larger buffers replace the ring, so it must be empty.
                while !self.flying.is_empty() {
                    self.land(FULL_RING_WAIT)?;
                }
                let shapes: Vec<MaskShape> = self.shapes().collect();
                let Backend::Compute(backend) = &mut self.backend else { continue };
                if let Err(error) = backend.fit(shapes.iter().copied().chain([opening.shape])) {
                    tracing::warn!(%error, shape = ?opening.shape, "no memory for a session");
                    // The others had room before. The new session's port closes as it is dropped here.
                    backend.fit(shapes)?;
                    continue;
                }
            }
            tracing::debug!(engine_session = self.next_key, shape = ?opening.shape, "session opened");
            self.scheduler.insert(self.next_key, opening.costs.expected_ms());
            self.sessions.insert(self.next_key, Seated { opening, due: None });
            self.next_key += 1;
        }
        Ok(())
    }

    fn shapes(&self) -> impl Iterator<Item = MaskShape> {
        self.sessions.values().map(|session| session.opening.shape)
    }

    /// The newest pose of the session whose turn it is, if there is room in the ring.
    fn next_job(&mut self) -> Option<Job> {
        while self.flying.len() < RING_FRAMES {
            let sessions = &mut self.sessions;
            let key = self.scheduler.next(|key| sessions.get_mut(&key).and_then(Seated::due))?;
            match catch_unwind(AssertUnwindSafe(|| self.job(key))) {
                Ok(Some(job)) => {
                    self.scheduler.started(key);
                    return Some(job);
                }
                Ok(None) => {}
                Err(_) => drop(self.panicked(key)),
            }
        }
        None
    }

    /// The work on a session's newest pose, unless there is nothing to be done after all.
    fn job(&mut self, key: SessionKey) -> Option<Job> {
        #[cfg(any(test, feature = "faults"))]
        self.panic_if_told();
        let session = self.sessions.get_mut(&key)?;
        session.due = None;
        let Opening { shape: largest, port, costs, retry, .. } = &mut session.opening;
        // Only this thread takes places, so the one that was there just now still is, unless the port closed.
        let place = port.masks.clone().try_reserve_owned();
        let lost = retry.take().filter(|_| !port.newest.has_changed().unwrap_or(false));
        let newest = *port.newest.borrow_and_update();
        let (Ok(place), Some(request)) = (place, lost.or(newest)) else { return None };
        let Some(shape) = within(*largest, &request.camera) else {
            tracing::warn!(engine_session = key, camera = ?request.camera, ?largest, "a pose of a larger size is dropped");
            return None;
        };
        costs.begins(request.received_at.elapsed());
        let used = port.used.try_iter().find(|mask| mask.shape() == shape);
        Some(Job { session: key, request, mask: used.unwrap_or_else(|| Mask::new(shape)), place })
    }

    /// Waits up to `patience` for the oldest frame in flight, then hands out all that have landed.
    fn land(&mut self, mut patience: Duration) -> Result<(), BackendError> {
        while let (Some(job), Backend::Compute(backend)) = (self.flying.front_mut(), &mut self.backend) {
            let session = job.session;
            let landed = catch_unwind(AssertUnwindSafe(|| backend.collect(patience, &mut job.mask)));
            let Ok(landed) = landed else { return Err(self.panicked(session)) };
            let Some(cost) = landed? else { break };
            patience = Duration::ZERO;
            if let Some(job) = self.flying.pop_front() {
                self.finish(job, cost);
            }
        }
        Ok(())
    }

    fn finish(&mut self, job: Job, cost: TraceCost) {
        self.losses = 0;
        self.scheduler.finished(job.session, cost.device_ms());
        self.shared.model.learn(job.mask.shape().pixels(), &cost);
        if let Some(session) = self.sessions.get(&job.session) {
            session.opening.costs.ends(&cost);
        }
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
        let shapes: Vec<MaskShape> = self.shapes().collect();
        match &mut self.backend {
            Backend::Compute(backend) => backend.fit(shapes),
            Backend::Cpu(_) | Backend::Gone => Ok(()),
        }
    }

    #[cfg(any(test, feature = "faults"))]
    fn lose_device_if_told(&mut self) -> Result<(), BackendError> {
        if self.shared.faults.take(Fault::DeviceLost) {
            if let Backend::Compute(backend) = &self.backend {
                backend.lose();
            }
            return Err(BackendError::Device("it was told to be lost".to_owned()));
        }
        Ok(())
    }

    #[cfg(any(test, feature = "faults"))]
    #[expect(clippy::panic, reason = "a fault on demand")]
    fn panic_if_told(&self) {
        if self.shared.faults.take(Fault::Panic) {
            panic!("told to");
        }
    }
}

impl Seated {
    /// When its mask is due, if it waits for one and can take it. That stays so when a newer pose takes the older one's place.
    fn due(&mut self) -> Option<Instant> {
        let port = &self.opening.port;
        let newest = port.newest.has_changed().unwrap_or(false);
        if (!newest && self.opening.retry.is_none()) || port.masks.capacity() == 0 {
            return None;
        }
        let request = port.newest.borrow().or(self.opening.retry)?;
        Some(*self.due.get_or_insert(request.received_at + request.interval))
    }
}

/// The shape of a mask for this camera, when it is no larger than the session's.
fn within(largest: MaskShape, camera: &Camera) -> Option<MaskShape> {
    let fits = camera.width <= largest.width() && camera.height <= largest.height();
    MaskShape::new(camera.width, camera.height, largest.lights()).ok().filter(|_| fits)
}
