//! Work on frames: begin one for the newest pose of the session whose turn it is, advance it, deliver it.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    time::{Duration, Instant},
};

use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::camera::Camera;

use super::{session::Room, state::Worker};
#[cfg(any(test, feature = "faults"))]
use crate::visibility::engine::faults::Fault;
use crate::visibility::{
    TraceCost, TraceRequest, TracedMask,
    backend::compute::RING_FRAMES,
    engine::{
        shared::PendingSession,
        tracer::{Advance, Job, PartialFrame, TraceError},
    },
    schedule::{parts, scheduler::SessionKey},
};

/// No part is added to this many submissions. The second keeps the device busy until the worker sees the first end.
const PARTS_IN_FLIGHT: usize = 2;

impl Worker {
    /// Does the next piece of work that fits the device: a whole frame, the first part of a frame, or a further part.
    /// Returns whether there was one.
    pub(super) fn work(&mut self) -> Result<bool, TraceError> {
        loop {
            let (room, now) = (self.room(), Instant::now());
            let sessions = &mut self.sessions;
            let next = self.scheduler.next(|key| sessions.get_mut(&key).and_then(|session| session.demand(room, now)));
            let Some(key) = next else { return Ok(false) };
            let Some(session) = self.sessions.get_mut(&key) else { continue };
            if let Some(partial) = session.partial.take() {
                self.advance(partial)?;
                return Ok(true);
            }
            match catch_unwind(AssertUnwindSafe(|| self.next_job(key))) {
                Ok(Some(job)) => {
                    self.begin(job, room)?;
                    return Ok(true);
                }
                Ok(None) => {}
                Err(_) => self.close_panicked(key),
            }
        }
    }

    fn room(&mut self) -> Room {
        let active = self.sessions.values().map(|session| session.opened.costs.need()).filter(|need| need.active);
        let split_above_ms = self.split_threshold.get(active.map(|need| need.cost_ms));
        let background_part = !self.sessions.values().any(|session| session.partial.is_some() && session.in_background);
        let Some(load) = self.tracer.load() else {
            return Room { whole: true, first_part: true, next_part: true, background_part, split_above_ms };
        };
        let next_part = load.submissions < PARTS_IN_FLIGHT;
        let interrupted = self.sessions.values().any(|session| session.partial.is_some());
        Room {
            // Whole frames wait for the same room as the parts of an interrupted frame, so that the scheduler chooses
            // between them. With more room than parts have, they would always overtake it.
            whole: load.in_flight < RING_FRAMES && load.free_slots > 0 && (next_part || !interrupted),
            // Leaves a slot for every frame that may be in flight, however many are interrupted.
            first_part: load.free_slots > 0 && load.free_slots + load.in_flight > RING_FRAMES,
            next_part,
            background_part,
            split_above_ms,
        }
    }

    /// Returns the job for a session's newest pose, or `None` if there is nothing to trace.
    fn next_job(&mut self, key: SessionKey) -> Option<Job> {
        #[cfg(any(test, feature = "faults"))]
        self.panic_on_demand();
        let session = self.sessions.get_mut(&key)?;
        let due = session.due.take();
        let in_background = session.is_background(Instant::now());
        let PendingSession { shape: largest, port, costs, retry, .. } = &mut session.opened;
        // Only this thread takes permits, so a free one stays free unless the port closes.
        let permit = port.masks.clone().try_reserve_owned();
        let lost = retry.take().filter(|_| !port.newest.has_changed().unwrap_or(false));
        let (was_lost, newest) = (lost.is_some(), port.newest.borrow_and_update().clone());
        let (Ok(permit), Some(request)) = (permit, lost.or(newest)) else { return None };
        let Some(shape) = shape_within(*largest, &request.camera) else {
            tracing::warn!(engine_session = key, camera = ?request.camera, ?largest, "dropped a pose of a larger size");
            return None;
        };
        costs.record_begin(request.received_at.elapsed());
        let now = Instant::now();
        session.in_background = !was_lost && in_background;
        if !was_lost {
            session.pace.take(now);
        }
        let mask = port.used.try_iter().find(|mask| mask.shape() == shape).unwrap_or_else(|| Mask::new(shape));
        let due = due.unwrap_or(request.received_at + request.interval);
        Some(Job { session: key, request, due, mask, permit })
    }

