//! The back end of an engine as a state machine: a frame begins, advances part by part, and is collected.

use std::{
    collections::VecDeque,
    ops::Range,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::mpsc::{RecvTimeoutError, sync_channel},
    time::{Duration, Instant},
};

use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{SceneAt, camera::Camera};
use tokio::sync::mpsc::OwnedPermit;

use crate::visibility::{
    TraceCost, TraceRequest, TracedMask,
    backend::{
        BackendError,
        compute::{ComputeBackend, PartialSubmission},
        cpu::{CpuBackend, Posed},
    },
    schedule::scheduler::SessionKey,
};

/// How long a lost device may take to close before another is opened beside it.
const DROP_PATIENCE: Duration = Duration::from_secs(5);

pub(super) enum Tracer {
    /// Kernels on a device. `in_flight`: wholly submitted frames, oldest first.
    Device {
        backend: Box<ComputeBackend>,
        in_flight: VecDeque<Job>,
    },
    Cpu(Box<CpuBackend>),
    /// The device is lost and not yet reopened.
    Lost,
}

/// A mask to trace for a session.
pub(super) struct Job {
    pub(super) session: SessionKey,
    pub(super) request: TraceRequest,
    /// When the mask is due.
    pub(super) due: Instant,
    pub(super) mask: Mask,
    /// The mask's reserved place in the session's channel.
    pub(super) permit: OwnedPermit<TracedMask>,
}

/// A frame that is interrupted between two parts.
pub(super) struct PartialFrame {
    pub(super) job: Job,
    /// Rows of tiles in each part.
    rows_per_part: u32,
    progress: Progress,
}

enum Progress {
    Device(PartialSubmission),
    /// `posed`: what moves, at the frame's time.
    Cpu {
        next_row: u32,
        cost: TraceCost,
        posed: Option<Box<Posed>>,
    },
}

/// State of a frame after one of its parts.
pub(super) enum Advance {
    Partial(PartialFrame),
    /// All parts are submitted. [`Tracer::collect`] returns the frame once it has landed.
    InFlight,
    Traced(Job, TraceCost),
}

/// Why tracing failed, and the affected job. Frames in flight stay with the tracer: see [`Tracer::lose`].
pub(super) enum TraceError {
    /// The device failed. Another device can trace the job's request.
    Device { error: BackendError, job: Option<Box<Job>> },
    /// The work on this job panicked.
    Panicked { job: Box<Job> },
}

/// How busy a device is.
pub(super) struct DeviceLoad {
    /// Frames that may begin now.
    pub(super) free_slots: usize,
    /// Frames wholly submitted and not collected.
    pub(super) in_flight: usize,
    /// Submissions that the device has not finished.
    pub(super) submissions: usize,
}

impl From<BackendError> for TraceError {
    fn from(error: BackendError) -> Self {
        Self::Device { error, job: None }
    }
}

impl PartialFrame {
    /// Share of the frame that the next part traces, 0 to 1.
    pub(super) fn next_share(&self) -> f64 {
        let rows = self.next_rows();
        f64::from(rows.end - rows.start) / f64::from(self.job.mask.shape().tiles_y().max(1))
    }

    fn next_rows(&self) -> Range<u32> {
        match &self.progress {
            Progress::Device(rest) => rest.next_rows(self.rows_per_part),
            Progress::Cpu { next_row, .. } => {
                *next_row..next_row.saturating_add(self.rows_per_part).min(self.job.mask.shape().tiles_y())
            }
        }
    }
}

impl Tracer {
    pub(super) fn on_device(backend: ComputeBackend) -> Self {
        Self::Device { backend: Box::new(backend), in_flight: VecDeque::new() }
    }

    pub(super) fn on_cpu(backend: CpuBackend) -> Self {
        Self::Cpu(Box::new(backend))
    }

