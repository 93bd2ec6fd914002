//! What a session's dearest view of late costs.
//!
//! A walk passes views that cost half of others. Planned with the view of the moment, a device takes in one session
//! more just when all look at a wall, and serves none of them well a second later.

use std::time::{Duration, Instant};

/// After this long, half of what a view cost beyond the present one is forgotten.
const HALF_LIFE: Duration = Duration::from_secs(30);

/// Weight of the newest mask in a view's cost, so that one odd mask is no dear view.
const NEWEST_SHARE: f64 = 0.125;

#[derive(Debug, Default)]
pub(crate) struct DearestView {
    now_ms: f64,
    /// The dearest, and when it was last aged.
    held: Option<(f64, Instant)>,
}

impl DearestView {
    /// Takes what a mask would cost a busy device, in milliseconds. Returns what to plan with: never less than the
    /// mean of the last masks.
    pub(crate) fn plan_ms(&mut self, mask_ms: f64, now: Instant) -> f64 {
        let Some((held_ms, at)) = self.held else {
            self.now_ms = mask_ms;
            self.held = Some((mask_ms, now));
            return mask_ms;
        };
        self.now_ms += (mask_ms - self.now_ms) * NEWEST_SHARE;
        let left = (-now.saturating_duration_since(at).div_duration_f64(HALF_LIFE)).exp2();
        let held_ms = self.now_ms + (held_ms - self.now_ms).max(0.0) * left;
        self.held = Some((held_ms, now));
        held_ms
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dear_view_counts_on_while_the_session_looks_at_a_cheap_one() {
        let start = Instant::now();
        let mut view = DearestView::default();
        let mut planned_ms = 0.0;
        for mask in 0..600_u32 {
            planned_ms = view.plan_ms(if mask < 300 { 2.5 } else { 1.0 }, start + Duration::from_millis(10) * mask);
        }
        // Three seconds of the cheap one: 2^(−1/10) of the difference is left.
        assert!((planned_ms - (1.0 + 1.5 * 0.933)).abs() < 0.01, "{planned_ms}");
        let later = start + Duration::from_secs(300);
        assert!(view.plan_ms(1.0, later) < 1.01);
    }

    #[test]
    fn a_rising_cost_counts_at_once_and_one_odd_mask_hardly() {
        let start = Instant::now();
        let mut view = DearestView::default();
        assert_eq!(view.plan_ms(1.0, start), 1.0);
        assert_eq!(view.plan_ms(2.0, start), 1.125);
        let planned_ms = (0..40).fold(0.0, |_, _| view.plan_ms(2.0, start));
        assert!(planned_ms > 1.99, "{planned_ms}");
    }
}
