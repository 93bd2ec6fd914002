//! Lights: at which surface points they matter, and how their shadow rays run.

use glam::Vec3;
use gnomon_shaders::scene::{Light, LightKind};

use super::{group::PACKETS, simd::Simd, surface::Surface};

/// A light, ready for testing points against it.
#[derive(Debug, Clone, Copy)]
pub(super) struct PreparedLight {
    /// Infinitely far away, along −`direction`.
    pub(super) directional: bool,
    /// Where it is.
    pub(super) position: Vec3,
    /// Where it shines to; a unit vector.
    pub(super) direction: Vec3,
    /// Square of its range.
    range_squared: f32,
    /// Cosine of its outer cone, for spots.
    cos_outer: Option<f32>,
}

impl PreparedLight {
    pub(super) fn new(light: &Light) -> Self {
        let cos_outer = match light.kind {
            LightKind::Spot { outer_cone_rad, .. } => Some(outer_cone_rad.cos()),
            LightKind::Directional | LightKind::Point => None,
        };
        Self {
            directional: light.kind == LightKind::Directional,
            position: light.position,
            direction: light.direction,
            range_squared: light.range_m * light.range_m,
            cos_outer,
        }
    }

    /// The rays of packet `p` that have to be traced: the light matters at their points, and these do not face away from
    /// it. With them, the way from the light to each point (of no fixed length for directional lights).
    #[inline(always)]
    pub(super) fn rays<S: Simd>(&self, s: S, surface: &Surface, p: usize) -> u8 {
        let dot = |a: [S::F; 3], b: [S::F; 3]| s.fma(a[0], b[0], s.fma(a[1], b[1], a[2] * b[2]));
        let at = |of: &super::surface::Coordinates| [0, 1, 2].map(|axis| s.load(&of[axis][p]));
        let zero = s.splat(0.0);
        let direction = self.direction.to_array().map(|k| s.splat(k));
        let to_light = if self.directional {
            direction.map(|d| zero - d)
        } else {
            let position = self.position.to_array();
            let point = at(&surface.point);
            [0, 1, 2].map(|axis| s.splat(position[axis]) - point[axis])
        };
        let faces =
            s.and(s.gt(dot(at(&surface.shading), to_light), zero), s.gt(dot(at(&surface.geometric), to_light), zero));
        let mut lanes = surface.lanes[p] & s.bits(faces);
        if !self.directional {
            let squared = dot(to_light, to_light);
            lanes &= s.bits(s.ge(s.splat(self.range_squared), squared));
            if let Some(cos_outer) = self.cos_outer {
                let along = zero - dot(to_light, direction);
                lanes &= s.bits(s.ge(along, s.sqrt(squared) * s.splat(cos_outer)));
            }
        }
        lanes
    }

    /// The rays of `rays`, sorted by the cube face that they leave the light through: a group each.
    #[inline(always)]
    pub(super) fn faces<S: Simd>(&self, s: S, surface: &Surface, rays: &[u8; PACKETS]) -> [[u8; PACKETS]; 6] {
        let mut faces = [[0; PACKETS]; 6];
        let position = self.position.to_array();
        for p in 0..PACKETS {
            if rays[p] == 0 {
                continue;
            }
            let way = [0, 1, 2].map(|axis| s.load(&surface.pushed[axis][p]) - s.splat(position[axis]));
            let sorted = lanes_by_face(s, way);
            for (face, lanes) in faces.iter_mut().zip(sorted) {
                face[p] = rays[p] & lanes;
            }
        }
        faces
    }
}

/// Which lanes' directions point to which face, as [`super::group::face_of`] has it.
#[inline(always)]
pub(super) fn lanes_by_face<S: Simd>(s: S, direction: [S::F; 3]) -> [u8; 6] {
    let [x, y, z] = direction.map(|k| s.abs(k));
    let along_x = s.bits(s.and(s.ge(x, y), s.ge(x, z)));
    let along_y = s.bits(s.ge(y, z)) & !along_x;
    let along_z = !(along_x | along_y);
    let [negative_x, negative_y, negative_z] = direction.map(|k| s.bits(s.gt(s.splat(0.0), k)));
    [
        along_x & !negative_x,
        along_x & negative_x,
        along_y & !negative_y,
        along_y & negative_y,
        along_z & !negative_z,
        along_z & negative_z,
    ]
}
