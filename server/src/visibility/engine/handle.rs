//! The handle of an engine: starts its thread, opens sessions, and stops it.

use std::{
    sync::{
        Arc, Mutex, PoisonError,
        atomic::Ordering,
        mpsc::{RecvTimeoutError, SyncSender, TrySendError, sync_channel},
    },
    thread::{JoinHandle, Thread},
    time::{Duration, Instant},
};

use gnomon_protocol::mask::MaskShape;
use gnomon_scene::{Scene, camera::Camera};

#[cfg(any(test, feature = "faults"))]
use super::faults::Fault;
use super::{
    error::{EngineError, OpenError},
    open::open_tracer,
    options::EngineOptions,
    port::{SessionPort, session_port},
    shared::{Peer, PendingSession, SessionPermit, Shared, WAITING_SESSIONS},
    worker::Worker,
};
use crate::visibility::{
    backend::compute::PictureLimit,
    schedule::{
        capacity::{Need, Overload, admit},
        costs::SessionCosts,
    },
};

/// Size of the warm-up masks that are traced before the first session, in pixels.
const WARM_UP_PX: [(u32, u32); 2] = [(320, 180), (1280, 720)];

/// Limit for opening a device and building the hierarchy. Only a driver that hangs takes longer.
const START_PATIENCE: Duration = Duration::from_secs(600);

/// Limit for the thread to end. A driver call that does not return keeps it; then the thread is left behind.
pub(super) const STOP_PATIENCE: Duration = Duration::from_secs(10);

/// A round of the thread that takes longer hangs in a driver call.
const ROUND_PATIENCE: Duration = Duration::from_secs(120);

/// Stack of the engine's thread. obvhs builds hierarchies recursively.
const STACK_BYTES: usize = 16 << 20;

