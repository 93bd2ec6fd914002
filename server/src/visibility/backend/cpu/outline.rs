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

/// Least d / (S·D·z·W), least d / (S·D²), and least zᵢ / S, times Q.
const LEAST_SHAPE: f32 = 1.0 / (1 << 7) as f32;
const LEAST_VOLUME: f32 = 1.0 / (1 << 14) as f32;
const LEAST_DEPTH: f32 = 1.0 / (1 << 6) as f32;

/// What rounding may add to W, as a share of Q.
const EXTENT_ROUNDING: f32 = 1.0 / (1 << 16) as f32;

/// Rectangles around eight triangles side by side: lowest x, highest x, lowest y, highest y. Infinite if it has none.
pub(super) type Outlines = [F8; 4];

/// The bounds of a group's packets, widened by the margin.
pub(super) struct Neighbourhood {
    /// Lowest x, highest x, lowest y, highest y.
    bounds: [F8; 4],
    /// Q.
    pub(super) most: f32,
}

impl Neighbourhood {
    #[inline(always)]
    pub(super) fn of<S: Simd>(s: S, group: &Group) -> Self {
        let [x, y] = [group.group_x, group.group_y];
        let most = x[1].max(-x[0]).max(y[1]).max(-y[0]).max(1.0);
        let margin = s.splat(most * MARGIN);
        let mut bounds = [F8::default(); 4];
        s.store(s.load(&group.packet_x[0]) - margin, &mut bounds[0]);
        s.store(s.load(&group.packet_x[1]) + margin, &mut bounds[1]);
        s.store(s.load(&group.packet_y[0]) - margin, &mut bounds[2]);
        s.store(s.load(&group.packet_y[1]) + margin, &mut bounds[3]);
        Self { bounds, most }
    }

    /// The packets whose rays may hit triangle `slot`. Some may have no rays.
    #[inline(always)]
    pub(super) fn packets<S: Simd>(&self, s: S, outlines: &Outlines, slot: usize) -> u8 {
        let [low_x, high_x, low_y, high_y] = &self.bounds;
        let in_x = s.and(
            s.ge(s.splat(outlines[1].0[slot]), s.load(low_x)),
            s.ge(s.load(high_x), s.splat(outlines[0].0[slot])),
        );
        let in_y = s.and(
            s.ge(s.splat(outlines[3].0[slot]), s.load(low_y)),
            s.ge(s.load(high_y), s.splat(outlines[2].0[slot])),
        );
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
    most: f32,
    to: &mut Outlines,
) {
    let one = s.splat(1.0);
    let inverse = [s.div(one, a[2]), s.div(one, b[2]), s.div(one, c[2])];
    let x = [a[0] * inverse[0], b[0] * inverse[1], c[0] * inverse[2]];
    let y = [a[1] * inverse[0], b[1] * inverse[1], c[1] * inverse[2]];
    let (low_x, high_x) = (vector::least(s, x), vector::most(s, x));
    let (low_y, high_y) = (vector::least(s, y), vector::most(s, y));
    let extent = s.max(high_x - low_x, high_y - low_y) + s.splat(most * EXTENT_ROUNDING);
    let depths = [a[2], b[2], c[2]];

    let sides = vector::size(s, to_b) + vector::size(s, to_c);
    let size = vector::size(s, a) + sides;
    let shape = vector::most(s, depths) * extent * s.splat(LEAST_SHAPE);
    let least = size * sides * s.max(shape, sides * s.splat(LEAST_VOLUME));
    let is_deep = s.ge(vector::least(s, depths) * s.splat(most), size * s.splat(LEAST_DEPTH));
    let is_sure = s.and(s.ge(s.abs(distance), least), is_deep);
    let (lowest, highest) = (s.splat(f32::NEG_INFINITY), s.splat(f32::INFINITY));
    s.store(s.select(is_sure, low_x, lowest), &mut to[0]);
    s.store(s.select(is_sure, high_x, highest), &mut to[1]);
    s.store(s.select(is_sure, low_y, lowest), &mut to[2]);
    s.store(s.select(is_sure, high_y, highest), &mut to[3]);
}
