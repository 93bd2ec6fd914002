//! The guard band: a mask with a wider field than the picture, so that a turning camera finds visibility at the
//! picture's edges.

use std::{fmt, str::FromStr};

use gnomon_protocol::limits::{MAX_PIXELS, MAX_SIDE_PX};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Extra pixels of a mask, half of them on each side: the dissertation's 64×36, 128×72 and 640×360 (§4.3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GuardSize {
    /// Even.
    pub width: u32,
    /// Even.
    pub height: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Guard {
    Fixed(GuardSize),
    /// Wide enough for the camera's turn while a mask is under way.
    Auto,
}

impl Default for Guard {
    fn default() -> Self {
        Self::Fixed(GuardSize::default())
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("invalid guard band {0:?}: use auto, 0, or WIDTHxHEIGHT extra pixels, even and at most 2048")]
pub struct NoGuard(pub String);

/// Largest extra width or height, in pixels.
const MOST_PX: u32 = 2048;

impl GuardSize {
    /// Returns the pixels on the left and right, and above and below.
    #[must_use]
    pub fn per_side(self) -> (u32, u32) {
        (self.width / 2, self.height / 2)
    }

    /// Returns the band, limited to what a mask around a picture of this size may have.
    #[must_use]
    pub fn around(self, (width, height): (u32, u32)) -> Self {
        let side = |extra: u32, picture: u32| extra.min(MAX_SIDE_PX.saturating_sub(picture)) & !1;
        let mut fitted = Self { width: side(self.width, width), height: side(self.height, height) };
        while u64::from(width + fitted.width) * u64::from(height + fitted.height) > u64::from(MAX_PIXELS)
            && fitted != Self::default()
        {
            fitted = Self { width: fitted.width / 4 * 2, height: fitted.height / 4 * 2 };
        }
        fitted
    }
}

impl fmt::Display for GuardSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

impl FromStr for GuardSize {
    type Err = NoGuard;

    fn from_str(text: &str) -> Result<Self, NoGuard> {
        let refused = || NoGuard(text.to_owned());
        let (width, height) = if text == "0" { ("0", "0") } else { text.split_once('x').ok_or_else(refused)? };
        let side = |side: &str| side.parse::<u32>().ok().filter(|side| side.is_multiple_of(2) && *side <= MOST_PX);
        Ok(Self { width: side(width).ok_or_else(refused)?, height: side(height).ok_or_else(refused)? })
    }
}

impl fmt::Display for Guard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fixed(size) => size.fmt(f),
            Self::Auto => f.write_str("auto"),
        }
    }
}

impl FromStr for Guard {
    type Err = NoGuard;

    fn from_str(text: &str) -> Result<Self, NoGuard> {
        if text == "auto" { Ok(Self::Auto) } else { text.parse().map(Self::Fixed) }
    }
}

impl TryFrom<String> for Guard {
    type Error = NoGuard;

    fn try_from(text: String) -> Result<Self, NoGuard> {
        text.parse()
    }
}

impl From<Guard> for String {
    fn from(guard: Guard) -> Self {
        guard.to_string()
    }
}

/// The automatic guard bands. There are few, because each change makes both ends reallocate.
const STEPS: [GuardSize; 5] = [
    GuardSize { width: 0, height: 0 },
    GuardSize { width: 64, height: 36 },
    GuardSize { width: 128, height: 72 },
    GuardSize { width: 320, height: 180 },
    GuardSize { width: 640, height: 360 },
];

/// Frames for which a smaller band must suffice before it is chosen.
const PATIENCE_FRAMES: u32 = 90;

/// Chooses the guard band frame by frame.
#[derive(Debug, Clone)]
pub struct GuardChoice {
    guard: Guard,
    picture: (u32, u32),
    step: usize,
    /// Frames since the next smaller step was last too small.
    calm_frames: u32,
}

impl GuardChoice {
    /// For pictures of this size.
    #[must_use]
    pub fn new(guard: Guard, picture: (u32, u32)) -> Self {
        Self { guard, picture, step: 0, calm_frames: 0 }
    }

    /// Returns the largest band that will ever be chosen; the session starts with it.
    #[must_use]
    pub fn largest(&self) -> GuardSize {
        match self.guard {
            Guard::Fixed(size) => size.around(self.picture),
            Guard::Auto => STEPS[STEPS.len() - 1].around(self.picture),
        }
    }

