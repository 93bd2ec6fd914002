//! The engine: one thread owns one device, traces for all of its sessions in turn, and is the only one to wait for the device.

use std::{
    io,
    num::NonZeroUsize,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::Ordering,
        mpsc::{SyncSender, TrySendError, sync_channel},
    },
    thread::{JoinHandle, Thread},
};

use gnomon_protocol::mask::MaskShape;
use gnomon_scene::{Scene, camera::Camera};
use thiserror::Error;

use super::{
    open::open_backend,
    port::{SessionPort, session_port},
    shared::{Peer, Seat, Shared},
    worker::{Opening, Worker},
};
use crate::visibility::{
    backend::{BackendError, compute::PictureLimit},
    schedule::{
        capacity::{Need, TooMuch, judge},
        costs::SessionCosts,
    },
};

/// Sessions that may wait to be taken up by the engine's thread.
const WAITING_OPENINGS: usize = 64;

/// Size of the masks that are traced for nobody before the first session comes, in pixels.
const WARM_UP_PX: (u32, u32) = (320, 180);

/// Stack of the engine's thread. obvhs builds hierarchies recursively.
const STACK_BYTES: usize = 16 << 20;

/// What traces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum BackendChoice {
    /// `ray-query` on a real GPU that has ray queries, `compute` on another, `cpu` when there is none or only software
    /// that pretends to be one.
    Auto,
    /// Kernels on a graphics adapter, with its own ray queries.
    RayQuery,
    /// Kernels on a graphics adapter.
    Compute,
    /// The processor.
    Cpu,
}

/// How to trace, and for how many.
#[derive(Debug, Clone, PartialEq)]
pub struct EngineOptions {
    /// What traces.
    pub backend: BackendChoice,
    /// Part of the adapter's name, for `compute`.
    pub adapter: Option<String>,
    /// Whether `compute` may take a software adapter.
    pub allow_software: bool,
    /// Threads for `cpu`; one a core when there is no number.
    pub threads: Option<NonZeroUsize>,
    /// Sessions that may be open at a time.
    pub max_sessions: usize,
    /// Time of each device that sessions may need in a second, in milliseconds.
    pub budget_ms: f64,
    /// Devices; as many as there are adapters of the best kind, without a number. More than there are share them.
    pub devices: Option<NonZeroUsize>,
}

impl EngineOptions {
    /// Of nearly all of a device's time: the rest is for what is not measured.
    pub const DEFAULT_BUDGET_MS: f64 = 900.0;
}

/// Why the engine does not start.
#[derive(Debug, Error)]
pub enum EngineError {
    /// The back end cannot be had.
    #[error(transparent)]
    Backend(#[from] BackendError),
    /// The thread cannot be had.
    #[error("the engine's thread does not start: {0}")]
    Thread(io::Error),
    /// The thread ended before the back end was there.
    #[error("the engine's thread died while it prepared the scene")]
    Died,
}

/// Why a session is not opened.
#[derive(Debug, Error)]
pub enum OpenError {
    /// All sessions are taken.
    #[error("all {0} sessions are taken")]
    Full(usize),
    /// The device does not bear one more.
    #[error("{0}")]
    TooMuch(TooMuch),
    /// So many sessions are opened at once that they queue up.
    #[error("{WAITING_OPENINGS} sessions wait to be opened already")]
    Busy,
    /// The mask must have a plane for each light of the scene.
    #[error("a mask with {found} lights for a scene with {expected}")]
    Lights {
        /// Lights of the scene.
        expected: usize,
        /// Lights of the mask.
        found: u32,
    },
    /// The device cannot hold the picture.
    #[error(transparent)]
    Picture(#[from] BackendError),
    /// The engine traces no more.
    #[error("the engine has stopped: {0}")]
    Stopped(String),
}

/// A running engine. Dropping it stops it; both wait for the thread to end, so neither belongs on an async worker.
#[derive(Debug)]
pub struct Engine {
    description: String,
    lights: usize,
    max_sessions: usize,
    budget_ms: f64,
    limit: Option<PictureLimit>,
    openings: SyncSender<Opening>,
    its_thread: Thread,
    shared: Arc<Shared>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Engine {
    /// Prepares the scene for tracing and starts the thread. Takes as long as building the hierarchy and compiling the
    /// kernels, so it does not belong on an async worker. The scene is kept, because a device that is lost is made anew from it.
    ///
    /// # Errors
    /// When the back end cannot be had for this scene.
    pub fn start(scene: Arc<Scene>, options: &EngineOptions) -> Result<Self, EngineError> {
        let shared = Arc::new(Shared::default());
        let lights = scene.lights.len();
        let (openings, openings_end) = sync_channel(WAITING_OPENINGS);
        let (ready, ready_end) = sync_channel(1);
        let thread = std::thread::Builder::new().name("gnomon-engine".to_owned()).stack_size(STACK_BYTES).spawn({
            let (options, shared) = (options.clone(), Arc::clone(&shared));
            move || {
                let guard = EndGuard(Arc::clone(&shared));
                let started = open_backend(&scene, &options).and_then(|(backend, about)| {
                    let warm_up = warm_up(&scene);
                    let reopen = Box::new(move || open_backend(&scene, &options).map(|(backend, _)| backend));
                    let mut worker = Worker::new(backend, reopen, openings_end, shared);
                    if let Some((camera, shape)) = warm_up {
                        worker.warm_up(&camera, shape)?;
                    }
                    Ok((worker, about))
                });
                match started {
                    Ok((worker, about)) => {
                        if ready.send(Ok(about)).is_ok() {
                            worker.run();
                        }
                    }
                    // Nobody waits for the answer any more when this fails.
                    Err(error) => drop(ready.send(Err(error))),
                }
                drop(guard);
            }
        });
        let thread = thread.map_err(EngineError::Thread)?;
        let its_thread = thread.thread().clone();
        let about = ready_end.recv().map_err(|_| EngineError::Died)??;
        tracing::info!(backend = about.description, lights, "engine started");
        Ok(Self {
            description: about.description,
            lights,
            max_sessions: options.max_sessions,
            budget_ms: options.budget_ms,
            limit: about.limit,
            openings,
            its_thread,
            shared,
            thread: Mutex::new(Some(thread)),
        })
    }

    /// Makes engines that take each other's sessions over when a device is lost.
    pub(super) fn introduce(engines: &[Self]) {
        for engine in engines {
            let others = engines.iter().filter(|other| !Arc::ptr_eq(&other.shared, &engine.shared));
            let peers = others.map(|other| Peer {
                shared: Arc::downgrade(&other.shared),
                openings: other.openings.clone(),
                thread: other.its_thread.clone(),
            });
            // Nobody introduces them twice.
            let _ = engine.shared.peers.set(peers.collect());
        }
    }

    /// What traces, for people: `compute on …`, `cpu: …`.
    #[must_use]
    pub fn description(&self) -> &str {
        &self.description
    }

    /// Sessions whose ports are open.
    #[must_use]
    pub fn sessions(&self) -> usize {
        self.shared.sessions().len()
    }

    /// What its sessions need in a second, in milliseconds of the device.
    #[must_use]
    pub fn load_ms(&self) -> f64 {
        self.shared.load_ms()
    }

    /// How often its device was lost.
    #[must_use]
    pub fn losses(&self) -> u64 {
        self.shared.losses.load(Ordering::Relaxed)
    }

    /// Whether its device can trace now.
    #[must_use]
    pub fn is_well(&self) -> bool {
        self.shared.is_well()
    }

    /// Has something go wrong.
    #[cfg(any(test, feature = "faults"))]
    pub fn inject(&self, fault: super::faults::Fault) {
        self.shared.faults.add(fault);
        self.its_thread.unpark();
    }

    /// Lets no panic happen that has not happened yet.
    #[cfg(any(test, feature = "faults"))]
    pub fn forget_faults(&self) {
        while self.shared.faults.take(super::faults::Fault::Panic) {}
    }

    /// As [`Self::open`], for a session that takes what it gets and that is always borne.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_session(&self, shape: MaskShape) -> Result<SessionPort, OpenError> {
        self.open_if(shape, None, |_, _| Ok(()))
    }

