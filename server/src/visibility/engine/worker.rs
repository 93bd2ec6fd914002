//! The engine's thread: takes up sessions, and lets them have the device in turn ([`work`]). A panic ends the session whose frame it
//! was; what happens when the device fails is in [`recovery`].

mod recovery;
#[cfg(test)]
mod tests;
mod work;

use std::{
    collections::{HashMap, VecDeque},
    sync::{Arc, atomic::Ordering, mpsc::Receiver},
    time::{Duration, Instant},
};

use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::camera::Camera;

use self::work::{Begun, Job, LongestWhole};

#[cfg(any(test, feature = "faults"))]
use super::faults::Fault;
use super::{
    port::{EnginePort, OUTSTANDING_MASKS},
    shared::{Seat, Shared},
};
use crate::visibility::{
    TraceRequest,
    backend::{
        BackendError,
        compute::{ComputeBackend, RING_FRAMES},
        cpu::CpuBackend,
    },
    schedule::{
        costs::SessionCosts,
        scheduler::{Scheduler, SessionKey},
    },
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
    /// Its frame that is traced in parts.
    begun: Option<Begun>,
}

impl Seated {
    fn new(opening: Opening) -> Self {
        Self { opening, due: None, begun: None }
    }
}

pub(super) struct Worker {
    backend: Backend,
    reopen: Reopen,
    openings: Receiver<Opening>,
    shared: Arc<Shared>,
    sessions: HashMap<SessionKey, Seated>,
    next_key: SessionKey,
    scheduler: Scheduler,
    /// Frames wholly submitted to the device, oldest first.
    flying: VecDeque<Job>,
    longest_whole: LongestWhole,
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
            longest_whole: LongestWhole::default(),
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
        let mut worked = false;
        while self.work()? {
            worked = true;
            // The processor has done it by now: sessions come, go and are stopped between two parts.
            if !matches!(self.backend, Backend::Compute(_)) {
                return Ok(());
            }
        }
        let (flying, submitted) = (self.flying.len(), self.submitted());
        if flying == 0 && submitted == 0 {
            if !worked {
                self.give_back_memory()?;
                std::thread::park();
            }
            return Ok(());
        }
        let patience = if flying < RING_FRAMES { GLANCE } else { FULL_RING_WAIT };
        self.land(patience)
    }

    /// What the device has not done of what it was given.
    fn submitted(&mut self) -> usize {
        match &mut self.backend {
            Backend::Compute(backend) => backend.submissions_open(),
            Backend::Cpu(_) | Backend::Gone => 0,
        }
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
        self.longest_whole.forget();
    }

    /// Forgets sessions whose ports were dropped.
    fn remove_closed(&mut self) {
        let (scheduler, longest_whole) = (&mut self.scheduler, &mut self.longest_whole);
        self.sessions.retain(|&key, session| {
            let open = !session.opening.port.is_closed();
            if !open {
                tracing::debug!(engine_session = key, "session closed");
                scheduler.remove(key);
                longest_whole.forget();
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
                self.begin_anew();
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
            self.sessions.insert(self.next_key, Seated::new(opening));
            self.longest_whole.forget();
            self.next_key += 1;
        }
        Ok(())
    }

    fn shapes(&self) -> impl Iterator<Item = MaskShape> {
        self.sessions.values().map(|session| session.opening.shape)
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
