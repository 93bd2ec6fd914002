//! The triangles of the adapter's structure: slightly larger than the scene's.
//!
//! An adapter may lose a ray that passes exactly through an edge, as software Vulkan does. Then light leaks, or a pixel
//! sees what lies behind. Enlarged triangles overlap at their edges. So a ray through an edge gets both triangles as
//! candidates, and the kernels' own watertight test decides which one it hits.

use glam::Vec3;
use gnomon_scene::{Piece, Scene};
use gnomon_shaders::host::TracedTriangle;
use rayon::iter::{IntoParallelRefIterator as _, ParallelIterator as _};

/// Outward shift of edges, relative to the greatest coordinate: 64 rounding units. Adapters may be off by a few.
const PAD: f64 = 1.0 / (1 << 18) as f64;
/// A corner moves at most this many times as far as its edges. Needle tips would otherwise move without bound.
const FARTHEST: f64 = 1024.0;

/// The greatest coordinate of all corners.
pub(super) fn greatest(triangles: &[TracedTriangle]) -> f32 {
    triangles.iter().flat_map(corners).fold(0.0_f32, |most, corner| most.max(corner.abs().max_element()))
}

/// The corners of each triangle, enlarged for a scene with this greatest coordinate. Runs on the current rayon pool.
pub(super) fn enlarged(triangles: &[TracedTriangle], greatest: f32) -> Vec<[Vec3; 3]> {
    let pad_m = f64::from(greatest) * PAD;
    triangles.par_iter().map(|triangle| enlarge(corners(triangle), pad_m)).collect()
}

/// The greatest coordinate of what moves, in the pose of the file.
pub(super) fn greatest_moving(scene: &Scene) -> f32 {
    let pieces = scene.animation.iter().flat_map(|animation| &animation.pieces);
    let of_piece = |piece: &Piece| (piece.first_vertex as usize, piece.vertices as usize);
    let vertices = pieces.map(of_piece).flat_map(|(first, count)| scene.positions.iter().skip(first).take(count));
    vertices.fold(0.0, |most, vertex| most.max(vertex.abs().max_element()))
}

fn corners(triangle: &TracedTriangle) -> [Vec3; 3] {
    [triangle.a, triangle.b, triangle.c].map(Vec3::from_array)
}

fn enlarge(corners: [Vec3; 3], pad_m: f64) -> [Vec3; 3] {
    let exact = corners.map(Vec3::as_dvec3);
    std::array::from_fn(|i| {
        let [a, b, c] = [0, 1, 2].map(|step| exact[(i + step) % 3]);
        let [to_b, to_c] = [(b - a).normalize_or_zero(), (c - a).normalize_or_zero()];
        // Moves back along both edges, so that each edge moves outwards by the pad.
        let sine = to_b.cross(to_c).length();
        let outwards = (to_b + to_c) * -(pad_m / sine.max(f64::MIN_POSITIVE)).min(pad_m * FARTHEST);
        (a + outwards.clamp_length_max(pad_m * FARTHEST)).as_vec3()
    })
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    #[test]
    fn enlarged_triangles_cover_the_originals_rounding_error() {
        let mut state = 1_u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 8_388_608.0 - 1.0
        };
        for round in 0..2000_u16 {
            let mut point = |size: f32| Vec3::new(next(), next(), next()) * size;
            let a = point(10.0);
            let width = if round % 3 == 0 { 1e-3 } else { 3.0 };
            let (along, aside) = (point(3.0), point(width));
            let corners = [a, a + along, a + along * 0.4 + aside];
            let [first, second, third] = corners.map(Vec3::as_dvec3);
            let normal = (second - first).cross(third - first).normalize_or_zero();
            let sine = |[a, b, c]: [DVec3; 3]| (b - a).normalize_or_zero().cross((c - a).normalize_or_zero()).length();
            let sharpest =
                sine([first, second, third]).min(sine([second, third, first])).min(sine([third, first, second]));
            // Needles move less, since their tips would be far away. 1e-6 is the rounding of these coordinates.
            let least = 1e-4 * (sharpest * 500.0).min(1.0) - 2e-6;
            let larger = enlarge(corners, 1e-4).map(Vec3::as_dvec3);
            for (from, to, inner) in [(0, 1, 2), (1, 2, 0), (2, 0, 1)] {
                let (from, to) = (larger[from], larger[to]);
                let inwards = normal.cross((to - from).normalize_or_zero());
                // Every old corner lies inside every new edge.
                for corner in [first, second, third] {
                    assert!(inwards.dot(corner - from) >= least, "{corners:?} edge opposite {inner}");
                }
            }
            assert!(larger.iter().zip(corners).all(|(l, c)| l.distance(c.as_dvec3()) < 0.103));
        }
        // A triangle without an area is never hit, and must not yield a NaN.
        assert!(enlarge([Vec3::ONE; 3], 1e-4).iter().all(|corner| corner.is_finite()));
        let line = enlarge([Vec3::ZERO, Vec3::X, Vec3::X * 2.0], 1e-4);
        assert!(line.iter().all(|corner| corner.is_finite()) && line[0].length() < 1.0);
    }
}
