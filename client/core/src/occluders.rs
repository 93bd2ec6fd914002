//! The scene's largest triangles, for coarse ray casts.
//!
//! Walls, floors and ceilings are large, and decide how bright a room is and where a camera fits. A few thousand
//! triangles can be tested in milliseconds: neighbours share a box, and most boxes are missed. These ray casts never
//! decide which lights reach a pixel: the server does.

use glam::Vec3;
use gnomon_scene::{Aabb, Scene};

pub const MAX_OCCLUDERS: usize = 4096;

/// Triangles that share a box. A ray meets a few of the largest triangles' boxes and tests each of their triangles.
const GROUP: usize = 16;

/// Boxes grow by this share of the coordinates involved: a hundred rounding units of f32, where a test takes ten.
const BOX_SLACK: f32 = 6e-6;

#[derive(Debug, Clone, Default)]
pub struct Occluders {
    /// Neighbours follow each other.
    triangles: Vec<Triangle>,
    /// The box of each [`GROUP`] of them.
    boxes: Vec<Aabb>,
}

#[derive(Debug, Clone, Copy)]
struct Triangle {
    /// A corner, and the edges from it to the other two.
    shape: [Vec3; 3],
    double_sided: bool,
}

impl Triangle {
    fn middle(&self) -> Vec3 {
        let [corner, edge_1, edge_2] = self.shape;
        corner + (edge_1 + edge_2) / 3.0
    }
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
        let mut all = triangles_of(scene);
        if all.len() > MAX_OCCLUDERS {
            let area = |triangle: &Triangle| triangle.shape[1].cross(triangle.shape[2]).length_squared();
            all.select_nth_unstable_by(MAX_OCCLUDERS, |one, other| area(other).total_cmp(&area(one)));
            all.truncate(MAX_OCCLUDERS);
            all.shrink_to_fit();
        }
        Self::new(all)
    }

    /// Returns all triangles of `scene` that stop rays: slow, for a handful of rays.
    #[must_use]
    pub fn all_of(scene: &Scene) -> Self {
        Self::new(triangles_of(scene))
    }

    fn new(mut triangles: Vec<Triangle>) -> Self {
        let whole = bounds(&triangles);
        let scale = 1023.0 / (whole.max - whole.min).max(Vec3::splat(f32::MIN_POSITIVE));
        triangles.sort_by_cached_key(|triangle| interleaved((triangle.middle() - whole.min) * scale));
        let boxes = triangles.chunks(GROUP).map(bounds).collect();
        Self { triangles, boxes }
    }

    /// The groups of triangles whose box the ray meets, each with the distance at which it does.
    fn groups(&self, origin: Vec3, direction: Vec3) -> impl Iterator<Item = (f32, &[Triangle])> {
        // A zero would give 0 · ∞ for a side that contains the origin.
        let slanted = Vec3::select(direction.cmpeq(Vec3::ZERO), Vec3::splat(f32::MIN_POSITIVE), direction);
        let inverse = slanted.recip().clamp(Vec3::splat(-f32::MAX), Vec3::splat(f32::MAX));
        self.boxes.iter().zip(self.triangles.chunks(GROUP)).filter_map(move |(around, triangles)| {
            let slack = (around.min.abs().max(around.max.abs()) + origin.abs()) * BOX_SLACK;
            let (one, other) = ((around.min - slack - origin) * inverse, (around.max + slack - origin) * inverse);
            let (enter, leave) = (one.min(other).max_element(), one.max(other).min_element());
            (enter <= leave && leave >= 0.0).then_some((enter, triangles))
        })
    }

    /// Returns the nearest hit along `direction` within `to` lengths of it.
    #[must_use]
    pub fn nearest(&self, origin: Vec3, direction: Vec3, to: f32) -> Option<Met> {
        let mut nearest = None;
        let mut limit = to;
        for (enter, triangles) in self.groups(origin, direction) {
            if enter >= limit {
                continue;
            }
            for triangle in triangles {
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
        }
        nearest
    }

    /// Returns whether a triangle lies between `from` and `to`, in lengths of `direction`.
    #[must_use]
    pub fn blocks(&self, origin: Vec3, direction: Vec3, from: f32, to: f32) -> bool {
        self.groups(origin, direction).filter(|(enter, _)| *enter < to).flat_map(|(_, triangles)| triangles).any(
            |triangle| {
                meet(&triangle.shape, origin, direction).is_some_and(|distance| distance > from && distance < to)
            },
        )
    }
}

fn triangles_of(scene: &Scene) -> Vec<Triangle> {
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
    triangles
}

fn bounds(triangles: &[Triangle]) -> Aabb {
    let corners = triangles.iter().flat_map(|Triangle { shape: [a, to_b, to_c], .. }| [*a, a + to_b, a + to_c]);
    corners.fold(Aabb { min: Vec3::MAX, max: Vec3::MIN }, |whole, corner| Aabb {
        min: whole.min.min(corner),
        max: whole.max.max(corner),
    })
}

/// Interleaves ten bits of each coordinate: neighbours in space mostly get neighbouring numbers (Morton's order).
fn interleaved(place: Vec3) -> u32 {
    let spread = |x: f32| {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to ten bits")]
        let mut bits = x.clamp(0.0, 1023.0) as u32;
        for (shift, kept) in [(16, 0x0300_00ff), (8, 0x0300_f00f), (4, 0x030c_30c3), (2, 0x0924_9249)] {
            bits = (bits | bits << shift) & kept;
        }
        bits
    };
    spread(place.x) << 2 | spread(place.y) << 1 | spread(place.z)
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
        Occluders::new(vec![one_sided([a, b - a, c - a]), one_sided([a, c - a, d - a])])
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

    #[test]
    fn boxes_lose_no_hit() {
        let mut random = 1_u32;
        let mut next = || {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (random >> 8) as f32 / (1 << 24) as f32 * 2.0 - 1.0
        };
        let mut vector = || Vec3::new(next(), next(), next());
        // Each eighth lies in a plane across an axis, so that its box is flat.
        let triangles: Vec<Triangle> = (0..400)
            .map(|index| {
                let flat = if index % 8 == 0 { Vec3::new(1.0, 0.0, 1.0) } else { Vec3::ONE };
                let shape = [vector() * 5.0, vector() * flat, vector() * flat];
                Triangle { shape, double_sided: true }
            })
            .collect();
        let occluders = Occluders::new(triangles.clone());
        let mut hits = 0;
        for index in 0..2000 {
            let along_axis = index % 5 == 0;
            let (origin, direction) = (vector() * 6.0, if along_axis { Vec3::NEG_Y } else { vector() });
            let met = triangles.iter().filter_map(|triangle| meet(&triangle.shape, origin, direction));
            let nearest = met.filter(|distance| *distance > 0.0).fold(f32::INFINITY, f32::min);
            let found = occluders.nearest(origin, direction, f32::INFINITY);
            assert_eq!(found.map(|met| met.distance), nearest.is_finite().then_some(nearest), "{origin} {direction}");
            assert_eq!(occluders.blocks(origin, direction, 0.0, 4.0), nearest < 4.0, "{origin} {direction}");
            hits += usize::from(found.is_some());
        }
        assert!((200..1900).contains(&hits), "{hits} of 2000 rays hit");
    }
}
