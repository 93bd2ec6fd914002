//! The surface points that camera rays hit: positions, normals, and the starts of their shadow rays.

use glam::Vec3;
use gnomon_scene::{Scene, triangle_normal};

use super::{
    group::PACKETS,
    rounding::ROUNDING,
    simd::{F8, Simd},
    vector,
};

/// A triangle's corners, their shading normals, and the unit normal of its plane.
#[derive(Debug, Clone, Copy)]
pub(super) struct Corners {
    positions: [[f32; 3]; 3],
    normals: [[f32; 3]; 3],
    /// Computed in f64: an f32 cross product of a long thin triangle loses most digits. Zero without an area.
    geometric: [f32; 3],
}

/// The corners of a scene's triangles: those that rest, and after them those that move.
#[derive(Clone, Copy)]
pub(super) struct AllCorners<'a> {
    pub(super) resting: &'a [Corners],
    pub(super) moving: &'a [Corners],
}

impl<'a> AllCorners<'a> {
    #[inline(always)]
    fn of(&self, triangle: u32) -> &'a Corners {
        let triangle = triangle as usize;
        if triangle < self.resting.len() {
            &self.resting[triangle]
        } else {
            &self.moving[triangle - self.resting.len()]
        }
    }
}

impl Corners {
    /// The corners of these triangles.
    pub(super) fn of(scene: &Scene, triangles: &[[u32; 3]]) -> Vec<Self> {
        let corners = triangles.iter().map(|corners| {
            let of = |from: &[Vec3]| corners.map(|i| from[i as usize]);
            Self::new(of(&scene.positions), of(&scene.normals))
        });
        corners.collect()
    }

    /// The positions, and the unit normal of their plane. `None` if they have no area.
    pub(super) fn placed(&self) -> Option<([Vec3; 3], Vec3)> {
        (self.geometric != [0.0; 3]).then(|| (self.positions.map(Vec3::from_array), Vec3::from_array(self.geometric)))
    }

    pub(super) fn new(positions: [Vec3; 3], normals: [Vec3; 3]) -> Self {
        let [a, b, c] = positions;
        Self {
            positions: positions.map(|corner| corner.to_array()),
            normals: normals.map(|normal| normal.to_array()),
            geometric: triangle_normal(a, b, c).unwrap_or_default().as_vec3().to_array(),
        }
    }
}

/// How far above the surface shadow rays start, in rounding units of Σ |nᵢ|·Σₖ |wₖ|·|pₖᵢ| with unit normal n, corners p
/// and weights w. Interpolation may move the point off the plane by 3 for products and sums, by up to 8 because weights
/// that do not sum to 1 scale it, and by 1 for rounding the start: 12 in all. Errors of the weights only slide the
/// point along the plane. Twin: `OFFSET_ROUNDINGS` in visibility/surface.wgsl, which derives the 8.
const OFFSET_ROUNDINGS: f32 = 16.0;

/// Three coordinates of a tile's points, by packet.
pub(super) type Coordinates = [[F8; PACKETS]; 3];

pub(super) struct Surface {
    /// Bit i of `lanes[p]`: ray i of packet p hit a surface.
    pub(super) lanes: [u8; PACKETS],
    pub(super) point: Coordinates,
    /// Starts of shadow rays: the points, pushed off the surface.
    pub(super) pushed: Coordinates,
    /// Unit normals of the triangles, towards the camera.
    pub(super) geometric: Coordinates,
    /// Interpolated normals, not normalised, negated where the ray hit the back.
    pub(super) shading: Coordinates,
}

impl Default for Surface {
    fn default() -> Self {
        let zero = [[F8::default(); PACKETS]; 3];
        Self { lanes: [0; PACKETS], point: zero, pushed: zero, geometric: zero, shading: zero }
    }
}

