//! The eight triangles of a leaf as a group's rays see them: edge functions, and which triangles can be met at all.
//!
//! With corners a, b, c in the group's homogeneous frame (u, v, w from the apex; sheared (u, v, 1) for parallel
//! rays, (u, v, 1 + spread·w) for those from far away), the
//! ray (x, y, 1) passes the edge a→b on the side that the sign of (x, y, 1) · (a × b) tells. Computed as (a + b) × (b − a),
//! which is twice that: swapping a and b negates every product exactly, so neighbours agree; and the error is a few
//! roundings of |a|·|b − a|, hence of |a| as a distance from the edge, however short the edge is.

use glam::DVec3;

use super::{
    group::{Group, Projection},
    simd::{F8, Simd},
    surface::ROUNDING,
    traverse::PLANE_ROUNDINGS,
    vector::{self, V3},
};
use crate::visibility::hierarchy::bvh::Leaf;

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

/// The greatest value of k·(x, y, 1) over a rectangle. Rounded like the value at each of its points, and rounding is
/// monotone, so this is never below any of those.
#[inline(always)]
fn highest_over<S: Simd>(s: S, k: V3<S>, x: &[f32; 2], y: &[f32; 2]) -> S::F {
    let best_x = s.select_negative(k[0], s.splat(x[0]), s.splat(x[1]));
    let best_y = s.select_negative(k[1], s.splat(y[0]), s.splat(y[1]));
    vector::at(s, k, best_x, best_y)
}