    /// Begins a frame. Each [`Self::advance`] traces `rows_per_part` rows of tiles. Errors if the device has failed.
    pub(super) fn begin(&mut self, job: Job, rows_per_part: u32) -> Result<PartialFrame, TraceError> {
        let progress = match self {
            Self::Device { backend, .. } => {
                let TraceRequest { camera, scene, .. } = &job.request;
                let begin = || backend.begin(camera, scene, job.mask.shape());
                match catch_unwind(AssertUnwindSafe(begin)) {
                    Ok(Ok(rest)) => Progress::Device(rest),
                    Ok(Err(error)) => return Err(TraceError::Device { error, job: Some(Box::new(job)) }),
                    Err(_) => return Err(TraceError::Panicked { job: Box::new(job) }),
                }
            }
            Self::Cpu(backend) => {
                let (from, scene) = (Instant::now(), &job.request.scene);
                let Ok(posed) = catch_unwind(AssertUnwindSafe(|| backend.pose(scene).map(Box::new))) else {
                    return Err(TraceError::Panicked { job: Box::new(job) });
                };
                // Without anything that moves it takes no time.
                let pose_ms = posed.as_ref().map_or(0.0, |_| from.elapsed().as_secs_f64() * 1e3);
                Progress::Cpu { next_row: 0, cost: TraceCost { pose_ms, ..TraceCost::default() }, posed }
            }
            Self::Lost => Progress::Cpu { next_row: 0, cost: TraceCost::default(), posed: None },
        };
        Ok(PartialFrame { job, rows_per_part, progress })
    }

    /// Submits the next part, or traces it on the processor. Errors if the device has failed or the work panics.
    pub(super) fn advance(&mut self, frame: PartialFrame) -> Result<Advance, TraceError> {
        let rows = frame.next_rows();
        let PartialFrame { mut job, rows_per_part, progress } = frame;
        match (self, progress) {
            (Self::Device { backend, in_flight }, Progress::Device(rest)) => {
                match catch_unwind(AssertUnwindSafe(|| backend.submit_part(rest, rows_per_part))) {
                    Ok(Ok(Some(rest))) => {
                        Ok(Advance::Partial(PartialFrame { job, rows_per_part, progress: Progress::Device(rest) }))
                    }
                    Ok(Ok(None)) => {
                        in_flight.push_back(job);
                        Ok(Advance::InFlight)
                    }
                    Ok(Err(error)) => Err(TraceError::Device { error, job: Some(Box::new(job)) }),
                    Err(_) => Err(TraceError::Panicked { job: Box::new(job) }),
                }
            }
            (Self::Cpu(backend), Progress::Cpu { cost, posed, .. }) => {
                let next_row = rows.end;
                let (camera, mask, posed_now) = (&job.request.camera, &mut job.mask, posed.as_deref());
                let trace = || backend.trace_rows(camera, mask, rows, posed_now);
                let Ok(part) = catch_unwind(AssertUnwindSafe(trace)) else {
                    return Err(TraceError::Panicked { job: Box::new(job) });
                };
                let cost = cost.plus(part);
                if next_row == job.mask.shape().tiles_y() {
                    return Ok(Advance::Traced(job, cost));
                }
                Ok(Advance::Partial(PartialFrame {
                    job,
                    rows_per_part,
                    progress: Progress::Cpu { next_row, cost, posed },
                }))
            }
            _ => {
                let error = BackendError::Device("the device is not open".to_owned());
                Err(TraceError::Device { error, job: Some(Box::new(job)) })
            }
        }
    }

    /// Waits up to `patience` for the oldest submission. Errors if the device has failed.
    pub(super) fn wait(&mut self, patience: Duration) -> Result<(), BackendError> {
        let Self::Device { backend, .. } = self else { return Ok(()) };
        // The host reads a long mask piece by piece, without waiting between pieces.
        let patience = if backend.has_landed()? { Duration::ZERO } else { patience };
        backend.wait(patience)
    }

    /// Returns whether the oldest frame in flight is in the host's memory. Errors if the device has failed.
    pub(super) fn has_landed(&self) -> Result<bool, BackendError> {
        match self {
            Self::Device { backend, .. } => backend.has_landed(),
            Self::Cpu(_) | Self::Lost => Ok(false),
        }
    }

    /// How long the device has worked on its oldest submission, and the session of the oldest frame in flight.
    pub(super) fn at_work(&self) -> (Duration, Option<SessionKey>) {
        match self {
            Self::Device { backend, in_flight } => (backend.at_work_for(), in_flight.front().map(|job| job.session)),
            Self::Cpu(_) | Self::Lost => (Duration::ZERO, None),
        }
    }

