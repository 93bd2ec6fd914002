//! The eight triangles of a leaf as a group's rays see them: edge functions, and which triangles can be met at all.
//!
//! With corners a, b, c in the group's homogeneous frame (u, v, w from the apex; sheared (u, v, 1) for parallel rays), the
//! ray (x, y, 1) passes the edge a→b on the side that the sign of (x, y, 1) · (a × b) tells. Computed as (a + b) × (b − a),
//! which is twice that: swapping a and b negates every product exactly, so neighbours agree; and the error is a few
//! roundings of |a|·|b − a|, hence of |a| as a distance from the edge, however short the edge is.

use super::{
    group::{Group, Projection},
    simd::{F8, Simd},
};
use crate::visibility::bvh::Leaf;

/// Three numbers for each of eight triangles.
type Triple<S> = [<S as Simd>::F; 3];

/// What packets are tested against, eight triangles side by side.
#[derive(Default)]
pub(super) struct Prepared {
    /// Coefficients of the edge functions opposite corners 0, 1, 2, turned so that all three are ≥ 0 inside.
    pub(super) edges: [[F8; 3]; 3],
    /// Coefficients of 1/z on the triangle's plane (closest hits only).
    pub(super) inverse_depth: [F8; 3],
    /// Bit i: triangle i's normal points along the rays, so they meet its back.
    pub(super) back: u8,
}

#[inline(always)]
fn cross_of_edge<S: Simd>(s: S, a: Triple<S>, b: Triple<S>) -> Triple<S> {
    let sum = [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
    let way = [b[0] - a[0], b[1] - a[1], b[2] - a[2]];
    cross(s, sum, way)
}

#[inline(always)]
fn cross<S: Simd>(s: S, a: Triple<S>, b: Triple<S>) -> Triple<S> {
    [s.fms(a[1], b[2], a[2] * b[1]), s.fms(a[2], b[0], a[0] * b[2]), s.fms(a[0], b[1], a[1] * b[0])]
}

/// The greatest value of k·(x, y, 1) over a rectangle. Rounded like the value at each of its points, and rounding is
/// monotone, so this is never below any of those.
#[inline(always)]
fn highest_over<S: Simd>(s: S, k: Triple<S>, x: &[f32; 2], y: &[f32; 2]) -> S::F {
    let best_x = s.select_negative(k[0], s.splat(x[0]), s.splat(x[1]));
    let best_y = s.select_negative(k[1], s.splat(y[0]), s.splat(y[1]));
    s.fma(k[0], best_x, s.fma(k[1], best_y, k[2]))
}

#[inline(always)]
fn corner<S: Simd, const PARALLEL: bool>(s: S, projection: &Projection, corner: &[F8; 3]) -> Triple<S> {
    let [u, v, w] = projection.axes;
    let x = s.load(&corner[u]) - s.splat(projection.origin[0]);
    let y = s.load(&corner[v]) - s.splat(projection.origin[1]);
    let z = (s.load(&corner[w]) - s.splat(projection.origin[2])) * s.splat(projection.w_sign);
    if PARALLEL {
        let [shear_x, shear_y] = projection.shear;
        [s.fnma(s.splat(shear_x), z, x), s.fnma(s.splat(shear_y), z, y), s.splat(1.0)]
    } else {
        [x, y, z]
    }
}

/// Prepares `leaf` for `group`. The result's bits are the triangles that some ray can meet: facing rules aside, not wholly
/// outside an edge, not seen edge-on, and (closest hits) not wholly beyond 1/z = `inverse_far`.
#[inline(always)]
pub(super) fn prepare<S: Simd, const PARALLEL: bool, const CLOSEST: bool>(
    s: S,
    leaf: &Leaf,
    group: &Group,
    inverse_far: f32,
    prepared: &mut Prepared,
) -> u8 {
    let zero = s.splat(0.0);
    let [a, b, c] = [0, 1, 2].map(|i| corner::<S, PARALLEL>(s, &group.projection, &leaf.corners[i]));
    let ab = [b[0] - a[0], b[1] - a[1], b[2] - a[2]];
    let ac = [c[0] - a[0], c[1] - a[1], c[2] - a[2]];
    let normal = cross(s, ab, ac);
    // Positive when the normal points along the rays. Zero: edge-on, nothing to be met.
    let distance = s.fma(normal[0], a[0], s.fma(normal[1], a[1], normal[2] * a[2]));
    let back = s.bits(s.gt(distance, zero));
    let mut alive = leaf.used & (back | s.bits(s.gt(zero, distance)));
    if CLOSEST {
        alive &= !(back & leaf.single_sided);
    }
    for (i, (from, to)) in [(b, c), (c, a), (a, b)].into_iter().enumerate() {
        let edge = cross_of_edge(s, from, to).map(|k| s.xor_sign(k, distance));
        alive &= s.bits(s.ge(highest_over(s, edge, &group.group_x, &group.group_y), zero));
        for (k, place) in edge.into_iter().zip(&mut prepared.edges[i]) {
            s.store(k, place);
        }
    }
    if CLOSEST {
        let inverse = s.div(s.splat(1.0), distance);
        let plane = normal.map(|n| n * inverse);
        alive &= s.bits(s.gt(highest_over(s, plane, &group.group_x, &group.group_y), s.splat(inverse_far)));
        for (k, place) in plane.into_iter().zip(&mut prepared.inverse_depth) {
            s.store(k, place);
        }
    }
    prepared.back = back;
    alive
}

impl Prepared {
    /// The values of triangle `slot`'s edge functions at eight points.
    #[inline(always)]
    pub(super) fn edges_at<S: Simd>(&self, s: S, slot: usize, x: S::F, y: S::F) -> Triple<S> {
        self.edges
            .each_ref()
            .map(|[kx, ky, k1]| s.fma(s.splat(kx.0[slot]), x, s.fma(s.splat(ky.0[slot]), y, s.splat(k1.0[slot]))))
    }

    /// 1/z of triangle `slot`'s plane at eight points.
    #[inline(always)]
    pub(super) fn inverse_depth_at<S: Simd>(&self, s: S, slot: usize, x: S::F, y: S::F) -> S::F {
        let [kx, ky, k1] = &self.inverse_depth;
        s.fma(s.splat(kx.0[slot]), x, s.fma(s.splat(ky.0[slot]), y, s.splat(k1.0[slot])))
    }

    /// Bit p: packet p of `group` may meet triangle `slot`; packets are tested side by side, each by its bounds.
    #[inline(always)]
    pub(super) fn packets<S: Simd>(&self, s: S, slot: usize, group: &Group) -> u8 {
        let inside = self.edges.each_ref().map(|k| {
            let [kx, ky, k1] = [k[0].0[slot], k[1].0[slot], k[2].0[slot]];
            let x = &group.packet_x[usize::from(kx.is_sign_positive())];
            let y = &group.packet_y[usize::from(ky.is_sign_positive())];
            s.fma(s.splat(kx), s.load(x), s.fma(s.splat(ky), s.load(y), s.splat(k1)))
        });
        s.bits(s.ge(s.min(s.min(inside[0], inside[1]), inside[2]), s.splat(0.0))) & group.packets
    }
}
