//! The rounds of the engine's thread: new sessions, work, waiting for the device.

use std::{
    ops::RangeInclusive,
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

use super::state::Worker;
#[cfg(any(test, feature = "faults"))]
use crate::visibility::{backend::BackendError, engine::faults::Fault};
use crate::visibility::{engine::tracer::TraceError, schedule::parts};

/// How long it waits for an empty ring at a time: it must notice a shutdown.
const EMPTY_RING_WAIT: Duration = Duration::from_millis(100);

/// Naps between two looks at the device.
const NAPS: RangeInclusive<Duration> = Duration::from_micros(100)..=Duration::from_millis(100);

/// A frame that takes longer than expected is looked at again after this share of the time that it has taken, and so
/// noticed late by at most that share.
const NAP_SHARE: u32 = 16;

impl Worker {
    /// Traces until the engine is stopped or gives up its device. Ports close when this returns.
    pub(in super::super) fn run(mut self) {
        while !self.shared.stop.load(Ordering::Acquire) {
            self.shared.pulse.beat();
            if let Err(error) = self.turn()
                && !self.recover(error)
            {
                return;
            }
        }
    }

    /// One round: does all work that is possible now, or else waits. `park` returns at once after a wake-up during the
    /// round, so no wake-up is lost.
    fn turn(&mut self) -> Result<(), TraceError> {
        #[cfg(any(test, feature = "faults"))]
        self.fail_on_demand()?;
        self.remove_closed();
        self.take_up_sessions()?;
        let mut worked = false;
        while self.work()? {
            worked = true;
            // Check between two parts for sessions that come, go or are stopped.
            if self.tracer.is_synchronous() {
                return Ok(());
            }
        }
        let load = self.tracer.load();
        let idle = load.as_ref().is_none_or(|load| load.in_flight == 0 && load.submissions == 0);
        if idle {
            if !worked {
                self.shrink_buffers()?;
                self.park();
            }
            return Ok(());
        }
        if !self.land(Duration::ZERO)? {
            self.nap();
        }
        Ok(())
    }

    /// Sleeps until the device should have finished its oldest frame, or its part of an interrupted one, or for a short
    /// time if that is over. A wake-up ends it. The driver's own waits are no better: short ones keep a core busy, long
    /// ones sleep through new poses.
    fn nap(&self) {
        let (at_work, session) = self.tracer.at_work();
        let expected_ms =
            session.and_then(|key| self.sessions.get(&key)).map_or(0.0, |it| it.opened.costs.expected_ms());
        // The device waits for the next part.
        let interrupted = self.sessions.values().any(|session| session.partial.is_some());
        let expected_ms = if interrupted { expected_ms.min(parts::PART_MS) } else { expected_ms };
        let left = Duration::from_secs_f64(expected_ms * 1e-3).saturating_sub(at_work);
        std::thread::park_timeout(left.max(at_work / NAP_SHARE).clamp(*NAPS.start(), *NAPS.end()));
    }

    /// Sleeps until something wakes the thread, or a session's pace lets its request begin.
    fn park(&self) {
        let now = Instant::now();
        self.shared.pulse.rest();
        match self.sessions.values().filter_map(|session| session.held_back(now)).min() {
            Some(wait) => std::thread::park_timeout(wait),
            None => std::thread::park(),
        }
        self.shared.pulse.beat();
    }

    pub(super) fn take_up_sessions(&mut self) -> Result<(), TraceError> {
        while let Ok(session) = self.pending.try_recv() {
            // A session that closes before this thread opens it does not wake the thread.
            if session.port.is_closed() {
                continue;
            }
            if !self.tracer.fits(session.shape) {
                // Larger buffers replace the ring, which must be empty.
                self.restart_partial_frames();
                while self.tracer.load().is_some_and(|load| load.in_flight > 0) {
                    self.land(EMPTY_RING_WAIT)?;
                }
                let shapes = self.shapes();
                if let Err(error) = self.tracer.fit(shapes.iter().copied().chain([session.shape])) {
                    tracing::warn!(%error, shape = ?session.shape, "no memory for a session");
                    // The other sessions fitted before. The new session's port closes as it is dropped here.
                    self.tracer.fit(shapes)?;
                    continue;
                }
            }
            let shape = session.shape;
            let key = self.insert(session);
            tracing::debug!(engine_session = key, ?shape, "session opened");
        }
        Ok(())
    }

    #[cfg(any(test, feature = "faults"))]
    fn fail_on_demand(&mut self) -> Result<(), BackendError> {
        if self.shared.faults.take(Fault::NoAnswer) {
            self.tracer.stop_answering(Duration::from_millis(100));
        }
        if self.shared.faults.take(Fault::StuckCall) {
            std::thread::sleep(Duration::from_secs(2));
        }
        if self.shared.faults.take(Fault::DeviceLost) {
            self.tracer.destroy_device();
            return Err(BackendError::Device("lost on demand".to_owned()));
        }
        Ok(())
    }
}
