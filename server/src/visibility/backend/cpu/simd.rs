//! Eight f32 lanes: AVX2 with FMA where the machine has them, plain arrays everywhere else.
//!
//! Kernels are generic over [`Simd`] and run through [`Level::dispatch`], which compiles them once for each level. The only
//! way to a value of [`Avx2`] is the check that the processor has the instructions, so holding one is the proof that
//! makes every call below sound. Nothing outside this module is unsafe.
//!
//! The levels may differ in the last bit: AVX2 fuses a multiplication and an addition into one rounding, the plain
//! arrays round twice. Results on one machine are always the same.

use std::ops::{Add, Mul, Sub};

pub(super) use crate::visibility::hierarchy::bvh::F8;
use crate::visibility::hierarchy::bvh::WIDTH;

/// Eight lanes of f32 and their masks.
pub(super) trait Simd: Copy + Send + Sync {
    /// Eight numbers.
    type F: Copy + Add<Output = Self::F> + Sub<Output = Self::F> + Mul<Output = Self::F>;
    /// Eight yes or no.
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
    /// a ≥ b; no where either is NaN.
    fn ge(self, a: Self::F, b: Self::F) -> Self::M;
    /// a > b; no where either is NaN.
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
}

/// Work that runs on any level.
pub(super) trait Work {
    /// What it gives.
    type Output;
    /// Runs. Implementations are `#[inline(always)]`, or they would be compiled without the level's instructions.
    fn run<S: Simd>(self, simd: S) -> Self::Output;
}

/// What the machine has.
#[derive(Debug, Clone, Copy)]
pub(super) enum Level {
    /// AVX2 and FMA.
    #[cfg(target_arch = "x86_64")]
    Avx2(avx2::Avx2),
    /// Whatever the compiler makes of plain arrays.
    Portable,
}

impl Level {
    /// The best that this machine has.
    pub(super) fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if let Some(avx2) = avx2::Avx2::detect() {
            return Self::Avx2(avx2);
        }
        Self::Portable
    }

    /// Its name.
    pub(super) fn name(self) -> &'static str {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx2(_) => "AVX2",
            Self::Portable => "portable",
        }
    }

    /// Runs `work` compiled for this level.
    pub(super) fn dispatch<W: Work>(self, work: W) -> W::Output {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx2(avx2) => avx2.dispatch(work),
            Self::Portable => work.run(Portable),
        }
    }
}

/// Plain arrays.
#[derive(Debug, Clone, Copy)]
pub(super) struct Portable;

/// Eight numbers in a plain array.
#[derive(Debug, Clone, Copy)]
#[repr(align(32))]
pub(super) struct Array([f32; WIDTH]);

impl Array {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|i| f(self.0[i], other.0[i])))
    }
}

macro_rules! array_operator {
    ($trait:ident, $method:ident, $op:tt) => {
        impl $trait for Array {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                self.zip(other, |a, b| a $op b)
            }
        }
    };
}
array_operator!(Add, add, +);
array_operator!(Sub, sub, -);
array_operator!(Mul, mul, *);

