//! Paces the bytes of the scene within the network budget. Masks go first: fetches share what the sessions leave.

use std::time::{Duration, Instant};

/// Share of the budget that fetches have at least, so that a busy server still admits clients. While there are fetches,
/// sessions cannot reserve it.
pub(super) const SCENE_SHARE: f64 = 0.1;

/// Fetches count as going on for this long after their last chunk.
const ACTIVE_FOR: Duration = Duration::from_secs(1);

/// When the next chunk may go, over all sessions. Pure: time is an argument.
#[derive(Debug, Default)]
pub(super) struct ScenePace {
    next_at: Option<Instant>,
    used_at: Option<Instant>,
}

impl ScenePace {
    /// Takes the time for a chunk at a rate in Mbit/s. Returns when the chunk after it may go.
    pub(super) fn take(&mut self, bytes: usize, mbit_per_s: f64, now: Instant) -> Instant {
        #[expect(clippy::cast_precision_loss, reason = "a chunk's bytes")]
        let seconds = bytes as f64 * 8e-6 / mbit_per_s;
        let start = self.next_at.map_or(now, |next| next.max(now));
        let next = start + Duration::try_from_secs_f64(seconds).unwrap_or(ACTIVE_FOR);
        (self.next_at, self.used_at) = (Some(next), Some(now));
        next
    }

    pub(super) fn is_active(&self, now: Instant) -> bool {
        self.next_at.is_some_and(|next| next > now)
            || self.used_at.is_some_and(|used| now.saturating_duration_since(used) < ACTIVE_FOR)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_fetches_together_keep_the_rate() {
        let (mut pace, start) = (ScenePace::default(), Instant::now());
        assert!(!pace.is_active(start));
        // Two fetches of 1 Mbit a chunk at 10 Mbit/s, each waiting for its own time.
        let mut due = [start; 2];
        for chunk in 0..20 {
            let fetch = chunk % 2;
            due[fetch] = pace.take(125_000, 10.0, due[fetch]);
        }
        let took = due[1] - start;
        assert!(took.abs_diff(Duration::from_secs(2)) < Duration::from_millis(1), "{took:?}");
        assert!(pace.is_active(due[1]) && !pace.is_active(due[1] + ACTIVE_FOR));
    }
}