    /// Returns the oldest frame in flight if it has landed. Errors if the device has failed or the work panics.
    pub(super) fn collect(&mut self) -> Result<Option<(Job, TraceCost)>, TraceError> {
        let Self::Device { backend, in_flight } = self else { return Ok(None) };
        let Some(job) = in_flight.front_mut() else { return Ok(None) };
        let collected = catch_unwind(AssertUnwindSafe(|| backend.collect(Duration::ZERO, &mut job.mask)));
        match collected {
            Ok(Ok(None)) => Ok(None),
            Ok(Ok(Some(cost))) => Ok(in_flight.pop_front().map(|job| (job, cost))),
            Ok(Err(error)) => Err(error.into()),
            Err(_) => in_flight.pop_front().map_or(Ok(None), |job| Err(TraceError::Panicked { job: Box::new(job) })),
        }
    }

    /// Drops the device. Returns the jobs whose frames were in flight, oldest first. A device that does not answer may
    /// never finish to be dropped, so that happens on a thread of its own, which is waited for only a while.
    pub(super) fn lose(&mut self) -> VecDeque<Job> {
        match std::mem::replace(self, Self::Lost) {
            Self::Device { backend, in_flight } => {
                let (done, dropped) = sync_channel::<()>(1);
                let dropping = std::thread::Builder::new().name("gnomon-drop-device".to_owned()).spawn(move || {
                    drop(backend);
                    drop(done);
                });
                let waited = dropping.map(|_| dropped.recv_timeout(DROP_PATIENCE));
                if matches!(waited, Ok(Err(RecvTimeoutError::Timeout))) {
                    tracing::error!("the lost device does not close; its memory stays taken");
                }
                in_flight
            }
            Self::Cpu(_) | Self::Lost => VecDeque::new(),
        }
    }

    /// Traces a whole mask of the scene in this state. `None` if the device is lost. Errors if the device has
    /// failed or frames are in flight.
    pub(super) fn trace(
        &mut self,
        camera: &Camera,
        scene: &SceneAt,
        mask: &mut Mask,
    ) -> Result<Option<TraceCost>, BackendError> {
        match self {
            Self::Device { backend, .. } => backend.trace_at(camera, scene, mask).map(Some),
            Self::Cpu(backend) => Ok(Some(backend.trace_at(camera, scene, mask))),
            Self::Lost => Ok(None),
        }
    }

    /// Returns whether [`Self::advance`] waits until the part is traced.
    pub(super) fn is_synchronous(&self) -> bool {
        !matches!(self, Self::Device { .. })
    }

    /// Returns whether the back end can continue after a panic. The CPU's does not change its own state while it
    /// traces. The state of a device's queue is unknown.
    pub(super) fn survives_panics(&self) -> bool {
        matches!(self, Self::Cpu(_))
    }

    /// Returns `None` if nothing limits how many frames may begin.
    pub(super) fn load(&mut self) -> Option<DeviceLoad> {
        let Self::Device { backend, in_flight } = self else { return None };
        Some(DeviceLoad {
            free_slots: backend.free_slots(),
            in_flight: in_flight.len(),
            submissions: backend.submissions_open(),
        })
    }

    /// Returns whether masks of this shape fit the present buffers.
    pub(super) fn fits(&self, shape: MaskShape) -> bool {
        match self {
            Self::Device { backend, .. } => backend.fits(shape),
            Self::Cpu(_) | Self::Lost => true,
        }
    }

    /// Resizes the buffers to just fit these shapes, losing any frames in flight. Errors if the device has too little
    /// memory: then it has no buffers at all.
    pub(super) fn fit(&mut self, shapes: impl IntoIterator<Item = MaskShape>) -> Result<(), BackendError> {
        match self {
            Self::Device { backend, .. } => backend.fit(shapes),
            Self::Cpu(_) | Self::Lost => Ok(()),
        }
    }

    /// The device completes nothing any more, and is given up after `patience`.
    #[cfg(any(test, feature = "faults"))]
    pub(super) fn stop_answering(&mut self, patience: Duration) {
        if let Self::Device { backend, .. } = self {
            backend.stop_answering(patience);
        }
    }

    /// Destroys the device, like a real loss.
    #[cfg(any(test, feature = "faults"))]
    pub(super) fn destroy_device(&self) {
        if let Self::Device { backend, .. } = self {
            backend.destroy_device();
        }
    }
}
