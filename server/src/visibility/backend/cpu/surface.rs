//! The surface points that camera rays met: where they are, how they face, and where shadow rays to them end.

use glam::Vec3;
use gnomon_shaders::scene::Scene;

use super::{
    group::PACKETS,
    simd::{F8, Simd},
    vector,
};

/// A triangle's corners and shading normals.
#[derive(Debug, Clone, Copy)]
pub(super) struct Corners {
    positions: [[f32; 3]; 3],
    normals: [[f32; 3]; 3],
}

impl Corners {
    /// Those of all triangles that stop rays.
    pub(super) fn of(scene: &Scene) -> Vec<Self> {
        let by_index = |from: &[Vec3], corners: &[u32; 3]| corners.map(|i| from[i as usize].to_array());
        scene
            .tracing_triangles()
            .iter()
            .map(|corners| Self {
                positions: by_index(&scene.positions, corners),
                normals: by_index(&scene.normals, corners),
            })
            .collect()
    }
}

/// Three coordinates of a tile's points, by packet.
pub(super) type Coordinates = [[F8; PACKETS]; 3];

/// A tile's surface points.
pub(super) struct Surface {
    /// Bit i of `lanes[p]`: ray i of packet p met a surface.
    pub(super) lanes: [u8; PACKETS],
    /// The points, interpolated.
    pub(super) point: Coordinates,
    /// The points, pushed off the surface.
    pub(super) pushed: Coordinates,
    /// Unit normals of the triangles, towards the camera.
    pub(super) geometric: Coordinates,
    /// Interpolated normals, not normalised, negated where the back was met.
    pub(super) shading: Coordinates,
}

impl Default for Surface {
    fn default() -> Self {
        let zero = [[F8::default(); PACKETS]; 3];
        Self { lanes: [0; PACKETS], point: zero, pushed: zero, geometric: zero, shading: zero }
    }
}

impl Surface {
    /// Fills in packet `p`, whose rays leave `apex` along `direction` and met `triangles` (in `lanes`; any triangle elsewhere).
    #[inline(always)]
    pub(super) fn set_packet<S: Simd>(
        &mut self,
        s: S,
        p: usize,
        lanes: u8,
        corners: &[Corners],
        triangles: &[u32; 8],
        (apex, direction): (Vec3, [S::F; 3]),
    ) {
        self.lanes[p] = lanes;
        if lanes == 0 {
            return;
        }
        let mut positions = [[F8::default(); 3]; 3];
        let mut normals = [[F8::default(); 3]; 3];
        for (lane, &triangle) in triangles.iter().enumerate() {
            let from = &corners[triangle as usize];
            for corner in 0..3 {
                for axis in 0..3 {
                    positions[corner][axis].0[lane] = from.positions[corner][axis];
                    normals[corner][axis].0[lane] = from.normals[corner][axis];
                }
            }
        }
        let a = vector::load(s, &positions[0]);
        let b = vector::load(s, &positions[1]);
        let c = vector::load(s, &positions[2]);
        let apex = vector::splat(s, apex.to_array());
        let from_a = vector::sub::<S>(a, apex);
        let from_b = vector::sub::<S>(b, apex);
        let from_c = vector::sub::<S>(c, apex);
        // The edge functions, as in `leaf`: the corners' weights, but for a common factor.
        let weights = [
            vector::dot(s, direction, vector::cross_of_edge(s, from_b, from_c)),
            vector::dot(s, direction, vector::cross_of_edge(s, from_c, from_a)),
            vector::dot(s, direction, vector::cross_of_edge(s, from_a, from_b)),
        ];
        let sum = weights[0] + weights[1] + weights[2];
        let weights = vector::scale::<S>(weights, s.div(s.splat(1.0), sum));

        let normal = vector::cross(s, vector::sub::<S>(b, a), vector::sub::<S>(c, a));
        // Negative where the normal points away from the camera, so that the back was met.
        let facing = s.splat(0.0) - vector::dot(s, normal, from_a);
        let length = s.sqrt(vector::dot(s, normal, normal));
        let geometric = vector::scale::<S>(normal, s.xor_sign(s.div(s.splat(1.0), length), facing));
        for axis in 0..3 {
            let point = vector::dot(s, weights, [a[axis], b[axis], c[axis]]);
            let normals = [s.load(&normals[0][axis]), s.load(&normals[1][axis]), s.load(&normals[2][axis])];
            let shading = vector::dot(s, weights, normals);
            s.store(point, &mut self.point[axis][p]);
            s.store(geometric[axis], &mut self.geometric[axis][p]);
            s.store(s.xor_sign(shading, facing), &mut self.shading[axis][p]);
            s.store(push(s, point, geometric[axis]), &mut self.pushed[axis][p]);
        }
    }
}

/// Pushes a coordinate off a surface whose unit normal has the component `normal` (Wächter and Binder, "A Fast and Robust
/// Method for Avoiding Self-Intersection", Ray Tracing Gems, 2019, ch. 6, listing 6-1): by up to 256 of the coordinate's own
/// roundings, or near 0, where those vanish, by 2⁻¹⁶ m.
///
/// An interpolated coordinate is off by the weights' errors, which only slide the point along its triangle, and by about
/// four roundings of the largest corner coordinate, 2⁻²² of it. So 256 roundings, at least 2⁻¹⁶ of the coordinate, are
/// enough where corners are at most 64 times farther from the origin than the point; beyond that, the plane test of
/// `traverse::beyond` knows its own error.
#[inline(always)]
fn push<S: Simd>(s: S, coordinate: S::F, normal: S::F) -> S::F {
    // One more rounding away from 0 makes a positive number larger and a negative one smaller.
    let steps = s.xor_sign(normal * s.splat(256.0), coordinate);
    let by_roundings = s.add_to_bits(coordinate, steps);
    let by_length = s.fma(normal, s.splat(1.0 / 65536.0), coordinate);
    s.select(s.gt(s.splat(1.0 / 32.0), s.abs(coordinate)), by_length, by_roundings)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::visibility::backend::cpu::simd::{Level, Work};

    struct Push(f32, f32);

    impl Work for Push {
        type Output = f32;
        #[inline(always)]
        fn run<S: Simd>(self, s: S) -> f32 {
            let mut out = F8::default();
            s.store(push(s, s.splat(self.0), s.splat(self.1)), &mut out);
            out.0[3]
        }
    }

    #[test]
    fn points_are_pushed_the_normals_way_by_256_roundings() {
        for level in [Level::detect(), Level::Portable] {
            for (coordinate, normal) in [(10.0_f32, 1.0_f32), (10.0, -1.0), (-10.0, 1.0), (-10.0, -0.5), (1e4, 0.3)] {
                let moved = level.dispatch(Push(coordinate, normal)) - coordinate;
                let rounding = coordinate.abs().next_up() - coordinate.abs();
                assert_eq!(moved.signum(), normal.signum());
                assert!((moved.abs() / rounding - 256.0 * normal.abs()).abs() <= 1.0, "{coordinate}: {moved}");
            }
            assert_eq!(level.dispatch(Push(0.0, -1.0)), -1.0 / 65536.0);
            assert_eq!(level.dispatch(Push(7.0, 0.0)), 7.0);
        }
    }
}
