//! Measured cost of sessions on their device. The engine's thread writes it; admission and statistics read it.

use std::{
    sync::atomic::{AtomicBool, AtomicU64, Ordering},
    time::{Duration, Instant},
};

use gnomon_protocol::mask::MaskShape;

use super::{
    capacity::{LEAST_HZ, Need},
    measured_rate::MeasuredRate,
};
use crate::visibility::TraceCost;

/// A session without a request for this long is idle.
const IDLE_AFTER: Duration = Duration::from_secs(10);

/// Weight of the newest mask in the expected cost of the next.
const NEWEST_SHARE: f64 = 0.125;

/// Masks after which a session's cost is known.
const MEASURED_AFTER: u64 = 8;

/// Counters of one session. All but the expected cost only grow.
#[derive(Debug)]
pub struct SessionCosts {
    opened_at: Instant,
    left: AtomicBool,
    pixels: usize,
    /// Declared.
    rate_hz: Option<f64>,
    begun: AtomicU64,
    measured: MeasuredRate,
    expected_ns: AtomicU64,
    /// What its masks cost a busy device.
    planned_ns: AtomicU64,
    /// Microseconds after `opened_at`.
    asked_us: AtomicU64,
    traced: AtomicU64,
    device_ns: AtomicU64,
    queue_us: AtomicU64,
}

/// A snapshot of a session's cost.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CostTotals {
    pub traced: u64,
    pub device_ms: f64,
    /// Time from a pose's arrival until its trace begins, summed over all masks.
    pub queue_ms: f64,
}

impl SessionCosts {
    pub(crate) fn new(shape: MaskShape, rate_hz: Option<f64>, expected_ms: f64) -> Self {
        Self {
            opened_at: Instant::now(),
            left: AtomicBool::new(false),
            pixels: shape.pixels(),
            rate_hz,
            begun: AtomicU64::new(0),
            measured: MeasuredRate::new(rate_hz.unwrap_or(LEAST_HZ)),
            expected_ns: AtomicU64::new(nanos(expected_ms)),
            planned_ns: AtomicU64::new(nanos(expected_ms)),
            asked_us: AtomicU64::new(0),
            traced: AtomicU64::new(0),
            device_ns: AtomicU64::new(0),
            queue_us: AtomicU64::new(0),
        }
    }

    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "times far below 2⁵³ ns")]
    pub fn totals(&self) -> CostTotals {
        CostTotals {
            traced: self.traced.load(Ordering::Relaxed),
            device_ms: self.device_ns.load(Ordering::Relaxed) as f64 * 1e-6,
            queue_ms: self.queue_us.load(Ordering::Relaxed) as f64 * 1e-3,
        }
    }

    /// Expected cost of the next mask, in milliseconds.
    #[expect(clippy::cast_precision_loss, reason = "times far below 2⁵³ ns")]
    pub(crate) fn expected_ms(&self) -> f64 {
        self.expected_ns.load(Ordering::Relaxed) as f64 * 1e-6
    }

    /// What a mask costs a device that is busy ([`RayPrice`](super::price::RayPrice)), in milliseconds.
    #[expect(clippy::cast_precision_loss, reason = "times far below 2⁵³ ns")]
    pub(crate) fn planned_ms(&self) -> f64 {
        self.planned_ns.load(Ordering::Relaxed) as f64 * 1e-6
    }

    /// Returns whether its cost is known from enough masks to say something about others.
    fn is_measured(&self) -> bool {
        self.traced.load(Ordering::Relaxed) >= MEASURED_AFTER
    }

    pub(crate) fn pixels(&self) -> usize {
        self.pixels
    }

    /// Declared masks per second.
    pub(crate) const fn rate_hz(&self) -> Option<f64> {
        self.rate_hz
    }

    /// Counts with the measured rate while it is active. Declared rates count only until they are measured.
    pub(crate) fn need(&self) -> Need {
        let asked = Duration::from_micros(self.asked_us.load(Ordering::Relaxed));
        let active = self.opened_at.elapsed().saturating_sub(asked) < IDLE_AFTER;
        let measured_hz = self.measured.planned_hz(self.begun.load(Ordering::Relaxed));
        let rate_hz = self.rate_hz.map(|declared_hz| if active { measured_hz } else { declared_hz });
        Need { cost_ms: self.planned_ms(), rate_hz, active }
    }

    /// Records that the client is gone: the session needs no more time, although its engine may not know yet.
    pub(crate) fn leave(&self) {
        self.left.store(true, Ordering::Relaxed);
    }

    pub(crate) fn has_left(&self) -> bool {
        self.left.load(Ordering::Relaxed)
    }

    /// Records that the trace of a pose begins, after it has waited this long.
    pub(crate) fn record_begin(&self, waited: Duration) {
        let micros = |time: Duration| u64::try_from(time.as_micros()).unwrap_or(u64::MAX);
        self.begun.fetch_add(1, Ordering::Relaxed);
        self.asked_us.store(micros(self.opened_at.elapsed()), Ordering::Relaxed);
        self.queue_us.fetch_add(micros(waited), Ordering::Relaxed);
    }

    /// Records the cost of a traced mask, and what such a mask costs a busy device.
    pub(crate) fn record_end(&self, cost: &TraceCost, planned_ms: f64) {
        let cost_ms = cost.device_ms();
        // Only the engine's thread writes.
        let share = if self.traced.fetch_add(1, Ordering::Relaxed) == 0 { 1.0 } else { NEWEST_SHARE };
        for (mean, before_ms, newest_ms) in
            [(&self.expected_ns, self.expected_ms(), cost_ms), (&self.planned_ns, self.planned_ms(), planned_ms)]
        {
            mean.store(nanos(before_ms + (newest_ms - before_ms) * share), Ordering::Relaxed);
        }
        self.device_ns.fetch_add(nanos(cost_ms), Ordering::Relaxed);
    }
}

