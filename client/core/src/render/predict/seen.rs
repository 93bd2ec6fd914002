//! What a picture shows, and which things may shade it: only these are drawn into shadow maps.

use glam::{Vec3, Vec4};
use gnomon_scene::{Light, LightKind, camera::Camera, camera::Space};

/// Coordinates are off by less than this share of their size, after a few roundings of f32.
const ROUNDING: f32 = 1e-5;

/// The space between the planes of a picture's edges, before the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Seen {
    /// Unit normals that point inwards, and distances: not negative inside.
    planes: [Vec4; 5],
}

impl Seen {
    pub(crate) fn new(camera: &Camera, space: Space) -> Self {
        let basis = camera.ray_basis(space.origin_m);
        let inward = |normal: Vec3| {
            let normal = normal.normalize_or_zero() * if normal.dot(basis.forward) < 0.0 { -1.0 } else { 1.0 };
            normal.extend(-normal.dot(basis.origin) + ROUNDING * basis.origin.abs().max_element())
        };
        let (forward, right, up) = (basis.forward, basis.right, basis.up);
        let edges = [up.cross(forward + right), up.cross(forward - right)];
        let ends = [right.cross(forward + up), right.cross(forward - up)];
        Self { planes: [edges[0], edges[1], ends[0], ends[1], forward].map(inward) }
    }

    /// The same space and what lies within this distance of it, in metres.
    pub(super) fn and_around(&self, distance_m: f32) -> Self {
        Self { planes: self.planes.map(|plane| plane + Vec4::W * distance_m) }
    }

    /// Whether all of another space lies in this one, as far as equal directions tell.
    pub(super) fn covers(&self, other: &Self) -> bool {
        let planes = self.planes.iter().zip(&other.planes);
        planes.into_iter().all(|(one, other)| one.truncate() == other.truncate() && one.w >= other.w)
    }

    /// Whether the shadow of a thing between these corners may fall into the space. It does not if, for one plane, the
    /// thing lies beyond it, and light that passes the thing goes on beyond it.
    pub(super) fn may_be_shaded(&self, light: &Light, corners: &[Vec3; 8]) -> bool {
        let stays_beyond = |plane: &Vec4, corner: &Vec3| {
            let way = match light.kind {
                LightKind::Directional => light.direction,
                LightKind::Point | LightKind::Spot { .. } => *corner - light.position,
            };
            let height = plane.dot(corner.extend(1.0));
            height < -ROUNDING * corner.abs().max_element() && plane.truncate().dot(way) <= 0.0
        };
        !self.planes.iter().any(|plane| corners.iter().all(|corner| stays_beyond(plane, corner)))
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use gnomon_scene::camera::NEAR_M;

    use super::*;

    fn around(centre: Vec3, half: f32) -> [Vec3; 8] {
        let sign = |number: usize, bit: usize| if number >> bit & 1 == 1 { half } else { -half };
        std::array::from_fn(|n| centre + Vec3::new(sign(n, 0), sign(n, 1), sign(n, 2)))
    }

    fn light(kind: LightKind, position: Vec3, direction: Vec3) -> Light {
        let (name, color) = (String::new(), Vec3::ONE);
        Light { name, kind, position, direction, color, intensity: 1.0, range_m: f32::INFINITY }
    }

    /// Looks along −z from (1, 2, 3), 90° high and wide.
    fn seen() -> Seen {
        let from = DVec3::new(101.0, 2.0, 3.0);
        let camera = Camera::looking_at(from, from - DVec3::Z, std::f64::consts::FRAC_PI_2, 64, 64);
        Seen::new(&camera, Space { origin_m: DVec3::X * 100.0, near_m: NEAR_M })
    }

    #[test]
    fn a_thing_shades_what_is_seen_if_light_takes_its_shadow_there() {
        let (seen, eye) = (seen(), Vec3::new(1.0, 2.0, 3.0));
        let down = light(LightKind::Directional, Vec3::ZERO, Vec3::new(0.0, -1.0, 0.0));
        let lamp = |at: Vec3| light(LightKind::Point, eye + at, Vec3::NEG_Y);
        for (light, at, shades) in [
            // In the picture; above it; beside it; behind the eye.
            (&down, Vec3::new(0.0, 0.0, -5.0), true),
            (&down, Vec3::new(0.0, 20.0, -5.0), true),
            (&down, Vec3::new(9.0, 20.0, -5.0), false),
            (&down, Vec3::new(0.0, 0.0, 5.0), false),
            // Below the picture light goes on down.
            (&down, Vec3::new(0.0, -9.0, -5.0), false),
            // A lamp before the eye casts the shadows of what is behind farther back.
            (&lamp(Vec3::new(0.0, 0.0, -5.0)), Vec3::new(0.0, 1.0, 5.0), false),
            (&lamp(Vec3::new(0.0, 0.0, -5.0)), Vec3::new(9.0, 0.0, -5.0), false),
            (&lamp(Vec3::new(0.0, 0.0, 20.0)), Vec3::new(0.0, 1.0, 5.0), true),
            (&lamp(Vec3::new(20.0, 0.0, -5.0)), Vec3::new(9.0, 0.0, -5.0), true),
        ] {
            assert_eq!(seen.may_be_shaded(light, &around(eye + at, 1.0)), shades, "{light:?} {at}");
        }
        // Four metres beyond the right edge, but for the thing's own size.
        let beside = around(eye + Vec3::new(9.0, 20.0, -5.0), 0.1);
        assert!(!seen.and_around(2.0).may_be_shaded(&down, &beside));
        assert!(seen.and_around(3.0).may_be_shaded(&down, &beside));
        assert!(seen.and_around(3.0).covers(&seen) && !seen.covers(&seen.and_around(3.0)));
    }

    /// Points along the light's way behind the thing, which would be shaded, and are seen.
    #[test]
    fn whatever_is_left_out_shades_nothing_that_is_seen() {
        let (seen, eye) = (seen(), Vec3::new(1.0, 2.0, 3.0));
        let mut state = 3_u32;
        let mut next = |half: f32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((state >> 8) as f32 / (1 << 23) as f32 - 1.0) * half
        };
        let mut left_out = 0;
        for number in 0..2000 {
            let (at, position) =
                (Vec3::new(next(15.0), next(15.0), next(15.0)), Vec3::new(next(9.0), next(9.0), next(9.0)));
            let kind = if number % 2 == 0 { LightKind::Directional } else { LightKind::Point };
            let light = light(kind, position, position.normalize());
            if seen.may_be_shaded(&light, &around(at, 0.5)) {
                continue;
            }
            left_out += 1;
            for _ in 0..50 {
                let within = at + Vec3::new(next(0.5), next(0.5), next(0.5));
                let way = if kind == LightKind::Directional { light.direction } else { within - light.position };
                let shaded = within + way * (next(1.0) + 1.0) * 20.0 - eye;
                let sees = shaded.z < 0.0 && shaded.x.abs() <= -shaded.z && shaded.y.abs() <= -shaded.z;
                assert!(!sees, "{light:?} {at} {shaded}");
            }
        }
        assert!(left_out > 500, "{left_out}");
    }
}
