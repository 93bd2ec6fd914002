//! When the device fails: its sessions move to another engine or stay, and the device, its pipelines and its buffers are made anew.

use std::{sync::atomic::Ordering, time::Duration};

use gnomon_protocol::mask::MaskShape;

use super::{Backend, BackendError, Opening, Worker};

/// A device that is lost so often without tracing a mask in between is not made anew again.
const MAX_LOSSES_IN_A_ROW: u32 = 3;

/// Time that a driver gets to come to itself before it is asked again.
const PAUSE: Duration = Duration::from_millis(100);

impl Worker {
    /// Goes on after a failure of the device. Whether there is a device to go on with is the answer.
    pub(super) fn recover(&mut self, error: BackendError) -> bool {
        self.shared.lost.store(true, Ordering::Release);
        self.shared.losses.fetch_add(1, Ordering::Relaxed);
        self.keep_lost_requests();
        let mut reason = error;
        loop {
            self.losses += 1;
            tracing::error!(error = %reason, sessions = self.sessions.len(), in_a_row = self.losses, "the device is lost");
            // What it was made of goes before anything new is asked for.
            self.backend = Backend::Gone;
            self.move_sessions();
            if self.losses >= MAX_LOSSES_IN_A_ROW {
                tracing::error!(error = %reason, sessions = self.sessions.len(), "tracing has ended");
                self.shared.end(reason.to_string());
                return false;
            }
            if self.losses > 1 {
                std::thread::sleep(PAUSE);
            }
            match self.open_again() {
                Ok(()) => break,
                Err(error) => reason = error,
            }
        }
        self.shared.lost.store(false, Ordering::Release);
        tracing::warn!(sessions = self.sessions.len(), "the device is back");
        true
    }

    fn open_again(&mut self) -> Result<(), BackendError> {
        self.backend = (self.reopen)()?;
        let shapes: Vec<MaskShape> = self.shapes().collect();
        match &mut self.backend {
            Backend::Compute(backend) => backend.fit(shapes),
            Backend::Cpu(_) | Backend::Gone => Ok(()),
        }
    }

    /// Frames in flight are lost; the poses that they were for are not, unless there are newer ones.
    fn keep_lost_requests(&mut self) {
        self.begin_anew();
        self.scheduler.lost_all();
        // The newest first: what had begun is newer still.
        for job in self.flying.drain(..).rev() {
            if let Some(session) = self.sessions.get_mut(&job.session) {
                session.opening.retry.get_or_insert(job.request);
            }
        }
    }

    /// Gives the sessions to engines whose devices are well, as far as these take them.
    fn move_sessions(&mut self) {
        self.remove_closed();
        let waiting: Vec<Opening> = self.openings.try_iter().collect();
        let keys: Vec<_> = self.sessions.keys().copied().collect();
        let seated = keys.into_iter().filter_map(|key| {
            self.scheduler.remove(key);
            self.sessions.remove(&key)
        });
        let all: Vec<Opening> = seated.map(|session| session.opening).chain(waiting).collect();
        for opening in all {
            if let Some(opening) = self.shared.hand_over(opening) {
                self.scheduler.insert(self.next_key, opening.costs.expected_ms());
                self.sessions.insert(self.next_key, super::Seated::new(opening));
                self.next_key += 1;
            }
        }
    }
}
