//! Geometric normals, how transforms turn normals, and replacements for zero shading normals.

use glam::{DMat3, DVec3, Vec3};

/// Smallest ratio of a triangle's height to its longest edge. Thinner triangles are narrower than the rounding of their
/// f32 edges: they are invisible, and their normals would be noise.
const MIN_HEIGHT_RATIO: f64 = 1e-7;

/// Smallest double area, in square metres. Below it, squares of f32 cross products underflow.
const MIN_DOUBLE_AREA_M2: f64 = 1e-16;

/// Returns the unit normal of a counter-clockwise triangle. `None` if its area is next to zero.
#[must_use]
pub fn triangle_normal(a: Vec3, b: Vec3, c: Vec3) -> Option<DVec3> {
    let (a, b, c) = (a.as_dvec3(), b.as_dvec3(), c.as_dvec3());
    let (ab, ac, bc) = (b - a, c - a, c - b);
    let cross = ab.cross(ac);
    let double_area = cross.length();
    let longest_squared = ab.length_squared().max(ac.length_squared()).max(bc.length_squared());
    let has_area = double_area > MIN_HEIGHT_RATIO * longest_squared && double_area > MIN_DOUBLE_AREA_M2;
    has_area.then(|| cross / double_area)
}

/// Returns the inverse transpose of a transform, up to a positive factor: its cofactors, with the sign of its
/// determinant. They exist even if a scale of 0 leaves no inverse.
pub(crate) fn normal_matrix(linear: &DMat3) -> DMat3 {
    let (x, y, z) = (linear.x_axis, linear.y_axis, linear.z_axis);
    let cofactors = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y));
    if linear.determinant() < 0.0 { -cofactors } else { cofactors }
}

/// Replaces each zero normal by the mean of its triangles' normals and returns how many were replaced. The weights are
/// the triangles' angles at the vertex, so that the mean does not depend on how a face is cut into triangles. Vertices
/// without triangles get +Y. Indices count from `first_vertex`.
pub(crate) fn repair(positions: &[Vec3], normals: &mut [Vec3], triangles: &[[u32; 3]], first_vertex: u32) -> u64 {
    let broken: Vec<bool> = normals.iter().map(|normal| *normal == Vec3::ZERO).collect();
    if !broken.contains(&true) {
        return 0;
    }
    let mut sums = vec![DVec3::ZERO; normals.len()];
    for triangle in triangles {
        let corners = triangle.map(|index| index.wrapping_sub(first_vertex) as usize);
        let [Some(a), Some(b), Some(c)] = corners.map(|corner| positions.get(corner).copied()) else { continue };
        let Some(normal) = triangle_normal(a, b, c) else { continue };
        let angles = [(a, b, c), (b, c, a), (c, a, b)]
            .map(|(at, next, last)| (next - at).as_dvec3().angle_between((last - at).as_dvec3()));
        for (corner, angle) in corners.into_iter().zip(angles) {
            if let Some(sum) = sums.get_mut(corner) {
                *sum += normal * angle;
            }
        }
    }
    let mut replaced = 0;
    for ((normal, sum), _) in normals.iter_mut().zip(sums).zip(broken).filter(|(_, broken)| *broken) {
        *normal = sum.try_normalize().map_or(Vec3::Y, DVec3::as_vec3);
        replaced += 1;
    }
    replaced
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counter_clockwise_triangles_face_the_viewer() {
        assert_eq!(triangle_normal(Vec3::ZERO, Vec3::X, Vec3::Y), Some(DVec3::Z));
        assert_eq!(triangle_normal(Vec3::ZERO, Vec3::Y, Vec3::X), Some(DVec3::NEG_Z));
    }

    #[test]
    fn points_lines_and_slivers_have_no_normal() {
        let far = Vec3::new(100.0, 3.0, -7.0);
        assert_eq!(triangle_normal(far, far, far + Vec3::X), None);
        assert_eq!(triangle_normal(Vec3::ZERO, Vec3::ONE, Vec3::ONE * 3.0), None);
        assert_eq!(triangle_normal(Vec3::ZERO, Vec3::X, Vec3::new(0.5, 1e-8, 0.0)), None);
        assert!(triangle_normal(Vec3::ZERO, Vec3::X, Vec3::new(0.5, 1e-5, 0.0)).is_some());
        assert!(triangle_normal(far, far + Vec3::X * 1e-4, far + Vec3::Y * 1e-4).is_some());
    }

    #[test]
    fn zero_normals_become_the_mean_of_their_faces_and_others_stay() {
        let positions = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
        let mut normals = [Vec3::ZERO, Vec3::Z, Vec3::ZERO, Vec3::ZERO];
        // Two faces at right angles share the edge of vertices 0 and 2, with equal angles at both ends.
        let triangles = [[7, 8, 9], [7, 9, 10]];
        assert_eq!(repair(&positions, &mut normals, &triangles, 7), 3);
        let between = Vec3::new(1.0, 0.0, 1.0).normalize();
        assert!((normals[0] - between).length() < 1e-6 && (normals[2] - between).length() < 1e-6, "{normals:?}");
        assert!((normals[3] - Vec3::X).length() < 1e-6, "{normals:?}");
        assert_eq!(normals[1], Vec3::Z);
        let mut lonely = [Vec3::ZERO; 4];
        assert_eq!(repair(&positions, &mut lonely, &triangles[..1], 7), 4);
        assert_eq!(lonely[3], Vec3::Y);
        let mut fine = [Vec3::X; 4];
        assert_eq!(repair(&positions, &mut fine, &triangles, 7), 0);
    }
}
