//! What a ray costs a busy device.
//!
//! A device that rests between masks lowers its clock: an H200 takes up to three times as long for a mask of a lone
//! session at 60 masks/s as for the same mask when it never rests. Planned with such times it would refuse sessions for
//! which it would only have to speed up. So a mask counts with its rays, at the price that rays had when the device was
//! last busy. When it is busy, measured times are what they seem, and count. So does the time to move what moves, which
//! is the processor's and the same for every mask.

use std::time::{Duration, Instant};

use crate::visibility::TraceCost;

/// Time over which it is told whether the device is busy.
const WINDOW: Duration = Duration::from_millis(100);

/// The device is busy if masks take at least this share of the time.
const BUSY_SHARE: f64 = 0.75;

/// Weight of the newest mask in the price.
const NEWEST_SHARE: f64 = 0.05;

#[derive(Debug)]
pub(crate) struct RayPrice {
    /// In milliseconds; `None` before the first mask.
    per_ray_ms: Option<f64>,
    window_began: Instant,
    /// Device time of the window's masks so far, in milliseconds.
    window_ms: f64,
    busy: bool,
}

impl RayPrice {
    pub(crate) fn new(now: Instant) -> Self {
        Self { per_ray_ms: None, window_began: now, window_ms: 0.0, busy: false }
    }

    /// Sets the price to that of a mask which a busy device traced.
    pub(crate) fn calibrate(&mut self, cost: &TraceCost) {
        self.per_ray_ms = Some(cost.rays_ms() / rays(cost));
    }

    /// Takes a mask that was collected at `now`. Returns what such a mask would cost the device when it is busy, in
    /// milliseconds: not more than it did cost.
    pub(crate) fn planned_ms(&mut self, cost: &TraceCost, now: Instant) -> f64 {
        let (measured_ms, rays) = (cost.device_ms(), rays(cost));
        let rays_ms = cost.rays_ms();
        self.window_ms += measured_ms;
        let window = now.saturating_duration_since(self.window_began);
        if window >= WINDOW {
            self.busy = self.window_ms >= BUSY_SHARE * window.as_secs_f64() * 1e3;
            (self.window_began, self.window_ms) = (now, 0.0);
        }
        let Some(price_ms) = &mut self.per_ray_ms else {
            self.calibrate(cost);
            return measured_ms;
        };
        if self.busy {
            *price_ms += (rays_ms / rays - *price_ms) * NEWEST_SHARE;
            return measured_ms;
        }
        cost.pose_ms + rays_ms.min(*price_ms * rays)
    }
}

#[expect(clippy::cast_precision_loss, reason = "rays far below 2⁵³")]
fn rays(cost: &TraceCost) -> f64 {
    (cost.primary_rays + cost.shadow_rays).max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cost(ms: f64, rays: u64) -> TraceCost {
        TraceCost { shadow_ms: ms, primary_rays: rays / 2, shadow_rays: rays - rays / 2, ..TraceCost::default() }
    }

    #[test]
    fn a_resting_device_is_planned_with_the_price_of_a_busy_one() {
        let start = Instant::now();
        let mut price = RayPrice::new(start);
        price.calibrate(&cost(2.5, 1_000_000));
        // 60 masks/s at a third of the clock: the device is busy for less than half of the time.
        for mask in 1..=120_u32 {
            let planned_ms = price.planned_ms(&cost(7.5, 1_000_000), start + Duration::from_micros(16_667) * mask);
            assert!((planned_ms - 2.5).abs() < 1e-9, "{planned_ms}");
        }
        // A mask never counts with more than it did cost.
        assert_eq!(price.planned_ms(&cost(1.0, 1_000_000), start + Duration::from_secs(3)), 1.0);
    }

    #[test]
    fn a_busy_device_sets_the_price() {
        let start = Instant::now();
        let mut price = RayPrice::new(start);
        price.calibrate(&cost(2.5, 1_000_000));
        let mut planned_ms = 0.0;
        // Never at rest, and dearer than thought.
        for mask in 1..=200_u32 {
            planned_ms = price.planned_ms(&cost(4.0, 1_000_000), start + Duration::from_millis(4) * mask);
        }
        assert_eq!(planned_ms, 4.0);
        // At rest again, with a slower clock: the price was learned.
        let later = start + Duration::from_secs(10);
        price.planned_ms(&cost(9.0, 1_000_000), later);
        let planned_ms = price.planned_ms(&cost(9.0, 1_000_000), later + WINDOW);
        assert!((planned_ms - 4.0).abs() < 0.01, "{planned_ms}");
    }

    #[test]
    fn moving_things_costs_the_same_whatever_the_picture() {
        let start = Instant::now();
        let mut price = RayPrice::new(start);
        price.calibrate(&TraceCost { pose_ms: 6.0, ..cost(2.5, 1_000_000) });
        let planned_ms = price.planned_ms(&TraceCost { pose_ms: 6.0, ..cost(0.9, 100_000) }, start);
        assert!((planned_ms - 6.25).abs() < 1e-9, "{planned_ms}");
    }

    #[test]
    fn the_first_mask_is_believed() {
        let start = Instant::now();
        assert_eq!(RayPrice::new(start).planned_ms(&cost(3.0, 0), start), 3.0);
    }
}
