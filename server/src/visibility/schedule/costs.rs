//! What a session costs its device, measured: the engine's thread counts, admission and statistics read.

use std::{
    sync::atomic::{AtomicU64, Ordering},
    time::{Duration, Instant},
};

use gnomon_protocol::mask::MaskShape;

use super::capacity::Need;
use crate::visibility::TraceCost;

/// A session that has asked for no mask for so long is idle.
const IDLE_AFTER: Duration = Duration::from_secs(10);

/// How much the newest mask counts in what the next is expected to cost.
const NEWEST_SHARE: f64 = 0.125;

/// The costs of one session. Every number but the expected cost only grows.
#[derive(Debug)]
pub struct SessionCosts {
    opened_at: Instant,
    pixels: usize,
    rate_hz: Option<f64>,
    expected_ns: AtomicU64,
    /// Microseconds after `opened_at`.
    asked_us: AtomicU64,
    traced: AtomicU64,
    device_ns: AtomicU64,
    queue_us: AtomicU64,
}

/// The costs of a session at one moment.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CostTotals {
    /// Masks traced.
    pub traced: u64,
    /// Device time, in milliseconds.
    pub device_ms: f64,
    /// From the arrival of each traced mask's pose until its trace began, summed, in milliseconds.
    pub queue_ms: f64,
}

impl SessionCosts {
    pub(crate) fn new(shape: MaskShape, rate_hz: Option<f64>, expected_ms: f64) -> Self {
        Self {
            opened_at: Instant::now(),
            pixels: shape.pixels(),
            rate_hz,
            expected_ns: AtomicU64::new(nanos(expected_ms)),
            asked_us: AtomicU64::new(0),
            traced: AtomicU64::new(0),
            device_ns: AtomicU64::new(0),
            queue_us: AtomicU64::new(0),
        }
    }

    /// What has been counted until now.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "times far below 2⁵³ ns")]
    pub fn totals(&self) -> CostTotals {
        CostTotals {
            traced: self.traced.load(Ordering::Relaxed),
            device_ms: self.device_ns.load(Ordering::Relaxed) as f64 * 1e-6,
            queue_ms: self.queue_us.load(Ordering::Relaxed) as f64 * 1e-3,
        }
    }

    /// What its next mask is expected to cost, in milliseconds.
    #[expect(clippy::cast_precision_loss, reason = "times far below 2⁵³ ns")]
    pub(crate) fn expected_ms(&self) -> f64 {
        self.expected_ns.load(Ordering::Relaxed) as f64 * 1e-6
    }

    pub(crate) fn pixels(&self) -> usize {
        self.pixels
    }

    /// What it needs of its device.
    pub(crate) fn need(&self) -> Need {
        let asked = Duration::from_micros(self.asked_us.load(Ordering::Relaxed));
        let active = self.opened_at.elapsed().saturating_sub(asked) < IDLE_AFTER;
        Need { cost_ms: self.expected_ms(), rate_hz: self.rate_hz, active }
    }

    /// Notes that a trace begins, of a pose that has waited so long.
    pub(crate) fn begins(&self, waited: Duration) {
        let micros = |time: Duration| u64::try_from(time.as_micros()).unwrap_or(u64::MAX);
        self.asked_us.store(micros(self.opened_at.elapsed()), Ordering::Relaxed);
        self.queue_us.fetch_add(micros(waited), Ordering::Relaxed);
    }

    /// Notes what a mask has cost.
    pub(crate) fn ends(&self, cost: &TraceCost) {
        let cost_ms = cost.device_ms();
        let before_ms = self.expected_ms();
        // Only the engine's thread writes.
        let expected_ms = before_ms + (cost_ms - before_ms) * NEWEST_SHARE;
        let first = self.traced.fetch_add(1, Ordering::Relaxed) == 0;
        self.expected_ns.store(nanos(if first { cost_ms } else { expected_ms }), Ordering::Relaxed);
        self.device_ns.fetch_add(nanos(cost_ms), Ordering::Relaxed);
    }
}

/// What masks cost on a device, by their size, for sessions of which nothing is known yet.
#[derive(Debug, Default)]
pub(crate) struct CostModel {
    /// Device time of a pixel, in picoseconds; 0 before anything was traced.
    per_pixel_ps: AtomicU64,
}

impl CostModel {
    /// Learns from a mask. Larger masks teach more: small ones cost mostly what every mask costs.
    #[expect(clippy::cast_precision_loss, reason = "pixels and picoseconds far below 2⁵³")]
    pub(crate) fn learn(&self, pixels: usize, cost: &TraceCost) {
        const MEMORY_PIXELS: f64 = 4e6;
        let pixels = pixels.max(1) as f64;
        let newest_ps = cost.device_ms() * 1e9 / pixels;
        let before_ps = self.per_pixel_ps.load(Ordering::Relaxed) as f64;
        let share = if before_ps == 0.0 { 1.0 } else { (pixels / MEMORY_PIXELS).min(0.25) };
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a time of some picoseconds")]
        self.per_pixel_ps.store((before_ps + (newest_ps - before_ps) * share).max(1.0) as u64, Ordering::Relaxed);
    }

    /// What a mask of so many pixels is expected to cost, in milliseconds, when the sessions that there are cost what they do.
    #[expect(clippy::cast_precision_loss, reason = "pixels and picoseconds far below 2⁵³")]
    pub(crate) fn expected_ms<'a>(&self, pixels: usize, known: impl IntoIterator<Item = &'a SessionCosts>) -> f64 {
        let by_pixels = self.per_pixel_ps.load(Ordering::Relaxed) as f64 * pixels as f64 * 1e-9;
        // No larger mask is cheaper than a smaller one.
        known
            .into_iter()
            .filter(|other| other.pixels() <= pixels)
            .map(SessionCosts::expected_ms)
            .fold(by_pixels, f64::max)
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
            costs.begins(Duration::from_millis(2));
            costs.ends(&cost(1.5));
        }
        let totals = costs.totals();
        assert_eq!((totals.traced, totals.device_ms, totals.queue_ms), (3, 4.5, 6.0));
        assert!((costs.need().cost_ms - 1.5).abs() < 1e-9, "the estimate goes with the first mask");
    }

    #[test]
    fn new_sessions_are_expected_to_cost_what_their_size_does() {
        let model = CostModel::default();
        assert_eq!(model.expected_ms(1000, []), 0.0);
        model.learn(100_000, &cost(10.0));
        assert!((model.expected_ms(200_000, []) - 20.0).abs() < 1e-3);
        // A small mask that costs more than its pixels does not make large ones look dear.
        model.learn(2304, &cost(1.0));
        assert!(model.expected_ms(200_000, []) < 21.0);
        let small = SessionCosts::new(shape(64, 36), None, 1.0);
        assert_eq!(model.expected_ms(2304, [&small]), 1.0);
        assert!(model.expected_ms(2303, [&small]) < 0.3);
    }
}
