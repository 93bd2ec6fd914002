//! A session on the engine's thread, and its demand for the scheduler.

use std::time::{Duration, Instant};

use crate::visibility::{
    engine::{shared::PendingSession, tracer::PartialFrame},
    schedule::{parts, scheduler::Demand},
};

/// How long the shortest frame cost among the sessions is remembered.
const THRESHOLD_LASTS: Duration = Duration::from_millis(10);

pub(super) struct ActiveSession {
    pub(super) opened: PendingSession,
    /// Due time of the mask that it waits for.
    pub(super) due: Option<Instant>,
    /// Its frame that is being traced in parts.
    pub(super) partial: Option<PartialFrame>,
}

/// What the device has room for now.
#[derive(Debug, Clone, Copy)]
pub(super) struct Room {
    /// A whole frame.
    pub(super) whole: bool,
    /// The first part of a frame.
    pub(super) first_part: bool,
    pub(super) next_part: bool,
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
        Self { opened, due: None, partial: None }
    }

    pub(super) fn is_closed(&self) -> bool {
        self.opened.port.is_closed()
    }

    /// Returns the work that it waits for, if any. A newer pose does not move the due time of an earlier request.
    pub(super) fn demand(&mut self, room: Room) -> Option<Demand> {
        if let Some(partial) = &self.partial {
            return Some(Demand { due: partial.job.due, resumes: true, fits: room.next_part });
        }
        let port = &self.opened.port;
        let newest = port.newest.has_changed().unwrap_or(false);
        if (!newest && self.opened.retry.is_none()) || port.masks.capacity() == 0 {
            return None;
        }
        let request = port.newest.borrow().or(self.opened.retry)?;
        let due = *self.due.get_or_insert(request.received_at + request.interval);
        let split = self.opened.costs.expected_ms() > room.split_above_ms;
        Some(Demand { due, resumes: false, fits: if split { room.first_part } else { room.whole } })
    }
}
