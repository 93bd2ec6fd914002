//! The wall clock, and one that does not step.
//!
//! The wall clock is right and may step, by hours when somebody sets it: so it is asked only where something is compared with a date that
//! people wrote (tokens, certificates) or that others read (reports). All that is waited for or measured goes by [`std::time::Instant`].

use std::time::{Instant, SystemTime};

/// The date and time.
pub(crate) fn wall() -> SystemTime {
    #[cfg(any(test, feature = "faults"))]
    return step::applied(SystemTime::now());
    #[cfg(not(any(test, feature = "faults")))]
    SystemTime::now()
}

/// Gives the time of its making, and what has passed since: for what must not end because somebody sets the clock.
#[derive(Debug)]
pub(crate) struct SteadyClock(SystemTime, Instant);

impl SteadyClock {
    pub(crate) fn new() -> Self {
        Self(wall(), Instant::now())
    }
}

impl quinn_proto::TimeSource for SteadyClock {
    fn now(&self) -> SystemTime {
        self.0 + self.1.elapsed()
    }
}

/// Somebody sets the clock: for tests.
#[cfg(any(test, feature = "faults"))]
pub mod step {
    use std::{
        sync::atomic::{AtomicI64, Ordering},
        time::{Duration, SystemTime},
    };

    static STEP_S: AtomicI64 = AtomicI64::new(0);

    /// From now on this process's wall clock is so many seconds ahead.
    pub fn set(ahead_s: i64) {
        STEP_S.store(ahead_s, Ordering::Release);
    }

    pub(super) fn applied(now: SystemTime) -> SystemTime {
        let ahead_s = STEP_S.load(Ordering::Acquire);
        let by = Duration::from_secs(ahead_s.unsigned_abs());
        if ahead_s < 0 { now.checked_sub(by) } else { now.checked_add(by) }.unwrap_or(now)
    }
}