#[inline(always)]
fn corner<S: Simd, const PARALLEL: bool>(s: S, projection: &Projection, corner: &[F8; 3]) -> V3<S> {
    let [u, v, w] = projection.axes;
    let x = s.load(&corner[u]) - s.splat(projection.origin[0]);
    let y = s.load(&corner[v]) - s.splat(projection.origin[1]);
    let z = (s.load(&corner[w]) - s.splat(projection.origin[2])) * s.splat(projection.w_sign);
    if PARALLEL {
        let [shear_x, shear_y] = projection.shear;
        [
            s.fnma(s.splat(shear_x), z, x),
            s.fnma(s.splat(shear_y), z, y),
            s.fma(s.splat(projection.spread), z, s.splat(1.0)),
        ]
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
    prepare_as::<S, PARALLEL, CLOSEST, false>(s, leaf, group, inverse_far, prepared)
}

/// As [`prepare`], where some triangle's side is in doubt: a function of its own, so that the common way keeps its
/// registers.
#[cold]
#[inline(never)]
fn prepare_settled<S: Simd, const CLOSEST: bool>(
    s: S,
    leaf: &Leaf,
    group: &Group,
    inverse_far: f32,
    prepared: &mut Prepared,
) -> u8 {
    prepare_as::<S, false, CLOSEST, true>(s, leaf, group, inverse_far, prepared)
}

#[inline(always)]
fn prepare_as<S: Simd, const PARALLEL: bool, const CLOSEST: bool, const SETTLE: bool>(
    s: S,
    leaf: &Leaf,
    group: &Group,
    inverse_far: f32,
    prepared: &mut Prepared,
) -> u8 {
    let zero = s.splat(0.0);
    let a = corner::<S, PARALLEL>(s, &group.projection, &leaf.corners[0]);
    let b = corner::<S, PARALLEL>(s, &group.projection, &leaf.corners[1]);
    let c = corner::<S, PARALLEL>(s, &group.projection, &leaf.corners[2]);
    let normal = vector::cross(s, vector::sub::<S>(b, a), vector::sub::<S>(c, a));
    // Positive when the normal points along the rays. Zero: edge-on, nothing to be met.
    let mut distance = vector::dot(s, normal, a);
    if !PARALLEL {
        let rounding = s.load(&leaf.span) * vector::size(s, a);
        let sure = s.gt(s.abs(distance), rounding * s.splat(APEX_ROUNDINGS * ROUNDING));
        let doubtful = leaf.used & !s.bits(sure);
        if doubtful != 0 && !SETTLE {
            return prepare_settled::<S, CLOSEST>(s, leaf, group, inverse_far, prepared);
        }
        if SETTLE {
            let mut distances = F8::default();
            s.store(distance, &mut distances);
            settle(leaf, &group.projection, doubtful, &mut distances);
            distance = s.load(&distances);
        }
    }
    let back = s.bits(s.gt(distance, zero));
    let mut alive = leaf.used & (back | s.bits(s.gt(zero, distance)));
    if CLOSEST {
        alive &= !(back & leaf.single_sided);
    }
    for (i, (from, to)) in [(b, c), (c, a), (a, b)].into_iter().enumerate() {
        let edge = vector::xor_sign(s, vector::cross_of_edge(s, from, to), distance);
        alive &= s.bits(s.ge(highest_over(s, edge, &group.group_x, &group.group_y), zero));
        store(s, edge, &mut prepared.edges[i]);
    }
    if CLOSEST {
        let plane = vector::scale::<S>(normal, s.div(s.splat(1.0), distance));
        alive &= s.bits(s.gt(highest_over(s, plane, &group.group_x, &group.group_y), s.splat(inverse_far)));
        store(s, plane, &mut prepared.inverse_depth);
    }
    prepared.back = back;
    alive
}

/// How far rounding may move the product of a triangle's normal and its distance from the apex, in rounding units of the
/// product of the sizes of two sides and of the distance: 4 for the normal, 1 for the distance, and 3 for products and sums.
const APEX_ROUNDINGS: f32 = 8.0;

/// The distances again for the triangles in `slots`, in f64: 0 where the plane holds the apex as far as rounding of the
/// corners can tell. A lamp on a surface is not shadowed by it, a camera on one does not
/// see it; and the sign of a distance turns the edges, so that a wrong
/// one would let light through.
fn settle(leaf: &Leaf, projection: &Projection, slots: u8, distances: &mut F8) {
    let [u, v, w] = projection.axes;
    let [x, y, z] = projection.origin.map(f64::from);
    for slot in (0..8).filter(|slot| slots >> slot & 1 == 1) {
        let [a, b, c] = leaf.corners.each_ref().map(|corner| {
            let [u, v, w] = [u, v, w].map(|axis| f64::from(corner[axis].0[slot]));
            DVec3::new(u - x, v - y, (w - z) * f64::from(projection.w_sign))
        });
        let normal = (b - a).cross(c - a);
        let distance = normal.dot(a);
        let is_clear = distance.abs() > f64::from(PLANE_ROUNDINGS * ROUNDING) * normal.abs().dot(a.abs());
        #[expect(clippy::cast_possible_truncation, reason = "rounding keeps the sign, and 0 is kept away from")]
        let rounded = (distance.abs() as f32).max(f32::MIN_POSITIVE);
        distances.0[slot] = match () {
            () if !is_clear => 0.0,
            () if distance < 0.0 => -rounded,
            () => rounded,
        };
    }
}

#[inline(always)]
fn store<S: Simd>(s: S, k: V3<S>, to: &mut [F8; 3]) {
    s.store(k[0], &mut to[0]);
    s.store(k[1], &mut to[1]);
    s.store(k[2], &mut to[2]);
}

/// The coefficients of triangle `slot`, in all lanes.
#[inline(always)]
fn of_slot<S: Simd>(s: S, k: &[F8; 3], slot: usize) -> V3<S> {
    [s.splat(k[0].0[slot]), s.splat(k[1].0[slot]), s.splat(k[2].0[slot])]
}

/// One triangle's edge functions, in all lanes.
#[derive(Clone, Copy)]
pub(super) struct Edges<S: Simd> {
    edges: [V3<S>; 3],
    /// Whether each rises with x, and with y: where over a rectangle it is highest.
    rising: [[bool; 2]; 3],
}

impl Prepared {
    /// The edge functions of triangle `slot`.
    #[inline(always)]
    pub(super) fn edges_of<S: Simd>(&self, s: S, slot: usize) -> Edges<S> {
        let [e0, e1, e2] = &self.edges;
        Edges {
            edges: [of_slot(s, e0, slot), of_slot(s, e1, slot), of_slot(s, e2, slot)],
            rising: [rising(e0, slot), rising(e1, slot), rising(e2, slot)],
        }
    }

    /// 1/z of triangle `slot`'s plane at eight points.
    #[inline(always)]
    pub(super) fn inverse_depth_at<S: Simd>(&self, s: S, slot: usize, x: S::F, y: S::F) -> S::F {
        vector::at(s, of_slot(s, &self.inverse_depth, slot), x, y)
    }
}

/// Whether triangle `slot`'s function of an edge rises with x, and with y.
#[inline(always)]
fn rising(k: &[F8; 3], slot: usize) -> [bool; 2] {
    [k[0].0[slot].is_sign_positive(), k[1].0[slot].is_sign_positive()]
}

impl<S: Simd> Edges<S> {
    /// The values at eight points.
    #[inline(always)]
    pub(super) fn at(&self, s: S, x: S::F, y: S::F) -> V3<S> {
        [vector::at(s, self.edges[0], x, y), vector::at(s, self.edges[1], x, y), vector::at(s, self.edges[2], x, y)]
    }

    /// Bit p: packet p of `group` may meet the triangle; packets are tested side by side, each by its bounds.
    #[inline(always)]
    pub(super) fn packets(&self, s: S, group: &Group) -> u8 {
        let inside = [self.highest(s, 0, group), self.highest(s, 1, group), self.highest(s, 2, group)];
        s.bits(s.ge(vector::least(s, inside), s.splat(0.0))) & group.packets
    }

    /// The greatest value of edge function `i` over each packet's bounds.
    #[inline(always)]
    fn highest(&self, s: S, i: usize, group: &Group) -> S::F {
        let x = &group.packet_x[usize::from(self.rising[i][0])];
        let y = &group.packet_y[usize::from(self.rising[i][1])];
        vector::at(s, self.edges[i], s.load(x), s.load(y))
    }
}
