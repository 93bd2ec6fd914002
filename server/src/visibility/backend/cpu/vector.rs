//! Vectors of three coordinates, eight side by side.
//!
//! These are `#[inline(always)]` functions instead of closures and `map`. A closure is compiled as a separate function
//! without the instructions of the level that uses it, and every operation in it becomes a call.

use super::simd::{F8, Simd};

/// Three coordinates of eight vectors.
pub(super) type V3<S> = [<S as Simd>::F; 3];

#[inline(always)]
pub(super) fn splat<S: Simd>(s: S, a: [f32; 3]) -> V3<S> {
    [s.splat(a[0]), s.splat(a[1]), s.splat(a[2])]
}

#[inline(always)]
pub(super) fn load<S: Simd>(s: S, a: &[F8; 3]) -> V3<S> {
    [s.load(&a[0]), s.load(&a[1]), s.load(&a[2])]
}

/// Packet `p` of coordinates kept by axis.
#[inline(always)]
pub(super) fn load_packet<S: Simd, const N: usize>(s: S, a: &[[F8; N]; 3], p: usize) -> V3<S> {
    [s.load(&a[0][p]), s.load(&a[1][p]), s.load(&a[2][p])]
}

#[inline(always)]
pub(super) fn add<S: Simd>(a: V3<S>, b: V3<S>) -> V3<S> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
pub(super) fn sub<S: Simd>(a: V3<S>, b: V3<S>) -> V3<S> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(super) fn scale<S: Simd>(a: V3<S>, by: S::F) -> V3<S> {
    [a[0] * by, a[1] * by, a[2] * by]
}

/// `a` with its sign flipped where `sign`'s sign bit is set.
#[inline(always)]
pub(super) fn xor_sign<S: Simd>(s: S, a: V3<S>, sign: S::F) -> V3<S> {
    [s.xor_sign(a[0], sign), s.xor_sign(a[1], sign), s.xor_sign(a[2], sign)]
}

#[inline(always)]
pub(super) fn dot<S: Simd>(s: S, a: V3<S>, b: V3<S>) -> S::F {
    s.fma(a[0], b[0], s.fma(a[1], b[1], a[2] * b[2]))
}

#[inline(always)]
pub(super) fn cross<S: Simd>(s: S, a: V3<S>, b: V3<S>) -> V3<S> {
    [s.fms(a[1], b[2], a[2] * b[1]), s.fms(a[2], b[0], a[0] * b[2]), s.fms(a[0], b[1], a[1] * b[0])]
}

/// Twice a × b, as (a + b) × (b − a): swapping a and b negates it to the last bit, and its error is a few roundings of
/// |a|·|b − a| rather than of |a|·|b|.
#[inline(always)]
pub(super) fn cross_of_edge<S: Simd>(s: S, a: V3<S>, b: V3<S>) -> V3<S> {
    cross(s, add::<S>(a, b), sub::<S>(b, a))
}

/// The sum of the coordinates' absolute values.
#[inline(always)]
pub(super) fn size<S: Simd>(s: S, a: V3<S>) -> S::F {
    s.abs(a[0]) + s.abs(a[1]) + s.abs(a[2])
}

/// k[0]·x + k[1]·y + k[2].
#[inline(always)]
pub(super) fn at<S: Simd>(s: S, k: V3<S>, x: S::F, y: S::F) -> S::F {
    s.fma(k[0], x, s.fma(k[1], y, k[2]))
}

#[inline(always)]
pub(super) fn least<S: Simd>(s: S, a: V3<S>) -> S::F {
    s.min(s.min(a[0], a[1]), a[2])
}

#[inline(always)]
pub(super) fn most<S: Simd>(s: S, a: V3<S>) -> S::F {
    s.max(s.max(a[0], a[1]), a[2])
}