    /// Begins a frame, and traces all of it unless it is split.
    fn begin(&mut self, job: Job, room: Room) -> Result<(), TraceError> {
        let (key, shape) = (job.session, job.mask.shape());
        let expected_ms = self.sessions.get(&key).map_or(0.0, |session| session.opened.costs.expected_ms());
        let split = expected_ms > room.split_above_ms;
        let rows_per_part = if split { parts::rows_per_part(shape, expected_ms) } else { u32::MAX };
        self.scheduler.started(key);
        let frame = self.tracer.begin(job, rows_per_part)?;
        match self.sessions.get_mut(&key) {
            Some(session) if split => session.partial = Some(frame),
            _ => self.advance(frame)?,
        }
        Ok(())
    }

    fn advance(&mut self, frame: PartialFrame) -> Result<(), TraceError> {
        let key = frame.job.session;
        self.scheduler.charge(key, frame.next_share());
        match self.tracer.advance(frame)? {
            Advance::Partial(frame) => {
                if let Some(session) = self.sessions.get_mut(&key) {
                    session.partial = Some(frame);
                }
            }
            Advance::InFlight => {}
            Advance::Traced(job, cost) => self.deliver(job, cost),
        }
        Ok(())
    }

    /// Waits up to `patience` for the oldest submission, then delivers all completed frames. Returns whether there was
    /// one, or a piece of one.
    pub(super) fn land(&mut self, patience: Duration) -> Result<bool, TraceError> {
        self.tracer.wait(patience)?;
        let mut landed = self.tracer.has_landed()?;
        while let Some((job, cost)) = self.tracer.collect()? {
            self.deliver(job, cost);
            landed = true;
        }
        Ok(landed)
    }

    fn deliver(&mut self, job: Job, cost: TraceCost) {
        self.losses_in_a_row = 0;
        self.scheduler.finished(job.session, cost.device_ms());
        // A processor hardly slows down between masks, and other work disturbs its times.
        let rests = !self.tracer.is_synchronous();
        let now = Instant::now();
        let busy_ms = if rests { self.price.planned_ms(&cost, now) } else { cost.device_ms() };
        self.shared.model.learn(job.mask.shape().pixels(), busy_ms);
        if let Some(session) = self.sessions.get_mut(&job.session) {
            let planned_ms = if rests { session.dearest.plan_ms(busy_ms, now) } else { busy_ms };
            session.opened.costs.record_end(&cost, planned_ms);
        }
        let TraceRequest { frame, ahead, received_at, .. } = job.request;
        tracing::debug!(
            engine_session = job.session,
            frame = frame.0,
            pose_ms = cost.pose_ms,
            primary_ms = cost.primary_ms,
            shadow_ms = cost.shadow_ms,
            readback_ms = cost.readback_ms,
            primary_listed = cost.primary_listed,
            shadow_rays = cost.shadow_rays,
            rays_proven_lit = cost.shares.proven_lit,
            rays_proven_dark = cost.shares.proven_dark,
            rays_listed = cost.shares.listed,
            rays_traced = cost.shares.traced,
            age_ms = received_at.elapsed().as_secs_f64() * 1e3,
            "mask traced"
        );
        job.permit.send(TracedMask { frame, mask: job.mask, ahead, received_at, cost });
    }

    #[cfg(any(test, feature = "faults"))]
    #[expect(clippy::panic, reason = "a fault on demand")]
    fn panic_on_demand(&self) {
        if self.shared.faults.take(Fault::Panic) {
            panic!("on demand");
        }
    }
}

/// The shape of a mask for this camera, or `None` if it exceeds the session's largest.
fn shape_within(largest: MaskShape, camera: &Camera) -> Option<MaskShape> {
    let fits = camera.width <= largest.width() && camera.height <= largest.height();
    MaskShape::new(camera.width, camera.height, largest.lights()).ok().filter(|_| fits)
}
