//! Rounding bounds that several steps of the tracer share.

pub(super) const ROUNDING: f32 = 1.0 / (1 << 24) as f32;

/// How far rounding may move the distance of a point from a triangle's plane, in rounding units of the distance's
/// terms.
///
/// With a corner a and the unit normal n the distance is n·(p − a), computed near the triangle and not near the light.
/// n comes from f64 and is exact up to its rounding to f32, so the planes of long thin triangles are as accurate as
/// others. Each term is off by 1 rounding of n, 1 of p − a and 3 of products and sums, contracted or not: 5, and one
/// more for the bound itself. Twin: `PLANE_ROUNDINGS` in shared/ray.wgsl.
pub(super) const PLANE_ROUNDINGS: f32 = 6.0;
