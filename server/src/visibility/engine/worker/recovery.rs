//! Recovery from failures. A panic closes the session whose frame it was. When the device fails, its sessions move to
//! other engines or wait while the device, its pipelines and its buffers are rebuilt.

use std::{sync::atomic::Ordering, time::Duration};

use super::state::Worker;
use crate::visibility::{
    backend::BackendError,
    engine::{
        shared::PendingSession,
        tracer::{Job, TraceError},
    },
    schedule::scheduler::SessionKey,
};

/// Consecutive losses, without a traced mask in between, after which the worker gives up the device.
const MAX_LOSSES_IN_A_ROW: u32 = 3;

/// Time that a driver gets to recover before the next attempt.
const PAUSE: Duration = Duration::from_millis(100);

impl Worker {
    /// Recovers from a failure. Returns false if the device is given up.
    pub(super) fn recover(&mut self, failure: TraceError) -> bool {
        let (error, job) = match failure {
            TraceError::Device { error, job } => (error, job.map(|job| *job)),
            TraceError::Panicked { job } => {
                self.close_panicked(job.session);
                if self.tracer.survives_panics() {
                    return true;
                }
                (BackendError::Device("tracing panicked".to_owned()), None)
            }
        };
        self.shared.lost.store(true, Ordering::Release);
        self.shared.losses.fetch_add(1, Ordering::Relaxed);
        self.keep_lost_requests(job);
        let mut reason = error;
        loop {
            self.losses_in_a_row += 1;
            let (sessions, in_a_row) = (self.sessions.len(), self.losses_in_a_row);
            tracing::error!(error = %reason, sessions, in_a_row, "the device is lost");
            // The old device must be gone before a new one is opened.
            self.tracer.lose();
            self.move_sessions();
            if self.losses_in_a_row >= MAX_LOSSES_IN_A_ROW {
                tracing::error!(error = %reason, sessions = self.sessions.len(), "tracing has ended");
                self.shared.end(reason.to_string());
                return false;
            }
            if self.losses_in_a_row > 1 {
                std::thread::sleep(PAUSE);
            }
            match self.reopen() {
                Ok(()) => break,
                Err(error) => reason = error,
            }
        }
        self.shared.lost.store(false, Ordering::Release);
        tracing::warn!(sessions = self.sessions.len(), "the device is back");
        true
    }

    pub(super) fn close_panicked(&mut self, session: SessionKey) {
        tracing::error!(engine_session = session, "tracing panicked: the session is closed");
        self.close(session);
    }

    fn reopen(&mut self) -> Result<(), BackendError> {
        self.tracer = (self.open_again)()?;
        self.shrink_buffers()
    }

    /// Drops the device. Its frames are lost, but each session's newest request is kept and traced again unless a newer
    /// one comes. `job` is the affected job, newer than the same session's frames in flight.
    fn keep_lost_requests(&mut self, job: Option<Job>) {
        self.restart_partial_frames();
        self.scheduler.lost_all();
        let in_flight = self.tracer.lose();
        for job in job.into_iter().chain(in_flight.into_iter().rev()) {
            if let Some(session) = self.sessions.get_mut(&job.session) {
                session.opened.retry.get_or_insert(job.request);
            }
        }
    }

    /// Drops frames that are not wholly submitted. Their requests are traced again unless newer ones come.
    pub(super) fn restart_partial_frames(&mut self) {
        for (&key, session) in &mut self.sessions {
            if let Some(partial) = session.partial.take() {
                session.opened.retry = Some(partial.job.request);
                self.scheduler.abandoned(key);
            }
        }
    }

    /// Hands sessions to engines with working devices, as far as these accept them.
    fn move_sessions(&mut self) {
        self.remove_closed();
        let pending: Vec<PendingSession> = self.pending.try_iter().collect();
        let keys: Vec<SessionKey> = self.sessions.keys().copied().collect();
        let active = keys.into_iter().filter_map(|key| {
            self.scheduler.remove(key);
            self.sessions.remove(&key)
        });
        let all: Vec<PendingSession> = active.map(|session| session.opened).chain(pending).collect();
        for session in all {
            if let Some(session) = self.shared.hand_over(session) {
                self.insert(session);
            }
        }
    }
}
