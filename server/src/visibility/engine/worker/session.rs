//! A session on the engine's thread, and its demand for the scheduler.

use std::time::{Duration, Instant};

use crate::visibility::{
    TraceRequest,
    engine::{shared::PendingSession, tracer::PartialFrame},
    schedule::{dearest::DearestView, pace::Pace, parts, scheduler::Demand},
};

/// How long the shortest frame cost among the sessions is remembered.
const THRESHOLD_LASTS: Duration = Duration::from_millis(10);

/// How long a session counts as greedy after it asked for more than it declared.
const GREEDY_FOR: Duration = Duration::from_secs(2);

pub(super) struct ActiveSession {
    pub(super) opened: PendingSession,
    /// Due time of the mask that it waits for.
    pub(super) due: Option<Instant>,
    /// Its frame that is being traced in parts.
    pub(super) partial: Option<PartialFrame>,
    /// The frame being traced in parts is background work.
    pub(super) in_background: bool,
    pub(super) pace: Pace,
    pub(super) dearest: DearestView,
    /// When its pace last held a request back, although it had declared a rate.
    held_back_at: Option<Instant>,
}

/// What the device has room for now.
#[derive(Debug, Clone, Copy)]
pub(super) struct Room {
    /// A whole frame.
    pub(super) whole: bool,
    /// The first part of a frame.
    pub(super) first_part: bool,
    pub(super) next_part: bool,
    /// The first part of a background frame. One of them at a time, so that they leave buffers to other frames.
    pub(super) background_part: bool,
    /// Cost above which a frame is split, in milliseconds.
    pub(super) split_above_ms: f64,
}

/// Cost above which frames are split, remembered for [`THRESHOLD_LASTS`].
#[derive(Debug, Default)]
pub(super) struct SplitThreshold {
    found: Option<(Instant, f64)>,
}

impl SplitThreshold {
    /// Call it when sessions come or go.
    pub(super) fn forget(&mut self) {
        self.found = None;
    }

    /// The threshold in milliseconds, from the frame costs of the active sessions.
    pub(super) fn get(&mut self, costs_ms: impl Iterator<Item = f64>) -> f64 {
        match self.found {
            Some((at, threshold_ms)) if at.elapsed() < THRESHOLD_LASTS => threshold_ms,
            _ => {
                let threshold_ms = parts::split_above_ms(costs_ms.fold(f64::INFINITY, f64::min));
                self.found = Some((Instant::now(), threshold_ms));
                threshold_ms
            }
        }
    }
}

impl ActiveSession {
    pub(super) fn new(opened: PendingSession) -> Self {
        let pace = Pace::new(opened.costs.rate_hz(), Instant::now());
        let dearest = DearestView::default();
        Self { opened, due: None, partial: None, in_background: false, pace, dearest, held_back_at: None }
    }

    pub(super) fn is_closed(&self) -> bool {
        self.opened.port.is_closed()
    }

    /// Returns the work that it waits for, if any. A newer pose does not move the due time of an earlier request.
    pub(super) fn demand(&mut self, room: Room, now: Instant) -> Option<Demand> {
        if let Some(partial) = &self.partial {
            let background = self.in_background;
            return Some(Demand { due: partial.job.due, resumes: true, fits: room.next_part, background });
        }
        if !self.request_waits() {
            return None;
        }
        // Beyond its pace, a session with a declared rate waits, and one without takes what others leave.
        if self.opened.costs.rate_hz().is_some() && !self.pace_wait(now).is_zero() {
            self.held_back_at = Some(now);
            return None;
        }
        let due_at = |request: &TraceRequest| request.received_at + request.interval;
        let newest = self.opened.port.newest.borrow().as_ref().map(due_at);
        let due_at = newest.or(self.opened.retry.as_ref().map(due_at))?;
        let due = *self.due.get_or_insert(due_at);
        let background = self.is_background(now);
        let fits = match (self.opened.costs.expected_ms() > room.split_above_ms, background) {
            (false, _) => room.whole,
            (true, false) => room.first_part,
            (true, true) => room.first_part && room.background_part,
        };
        Some(Demand { due, resumes: false, fits, background })
    }

    /// How long its request must wait for its pace. `None` if it has no request that only its pace holds back.
    pub(super) fn held_back(&self, now: Instant) -> Option<Duration> {
        let wait = self.pace_wait(now);
        (self.partial.is_none() && !wait.is_zero() && self.request_waits()).then_some(wait)
    }

    /// A session that asks for more than it declared takes what others leave, too, until it stops for a while:
    /// otherwise many such sessions, whose turns come at the same time, would make honest ones late.
    pub(super) fn is_background(&self, now: Instant) -> bool {
        let greedy = self.held_back_at.is_some_and(|at| now.saturating_duration_since(at) < GREEDY_FOR);
        greedy || !self.pace_wait(now).is_zero()
    }

    fn request_waits(&self) -> bool {
        let port = &self.opened.port;
        let newest = port.newest.has_changed().unwrap_or(false);
        (newest || self.opened.retry.is_some()) && port.masks.capacity() > 0
    }

    /// A request whose trace was lost with its device has had its turn already.
    fn pace_wait(&self, now: Instant) -> Duration {
        if self.opened.retry.is_some() { Duration::ZERO } else { self.pace.wait(now) }
    }
}