    /// Opens a session for masks of this shape, so many a second at most. Returns at once; when the device turns out to have no
    /// memory for it the port closes.
    ///
    /// # Errors
    /// When there are too many sessions, the device does not bear another of this kind, the shape is not this scene's or too large,
    /// or the engine has stopped.
    pub fn open(&self, shape: MaskShape, rate_hz: Option<f64>) -> Result<SessionPort, OpenError> {
        self.open_if(shape, rate_hz, |needs, new| judge(needs.iter().copied(), new, self.budget_ms))
    }

    fn open_if(
        &self,
        shape: MaskShape,
        rate_hz: Option<f64>,
        bears: impl FnOnce(&[Need], Need) -> Result<(), TooMuch>,
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
        let seat = Seat::take(&self.shared, &costs, |needs| {
            if needs.len() >= self.max_sessions {
                return Err(OpenError::Full(self.max_sessions));
            }
            bears(needs, costs.need()).map_err(OpenError::TooMuch)
        })?;
        let (port, engine_port) = session_port(self.its_thread.clone(), Arc::clone(&costs));
        let opening = Opening { shape, port: engine_port, costs, seat, retry: None };
        self.openings.try_send(opening).map_err(|error| match error {
            TrySendError::Full(_) => OpenError::Busy,
            TrySendError::Disconnected(_) => {
                OpenError::Stopped(self.shared.end_reason().unwrap_or_else(|| "its thread is gone".to_owned()))
            }
        })?;
        self.its_thread.unpark();
        Ok(port)
    }

    /// Waits until the engine traces no more, and says why.
    pub async fn ended(&self) -> String {
        let mut ended = self.shared.ended.subscribe();
        // It does not fail: the sender lives as long as `self`.
        let reason = ended.wait_for(Option::is_some).await.ok().and_then(|reason| reason.clone());
        reason.unwrap_or_default()
    }

    /// Stops tracing, closes all sessions' ports, and waits for the thread to end.
    pub fn shutdown(&self) {
        self.shared.stop.store(true, Ordering::Release);
        self.its_thread.unpark();
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take();
        if thread.is_some_and(|thread| thread.join().is_err()) {
            tracing::error!("the engine's thread had panicked");
        }
    }
}

/// What to trace for nobody: the scene from its middle.
fn warm_up(scene: &Scene) -> Option<(Camera, MaskShape)> {
    let (width, height) = WARM_UP_PX;
    let shape = MaskShape::new(width, height, u32::try_from(scene.lights.len()).ok()?).ok()?;
    let middle = scene.origin_m + scene.bounds.min.midpoint(scene.bounds.max).as_dvec3();
    let camera = Camera::looking_at(middle, middle + glam::DVec3::X, 1.0, width, height);
    Some((camera, shape))
}

impl Drop for Engine {
    fn drop(&mut self) {
        self.shutdown();
    }
}

/// Leaves a reason behind when the thread ends, however it ends.
struct EndGuard(Arc<Shared>);

impl Drop for EndGuard {
    fn drop(&mut self) {
        if std::thread::panicking() {
            tracing::error!("the engine's thread panicked: no session is traced any more");
            self.0.end("its thread panicked".to_owned());
        } else {
            self.0.end("it was shut down".to_owned());
        }
    }
}
