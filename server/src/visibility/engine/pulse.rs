//! Signs of life of an engine's thread. A driver call that never returns stops them.

use std::{
    sync::atomic::{AtomicU64, Ordering},
    time::{Duration, Instant},
};

/// The thread has nothing to do, and waits to be woken.
const RESTS: u64 = u64::MAX;

#[derive(Debug)]
pub(super) struct Pulse {
    born: Instant,
    /// Milliseconds from `born` to the last round, or [`RESTS`].
    last_ms: AtomicU64,
}

impl Default for Pulse {
    fn default() -> Self {
        Self { born: Instant::now(), last_ms: AtomicU64::new(RESTS) }
    }
}

impl Pulse {
    /// A round begins.
    pub(super) fn beat(&self) {
        let now_ms = u64::try_from(self.born.elapsed().as_millis()).unwrap_or(RESTS - 1);
        self.last_ms.store(now_ms, Ordering::Release);
    }

    pub(super) fn rest(&self) {
        self.last_ms.store(RESTS, Ordering::Release);
    }

    /// How long the current round has lasted; zero while the thread rests.
    pub(super) fn silent_for(&self) -> Duration {
        match self.last_ms.load(Ordering::Acquire) {
            RESTS => Duration::ZERO,
            last_ms => self.born.elapsed().saturating_sub(Duration::from_millis(last_ms)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_round_is_silence_and_rest_is_not() {
        let pulse = Pulse::default();
        let patience = Duration::from_millis(20);
        std::thread::sleep(patience);
        assert_eq!(pulse.silent_for(), Duration::ZERO);
        pulse.beat();
        std::thread::sleep(patience);
        assert!(pulse.silent_for() >= patience / 2);
        pulse.rest();
        assert_eq!(pulse.silent_for(), Duration::ZERO);
    }
}
