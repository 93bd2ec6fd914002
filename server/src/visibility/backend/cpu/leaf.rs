//! The eight triangles of a leaf, prepared for a group: edge functions, and which triangles rays may hit at all.
//!
//! Corners a, b, c are in the group's homogeneous frame: (u, v, w) from the apex, sheared (u, v, 1) for parallel rays,
//! (u, v, 1 + spread·w) for rays from a distant apex. The sign of (x, y, 1) · (a × b) tells on which side of the edge
//! a→b the ray (x, y, 1) passes. It is computed as (a + b) × (b − a), which is twice that. Swapping a and b negates
//! every product exactly, so neighbours agree. The error is a few roundings of |a|·|b − a|, hence of |a| as a distance
//! from the edge, however short the edge is.

use glam::DVec3;

use super::{
    group::{Group, Projection},
    outline::{Neighbourhood, Outlines, outlines},
    rounding::{PLANE_ROUNDINGS, ROUNDING},
    simd::{F8, Simd},
    vector::{self, V3},
};
use crate::visibility::hierarchy::bvh::Leaf;

/// Eight triangles side by side, for tests against packets.
#[derive(Default)]
pub(super) struct Prepared {
    /// Coefficients of the edge functions opposite corners 0, 1, 2. Signs are such that all three are ≥ 0 inside.
    pub(super) edges: [[F8; 3]; 3],
    /// Coefficients of 1/z on the triangle's plane; for closest hits only.
    pub(super) inverse_depth: [F8; 3],
    /// Rectangles around the triangles.
    pub(super) outlines: Outlines,
    /// Whether they are known.
    pub(super) outlined: bool,
    /// Bit i: triangle i's normal points along the rays, so they hit its back.
    pub(super) back: u8,
}

/// The maximum of k·(x, y, 1) over a rectangle. It is rounded like the value at each point. Rounding is monotone, so it
/// is never below the value at any point.
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

/// A rectangle takes about as long as to rule one triangle out without. Leaves with fewer candidates get none.
const LEAST_OUTLINED: u32 = 2;

/// Prepares `leaf` for `group`. Returns the triangles that some ray may hit: not edge-on, not wholly outside an edge
/// and, for closest hits, neither showing a culled back nor wholly beyond 1/z = `inverse_far`.
#[inline(always)]
pub(super) fn prepare<S: Simd, const PARALLEL: bool, const CLOSEST: bool>(
    s: S,
    leaf: &Leaf,
    (group, near): (&Group, &Neighbourhood),
    inverse_far: f32,
    prepared: &mut Prepared,
) -> u8 {
    prepare_as::<S, PARALLEL, CLOSEST, false>(s, leaf, (group, near), inverse_far, prepared)
}

/// As [`prepare`], if some triangle's side is in doubt. Separate, so that the common path keeps its registers.
#[cold]
#[inline(never)]
fn prepare_settled<S: Simd, const CLOSEST: bool>(
    s: S,
    leaf: &Leaf,
    (group, near): (&Group, &Neighbourhood),
    inverse_far: f32,
    prepared: &mut Prepared,
) -> u8 {
    prepare_as::<S, false, CLOSEST, true>(s, leaf, (group, near), inverse_far, prepared)
}

#[inline(always)]
fn prepare_as<S: Simd, const PARALLEL: bool, const CLOSEST: bool, const SETTLE: bool>(
    s: S,
    leaf: &Leaf,
    (group, near): (&Group, &Neighbourhood),
    inverse_far: f32,
    prepared: &mut Prepared,
) -> u8 {
    let zero = s.splat(0.0);
    let a = corner::<S, PARALLEL>(s, &group.projection, &leaf.corners[0]);
    let b = corner::<S, PARALLEL>(s, &group.projection, &leaf.corners[1]);
    let c = corner::<S, PARALLEL>(s, &group.projection, &leaf.corners[2]);
    let (to_b, to_c) = (vector::sub::<S>(b, a), vector::sub::<S>(c, a));
    let normal = vector::cross(s, to_b, to_c);
    // Positive if the normal points along the rays, zero if the triangle is edge-on.
    let mut distance = vector::dot(s, normal, a);
    if !PARALLEL {
        let rounding = s.load(&leaf.span) * vector::size(s, a);
        let sure = s.gt(s.abs(distance), rounding * s.splat(APEX_ROUNDINGS * ROUNDING));
        let doubtful = leaf.used & !s.bits(sure);
        if doubtful != 0 && !SETTLE {
            return prepare_settled::<S, CLOSEST>(s, leaf, (group, near), inverse_far, prepared);
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
    prepared.back = back;
    if alive == 0 {
        return 0;
    }
    if CLOSEST {
        let plane = vector::scale::<S>(normal, s.div(s.splat(1.0), distance));
        alive &= s.bits(s.gt(highest_over(s, plane, &group.group_x, &group.group_y), s.splat(inverse_far)));
        store(s, plane, &mut prepared.inverse_depth);
    }
    // In doubt the distances are not those of the rounded corners.
    prepared.outlined = !SETTLE && alive.count_ones() >= LEAST_OUTLINED;
    if prepared.outlined {
        outlines(s, [a, b, c], [to_b, to_c], distance, near, &mut prepared.outlines);
    }
    alive
}

/// How far rounding may move normal · (corner − apex), in rounding units of the product of two sides' sizes and that
/// distance's size: 4 for the normal, 1 for the distance, 3 for products and sums.
const APEX_ROUNDINGS: f32 = 8.0;

/// Recomputes the distances of the triangles in `slots` in f64. Sets them to 0 where the plane contains the apex within
/// the rounding error of the corners, so that a surface neither shadows a lamp on it nor is seen by a camera on it. The
/// sign of a distance decides the signs of the edges: a wrong one would let light through.
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
        #[expect(clippy::cast_possible_truncation, reason = "rounding keeps the sign, and the result is never 0")]
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

/// A triangle's edge functions, in all lanes.
#[derive(Clone, Copy)]
pub(super) struct Edges<S: Simd> {
    edges: [V3<S>; 3],
    /// True where a function rises with x, and with y: selects the corner of a rectangle with its maximum.
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

/// Returns whether triangle `slot`'s edge function rises with x, and with y.
#[inline(always)]
fn rising(k: &[F8; 3], slot: usize) -> [bool; 2] {
    [k[0].0[slot].is_sign_positive(), k[1].0[slot].is_sign_positive()]
}

impl<S: Simd> Edges<S> {
    #[inline(always)]
    pub(super) fn at(&self, s: S, x: S::F, y: S::F) -> V3<S> {
        [vector::at(s, self.edges[0], x, y), vector::at(s, self.edges[1], x, y), vector::at(s, self.edges[2], x, y)]
    }

    /// Returns the packets of `group` that may hit the triangle, by their bounds.
    #[inline(always)]
    pub(super) fn packets(&self, s: S, group: &Group) -> u8 {
        let inside = [self.highest(s, 0, group), self.highest(s, 1, group), self.highest(s, 2, group)];
        s.bits(s.ge(vector::least(s, inside), s.splat(0.0))) & group.packets
    }

    /// The maximum of edge function `i` over each packet's bounds.
    #[inline(always)]
    fn highest(&self, s: S, i: usize, group: &Group) -> S::F {
        let x = &group.packet_x[usize::from(self.rising[i][0])];
        let y = &group.packet_y[usize::from(self.rising[i][1])];
        vector::at(s, self.edges[i], s.load(x), s.load(y))
    }
}
