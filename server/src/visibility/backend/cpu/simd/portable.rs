//! Eight lanes in a plain array.

use std::ops::{Add, Mul, Sub};

use super::lanes::{F8, Simd};
use crate::visibility::hierarchy::bvh::WIDTH;

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
    #[inline(always)]
    fn prefetch<T>(self, _data: &T) {}
}
