//! Rectangles around triangles, as seen along a group's rays.
//!
//! Three edge functions tell exactly whether a ray hits a triangle, but over a packet's bounds they say little of a
//! triangle that is smaller: near a corner each of them is positive somewhere. A rectangle around the triangle rules
//! such packets out by four comparisons.
//!
//! # What rounding may do
//!
//! A ray outside a rectangle may still be inside the computed edges, since these are rounded. Let u be 2⁻²⁴, |v| a sum
//! of magnitudes, vᵢ the triangle's corners in the group's homogeneous frame, zᵢ their third coordinates, q = (x, y, 1)
//! a ray, Q the largest of 1, |x| and |y|, S ≥ |vᵢ| and D ≥ |vᵢ − vⱼ|. The corners are exact: they are the numbers from
//! which the edge functions are computed.
//!
//! - An edge function is 2 (vⱼ × vₖ)·q. Its coefficients are off by 4 roundings of their terms, its value by 3 more:
//!   by at most 7u·Q·2S·D.
//! - With d = v₀·(v₁ × v₂), q = Σ wᵢvᵢ where wᵢ is an edge function over 2d. If all three are computed as ≥ 0, then
//!   wᵢ ≥ −η with η = 7u·Q·S·D / d. The third coordinates give Σ wᵢzᵢ = 1.
//! - Let all corners lie left of X by μ or more, xᵢ = (vᵢ)ₓ / zᵢ ≤ X − μ, and W be the rectangle's side: X − xᵢ ≤ μ + W
//!   if X is the closest such place. Then x − X = Σ wᵢzᵢ(xᵢ − X). The wᵢ > 0 add at most −μ·Σ wᵢzᵢ = −μ(1 + Σ |wⱼ|zⱼ)
//!   over the wⱼ < 0. These, at most two, add at most |wⱼ|zⱼ(μ + W) each. So x − X ≤ 2η·z·W − μ, with z the largest zᵢ.
//! - So no ray at X or beyond is inside if μ > 14u·Q·S·D·z·W / d. For thin triangles, whose d is small, that is far: an
//!   edge hardly limits how far along it a ray passes. They get no rectangle. Others have d ≥ S·D·z·W / 2⁷, and
//!   [`MARGIN`] = 16u·2⁷ suffices.
//! - The remaining eighth covers the rounding of what is compared. Places are at most 2⁶Q, so 2 roundings move them by
//!   2⁻¹⁷Q. W gets twice that on top. d is off by 7u·S·D²/4, which is little if d ≥ S·D² / 2¹⁴.

use super::{
    group::Group,
    simd::{F8, Simd},
    vector::{self, V3},
};

/// By how much packets' bounds are widened, as a share of Q.
const MARGIN: f32 = 1.0 / (1 << 13) as f32;

/// What a triangle needs to get a rectangle.
#[derive(Debug, Clone, Copy)]
struct Least {
    /// d / (S·D·z·W).
    shape: f32,
    /// d / (S·D²).
    volume: f32,
    /// Q·zᵢ / S.
    depth: f32,
}

const LEAST: Least =
    Least { shape: 1.0 / (1 << 7) as f32, volume: 1.0 / (1 << 14) as f32, depth: 1.0 / (1 << 6) as f32 };

/// What rounding may add to W, as a share of Q.
const EXTENT_ROUNDING: f32 = 1.0 / (1 << 16) as f32;

/// Rectangles around eight triangles side by side: lowest x, highest x, lowest y, highest y. Infinite if it has none.
pub(super) type Outlines = [F8; 4];

/// The bounds of a group's packets, widened by the margin.
pub(super) struct Neighbourhood {
    /// Lowest x, highest x, lowest y, highest y.
    bounds: [F8; 4],
    /// Q.
    most: f32,
    least: Least,
}

impl Neighbourhood {
    #[inline(always)]
    pub(super) fn of<S: Simd>(s: S, group: &Group) -> Self {
        Self::with(s, group, MARGIN, LEAST)
    }

    #[inline(always)]
    fn with<S: Simd>(s: S, group: &Group, margin: f32, least: Least) -> Self {
        let [x, y] = [group.group_x, group.group_y];
        let most = x[1].max(-x[0]).max(y[1]).max(-y[0]).max(1.0);
        let margin = s.splat(most * margin);
        let mut bounds = [F8::default(); 4];
        s.store(s.load(&group.packet_x[0]) - margin, &mut bounds[0]);
        s.store(s.load(&group.packet_x[1]) + margin, &mut bounds[1]);
        s.store(s.load(&group.packet_y[0]) - margin, &mut bounds[2]);
        s.store(s.load(&group.packet_y[1]) + margin, &mut bounds[3]);
        Self { bounds, most, least }
    }

