//! The engine: one thread owns the back end, traces for all sessions in turn, and is the only one to wait for a device.

use std::{
    io,
    num::NonZeroUsize,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, AtomicUsize, Ordering},
        mpsc::{SyncSender, TrySendError, sync_channel},
    },
    thread::JoinHandle,
};

use gnomon_protocol::mask::MaskShape;
use gnomon_shaders::{gpu::GpuError, scene::Scene};
use serde::{Deserialize, Serialize};
use thiserror::Error;
use tokio::sync::watch;

use super::{
    backend::{
        BackendError,
        compute::{ComputeBackend, PictureLimit},
        cpu::CpuBackend,
        ray_query,
    },
    port::{EngineWaker, SessionPort, session_port},
    worker::{Backend, Opening, Worker},
};

/// Sessions that may wait to be taken up by the engine's thread.
const WAITING_OPENINGS: usize = 64;

/// Stack of the engine's thread. obvhs builds hierarchies recursively.
const STACK_BYTES: usize = 16 << 20;

/// What traces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
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
#[derive(Debug, Clone, PartialEq, Eq)]
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

/// What the engine and its thread both know.
#[derive(Debug, Default)]
pub(super) struct Shared {
    /// The thread shall end.
    pub(super) stop: AtomicBool,
    /// Open sessions.
    pub(super) sessions: AtomicUsize,
    /// Why the thread has ended.
    ended: watch::Sender<Option<String>>,
}

impl Shared {
    pub(super) fn end(&self, reason: String) {
        // The first reason stays.
        self.ended.send_if_modified(|ended| {
            let is_first = ended.is_none();
            ended.get_or_insert(reason);
            is_first
        });
    }

    pub(super) fn end_reason(&self) -> Option<String> {
        self.ended.borrow().clone()
    }
}

/// A place among the sessions, free again when it is dropped.
#[derive(Debug)]
pub(super) struct Seat(Arc<Shared>);

impl Seat {
    /// One of `seats`, if there is one left.
    pub(super) fn take(shared: &Arc<Shared>, seats: usize) -> Option<Self> {
        let take = |taken: usize| (taken < seats).then_some(taken + 1);
        shared.sessions.fetch_update(Ordering::AcqRel, Ordering::Acquire, take).ok()?;
        Some(Self(Arc::clone(shared)))
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.0.sessions.fetch_sub(1, Ordering::AcqRel);
    }
}

/// A running engine. Dropping it stops it; both wait for the thread to end, so neither belongs on an async worker.
#[derive(Debug)]
pub struct Engine {
    description: String,
    lights: usize,
    max_sessions: usize,
    limit: Option<PictureLimit>,
    openings: SyncSender<Opening>,
    waker: EngineWaker,
    shared: Arc<Shared>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Engine {
    /// Prepares the scene for tracing and starts the thread. Takes as long as building the hierarchy and compiling the
    /// kernels, so it does not belong on an async worker.
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
                let backend = open_backend(&scene, &options);
                // Back ends keep what they need; the server's scene may go.
                drop(scene);
                match backend {
                    Ok((backend, about)) => {
                        if ready.send(Ok(about)).is_ok() {
                            Worker::new(backend, openings_end, shared).run();
                        }
                    }
                    // Nobody waits for the answer any more when this fails.
                    Err(error) => drop(ready.send(Err(error))),
                }
                drop(guard);
            }
        });
        let thread = thread.map_err(EngineError::Thread)?;
        let waker = EngineWaker(thread.thread().clone());
        let about = ready_end.recv().map_err(|_| EngineError::Died)??;
        tracing::info!(backend = about.description, lights, "engine started");
        Ok(Self {
            description: about.description,
            lights,
            max_sessions: options.max_sessions,
            limit: about.limit,
            openings,
            waker,
            shared,
            thread: Mutex::new(Some(thread)),
        })
    }

    /// What traces, for people: `compute on …`, `cpu: …`.
    #[must_use]
    pub fn description(&self) -> &str {
        &self.description
    }

    /// Sessions whose ports are open.
    #[must_use]
    pub fn sessions(&self) -> usize {
        self.shared.sessions.load(Ordering::Acquire)
    }

    /// Opens a session for masks of this shape. Returns at once; when the device turns out to have no memory for it the
    /// port closes.
    ///
    /// # Errors
    /// When there are too many sessions, the shape is not this scene's or too large, or the engine has stopped.
    pub fn open_session(&self, shape: MaskShape) -> Result<SessionPort, OpenError> {
        if shape.lights() as usize != self.lights {
            return Err(OpenError::Lights { expected: self.lights, found: shape.lights() });
        }
        if let Some(limit) = &self.limit {
            limit.check(shape)?;
        }
        if let Some(reason) = self.shared.end_reason() {
            return Err(OpenError::Stopped(reason));
        }
        let seat = Seat::take(&self.shared, self.max_sessions).ok_or(OpenError::Full(self.max_sessions))?;
        let (port, engine_port) = session_port(self.waker.clone());
        self.openings.try_send(Opening { shape, port: engine_port, seat }).map_err(|error| match error {
            TrySendError::Full(_) => OpenError::Busy,
            TrySendError::Disconnected(_) => {
                OpenError::Stopped(self.shared.end_reason().unwrap_or_else(|| "its thread is gone".to_owned()))
            }
        })?;
        self.waker.wake();
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
        self.waker.wake();
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take();
        if thread.is_some_and(|thread| thread.join().is_err()) {
            tracing::error!("the engine's thread had panicked");
        }
    }
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

/// What the engine tells about its back end.
struct About {
    description: String,
    limit: Option<PictureLimit>,
}

fn open_backend(scene: &Scene, options: &EngineOptions) -> Result<(Backend, About), BackendError> {
    let adapter = || options.adapter.clone();
    let on_device = |backend: ComputeBackend| {
        let about = About { description: backend.describe(), limit: Some(backend.picture_limit()) };
        (Backend::Compute(Box::new(backend)), about)
    };
    let cpu = || {
        let backend = CpuBackend::new(scene, options.threads)?;
        let about = About { description: backend.describe(), limit: None };
        Ok((Backend::Cpu(Box::new(backend)), about))
    };
    match options.backend {
        BackendChoice::RayQuery => ray_query::open(scene, adapter(), options.allow_software).map(on_device),
        BackendChoice::Compute => ComputeBackend::open(scene, adapter(), options.allow_software).map(on_device),
        BackendChoice::Cpu => cpu(),
        BackendChoice::Auto => match ray_query::open_preferred(scene, adapter(), false) {
            Ok(backend) => Ok(on_device(backend)),
            // Who names an adapter wants that one, or to hear that it is not there.
            Err(error @ BackendError::Gpu(GpuError::NoAdapter { wanted: Some(_), .. })) => Err(error),
            Err(BackendError::Gpu(error @ (GpuError::NoAdapter { .. } | GpuError::SoftwareOnly(_)))) => {
                tracing::info!(reason = %error, "tracing on the processor");
                cpu()
            }
            Err(error) => {
                tracing::warn!(reason = %error, "the graphics adapter cannot trace this scene: tracing on the processor");
                cpu()
            }
        },
    }
}
