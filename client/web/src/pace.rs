//! How many of the screen's pixels are drawn: as many as the device draws without stutter.

/// Frames that are averaged, or as many as come in this time.
const WINDOW: u32 = 30;
const WINDOW_S: f64 = 2.0;

/// Mean time of a frame above which fewer pixels are drawn: 45 frames/s.
const SLOW_S: f64 = 1.0 / 45.0;

/// Mean time of a frame below which more pixels are tried: a screen's 60 frames/s, with some jitter.
const FAST_S: f64 = 1.0 / 57.0;

/// Windows in a row that must be fast, at first. Doubles each time that more pixels turn out to be too many.
const PATIENCE: u32 = 8;
const MOST_PATIENCE: u32 = 1024;

/// Least share of the width and of the height.
const LEAST: f64 = 0.3;

/// A frame after a pause, as of a hidden tab, says nothing.
const PAUSE_S: f64 = 5.0;

#[derive(Debug, Clone, PartialEq)]
pub struct Pace {
    share: f64,
    frames: u32,
    sum_s: f64,
    fast: u32,
    patience: u32,
    /// True if the last change was to more pixels.
    grew: bool,
}

impl Default for Pace {
    fn default() -> Self {
        Self { share: 1.0, frames: 0, sum_s: 0.0, fast: 0, patience: PATIENCE, grew: false }
    }
}

impl Pace {
    /// Of the width and of the height, up to 1.
    #[must_use]
    pub fn share(&self) -> f64 {
        self.share
    }

    /// Notes a frame that came `step_s` after the last. Returns the new share if it changes.
    pub fn frame(&mut self, step_s: f64) -> Option<f64> {
        if !(0.0..PAUSE_S).contains(&step_s) {
            (self.frames, self.sum_s) = (0, 0.0);
            return None;
        }
        self.frames += 1;
        self.sum_s += step_s;
        if self.frames < WINDOW && self.sum_s < WINDOW_S {
            return None;
        }
        let mean_s = self.sum_s / f64::from(self.frames);
        (self.frames, self.sum_s) = (0, 0.0);
        let before = self.share;
        if mean_s > SLOW_S {
            if self.grew {
                self.patience = (self.patience * 2).min(MOST_PATIENCE);
            }
            // The time goes with the area, at least in part.
            self.share = (before * (FAST_S / mean_s).sqrt().max(0.7)).max(LEAST);
            (self.fast, self.grew) = (0, false);
        } else if mean_s < FAST_S && before < 1.0 {
            self.fast += 1;
            if self.fast >= self.patience {
                self.share = (before * 1.15).min(1.0);
                (self.fast, self.grew) = (0, true);
            }
        } else {
            self.fast = 0;
        }
        (self.share != before).then_some(self.share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs for a minute on a device that draws `pixels_per_s` of a screen of 2 million.
    fn after_a_minute(pixels_per_s: f64) -> (Pace, u32) {
        let (mut pace, mut changes, mut time) = (Pace::default(), 0, 0.0);
        while time < 60.0 {
            let step_s = (2e6 * pace.share() * pace.share() / pixels_per_s).max(1.0 / 60.0);
            time += step_s;
            changes += u32::from(pace.frame(step_s).is_some());
        }
        (pace, changes)
    }

    #[test]
    fn a_fast_device_draws_every_pixel() {
        let (pace, changes) = after_a_minute(1e9);
        assert_eq!((pace.share(), changes), (1.0, 0));
    }

    #[test]
    fn a_slow_device_keeps_its_rate_and_does_not_swing() {
        let (pace, changes) = after_a_minute(30e6);
        let rate = 30e6 / (2e6 * pace.share() * pace.share());
        assert!(rate >= 45.0, "{rate} frames/s at {}", pace.share());
        assert!(changes < 16, "{changes} changes");
    }

    #[test]
    fn the_slowest_device_still_gets_a_picture() {
        for pixels_per_s in [5e5, 1e6] {
            assert_eq!(after_a_minute(pixels_per_s).0.share(), LEAST, "{pixels_per_s}");
        }
    }

    #[test]
    fn a_pause_changes_nothing() {
        let mut pace = Pace::default();
        assert!((0..100).all(|_| pace.frame(3600.0).is_none() && pace.frame(f64::NAN).is_none()));
        assert_eq!(pace.share(), 1.0);
    }
}
