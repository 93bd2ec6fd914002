//! The scene's largest triangles, for coarse ray casts.
//!
//! Walls, floors and ceilings are large, and decide how bright a room is and where a camera fits. A few thousand
//! triangles can be tested in milliseconds, without an acceleration structure on a thin client. These ray casts never
//! decide which lights reach a pixel: the server does.

use glam::Vec3;
use gnomon_scene::Scene;

pub const MAX_OCCLUDERS: usize = 4096;

#[derive(Debug, Clone, Default)]
pub struct Occluders {
    triangles: Vec<Triangle>,
}

#[derive(Debug, Clone, Copy)]
struct Triangle {
    /// A corner, and the edges from it to the other two.
    shape: [Vec3; 3],
    double_sided: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Met {
    /// Distance, in lengths of the ray's direction.
    pub distance: f32,
    /// True if the side that was hit is drawn.
    pub visible: bool,
    /// Unit normal of the triangle's front.
    pub normal: Vec3,
}

impl Occluders {
    /// Returns the [`MAX_OCCLUDERS`] largest triangles of `scene` that stop rays.
    #[must_use]
    pub fn largest_of(scene: &Scene) -> Self {
        let mut all = Self::all_of(scene);
        if all.triangles.len() > MAX_OCCLUDERS {
            let area = |triangle: &Triangle| triangle.shape[1].cross(triangle.shape[2]).length_squared();
            all.triangles.select_nth_unstable_by(MAX_OCCLUDERS, |one, other| area(other).total_cmp(&area(one)));
            all.triangles.truncate(MAX_OCCLUDERS);
            all.triangles.shrink_to_fit();
        }
        all
    }

    /// Returns all triangles of `scene` that stop rays: slow, for a handful of rays.
    #[must_use]
    pub fn all_of(scene: &Scene) -> Self {
        let tracing = scene.tracing_triangles();
        let mut triangles = Vec::with_capacity(tracing.len());
        for draw in &scene.draws {
            let first = draw.first_triangle as usize;
            let Some(drawn) = tracing.get(first..first + draw.triangles as usize) else { break };
            let double_sided = scene.materials[draw.material as usize].double_sided;
            triangles.extend(drawn.iter().map(|corners| {
                let [a, b, c] = corners.map(|index| scene.positions[index as usize]);
                Triangle { shape: [a, b - a, c - a], double_sided }
            }));
        }
        Self { triangles }
    }

    /// Returns the nearest hit along `direction` within `to` lengths of it.
    #[must_use]
    pub fn nearest(&self, origin: Vec3, direction: Vec3, to: f32) -> Option<Met> {
        let mut nearest = None;
        let mut limit = to;
        for triangle in &self.triangles {
            if let Some(distance) = meet(&triangle.shape, origin, direction)
                && distance > 0.0
                && distance < limit
            {
                limit = distance;
                let across = triangle.shape[1].cross(triangle.shape[2]);
                let visible = across.dot(direction) < 0.0 || triangle.double_sided;
                nearest = Some(Met { distance, visible, normal: across.normalize_or_zero() });
            }
        }
        nearest
    }

    /// Returns whether a triangle lies between `from` and `to`, in lengths of `direction`.
    #[must_use]
    pub fn blocks(&self, origin: Vec3, direction: Vec3, from: f32, to: f32) -> bool {
        self.triangles.iter().any(|triangle| {
            meet(&triangle.shape, origin, direction).is_some_and(|distance| distance > from && distance < to)
        })
    }
}

/// Intersects a ray with a triangle (Möller and Trumbore, 1997). The result may be negative: behind the origin.
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
        let one_sided = |shape| Triangle { shape, double_sided: false };
        Occluders { triangles: vec![one_sided([a, b - a, c - a]), one_sided([a, c - a, d - a])] }
    }

    #[test]
    fn a_wall_stops_only_rays_that_hit_it() {
        let wall = square_at(3.0);
        let met = wall.nearest(Vec3::new(0.0, 0.3, 0.2), Vec3::X, 10.0).unwrap();
        assert!((met.distance - 3.0).abs() < 1e-6 && !met.visible, "{met:?}");
        assert!(wall.nearest(Vec3::new(5.0, 0.3, 0.2), Vec3::NEG_X, 10.0).unwrap().visible);
        assert_eq!(wall.nearest(Vec3::new(0.0, 1.3, 0.2), Vec3::X, 10.0), None);
        assert_eq!(wall.nearest(Vec3::new(0.0, 0.3, 0.2), Vec3::X, 2.9), None);
        assert!(wall.blocks(Vec3::ZERO, Vec3::X, 0.0, 3.5));
        assert!(!wall.blocks(Vec3::ZERO, Vec3::X, 0.0, 2.9));
        assert!(!wall.blocks(Vec3::ZERO, Vec3::X, 3.1, 9.0));
        assert!(!wall.blocks(Vec3::ZERO, Vec3::NEG_X, 0.0, 9.0));
    }
}