    /// Returns the guard band for the next mask. `lag_frames` is the age of masks on arrival; `turn_px` is how far the
    /// picture's centre moves per frame, across and up. The band grows at once and shrinks after a while.
    pub fn next(&mut self, lag_frames: f64, turn_px: (f64, f64)) -> GuardSize {
        if self.guard == Guard::Auto {
            let needs = |step: &GuardSize| {
                let (x, y) = step.per_side();
                f64::from(x) >= turn_px.0.abs() * lag_frames && f64::from(y) >= turn_px.1.abs() * lag_frames
            };
            let needed = STEPS.iter().position(needs).unwrap_or(STEPS.len() - 1);
            // A turn of less than half a pixel during the lag is ignored.
            let needed = if turn_px.0.abs().max(turn_px.1.abs()) * lag_frames < 0.5 { 0 } else { needed };
            self.calm_frames = if needed < self.step { self.calm_frames + 1 } else { 0 };
            if needed > self.step {
                self.step = needed;
            } else if self.calm_frames >= PATIENCE_FRAMES {
                self.step -= 1;
                self.calm_frames = 0;
            }
        }
        match self.guard {
            Guard::Fixed(size) => size.around(self.picture),
            Guard::Auto => STEPS[self.step].around(self.picture),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HD: (u32, u32) = (1920, 1080);

    #[test]
    fn texts_are_read_and_written() {
        let size = |width, height| Guard::Fixed(GuardSize { width, height });
        for (text, guard) in
            [("auto", Guard::Auto), ("0x0", size(0, 0)), ("64x36", size(64, 36)), ("640x360", size(640, 360))]
        {
            assert_eq!(text.parse(), Ok(guard));
            assert_eq!(guard.to_string(), text);
        }
        assert_eq!("0".parse(), Ok(Guard::default()));
        for bad in ["", "64", "63x36", "64x-2", "64x36x2", "4096x0", "wide"] {
            assert!(bad.parse::<Guard>().unwrap_err().to_string().contains("auto"), "{bad}");
        }
    }

    #[test]
    fn a_mask_stays_within_its_limits() {
        let most = GuardSize { width: MOST_PX, height: MOST_PX };
        for picture in [HD, (3840, 2160), (4096, 16), (16, 4096), (4095, 2025)] {
            let fitted = most.around(picture);
            let (width, height) = (picture.0 + fitted.width, picture.1 + fitted.height);
            assert!(width <= MAX_SIDE_PX.max(picture.0) && height <= MAX_SIDE_PX.max(picture.1));
            assert!(width * height <= MAX_PIXELS, "{picture:?} {fitted:?}");
            assert!(fitted.width.is_multiple_of(2) && fitted.height.is_multiple_of(2));
        }
        assert_eq!(STEPS[4].around(HD), STEPS[4]);
    }

    #[test]
    fn the_band_grows_at_once_and_shrinks_after_a_while() {
        let mut choice = GuardChoice::new(Guard::Auto, HD);
        assert_eq!(choice.largest(), STEPS[4]);
        // Lag, pixels a frame across and up, number of such frames, expected step.
        for (lag, turn, frames, step) in [
            (6.0, (0.0, 0.0), 100, 0),
            (6.0, (0.01, 0.0), 1, 0),
            (6.0, (5.0, 0.0), 1, 1),
            (6.0, (-10.0, 0.0), 1, 2),
            (6.0, (10.0, 12.0), 1, 3),
            (60.0, (30.0, 0.0), 1, 4),
            (6.0, (10.0, 0.0), PATIENCE_FRAMES - 1, 4),
            (6.0, (10.0, 0.0), 1, 3),
            (6.0, (10.0, 0.0), PATIENCE_FRAMES - 1, 3),
            (6.0, (26.0, 0.0), 1, 3),
            (6.0, (10.0, 0.0), PATIENCE_FRAMES, 2),
            (6.0, (0.0, 0.0), 2 * PATIENCE_FRAMES, 0),
        ] {
            let mut found = GuardSize::default();
            for _ in 0..frames {
                found = choice.next(lag, turn);
            }
            assert_eq!(found, STEPS[step], "lag {lag}, turn {turn:?}, {frames} frames");
        }
    }

    #[test]
    fn a_fixed_band_stays() {
        let size = GuardSize { width: 128, height: 72 };
        let mut choice = GuardChoice::new(Guard::Fixed(size), HD);
        assert_eq!(
            (choice.largest(), choice.next(50.0, (100.0, 0.0)), choice.next(0.0, (0.0, 0.0))),
            (size, size, size)
        );
    }
}
