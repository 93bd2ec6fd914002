//! What shadow maps take, and what moves, beside the picture's own surfaces and light: counts, for tests and
//! measurements.

use std::ops::{Add, Sub};

/// Of all frames so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Work {
    /// Passes that draw into shadow maps, or find out what has moved.
    pub passes: u64,
    /// Draws into shadow maps, and their triangles.
    pub draws: u64,
    pub triangles: u64,
    /// Texels of shadow maps that were cleared or put back.
    pub texels: u64,
    /// Bytes that were written because something has moved.
    pub bytes: u64,
}

impl Work {
    fn with(self, other: Self, each: fn(u64, u64) -> u64) -> Self {
        Self {
            passes: each(self.passes, other.passes),
            draws: each(self.draws, other.draws),
            triangles: each(self.triangles, other.triangles),
            texels: each(self.texels, other.texels),
            bytes: each(self.bytes, other.bytes),
        }
    }
}

impl Add for Work {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        self.with(other, u64::wrapping_add)
    }
}

/// What came after `other`.
impl Sub for Work {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self.with(other, u64::wrapping_sub)
    }
}