impl Surface {
    /// Fills packet `p`, whose rays leave `apex` along `direction` and hit `triangles` (arbitrary outside `lanes`).
    #[inline(always)]
    pub(super) fn set_packet<S: Simd>(
        &mut self,
        s: S,
        p: usize,
        lanes: u8,
        corners: AllCorners<'_>,
        triangles: &[u32; 8],
        (apex, direction): (Vec3, [S::F; 3]),
    ) {
        self.lanes[p] = lanes;
        if lanes == 0 {
            return;
        }
        let mut positions = [[F8::default(); 3]; 3];
        let mut normals = [[F8::default(); 3]; 3];
        let mut geometric = [F8::default(); 3];
        for (lane, &triangle) in triangles.iter().enumerate() {
            let from = corners.of(triangle);
            for corner in 0..3 {
                for axis in 0..3 {
                    positions[corner][axis].0[lane] = from.positions[corner][axis];
                    normals[corner][axis].0[lane] = from.normals[corner][axis];
                }
            }
            for (to, from) in geometric.iter_mut().zip(from.geometric) {
                to.0[lane] = from;
            }
        }
        let a = vector::load(s, &positions[0]);
        let b = vector::load(s, &positions[1]);
        let c = vector::load(s, &positions[2]);
        let apex = vector::splat(s, apex.to_array());
        let from_a = vector::sub::<S>(a, apex);
        let from_b = vector::sub::<S>(b, apex);
        let from_c = vector::sub::<S>(c, apex);
        // Edge functions as in `leaf`: the corners' weights up to a common factor.
        let weights = [
            vector::dot(s, direction, vector::cross_of_edge(s, from_b, from_c)),
            vector::dot(s, direction, vector::cross_of_edge(s, from_c, from_a)),
            vector::dot(s, direction, vector::cross_of_edge(s, from_a, from_b)),
        ];
        let sum = weights[0] + weights[1] + weights[2];
        let weights = vector::scale::<S>(weights, s.div(s.splat(1.0), sum));

        let normal = vector::load(s, &geometric);
        // Negative if the normal points away from the camera: the ray hit the back.
        let facing = s.splat(0.0) - vector::dot(s, normal, from_a);
        let geometric = vector::xor_sign(s, normal, facing);
        // Weights of a thin triangle that is nearly edge-on may be negative or exceed 1.
        let sizes = [s.abs(weights[0]), s.abs(weights[1]), s.abs(weights[2])];
        let mut terms = s.splat(0.0);
        let mut point = [s.splat(0.0); 3];
        for axis in 0..3 {
            point[axis] = vector::dot(s, weights, [a[axis], b[axis], c[axis]]);
            let summed = vector::dot(s, sizes, [s.abs(a[axis]), s.abs(b[axis]), s.abs(c[axis])]);
            terms = s.fma(s.abs(geometric[axis]), summed, terms);
        }
        let offset = terms * s.splat(OFFSET_ROUNDINGS * ROUNDING);
        for axis in 0..3 {
            let normals = [s.load(&normals[0][axis]), s.load(&normals[1][axis]), s.load(&normals[2][axis])];
            let shading = vector::dot(s, weights, normals);
            s.store(point[axis], &mut self.point[axis][p]);
            s.store(geometric[axis], &mut self.geometric[axis][p]);
            s.store(s.xor_sign(shading, facing), &mut self.shading[axis][p]);
            s.store(s.fma(geometric[axis], offset, point[axis]), &mut self.pushed[axis][p]);
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::visibility::backend::cpu::simd::{Level, WithSimd};

    /// Starts of shadow rays from the packet's eight points.
    struct Starts<'a>(&'a [Corners], Vec3, [F8; 3]);

    impl WithSimd for Starts<'_> {
        type Output = [DVec3; 8];
        #[inline(always)]
        fn run<S: Simd>(self, s: S) -> [DVec3; 8] {
            let mut surface = Surface::default();
            let direction = vector::load(s, &self.2);
            let corners = AllCorners { resting: self.0, moving: &[] };
            surface.set_packet(s, 0, 0xff, corners, &[0, 1, 2, 3, 4, 5, 6, 7], (self.1, direction));
            std::array::from_fn(|lane| {
                let [x, y, z] = [0, 1, 2].map(|axis| f64::from(surface.pushed[axis][0].0[lane]));
                DVec3::new(x, y, z)
            })
        }
    }

    #[test]
    fn starts_lie_above_their_surface_and_no_farther_than_they_must() {
        let mut random = 1_u32;
        let mut next = || {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (random >> 8) as f32 / (1 << 23) as f32 - 1.0
        };
        let mut heights = Vec::new();
        for round in 0..4000 {
            let mut vector = |size: f32| Vec3::new(next(), next(), next()) * size;
            // Scenes of all sizes, near and far from their origin. Every other triangle is a sliver.
            let size = 10.0_f32.powi(round % 9 - 4);
            let eye = vector(3.0 * size);
            let mut direction = [F8::default(); 3];
            let triangles: Vec<[Vec3; 3]> = (0..8)
                .map(|lane| {
                    let a = vector(size);
                    let along = vector(size);
                    let width = if lane % 2 == 0 { size } else { size * 1e-3 };
                    let [b, c] = [a + along, a + along * 0.7 + vector(width)];
                    let towards = (a * 0.3 + b * 0.3 + c * 0.4) - eye;
                    for axis in 0..3 {
                        direction[axis].0[lane] = towards[axis];
                    }
                    [a, b, c]
                })
                .collect();
            let corners: Vec<_> = triangles.iter().map(|corners| Corners::new(*corners, [Vec3::Y; 3])).collect();
            for level in [Level::detect(), Level::Portable] {
                let starts = level.dispatch(Starts(&corners, eye, direction));
                for ([a, b, c], start) in triangles.iter().zip(starts) {
                    // The loader drops triangles without an area.
                    let Some(normal) = triangle_normal(*a, *b, *c) else { continue };
                    let [a, b, c] = [a, b, c].map(|corner| corner.as_dvec3());
                    let normal = if normal.dot(a - eye.as_dvec3()) > 0.0 { -normal } else { normal };
                    let height = normal.dot(start - a);
                    assert!(height > 0.0, "{height} below {a} {b} {c}");
                    heights.push(height / normal.abs().dot(a.abs().max(b.abs()).max(c.abs())));
                }
            }
        }
        heights.sort_by(f64::total_cmp);
        // Excludes the few that are nearly edge-on, whose weights mean little.
        let most = heights[heights.len() * 99 / 100] / f64::from(ROUNDING);
        assert!(most <= 32.0, "{most} roundings of the largest coordinates");
    }
}