/// A running engine: its thread owns one device, traces for all sessions in turn, and is the only one to wait for the
/// device. Dropping the engine stops the thread and waits for it, so don't drop it on an async worker.
#[derive(Debug)]
pub struct Engine {
    description: String,
    lights: usize,
    max_sessions: usize,
    budget_ms: f64,
    limit: Option<PictureLimit>,
    pending: SyncSender<PendingSession>,
    waker: Thread,
    shared: Arc<Shared>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Engine {
    /// Prepares the scene for tracing and starts the thread. Builds the hierarchy and compiles the kernels, so don't
    /// call it on an async worker. Keeps the scene, to reopen a lost device.
    ///
    /// # Errors
    /// If the back end cannot be opened for this scene.
    pub fn start(scene: Arc<Scene>, options: &EngineOptions) -> Result<Self, EngineError> {
        let shared = Arc::new(Shared::default());
        let lights = scene.lights.len();
        let (pending, pending_end) = sync_channel(WAITING_SESSIONS);
        let (ready, ready_end) = sync_channel(1);
        let thread = std::thread::Builder::new().name("gnomon-engine".to_owned()).stack_size(STACK_BYTES).spawn({
            let (options, shared) = (options.clone(), Arc::clone(&shared));
            move || {
                let guard = EndGuard(Arc::clone(&shared));
                let started = open_tracer(&scene, &options).and_then(|(tracer, about)| {
                    let warm_up = warm_up_views(&scene);
                    let reopen = Box::new(move || open_tracer(&scene, &options).map(|(tracer, _)| tracer));
                    let mut worker = Worker::new(tracer, reopen, pending_end, shared);
                    worker.warm_up(&warm_up)?;
                    Ok((worker, about))
                });
                match started {
                    Ok((worker, about)) => {
                        if ready.send(Ok(about)).is_ok() {
                            worker.run();
                        }
                    }
                    // Sending fails only after `start` has returned.
                    Err(error) => drop(ready.send(Err(error))),
                }
                drop(guard);
            }
        });
        let thread = thread.map_err(EngineError::Thread)?;
        let waker = thread.thread().clone();
        let about = ready_end.recv_timeout(START_PATIENCE).map_err(|error| match error {
            RecvTimeoutError::Timeout => EngineError::NoAnswer(START_PATIENCE),
            RecvTimeoutError::Disconnected => EngineError::Died,
        })??;
        tracing::info!(backend = about.description, lights, "engine started");
        Ok(Self {
            description: about.description,
            lights,
            max_sessions: options.max_sessions,
            budget_ms: options.budget_ms,
            limit: about.limit,
            pending,
            waker,
            shared,
            thread: Mutex::new(Some(thread)),
        })
    }

    /// Lets engines take over each other's sessions when a device is lost. Call it once.
    pub(super) fn connect_peers(engines: &[Self]) {
        for engine in engines {
            let others = engines.iter().filter(|other| !Arc::ptr_eq(&other.shared, &engine.shared));
            let peers = others.map(|other| Peer {
                shared: Arc::downgrade(&other.shared),
                pending: other.pending.clone(),
                thread: other.waker.clone(),
            });
            // Setting fails only on a second call.
            let _ = engine.shared.peers.set(peers.collect());
        }
    }

    /// Back end and adapter, in readable form: `compute on …`, `cpu: …`.
    #[must_use]
    pub fn description(&self) -> &str {
        &self.description
    }

    pub(super) const fn has_device(&self) -> bool {
        self.limit.is_some()
    }

    #[must_use]
    pub fn sessions(&self) -> usize {
        self.shared.sessions().len()
    }

    /// Device time that the sessions need, in milliseconds per second.
    #[must_use]
    pub fn load_ms(&self) -> f64 {
        self.shared.load_ms()
    }

    pub(super) fn load_without_ms(&self, left_out: Option<&Arc<SessionCosts>>) -> f64 {
        self.shared.load_without_ms(left_out)
    }

    /// Number of times that the device was lost.
    #[must_use]
    pub fn losses(&self) -> u64 {
        self.shared.losses.load(Ordering::Relaxed)
    }

    /// Returns whether the device can trace now.
    #[must_use]
    pub fn is_well(&self) -> bool {
        self.shared.is_well()
    }

    /// Returns false if the thread hangs, for example in a driver call that does not return. Slow clients do not
    /// matter.
    #[must_use]
    pub fn answers(&self) -> bool {
        self.answers_within(ROUND_PATIENCE)
    }

    pub(super) fn answers_within(&self, patience: Duration) -> bool {
        self.shared.pulse.silent_for() < patience
    }

    #[cfg(any(test, feature = "faults"))]
    pub fn inject(&self, fault: Fault) {
        self.shared.faults.add(fault);
        self.waker.unpark();
    }

    /// Cancels injected panics that have not happened yet.
    #[cfg(any(test, feature = "faults"))]
    pub fn forget_faults(&self) {
        while self.shared.faults.take(Fault::Panic) {}
    }

    /// Opens a session without a rate and without an admission test.
    ///
    /// # Errors
    /// As [`Self::open`], except [`OpenError::Overload`].
    pub fn open_session(&self, shape: MaskShape) -> Result<SessionPort, OpenError> {
        self.open_if(shape, None, None, |_, _| Ok(()))
    }

    /// Opens a session for masks of at most this shape, `rate_hz` of them per second. Returns at once. If the device
    /// has no memory for the session, its port closes later.
    ///
    /// # Errors
    /// If there are too many sessions, the device has too little time left, the shape does not fit the scene or is too
    /// large, or the engine has stopped.
    pub fn open(&self, shape: MaskShape, rate_hz: Option<f64>) -> Result<SessionPort, OpenError> {
        self.open_instead(shape, rate_hz, None)
    }

    /// As [`Self::open`], judged as if the session with the costs `replaced` were gone.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub(super) fn open_instead(
        &self,
        shape: MaskShape,
        rate_hz: Option<f64>,
        replaced: Option<&Arc<SessionCosts>>,
    ) -> Result<SessionPort, OpenError> {
        self.open_if(shape, rate_hz, replaced, |needs, new| admit(needs.iter().copied(), new, self.budget_ms))
    }