impl Simd for Portable {
    type F = Array;
    type M = [bool; WIDTH];
    #[inline(always)]
    fn splat(self, x: f32) -> Array {
        Array([x; WIDTH])
    }
    #[inline(always)]
    fn load(self, x: &F8) -> Array {
        Array(x.0)
    }
    #[inline(always)]
    fn store(self, x: Array, to: &mut F8) {
        to.0 = x.0;
    }
    #[inline(always)]
    fn fma(self, a: Array, b: Array, c: Array) -> Array {
        a * b + c
    }
    #[inline(always)]
    fn fms(self, a: Array, b: Array, c: Array) -> Array {
        a * b - c
    }
    #[inline(always)]
    fn fnma(self, a: Array, b: Array, c: Array) -> Array {
        c - a * b
    }
    #[inline(always)]
    fn div(self, a: Array, b: Array) -> Array {
        a.zip(b, |a, b| a / b)
    }
    #[inline(always)]
    fn sqrt(self, a: Array) -> Array {
        Array(a.0.map(f32::sqrt))
    }
    #[inline(always)]
    fn min(self, a: Array, b: Array) -> Array {
        a.zip(b, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max(self, a: Array, b: Array) -> Array {
        a.zip(b, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn abs(self, a: Array) -> Array {
        Array(a.0.map(f32::abs))
    }
    #[inline(always)]
    fn xor_sign(self, a: Array, sign: Array) -> Array {
        a.zip(sign, |a, sign| f32::from_bits(a.to_bits() ^ (sign.to_bits() & 1 << 31)))
    }
    #[inline(always)]
    fn ge(self, a: Array, b: Array) -> [bool; WIDTH] {
        std::array::from_fn(|i| a.0[i] >= b.0[i])
    }
    #[inline(always)]
    fn gt(self, a: Array, b: Array) -> [bool; WIDTH] {
        std::array::from_fn(|i| a.0[i] > b.0[i])
    }
    #[inline(always)]
    fn and(self, a: [bool; WIDTH], b: [bool; WIDTH]) -> [bool; WIDTH] {
        std::array::from_fn(|i| a[i] & b[i])
    }
    #[inline(always)]
    fn bits(self, m: [bool; WIDTH]) -> u8 {
        m.iter().enumerate().fold(0, |bits, (i, &set)| bits | u8::from(set) << i)
    }
    #[inline(always)]
    fn mask(self, bits: u8) -> [bool; WIDTH] {
        std::array::from_fn(|i| bits >> i & 1 == 1)
    }
    #[inline(always)]
    fn select(self, m: [bool; WIDTH], a: Array, b: Array) -> Array {
        Array(std::array::from_fn(|i| if m[i] { a.0[i] } else { b.0[i] }))
    }
    #[inline(always)]
    fn select_negative(self, sign: Array, a: Array, b: Array) -> Array {
        Array(std::array::from_fn(|i| if sign.0[i].is_sign_negative() { a.0[i] } else { b.0[i] }))
    }
    #[inline(always)]
    fn lowest(self, a: Array) -> f32 {
        a.0.iter().copied().fold(f32::INFINITY, f32::min)
    }
    #[inline(always)]
    fn highest(self, a: Array) -> f32 {
        a.0.iter().copied().fold(f32::NEG_INFINITY, f32::max)
    }
}

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code, reason = "std::arch intrinsics; sound because `Avx2` exists only where the processor has them")]
mod avx2;

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs every operation on awkward numbers; the results as bits, the fused ones apart.
    struct Everything;

    impl Work for Everything {
        type Output = (Vec<[u32; 8]>, Vec<[f32; 8]>, Vec<u8>, [f32; 2]);
        #[inline(always)]
        fn run<S: Simd>(self, s: S) -> Self::Output {
            let a = s.load(&F8([1.5, -2.25, 0.0, -0.0, f32::INFINITY, 3e-39, f32::NAN, 1e30]));
            let b = s.load(&F8([-0.5, -2.25, -0.0, 7.0, 1.0, -1e-20, 2.0, f32::NAN]));
            let c = s.load(&F8([0.1, 0.2, 0.3, -0.4, -0.5, 0.6, 0.7, 1e-3]));
            let out = |f: S::F| {
                let mut to = F8::default();
                s.store(f, &mut to);
                to.0
            };
            let exact = [
                a + c,
                a - c,
                c * c,
                s.div(c, b),
                s.sqrt(s.abs(c)),
                s.min(a, b),
                s.max(a, b),
                s.abs(b),
                s.xor_sign(c, b),
                s.select(s.mask(0b1011_0001), a, c),
                s.select_negative(b, a, c),
                s.splat(2.5),
            ];
            let exact = exact.map(|f| out(f).map(|x| if x.is_nan() { u32::MAX } else { x.to_bits() })).to_vec();
            let fused = [s.fma(c, c, c), s.fms(c, c, c), s.fnma(c, c, c)].map(out).to_vec();
            let masks =
                [s.ge(a, b), s.gt(a, b), s.and(s.ge(c, b), s.gt(a, c)), s.mask(0xa5)].map(|m| s.bits(m)).to_vec();
            (exact, fused, masks, [s.lowest(c), s.highest(c)])
        }
    }

    #[test]
    fn the_levels_agree() {
        let plain = Level::Portable.dispatch(Everything);
        let best = Level::detect().dispatch(Everything);
        assert_eq!(plain.0, best.0);
        assert_eq!(plain.2, best.2);
        assert_eq!(plain.3, [-0.5, 0.7]);
        assert_eq!(plain.3, best.3);
        for (a, b) in plain.1.iter().flatten().zip(best.1.iter().flatten()) {
            assert!((a - b).abs() <= 1e-7, "{a} and {b}");
        }
        // A test that compares a level with itself proves nothing about the other.
        #[cfg(target_arch = "x86_64")]
        assert_eq!(
            Level::detect().name() == "AVX2",
            is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")
        );
    }
}