/// Predicts the cost of new sessions' masks on a device from their size.
#[derive(Debug, Default)]
pub(crate) struct CostModel {
    /// Device time per pixel, in picoseconds; 0 before the first mask.
    per_pixel_ps: AtomicU64,
}

impl CostModel {
    /// Sets what masks cost to what one of this many pixels costs a busy device, in milliseconds.
    #[expect(clippy::cast_precision_loss, reason = "pixels far below 2⁵³")]
    pub(crate) fn calibrate(&self, pixels: usize, planned_ms: f64) {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a time of some picoseconds")]
        self.per_pixel_ps.store((planned_ms * 1e9 / pixels.max(1) as f64).max(1.0) as u64, Ordering::Relaxed);
    }

    /// Learns from a mask's planned cost. Larger masks count more: the cost of small ones is mostly fixed.
    #[expect(clippy::cast_precision_loss, reason = "pixels and picoseconds far below 2⁵³")]
    pub(crate) fn learn(&self, pixels: usize, planned_ms: f64) {
        const MEMORY_PIXELS: f64 = 4e6;
        let pixels = pixels.max(1) as f64;
        let newest_ps = planned_ms * 1e9 / pixels;
        let before_ps = self.per_pixel_ps.load(Ordering::Relaxed) as f64;
        let share = if before_ps == 0.0 { 1.0 } else { (pixels / MEMORY_PIXELS).min(0.25) };
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a time of some picoseconds")]
        self.per_pixel_ps.store((before_ps + (newest_ps - before_ps) * share).max(1.0) as u64, Ordering::Relaxed);
    }

