//! The work on a frame: begun for the newest pose of the session whose turn it is, done whole or part by part, handed out.

use std::{
    ops::Range,
    panic::{AssertUnwindSafe, catch_unwind},
    time::{Duration, Instant},
};

use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::camera::Camera;
use tokio::sync::mpsc::OwnedPermit;

use super::{Backend, Opening, Seated, Worker};
use crate::visibility::{
    TraceCost, TraceRequest, TracedMask,
    backend::{
        BackendError,
        compute::{RING_FRAMES, Rest},
    },
    schedule::{
        parts,
        scheduler::{SessionKey, Wish},
    },
};

/// Submissions that may be in flight when a part is added to them. The second keeps the device busy until this thread has seen the end
/// of the first.
const PARTS_IN_FLIGHT: usize = 2;

/// For how long it is believed which session has the shortest frames.
const SHORTEST_LASTS: Duration = Duration::from_millis(10);

/// A frame that is being traced.
pub(super) struct Job {
    pub(super) session: SessionKey,
    pub(super) request: TraceRequest,
    mask: Mask,
    /// The place in the session's channel that the mask will take.
    place: OwnedPermit<TracedMask>,
}

/// A frame that is traced in parts, between two of them.
pub(super) struct Begun {
    pub(super) job: Job,
    due: Instant,
    rows_a_part: u32,
    progress: Progress,
}

enum Progress {
    Device(Rest),
    Processor { next_row: u32, cost: TraceCost },
}

/// What there is room for on the device.
#[derive(Debug, Clone, Copy)]
pub(super) struct Room {
    /// A frame that is traced whole.
    whole: bool,
    /// The beginning of one that is traced in parts.
    begin: bool,
    /// A part.
    part: bool,
    /// A frame that is expected to take longer is traced in parts, in milliseconds.
    longest_whole_ms: f64,
}

/// The longest frames that are traced whole now.
#[derive(Debug, Default)]
pub(super) struct LongestWhole {
    found: Option<(Instant, f64)>,
}

impl LongestWhole {
    /// Sessions have come or gone.
    pub(super) fn forget(&mut self) {
        self.found = None;
    }

    fn get(&mut self, sessions: impl Iterator<Item = f64>) -> f64 {
        match self.found {
            Some((at, longest_ms)) if at.elapsed() < SHORTEST_LASTS => longest_ms,
            _ => {
                let longest_ms = parts::longest_whole_ms(sessions.fold(f64::INFINITY, f64::min));
                self.found = Some((Instant::now(), longest_ms));
                longest_ms
            }
        }
    }
}

impl Seated {
    /// What it waits for, if for anything. When its mask is due stays so when a newer pose takes the older one's place.
    fn wish(&mut self, room: Room) -> Option<Wish> {
        if let Some(begun) = &self.begun {
            return Some(Wish { due: begun.due, rest: true, fits: room.part });
        }
        let port = &self.opening.port;
        let newest = port.newest.has_changed().unwrap_or(false);
        if (!newest && self.opening.retry.is_none()) || port.masks.capacity() == 0 {
            return None;
        }
        let request = port.newest.borrow().or(self.opening.retry)?;
        let due = *self.due.get_or_insert(request.received_at + request.interval);
        let long = self.opening.costs.expected_ms() > room.longest_whole_ms;
        Some(Wish { due, rest: false, fits: if long { room.begin } else { room.whole } })
    }
}

impl Worker {
    /// Does the next piece of work that there is room for: the beginning of a frame, a whole one, or a part. Whether there was one.
    pub(super) fn work(&mut self) -> Result<bool, BackendError> {
        loop {
            let room = self.room();
            let sessions = &mut self.sessions;
            let next = self.scheduler.next(|key| sessions.get_mut(&key).and_then(|session| session.wish(room)));
            let Some(key) = next else { return Ok(false) };
            let Some(session) = self.sessions.get_mut(&key) else { continue };
            if let Some(begun) = session.begun.take() {
                self.go_on(begun)?;
                return Ok(true);
            }
            match catch_unwind(AssertUnwindSafe(|| self.job(key))) {
                Ok(Some((job, due))) => {
                    self.begin(job, due, room)?;
                    return Ok(true);
                }
                Ok(None) => {}
                Err(_) => drop(self.panicked(key)),
            }
        }
    }

    fn room(&mut self) -> Room {
        let active = self.sessions.values().map(|session| session.opening.costs.need()).filter(|need| need.active);
        let longest_whole_ms = self.longest_whole.get(active.map(|need| need.cost_ms));
        match &mut self.backend {
            Backend::Compute(backend) => {
                let (slots, flying) = (backend.free_slots(), self.flying.len());
                let part = backend.submissions_open() < PARTS_IN_FLIGHT;
                let interrupted = self.sessions.values().any(|session| session.begun.is_some());
                Room {
                    // Whole frames wait for the same room as the parts of one that has begun, so that it is the scheduler who
                    // chooses: with more room than parts have they would go past it for ever.
                    whole: flying < RING_FRAMES && slots > 0 && (part || !interrupted),
                    // As many as may fly at once find a slot, however many are interrupted.
                    begin: slots > 0 && slots + flying > RING_FRAMES,
                    part,
                    longest_whole_ms,
                }
            }
            Backend::Cpu(_) | Backend::Gone => Room { whole: true, begin: true, part: true, longest_whole_ms },
        }
    }

