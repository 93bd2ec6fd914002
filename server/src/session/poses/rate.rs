//! Limits the datagrams of one client to [`MAX_POSES_PER_SECOND`].

use std::time::{Duration, Instant};

use crate::limits::MAX_POSES_PER_SECOND;

#[derive(Debug)]
pub(super) struct RateLimit {
    window_began_at: Instant,
    left: u32,
}

impl RateLimit {
    pub(super) const fn new(now: Instant) -> Self {
        Self { window_began_at: now, left: MAX_POSES_PER_SECOND }
    }

    /// Counts a datagram. Returns whether it is within the limit.
    pub(super) fn allows(&mut self, now: Instant) -> bool {
        if now.saturating_duration_since(self.window_began_at) >= Duration::from_secs(1) {
            *self = Self::new(now);
        }
        let allowed = self.left > 0;
        self.left = self.left.saturating_sub(1);
        allowed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_second_has_its_limit() {
        let start = Instant::now();
        let mut rate = RateLimit::new(start);
        let within = |rate: &mut RateLimit, at| (0..2 * MAX_POSES_PER_SECOND).filter(|_| rate.allows(at)).count();
        assert_eq!(within(&mut rate, start), MAX_POSES_PER_SECOND as usize);
        assert_eq!(within(&mut rate, start + Duration::from_millis(999)), 0);
        assert_eq!(within(&mut rate, start + Duration::from_secs(1)), MAX_POSES_PER_SECOND as usize);
    }
}