    fn open_if(
        &self,
        shape: MaskShape,
        rate_hz: Option<f64>,
        replaced: Option<&Arc<SessionCosts>>,
        admit: impl FnOnce(&[Need], Need) -> Result<(), Overload>,
    ) -> Result<SessionPort, OpenError> {
        if shape.lights() as usize != self.lights {
            return Err(OpenError::Lights { expected: self.lights, found: shape.lights() });
        }
        if let Some(limit) = &self.limit {
            limit.check(shape)?;
        }
        if let Some(reason) = self.shared.end_reason() {
            return Err(OpenError::Stopped(reason));
        }
        let known: Vec<Arc<SessionCosts>> = self.shared.sessions().clone();
        let expected_ms = self.shared.model.expected_ms(shape.pixels(), known.iter().map(AsRef::as_ref));
        let costs = Arc::new(SessionCosts::new(shape, rate_hz, expected_ms));
        let permit = SessionPermit::acquire(&self.shared, &costs, replaced, |needs| {
            if needs.len() >= self.max_sessions {
                return Err(OpenError::Full(self.max_sessions));
            }
            admit(needs, costs.need()).map_err(OpenError::Overload)
        })?;
        let (port, engine_port) = session_port(self.waker.clone(), Arc::clone(&costs));
        let session = PendingSession { shape, port: engine_port, costs, permit, retry: None };
        self.pending.try_send(session).map_err(|error| match error {
            TrySendError::Full(_) => OpenError::Busy,
            TrySendError::Disconnected(_) => {
                OpenError::Stopped(self.shared.end_reason().unwrap_or_else(|| "its thread is gone".to_owned()))
            }
        })?;
        self.waker.unpark();
        Ok(port)
    }

    /// Waits until the engine has ended. Returns the reason.
    pub async fn ended(&self) -> String {
        let mut ended = self.shared.ended.subscribe();
        // Waiting cannot fail: the sender lives as long as `self`.
        let reason = ended.wait_for(Option::is_some).await.ok().and_then(|reason| reason.clone());
        reason.unwrap_or_default()
    }

    /// Stops tracing, closes all sessions' ports, and waits for the thread to end, for a limited time.
    pub fn shutdown(&self) {
        self.shutdown_within(STOP_PATIENCE);
    }

    pub(super) fn ask_to_stop(&self) {
        self.shared.stop.store(true, Ordering::Release);
        self.waker.unpark();
    }

    /// Returns whether the thread has ended.
    pub(super) fn shutdown_within(&self, patience: Duration) -> bool {
        self.ask_to_stop();
        let Some(thread) = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take() else { return true };
        let deadline = Instant::now() + patience;
        while !thread.is_finished() {
            if Instant::now() >= deadline {
                tracing::error!("the device does not answer: its thread is left behind");
                self.shared.end("its device does not answer".to_owned());
                return false;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        if thread.join().is_err() {
            tracing::error!("the engine's thread had panicked");
        }
        true
    }
}

/// The warm-up views, from the middle of the scene.
fn warm_up_views(scene: &Scene) -> Vec<(Camera, MaskShape)> {
    let middle = scene.origin_m + scene.bounds.min.midpoint(scene.bounds.max).as_dvec3();
    let view = |(width, height)| {
        let shape = MaskShape::new(width, height, u32::try_from(scene.lights.len()).ok()?).ok()?;
        Some((Camera::looking_at(middle, middle + glam::DVec3::X, 1.0, width, height), shape))
    };
    WARM_UP_PX.into_iter().filter_map(view).collect()
}

impl Drop for Engine {
    fn drop(&mut self) {
        self.shutdown();
    }
}

/// Records why the thread ends, even when it panics.
struct EndGuard(Arc<Shared>);

impl Drop for EndGuard {
    fn drop(&mut self) {
        if std::thread::panicking() {
            tracing::error!("the engine's thread panicked: tracing has stopped");
            self.0.end("its thread panicked".to_owned());
        } else {
            self.0.end("it was shut down".to_owned());
        }
    }
}
