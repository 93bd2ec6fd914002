//! Lights: which surface points need shadow rays, and in which directions.

use glam::Vec3;
use gnomon_scene::{Light, LightKind};

use super::{group::PACKETS, rounding::ROUNDING, simd::Simd, surface::Surface, vector};

/// How far rounding may move a light's height above a shadow ray's start, in rounding units of Σ |lᵢ − sᵢ|: 1 for the
/// normal, which has no coordinate above 1, 1 for the difference, 3 for products and sums. Twin: `FACING_ROUNDINGS` in
/// visibility/surface.wgsl.
const FACING_ROUNDINGS: f32 = 5.0;

#[derive(Debug, Clone, Copy)]
pub(super) struct PreparedLight {
    /// Infinitely far away, along −`direction`.
    pub(super) directional: bool,
    /// True if it is so far from the scene that its rays are almost parallel.
    pub(super) distant: bool,
    pub(super) position: Vec3,
    /// Unit vector in which the light travels.
    pub(super) direction: Vec3,
    range_squared: f32,
    /// Cosine of the outer cone's angle, for spots.
    cos_outer: Option<f32>,
}

impl PreparedLight {
    /// `size_m` bounds the distance of the scene's coordinates from its `middle`.
    pub(super) fn new(light: &Light, middle: Vec3, size_m: f32) -> Self {
        let cos_outer = match light.kind {
            LightKind::Spot { outer_cone_rad, .. } => Some(outer_cone_rad.cos()),
            LightKind::Directional | LightKind::Point => None,
        };
        Self {
            directional: light.kind == LightKind::Directional,
            distant: light.position.distance(middle) > size_m,
            position: light.position,
            // If it is switched off, its range contains no point and no normal faces its zero direction.
            direction: if light.shines() { light.direction } else { Vec3::ZERO },
            range_squared: if light.shines() { light.range_m * light.range_m } else { -1.0 },
            cos_outer,
        }
    }

    /// Returns the lanes of packet `p` that need a shadow ray: the light is relevant and the surface faces it.
    #[inline(always)]
    pub(super) fn rays<S: Simd>(&self, s: S, surface: &Surface, p: usize) -> u8 {
        let zero = s.splat(0.0);
        let direction = vector::splat(s, self.direction.to_array());
        let to_light = if self.directional {
            vector::sub::<S>([zero; 3], direction)
        } else {
            vector::sub::<S>(vector::splat(s, self.position.to_array()), vector::load_packet(s, &surface.point, p))
        };
        // The start lies above its surface. A light that is not above the start may lie in the surface's plane.
        let from_start = if self.directional {
            to_light
        } else {
            vector::sub::<S>(vector::splat(s, self.position.to_array()), vector::load_packet(s, &surface.pushed, p))
        };
        let normal = vector::load_packet(s, &surface.geometric, p);
        let height = vector::dot(s, normal, from_start);
        let rounding = vector::size(s, from_start) * s.splat(FACING_ROUNDINGS * ROUNDING);
        let shading = vector::dot(s, vector::load_packet(s, &surface.shading, p), to_light);
        let faces = s.and(s.gt(shading, zero), s.gt(height, rounding));
        let mut lanes = surface.lanes[p] & s.bits(faces);
        if !self.directional {
            let squared = vector::dot(s, to_light, to_light);
            lanes &= s.bits(s.ge(s.splat(self.range_squared), squared));
            if let Some(cos_outer) = self.cos_outer {
                let along = zero - vector::dot(s, to_light, direction);
                lanes &= s.bits(s.ge(along, s.sqrt(squared) * s.splat(cos_outer)));
            }
        }
        lanes
    }

    /// Groups the rays by cube face around the light.
    #[inline(always)]
    pub(super) fn faces<S: Simd>(&self, s: S, surface: &Surface, rays: &[u8; PACKETS]) -> [[u8; PACKETS]; 6] {
        let mut faces = [[0; PACKETS]; 6];
        let position = vector::splat(s, self.position.to_array());
        for p in 0..PACKETS {
            if rays[p] == 0 {
                continue;
            }
            let sorted = lanes_by_face(s, vector::sub::<S>(vector::load_packet(s, &surface.pushed, p), position));
            for (face, lanes) in faces.iter_mut().zip(sorted) {
                face[p] = rays[p] & lanes;
            }
        }
        faces
    }
}

/// Returns the lanes whose directions point to each face: [`super::group::face_of`] for eight directions.
#[inline(always)]
pub(super) fn lanes_by_face<S: Simd>(s: S, direction: [S::F; 3]) -> [u8; 6] {
    let [x, y, z] = [s.abs(direction[0]), s.abs(direction[1]), s.abs(direction[2])];
    let along_x = s.bits(s.and(s.ge(x, y), s.ge(x, z)));
    let along_y = s.bits(s.ge(y, z)) & !along_x;
    let along_z = !(along_x | along_y);
    let zero = s.splat(0.0);
    let negative_x = s.bits(s.gt(zero, direction[0]));
    let negative_y = s.bits(s.gt(zero, direction[1]));
    let negative_z = s.bits(s.gt(zero, direction[2]));
    [
        along_x & !negative_x,
        along_x & negative_x,
        along_y & !negative_y,
        along_y & negative_y,
        along_z & !negative_z,
        along_z & negative_z,
    ]
}
