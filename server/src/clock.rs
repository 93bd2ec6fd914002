//! The wall clock, and a clock that does not step.
//!
//! The wall clock steps when someone sets it, so it serves only for dates that people write (tokens, certificates) or
//! read (reports). All waiting and measuring uses [`std::time::Instant`].

use std::time::{Instant, SystemTime, UNIX_EPOCH};

use time::OffsetDateTime;

pub(crate) fn wall() -> SystemTime {
    #[cfg(any(test, feature = "faults"))]
    return step::applied(SystemTime::now());
    #[cfg(not(any(test, feature = "faults")))]
    SystemTime::now()
}

/// Returns a time for people, such as 2026-11-29T18:00:00Z.
pub(crate) fn utc(at: SystemTime) -> String {
    let seconds = at.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
    let at = i64::try_from(seconds).ok().and_then(|seconds| OffsetDateTime::from_unix_timestamp(seconds).ok());
    let shown = |at: OffsetDateTime| {
        let (hour, minute, second) = at.to_hms();
        format!("{}T{hour:02}:{minute:02}:{second:02}Z", at.date())
    };
    at.map(shown).unwrap_or_default()
}

/// Wall time at its creation plus the elapsed time. Setting the clock does not affect it.
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

#[cfg(any(test, feature = "faults"))]
pub mod step {
    use std::{
        sync::atomic::{AtomicI64, Ordering},
        time::{Duration, SystemTime},
    };

    static STEP_S: AtomicI64 = AtomicI64::new(0);

    /// Moves this process's wall clock ahead by `ahead_s` seconds.
    pub fn set(ahead_s: i64) {
        STEP_S.store(ahead_s, Ordering::Release);
    }

    pub(super) fn applied(now: SystemTime) -> SystemTime {
        let ahead_s = STEP_S.load(Ordering::Acquire);
        let by = Duration::from_secs(ahead_s.unsigned_abs());
        if ahead_s < 0 { now.checked_sub(by) } else { now.checked_add(by) }.unwrap_or(now)
    }
}