    /// The packets whose rays may hit triangle `slot`. Some may have no rays.
    #[inline(always)]
    pub(super) fn packets<S: Simd>(&self, s: S, outlines: &Outlines, slot: usize) -> u8 {
        let [low_x, high_x, low_y, high_y] = &self.bounds;
        let in_x = s
            .and(s.ge(s.splat(outlines[1].0[slot]), s.load(low_x)), s.ge(s.load(high_x), s.splat(outlines[0].0[slot])));
        let in_y = s
            .and(s.ge(s.splat(outlines[3].0[slot]), s.load(low_y)), s.ge(s.load(high_y), s.splat(outlines[2].0[slot])));
        s.bits(s.and(in_x, in_y))
    }
}

/// Rectangles around the triangles with these corners, sides from corner 0, and `distance` = d.
#[inline(always)]
pub(super) fn outlines<S: Simd>(
    s: S,
    [a, b, c]: [V3<S>; 3],
    [to_b, to_c]: [V3<S>; 2],
    distance: S::F,
    near: &Neighbourhood,
    to: &mut Outlines,
) {
    let (one, most) = (s.splat(1.0), s.splat(near.most));
    let inverse = [s.div(one, a[2]), s.div(one, b[2]), s.div(one, c[2])];
    let x = [a[0] * inverse[0], b[0] * inverse[1], c[0] * inverse[2]];
    let y = [a[1] * inverse[0], b[1] * inverse[1], c[1] * inverse[2]];
    let (low_x, high_x) = (vector::least(s, x), vector::most(s, x));
    let (low_y, high_y) = (vector::least(s, y), vector::most(s, y));
    let extent = s.max(high_x - low_x, high_y - low_y) + most * s.splat(EXTENT_ROUNDING);
    let depths = [a[2], b[2], c[2]];

    let sides = vector::size(s, to_b) + vector::size(s, to_c);
    let size = vector::size(s, a) + sides;
    let shape = vector::most(s, depths) * extent * s.splat(near.least.shape);
    let least = size * sides * s.max(shape, sides * s.splat(near.least.volume));
    let is_deep = s.ge(vector::least(s, depths) * most, size * s.splat(near.least.depth));
    let is_sure = s.and(s.ge(s.abs(distance), least), is_deep);
    let (lowest, highest) = (s.splat(f32::NEG_INFINITY), s.splat(f32::INFINITY));
    s.store(s.select(is_sure, low_x, lowest), &mut to[0]);
    s.store(s.select(is_sure, high_x, highest), &mut to[1]);
    s.store(s.select(is_sure, low_y, lowest), &mut to[2]);
    s.store(s.select(is_sure, high_y, highest), &mut to[3]);
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::visibility::{
        backend::cpu::{
            group::{PACKETS, Projection},
            leaf::{Prepared, prepare},
            simd::{Level, WithSimd},
        },
        hierarchy::bvh::Leaf,
    };

    /// Counts packets that rectangles rule out, and those of them with a ray inside the edges.
    struct Judge<'a> {
        leaf: &'a Leaf,
        projection: Projection,
        parallel: bool,
        rays: &'a [(F8, F8)],
        margin: f32,
        least: Least,
    }

    impl WithSimd for Judge<'_> {
        type Output = [u32; 2];
        #[inline(always)]
        fn run<S: Simd>(self, s: S) -> [u32; 2] {
            let mut group = Group::empty(self.projection);
            for (p, (x, y)) in self.rays.iter().enumerate() {
                group.set_packet(s, p, s.load(x), s.load(y), 0xff);
            }
            let near = Neighbourhood::with(s, &group, self.margin, self.least);
            let mut prepared = Prepared::default();
            let mut alive = if self.parallel {
                prepare::<S, true, false>(s, self.leaf, (&group, &near), 0.0, &mut prepared)
            } else {
                prepare::<S, false, true>(s, self.leaf, (&group, &near), 0.0, &mut prepared)
            };
            let mut found = [0; 2];
            while prepared.outlined && alive != 0 {
                let slot = alive.trailing_zeros() as usize;
                alive &= alive - 1;
                let kept = near.packets(s, &prepared.outlines, slot);
                let edges = prepared.edges_of(s, slot);
                for (_, (x, y)) in self.rays.iter().enumerate().filter(|(p, _)| kept >> p & 1 == 0) {
                    let inside = s.ge(vector::least(s, edges.at(s, s.load(x), s.load(y))), s.splat(0.0));
                    found[0] += 1;
                    found[1] += u32::from(s.bits(inside) != 0);
                }
            }
            found
        }
    }

    /// Where a point of the scene is on the plane, if in front.
    fn seen(projection: &Projection, point: Vec3) -> Option<[f32; 2]> {
        let [u, v, w] = projection.axes;
        let z = (point[w] - projection.origin[2]) * projection.w_sign;
        let [x, y] = [point[u] - projection.origin[0], point[v] - projection.origin[1]];
        let [shear_x, shear_y] = projection.shear;
        let is_parallel = projection.shear != [0.0; 2] || projection.spread != 0.0;
        let scale = if is_parallel { 1.0 + projection.spread * z } else { z };
        (scale > 0.0).then(|| [(x - shear_x * z) / scale, (y - shear_y * z) / scale])
    }

    /// Leaves of nasty triangles, seen from near and far, with packets close to their corners and beyond their tips.
    fn judge(margin: f32, least: Least) -> [u32; 2] {
        let mut state = 1_u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 23) as f32 - 1.0
        };
        let mut found = [0; 2];
        for round in 0..3000_u16 {
            let mut vector = |size: f32| Vec3::new(next(), next(), next()) * size;
            let scale = 10.0_f32.powi(i32::from(round % 9) - 4);
            // Every third scene lies far from its origin, so that coordinates are coarse.
            let apex = vector(if round % 3 == 0 { 300.0 * scale } else { scale });
            let direction = (vector(1.0) + Vec3::X * 0.01).normalize();
            let projection = match round % 4 {
                0 => Projection::along(direction, apex),
                1 => Projection::from_distant(apex - direction * 12.0 * scale, apex),
                _ => Projection::from_apex(apex, super::super::group::face_of(direction)),
            };
            let extent = scale * [1.0, 0.1, 1e-2, 1e-3][usize::from(round / 4 % 4)];
            let mut leaf = Leaf::EMPTY;
            let triangles: [[Vec3; 3]; 8] = std::array::from_fn(|slot| {
                let a = apex + direction * scale * (1.0 + slot as f32) + vector(0.3 * scale);
                let b = a + vector(extent);
                match slot % 4 {
                    // A sliver.
                    0 => [a, b, a + (b - a) * vector(1.0).x.abs() + vector(extent * 1e-3)],
                    1 => [a, b, a + (b - a) * 0.5 + vector(extent * 1e-5)],
                    // In a plane that nearly holds the apex.
                    2 => [a, b, a + (a - apex) * 0.1 + vector(extent * 1e-4)],
                    _ => [a, b, a + vector(extent)],
                }
            });
            for (slot, corners) in triangles.into_iter().enumerate() {
                leaf.place(slot, corners, Vec3::Y);
            }
            for corners in triangles {
                let [Some(a), Some(b), Some(c)] = corners.map(|corner| seen(&projection, corner)) else { continue };
                let rays: [(F8, F8); PACKETS] = std::array::from_fn(|p| {
                    let (tip, from) = [(a, b), (b, c), (c, a), (a, c), (b, a), (c, b)][p % 6];
                    let (mut x, mut y) = (F8::default(), F8::default());
                    // Beyond the tip by 2⁻⁶ to 2⁻²⁵ of a side, or of the place.
                    let far = 2.0_f32.powf(-6.0 - 19.0 * next().abs());
                    let sizes = if p % 2 == 0 { [tip[0] - from[0], tip[1] - from[1]] } else { tip };
                    for lane in 0..8 {
                        // On the axis, where a tip's two edges differ least.
                        let step = far * (1.0 + 0.1 * next());
                        x.0[lane] = tip[0] + sizes[0] * step;
                        y.0[lane] = tip[1] + sizes[1] * step;
                    }
                    (x, y)
                });
                let parallel = round % 4 < 2;
                let on_face = |ray: &(F8, F8)| ray.0.0.iter().chain(&ray.1.0).all(|at| at.abs() <= 1.0);
                if !parallel && !rays.iter().all(on_face) {
                    continue;
                }
                for level in [Level::detect(), Level::Portable] {
                    let judge = Judge { leaf: &leaf, projection, parallel, rays: &rays, margin, least };
                    let [out, wrong] = level.dispatch(judge);
                    found = [found[0] + out, found[1] + wrong];
                }
            }
        }
        found
    }

    #[test]
    fn what_a_rectangle_rules_out_is_inside_no_edges() {
        let [out, wrong] = judge(MARGIN, LEAST);
        assert!(out > 10_000, "only {out} packets are ruled out");
        assert_eq!(wrong, 0, "of {out}");
    }

    #[test]
    fn bounds_that_are_too_tight_are_noticed() {
        let [_, wrong] = judge(0.0, LEAST);
        assert!(wrong > 0, "no margin");
        let [_, wrong] = judge(MARGIN, Least { shape: 0.0, volume: 0.0, ..LEAST });
        assert!(wrong > 0, "rectangles of slivers");
    }
}