    /// Expected cost of a mask of this many pixels, in milliseconds. `known`: the open sessions. A measured one is a
    /// better guess than the pixels: a mask costs at least as much as any smaller one, and at most as much as any
    /// larger.
    #[expect(clippy::cast_precision_loss, reason = "pixels and picoseconds far below 2⁵³")]
    pub(crate) fn expected_ms<'a>(&self, pixels: usize, known: impl IntoIterator<Item = &'a SessionCosts>) -> f64 {
        let by_pixels = self.per_pixel_ps.load(Ordering::Relaxed) as f64 * pixels as f64 * 1e-9;
        let (mut least_ms, mut most_ms) = (0.0, f64::INFINITY);
        for other in known.into_iter().filter(|other| other.is_measured()) {
            if other.pixels() <= pixels {
                least_ms = f64::max(least_ms, other.planned_ms());
            }
            if other.pixels() >= pixels {
                most_ms = f64::min(most_ms, other.planned_ms());
            }
        }
        // Views differ: of two sessions of one size, the dearer counts.
        by_pixels.min(most_ms).max(least_ms)
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a time of some milliseconds")]
fn nanos(ms: f64) -> u64 {
    (ms.max(0.0) * 1e6) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cost(ms: f64) -> TraceCost {
        TraceCost { primary_ms: ms / 2.0, shadow_ms: ms / 2.0, readback_ms: 9.0, ..TraceCost::default() }
    }

    fn shape(width: u32, height: u32) -> MaskShape {
        MaskShape::new(width, height, 4).unwrap()
    }

    #[test]
    fn a_session_is_charged_for_what_its_masks_cost_the_device() {
        let costs = SessionCosts::new(shape(64, 36), Some(10.0), 7.0);
        let need = costs.need();
        assert_eq!((need.cost_ms, need.rate_hz, need.active), (7.0, Some(10.0), true));
        for _ in 0..3 {
            costs.record_begin(Duration::from_millis(2));
            costs.record_end(&cost(1.5), 1.0);
        }
        let totals = costs.totals();
        assert_eq!((totals.traced, totals.device_ms, totals.queue_ms), (3, 4.5, 6.0));
        assert!((costs.need().cost_ms - 1.0).abs() < 1e-9, "the first mask replaces the estimate");
        assert!((costs.expected_ms() - 1.5).abs() < 1e-9);
    }

    #[test]
    fn a_session_is_planned_with_what_it_asks_not_with_what_it_declares() {
        let costs = SessionCosts::new(shape(64, 36), Some(500.0), 7.0);
        assert_eq!(costs.need().rate_hz, Some(500.0));
        for _ in 0..2000 {
            costs.record_begin(Duration::ZERO);
        }
        costs.measured.end_window(0);
        let measured = costs.need().rate_hz.unwrap();
        assert!((90.0..=100.0).contains(&measured), "{measured}");
        let best_effort = SessionCosts::new(shape(64, 36), None, 7.0);
        assert_eq!(best_effort.need().rate_hz, None);
    }

    #[test]
    fn new_sessions_are_expected_to_cost_by_their_size() {
        let model = CostModel::default();
        assert_eq!(model.expected_ms(1000, []), 0.0);
        model.learn(100_000, 10.0);
        assert!((model.expected_ms(200_000, []) - 20.0).abs() < 1e-3);
        // A small mask with a large fixed cost does not make large masks look expensive.
        model.learn(2304, 1.0);
        assert!(model.expected_ms(200_000, []) < 21.0);
        let session = |ms: f64, masks: u64| {
            let session = SessionCosts::new(shape(64, 36), None, 50.0);
            (0..masks).for_each(|_| session.record_end(&cost(9.0), ms));
            session
        };
        // A session that has hardly traced says nothing.
        assert!(model.expected_ms(2304, [&session(1.0, 7)]) < 0.3);
        let known = session(1.0, 8);
        assert_eq!(model.expected_ms(2304, [&known]), 1.0);
        assert!(model.expected_ms(2303, [&known]) < 0.3);
        // A larger one that is cheap caps the guess.
        let cheap = session(0.1, 8);
        assert!(model.expected_ms(2303, []) > 0.2);
        // Costs are kept in nanoseconds.
        assert!((model.expected_ms(2303, [&cheap]) - 0.1).abs() < 1e-5);
        assert!((model.expected_ms(2304, [&cheap, &known]) - 1.0).abs() < 1e-5);
    }
}
