//! The operations on eight lanes, and code that runs on any implementation of them.

pub(in super::super) use crate::visibility::hierarchy::bvh::F8;
use std::ops::{Add, Mul, Sub};

/// Operations on eight lanes of f32 and their masks.
pub(in super::super) trait Simd: Copy + Send + Sync {
    type F: Copy + Add<Output = Self::F> + Sub<Output = Self::F> + Mul<Output = Self::F>;
    /// Eight booleans.
    type M: Copy;
    fn splat(self, x: f32) -> Self::F;
    fn load(self, x: &F8) -> Self::F;
    fn store(self, x: Self::F, to: &mut F8);
    /// a·b + c.
    fn fma(self, a: Self::F, b: Self::F, c: Self::F) -> Self::F;
    /// a·b − c.
    fn fms(self, a: Self::F, b: Self::F, c: Self::F) -> Self::F;
    /// c − a·b.
    fn fnma(self, a: Self::F, b: Self::F, c: Self::F) -> Self::F;
    fn div(self, a: Self::F, b: Self::F) -> Self::F;
    fn sqrt(self, a: Self::F) -> Self::F;
    /// The smaller; b when either is NaN.
    fn min(self, a: Self::F, b: Self::F) -> Self::F;
    /// The larger; b when either is NaN.
    fn max(self, a: Self::F, b: Self::F) -> Self::F;
    fn abs(self, a: Self::F) -> Self::F;
    /// a with its sign flipped where `sign`'s sign bit is set.
    fn xor_sign(self, a: Self::F, sign: Self::F) -> Self::F;
    /// a ≥ b; false where either is NaN.
    fn ge(self, a: Self::F, b: Self::F) -> Self::M;
    /// a > b; false where either is NaN.
    fn gt(self, a: Self::F, b: Self::F) -> Self::M;
    fn and(self, a: Self::M, b: Self::M) -> Self::M;
    /// Lane i as bit i.
    fn bits(self, m: Self::M) -> u8;
    /// Bit i as lane i.
    fn mask(self, bits: u8) -> Self::M;
    /// a where m, else b.
    fn select(self, m: Self::M, a: Self::F, b: Self::F) -> Self::F;
    /// a where `sign`'s sign bit is set, else b.
    fn select_negative(self, sign: Self::F, a: Self::F, b: Self::F) -> Self::F;
    fn lowest(self, a: Self::F) -> f32;
    fn highest(self, a: Self::F) -> f32;
    /// Asks for `data` to be in the cache soon.
    fn prefetch<T>(self, data: &T);
}

/// Code that runs at any level.
pub(in super::super) trait WithSimd {
    type Output;
    /// Implement it as `#[inline(always)]`: otherwise it is compiled without the level's instructions.
    fn run<S: Simd>(self, simd: S) -> Self::Output;
}
