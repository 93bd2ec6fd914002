//! The rate at which a session really works, for planning: what it declared counts only until it is measured.

use std::time::{Duration, Instant};

use parking_lot::Mutex;

use super::{capacity::IDLE_SHARE, pace::TOLERANCE};

/// A session counts with the rate that it declared for this long, and then with that of its last window.
const WINDOW: Duration = Duration::from_secs(10);

#[derive(Debug)]
pub(crate) struct MeasuredRate {
    declared_hz: f64,
    latest: Mutex<Latest>,
}

#[derive(Debug)]
struct Latest {
    since: Instant,
    count: u64,
    rate_hz: f64,
}

impl MeasuredRate {
    pub(crate) fn new(declared_hz: f64) -> Self {
        Self { declared_hz, latest: Mutex::new(Latest { since: Instant::now(), count: 0, rate_hz: declared_hz }) }
    }

    /// Returns the rate per second. `count` is the total so far.
    pub(crate) fn update(&self, count: u64) -> f64 {
        let mut latest = self.latest.lock();
        let elapsed = latest.since.elapsed();
        if elapsed >= WINDOW {
            #[expect(clippy::cast_precision_loss, reason = "masks of some seconds")]
            let rate_hz = count.saturating_sub(latest.count) as f64 / elapsed.as_secs_f64();
            *latest = Latest { since: Instant::now(), count, rate_hz };
        }
        latest.rate_hz
    }

    /// As [`Self::update`], within what the session may need: not less than an idle session's share, since it may wake,
    /// and not more than its pace allows.
    pub(crate) fn planned_hz(&self, count: u64) -> f64 {
        self.update(count).clamp(self.declared_hz * IDLE_SHARE, self.declared_hz * TOLERANCE)
    }

    /// Ends the window now.
    #[cfg(test)]
    pub(crate) fn end_window(&self, count: u64) {
        let mut latest = self.latest.lock();
        latest.since = Instant::now().checked_sub(WINDOW * 2).unwrap();
        latest.count = count;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_claim_counts_until_it_is_measured() {
        let rate = MeasuredRate::new(60.0);
        assert_eq!(rate.planned_hz(5), 60.0);
        rate.end_window(0);
        // 300 in 20 s.
        let measured = rate.planned_hz(300);
        assert!((14.0..=15.0).contains(&measured), "{measured}");
        rate.end_window(300);
        assert_eq!(rate.planned_hz(300), 6.0, "an idle session may wake");
        rate.end_window(300);
        assert_eq!(rate.planned_hz(100_000), 75.0, "its pace allows no more");
        assert!(rate.update(100_000) > 1000.0);
    }
}
