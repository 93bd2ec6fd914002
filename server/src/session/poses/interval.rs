//! The smoothed time between poses, after which a mask is due.

use std::time::{Duration, Instant};

use gnomon_protocol::average::smoothed;

#[derive(Debug)]
pub(super) struct PoseInterval {
    last_at: Instant,
    smoothed: Duration,
}

impl PoseInterval {
    /// For a client that sends poses rarely, or has paused.
    const MAX: Duration = Duration::from_millis(250);

    pub(super) const fn new(now: Instant) -> Self {
        Self { last_at: now, smoothed: Self::MAX }
    }

    /// Counts a pose, and returns the smoothed interval.
    pub(super) fn update(&mut self, now: Instant) -> Duration {
        let sample = now.saturating_duration_since(self.last_at).min(Self::MAX);
        self.last_at = now;
        self.smoothed = smoothed(self.smoothed, sample);
        self.smoothed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_converges_and_is_bounded() {
        let start = Instant::now();
        let mut interval = PoseInterval::new(start);
        let mut found = Duration::ZERO;
        for pose in 1..=60 {
            found = interval.update(start + Duration::from_millis(16) * pose);
        }
        assert!(found > Duration::from_millis(16) && found < Duration::from_millis(17), "{found:?}");
        assert!(interval.update(start + Duration::from_secs(3600)) <= PoseInterval::MAX);
    }
}
