//! The space that a group's rays sweep, tested against the eight boxes of a node at once.
//!
//! In the group's frame the rays lie between two planes x = b + a·z, and two more for y. A box is outside if it lies
//! beyond one of the four, behind the origin, or farther than `z_far`. Testing 64 rays costs as much as testing one.

use super::{
    group::Group,
    simd::{F8, Simd},
};
use crate::visibility::hierarchy::bvh::Node;

/// Widening of the planes: a slope for rays from an apex, relative to the scene's size for parallel rays. An edge
/// function is off by a few roundings (2⁻²⁴ each) of its corners' distance from the origin. A ray may hit a triangle
/// that it misses by that much, so it must then hit the box, too.
const SLACK: f32 = 1.0 / (1 << 20) as f32;

/// The planes. Each vector repeats one number in all lanes.
pub(super) struct Frustum<S: Simd> {
    axes: [usize; 3],
    w_negative: bool,
    origin: [S::F; 2],
    w_sign: S::F,
    w_offset: S::F,
    /// Slopes: lowest x, highest x, lowest y, highest y.
    slope: [S::F; 4],
    /// Offsets of the planes at z = 0.
    base: [S::F; 4],
    z_near: S::F,
}

impl<S: Simd> Frustum<S> {
    /// The space swept by `group`. `scene_size_m` bounds scene coordinates relative to the origin of parallel rays.
    #[inline(always)]
    pub(super) fn new<const PARALLEL: bool>(s: S, group: &Group, scene_size_m: f32) -> Self {
        let projection = &group.projection;
        let [u, v, w] = projection.origin;
        let bounds = [group.group_x[0], group.group_x[1], group.group_y[0], group.group_y[1]];
        let slack = if PARALLEL { SLACK * scene_size_m } else { SLACK };
        let bounds = [bounds[0] - slack, bounds[1] + slack, bounds[2] - slack, bounds[3] + slack];
        let [shear_x, shear_y] = projection.shear;
        let (slope, base, z_near) = if PARALLEL {
            let spread = |shear: f32, bound: f32| shear + projection.spread * bound;
            let slope = [
                spread(shear_x, bounds[0]),
                spread(shear_x, bounds[1]),
                spread(shear_y, bounds[2]),
                spread(shear_y, bounds[3]),
            ];
            (slope, bounds, f32::NEG_INFINITY)
        } else {
            (bounds, [0.0; 4], 0.0)
        };
        let [slope, base] = [slope, base].map(|planes| planes.map(|plane| s.splat(plane)));
        Self {
            axes: projection.axes,
            w_negative: projection.w_sign < 0.0,
            origin: [s.splat(u), s.splat(v)],
            w_sign: s.splat(projection.w_sign),
            w_offset: s.splat(w * projection.w_sign),
            slope,
            base,
            z_near: s.splat(z_near),
        }
    }

    /// Returns the children of `node` that rays may hit before `z_far`, and where each box begins along z.
    #[inline(always)]
    pub(super) fn intersect(&self, s: S, node: &Node, z_far: S::F) -> (u8, S::F) {
        let [u, v, w] = self.axes;
        let (near, far): (&F8, &F8) =
            if self.w_negative { (&node.max[w], &node.min[w]) } else { (&node.min[w], &node.max[w]) };
        let z0 = s.max(s.fms(s.load(near), self.w_sign, self.w_offset), self.z_near);
        let z1 = s.min(s.fms(s.load(far), self.w_sign, self.w_offset), z_far);
        let low_x = s.load(&node.min[u]) - self.origin[0];
        let high_x = s.load(&node.max[u]) - self.origin[0];
        let low_y = s.load(&node.min[v]) - self.origin[1];
        let high_y = s.load(&node.max[v]) - self.origin[1];
        // Compares each plane at the end of the box where it admits most.
        let in_x = s.and(s.ge(high_x, self.plane(s, 0, z0, z1)), s.ge(self.plane(s, 1, z1, z0), low_x));
        let in_y = s.and(s.ge(high_y, self.plane(s, 2, z0, z1)), s.ge(self.plane(s, 3, z1, z0), low_y));
        (s.bits(s.and(s.and(in_x, in_y), s.ge(z1, z0))), z0)
    }

    /// The offset of plane `i` at z = `rising` if it rises with z, else at z = `falling`.
    #[inline(always)]
    fn plane(&self, s: S, i: usize, rising: S::F, falling: S::F) -> S::F {
        s.fma(self.slope[i], s.select_negative(self.slope[i], falling, rising), self.base[i])
    }
}
