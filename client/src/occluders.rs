//! The scene's largest triangles, to ask coarsely what stands in the way of a ray.
//!
//! Walls, floors and ceilings are large; what they hide decides how bright a room is and where a camera has room. A few
//! thousand of them answer that in milliseconds, without building an acceleration structure on a thin client. Which
//! lights reach a pixel is never asked here: that is the server's part.

use glam::Vec3;
use gnomon_shaders::scene::Scene;

/// Triangles that are kept.
pub const MAX_OCCLUDERS: usize = 4096;

/// Triangles as a corner and two edges.
#[derive(Debug, Clone, Default)]
pub struct Occluders {
    triangles: Vec<[Vec3; 3]>,
}

impl Occluders {
    /// The largest triangles of `scene` that stop rays.
    #[must_use]
    pub fn largest_of(scene: &Scene) -> Self {
        let mut triangles: Vec<(f32, [Vec3; 3])> = scene
            .tracing_triangles()
            .iter()
            .map(|corners| {
                let [a, b, c] = corners.map(|index| scene.positions[index as usize]);
                ((b - a).cross(c - a).length_squared(), [a, b - a, c - a])
            })
            .collect();
        if triangles.len() > MAX_OCCLUDERS {
            triangles.select_nth_unstable_by(MAX_OCCLUDERS, |one, other| other.0.total_cmp(&one.0));
            triangles.truncate(MAX_OCCLUDERS);
        }
        Self { triangles: triangles.into_iter().map(|(_, triangle)| triangle).collect() }
    }

    /// Distance along `direction` (in its lengths) to the nearest triangle between `from` and `to`, if there is one.
    #[must_use]
    pub fn nearest(&self, origin: Vec3, direction: Vec3, from: f32, to: f32) -> Option<f32> {
        let mut nearest = None;
        let mut limit = to;
        for triangle in &self.triangles {
            if let Some(distance) = meet(triangle, origin, direction)
                && distance > from
                && distance < limit
            {
                limit = distance;
                nearest = Some(distance);
            }
        }
        nearest
    }

    /// Whether any triangle stands between `from` and `to` along `direction`.
    #[must_use]
    pub fn blocks(&self, origin: Vec3, direction: Vec3, from: f32, to: f32) -> bool {
        self.triangles
            .iter()
            .any(|triangle| meet(triangle, origin, direction).is_some_and(|distance| distance > from && distance < to))
    }
}

/// Where a ray meets a triangle's plane inside the triangle (Möller and Trumbore, 1997).
fn meet([corner, edge_1, edge_2]: &[Vec3; 3], origin: Vec3, direction: Vec3) -> Option<f32> {
    let across = direction.cross(*edge_2);
    let determinant = edge_1.dot(across);
    if determinant == 0.0 {
        return None;
    }
    let inverse = 1.0 / determinant;
    let offset = origin - *corner;
    let u = offset.dot(across) * inverse;
    if !(0.0..=1.0).contains(&u) {
        return None;
    }
    let around = offset.cross(*edge_1);
    let v = direction.dot(around) * inverse;
    (v >= 0.0 && u + v <= 1.0).then(|| edge_2.dot(around) * inverse)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square_at(x: f32) -> Occluders {
        let corner = |y: f32, z: f32| Vec3::new(x, y, z);
        let (a, b, c, d) = (corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0));
        Occluders { triangles: vec![[a, b - a, c - a], [a, c - a, d - a]] }
    }

    #[test]
    fn a_wall_stops_what_runs_into_it_and_nothing_else() {
        let wall = square_at(3.0);
        assert!((wall.nearest(Vec3::new(0.0, 0.3, 0.2), Vec3::X, 0.0, 10.0).unwrap() - 3.0).abs() < 1e-6);
        assert_eq!(wall.nearest(Vec3::new(0.0, 1.3, 0.2), Vec3::X, 0.0, 10.0), None);
        assert!(wall.blocks(Vec3::ZERO, Vec3::X, 0.0, 3.5));
        assert!(!wall.blocks(Vec3::ZERO, Vec3::X, 0.0, 2.9));
        assert!(!wall.blocks(Vec3::ZERO, Vec3::X, 3.1, 9.0));
        assert!(!wall.blocks(Vec3::ZERO, Vec3::NEG_X, 0.0, 9.0));
    }
}