    /// The work on a session's newest pose, and when it is due, unless there is nothing to be done after all.
    fn job(&mut self, key: SessionKey) -> Option<(Job, Instant)> {
        #[cfg(any(test, feature = "faults"))]
        self.panic_if_told();
        let session = self.sessions.get_mut(&key)?;
        let due = session.due.take();
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
        let job = Job { session: key, request, mask: used.unwrap_or_else(|| Mask::new(shape)), place };
        Some((job, due.unwrap_or(request.received_at + request.interval)))
    }

    /// Begins a frame, and traces all of it unless it is long.
    fn begin(&mut self, job: Job, due: Instant, room: Room) -> Result<(), BackendError> {
        let (key, shape, camera) = (job.session, job.mask.shape(), job.request.camera);
        let expected_ms = self.sessions.get(&key).map_or(0.0, |session| session.opening.costs.expected_ms());
        let long = expected_ms > room.longest_whole_ms;
        self.scheduler.started(key);
        let progress = match &mut self.backend {
            Backend::Compute(backend) => match backend.begin(&camera, shape) {
                Ok(rest) => Progress::Device(rest),
                Err(error) => {
                    self.flying.push_back(job);
                    return Err(error);
                }
            },
            Backend::Cpu(_) | Backend::Gone => Progress::Processor { next_row: 0, cost: TraceCost::default() },
        };
        let rows_a_part = if long { parts::rows_a_part(shape, expected_ms) } else { u32::MAX };
        let begun = Begun { job, due, rows_a_part, progress };
        match self.sessions.get_mut(&key) {
            Some(session) if long => session.begun = Some(begun),
            _ => self.go_on(begun)?,
        }
        Ok(())
    }

    /// Traces the next part of a frame.
    fn go_on(&mut self, begun: Begun) -> Result<(), BackendError> {
        let Begun { mut job, due, rows_a_part, progress } = begun;
        let (key, shape, camera) = (job.session, job.mask.shape(), job.request.camera);
        let share_of = |rows: &Range<u32>| f64::from(rows.end - rows.start) / f64::from(shape.tiles_y().max(1));
        match (&mut self.backend, progress) {
            (Backend::Compute(backend), Progress::Device(rest)) => {
                let share = share_of(&rest.next_rows(rows_a_part));
                let submitted = catch_unwind(AssertUnwindSafe(|| backend.submit_part(rest, rows_a_part)));
                self.scheduler.charge(key, share);
                let left = match submitted {
                    Ok(Ok(left)) => left,
                    Ok(Err(error)) => {
                        self.flying.push_back(job);
                        return Err(error);
                    }
                    // Nobody knows what state it left the device's queue in.
                    Err(_) => return Err(self.panicked(key)),
                };
                match (left, self.sessions.get_mut(&key)) {
                    (None, _) => self.flying.push_back(job),
                    (Some(rest), Some(session)) => {
                        session.begun = Some(Begun { job, due, rows_a_part, progress: Progress::Device(rest) });
                    }
                    (Some(_), None) => {}
                }
            }
            (Backend::Cpu(backend), Progress::Processor { next_row, cost }) => {
                let rows = next_row..next_row.saturating_add(rows_a_part).min(shape.tiles_y());
                // It changes nothing of its own while it traces, so a panic leaves nothing half done.
                let traced =
                    catch_unwind(AssertUnwindSafe(|| backend.trace_rows(&camera, &mut job.mask, rows.clone())));
                let Ok(part) = traced else {
                    drop(self.panicked(key));
                    return Ok(());
                };
                self.scheduler.charge(key, share_of(&rows));
                let cost = cost.plus(part);
                if rows.end == shape.tiles_y() {
                    self.finish(job, cost);
                } else if let Some(session) = self.sessions.get_mut(&key) {
                    let progress = Progress::Processor { next_row: rows.end, cost };
                    session.begun = Some(Begun { job, due, rows_a_part, progress });
                }
            }
            _ => {
                self.flying.push_back(job);
                return Err(BackendError::Device("it is not there".to_owned()));
            }
        }
        Ok(())
    }

    /// Waits up to `patience` for the oldest submission, then hands out all frames that have landed.
    pub(super) fn land(&mut self, patience: Duration) -> Result<(), BackendError> {
        if let Backend::Compute(backend) = &mut self.backend {
            // A long mask is read a piece at a time, and not waited for in between.
            let patience = if backend.has_landed()? { Duration::ZERO } else { patience };
            backend.wait(patience)?;
        }
        while let (Some(job), Backend::Compute(backend)) = (self.flying.front_mut(), &mut self.backend) {
            let session = job.session;
            let landed = catch_unwind(AssertUnwindSafe(|| backend.collect(Duration::ZERO, &mut job.mask)));
            let Ok(landed) = landed else { return Err(self.panicked(session)) };
            let Some(cost) = landed? else { break };
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

    /// Lets go of the frames that have begun and are not wholly submitted; their poses are traced anew, unless there are newer ones.
    pub(super) fn begin_anew(&mut self) {
        for (&key, session) in &mut self.sessions {
            if let Some(begun) = session.begun.take() {
                session.opening.retry = Some(begun.job.request);
                self.scheduler.abandoned(key);
            }
        }
    }
}

/// The shape of a mask for this camera, when it is no larger than the session's.
fn within(largest: MaskShape, camera: &Camera) -> Option<MaskShape> {
    let fits = camera.width <= largest.width() && camera.height <= largest.height();
    MaskShape::new(camera.width, camera.height, largest.lights()).ok().filter(|_| fits)
}
