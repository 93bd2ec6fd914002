//! The rounds of the engine's thread: new sessions, work, waiting for the device.

use std::{
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

use super::state::Worker;
#[cfg(any(test, feature = "faults"))]
use crate::visibility::{backend::BackendError, engine::faults::Fault};
use crate::visibility::{backend::compute::RING_FRAMES, engine::tracer::TraceError};

/// How long the thread waits for the device before it checks for new poses, while another frame may begin. A frame
/// takes a GPU milliseconds, so polling costs little time and few wake-ups, and none when nothing is in flight.
const POLL: Duration = Duration::from_micros(500);

/// How long it waits when the ring is full: no frame may begin, but it must notice a shutdown.
const FULL_RING_WAIT: Duration = Duration::from_millis(100);

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
        let may_begin = load.is_some_and(|load| load.in_flight < RING_FRAMES);
        self.land(if may_begin { POLL } else { FULL_RING_WAIT })
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
                    self.land(FULL_RING_WAIT)?;
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
