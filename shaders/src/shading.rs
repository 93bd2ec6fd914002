//! Host types that the shading shaders read. Their twins are in `wgsl/shading/`.
//!
//! Values that never change are computed here once: exposure, cone falloff, tone curve.

use bytemuck::{Pod, Zeroable};
use glam::{Mat4, Vec3, Vec4};

use gnomon_scene::{
    Light as SceneLight, LightKind,
    camera::{Camera, NEAR_M, Space},
    limits::MAX_LIGHTS,
};

/// The camera. Twin of `View` in `view.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct View {
    /// Reversed-Z clip space from local space.
    pub clip_from_local: Mat4,
    /// The camera's position in local space, in metres.
    pub origin: Vec3,
    /// Distance of the near plane, in metres.
    pub near_m: f32,
    /// Unit vector along the view.
    pub forward: Vec3,
    /// Width of the picture, in pixels.
    pub width: u32,
    /// Half the picture's width on the plane at distance 1.
    pub right: Vec3,
    /// Height of the picture, in pixels.
    pub height: u32,
    /// Half the picture's height on the plane at distance 1.
    pub up: Vec3,
    /// Weight of predicted visibility, 0 to 1, against the client's own shadow maps.
    pub visibility_share: f32,
}

impl View {
    /// Returns the view of `camera` in the local space of a scene.
    #[must_use]
    pub fn new(camera: &Camera, space: Space, visibility_share: f32) -> Self {
        let basis = camera.ray_basis(space.origin_m);
        Self {
            clip_from_local: camera.clip_from_local(space),
            origin: basis.origin,
            #[expect(clippy::cast_possible_truncation, reason = "rounding is what is wanted")]
            near_m: space.near_m as f32,
            forward: basis.forward,
            width: camera.width,
            right: basis.right,
            height: camera.height,
            up: basis.up,
            visibility_share,
        }
    }
}

/// Most masks that prediction reads.
pub const MAX_MASK_LAYERS: usize = 8;

/// A mask that prediction reads. Twin of `MaskLayer` in `predict.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct MaskLayer {
    /// The view that it was traced for, with the mask's size.
    pub view: View,
    /// Its layer in the textures.
    pub slot: u32,
    /// 1 if it was traced for the picture's own view.
    pub same_view: u32,
    /// 1 if all of it has arrived.
    pub whole: u32,
    /// 1 if it was traced for the picture's own time.
    pub same_time: u32,
}

/// The inputs of prediction. Twin of `Prediction` in `predict.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Prediction {
    /// The masks, newest first.
    pub layers: [MaskLayer; MAX_MASK_LAYERS],
    pub count: u32,
    /// 0 none, 1 the dissertation's, 2 by surface.
    pub predictor: u32,
    /// How the dissertation's predictor fills unknown points: 0 lit, 1 shadowed, 2 copied.
    pub unknown: u32,
    /// A bit for each light.
    pub lights: u32,
}

/// The way from a piece's place now to that of a mask's time: the rows of an affine transform of local space, all zeros
/// if it was not shown then or that is not known. Twin of `Before` in `before.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
pub struct Before {
    pub x: Vec4,
    pub y: Vec4,
    pub z: Vec4,
}

impl Before {
    /// Of a piece that changes its shape: what is drawn of its points says where they were.
    pub const DRAWN: Self = Self { x: Vec4::W, y: Vec4::ZERO, z: Vec4::ZERO };
}

/// A light's view of the scene, in a square of the shadow map. Twin of `ShadowView` in `shadow_map.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct ShadowView {
    /// Reversed-Z clip space from local space.
    pub clip_from_local: Mat4,
    /// Left edge of the square, in texels.
    pub left: f32,
    /// Top edge of the square, in texels.
    pub top: f32,
    /// Side of the square, in texels.
    pub side: f32,
    /// Side of a texel in metres: at distance 1, or anywhere for a directional light.
    pub texel_m: f32,
}

/// A light. Twin of `Light` in `lighting.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Light {
    /// Position in local space, in metres.
    pub position: Vec3,
    /// 0 directional, 1 point, 2 spot.
    pub kind: u32,
    /// Unit vector in which the light travels.
    pub direction: Vec3,
    /// One over the range in metres, or 0.
    pub inverse_range: f32,
    /// Colour times intensity times exposure.
    pub intensity: Vec3,
    /// Factor of the cone's falloff.
    pub cone_scale: f32,
    /// Offset of the cone's falloff.
    pub cone_offset: f32,
    /// The light's first view in the shadow map.
    pub shadow_view: u32,
    /// Square of the distance within which light grows no more.
    pub closest_squared: f32,
    pub unused: f32,
}

impl Light {
    /// Returns a light of the scene, with `exposure` multiplied into its intensity.
    #[must_use]
    pub fn new(light: &SceneLight, exposure: f32) -> Self {
        let (kind, cone_scale, cone_offset) = match light.kind {
            LightKind::Directional => (0, 0.0, 1.0),
            LightKind::Point => (1, 0.0, 1.0),
            LightKind::Spot { inner_cone_rad, outer_cone_rad } => {
                // KHR_lights_punctual, "Inner and Outer Cone Angles": the recommended falloff.
                let outer = outer_cone_rad.cos();
                let scale = 1.0 / (inner_cone_rad.cos() - outer).max(0.001);
                (2, scale, -outer * scale)
            }
        };
        let inverse_range = if light.range_m.is_finite() && kind != 0 { 1.0 / light.range_m.max(1e-6) } else { 0.0 };
        Self {
            position: light.position,
            kind,
            direction: light.direction,
            inverse_range,
            intensity: light.color * light.intensity * exposure,
            cone_scale,
            cone_offset,
            shadow_view: 0,
            closest_squared: closest_squared(2.0 * NEAR_M),
            unused: 0.0,
        }
    }

    /// Returns the light as it shines in `space`: [`Self::new`] suits all but small scenes.
    #[must_use]
    pub fn in_space(self, space: Space) -> Self {
        Self { closest_squared: closest_squared(space.closest_m()), ..self }
    }

    /// Returns the unshadowed irradiance on a surface at `point` that faces the light, and the unit vector towards the
    /// light: `arrival` of `lighting.wgsl`, for the exposure.
    #[must_use]
    pub fn arrival(&self, point: Vec3) -> (Vec3, Vec3) {
        if self.kind == 0 {
            return (self.intensity, -self.direction);
        }
        let between = self.position - point;
        let squared = between.length_squared().max(self.closest_squared);
        let toward = between / squared.sqrt();
        let reach = squared * self.inverse_range * self.inverse_range;
        let cone = (-toward.dot(self.direction) * self.cone_scale + self.cone_offset).clamp(0.0, 1.0);
        (self.intensity * ((1.0 - reach * reach).clamp(0.0, 1.0) / squared * cone * cone), toward)
    }
}

#[expect(clippy::cast_possible_truncation, reason = "rounding is what is wanted")]
fn closest_squared(closest_m: f64) -> f32 {
    // Not 0, which is divided by.
    ((closest_m * closest_m) as f32).max(f32::MIN_POSITIVE)
}

/// All light in the scene. Twin of `Lighting` in `lighting.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Lighting {
    /// Ambient irradiance from above, exposed.
    pub ambient_above: Vec3,
    pub count: u32,
    /// Ambient irradiance from below, exposed.
    pub ambient_below: Vec3,
    /// First column of the picture that is drawn without shadows.
    pub lit_from_px: u32,
    /// Radiance of a painted sky at the zenith, exposed.
    pub zenith: Vec3,
    /// Factor of the environment as it is seen.
    pub sky_seen: f32,
    /// Radiance of a painted sky at the horizon, exposed.
    pub horizon: Vec3,
    /// Factor of the environment as it lights surfaces.
    pub sky_lit: f32,
    /// The lights, in the order of the mask's planes.
    pub lights: [Light; MAX_LIGHTS],
    /// Irradiance from the environment over π, exposed: factors of 1, y, z, x, xy, yz, 3z² − 1, xz, x² − y².
    pub harmonics: [Vec4; 9],
    /// 1 if surfaces mirror the ambient light, else 0.
    pub mirrored: f32,
    pub unused: [f32; 3],
}

/// The tone curve x^a / (b·x^(a·d) + c) (Lottes, GDC 2016). Twin of `Tone` in `tone.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Tone {
    /// a: steepness in the middle.
    pub contrast: f32,
    /// d: steepness of the shoulder.
    pub shoulder: f32,
    /// b: places the white point.
    pub b: f32,
    /// c: places the middle.
    pub c: f32,
}

impl Tone {
    /// Returns the curve with these slopes that maps `white` to 1 and `middle` to `middle_shown`.
    #[must_use]
    pub fn new(contrast: f64, shoulder: f64, white: f64, middle: f64, middle_shown: f64) -> Self {
        let (white_a, middle_a) = (white.powf(contrast), middle.powf(contrast));
        let (white_ad, middle_ad) = (white_a.powf(shoulder), middle_a.powf(shoulder));
        let below = (white_ad - middle_ad) * middle_shown;
        let b = (white_a * middle_shown - middle_a) / below;
        let c = (white_ad * middle_a - white_a * middle_ad * middle_shown) / below;
        #[expect(clippy::cast_possible_truncation, reason = "rounding is what is wanted")]
        let rounded = |value: f64| value as f32;
        Self { contrast: rounded(contrast), shoulder: rounded(shoulder), b: rounded(b), c: rounded(c) }
    }

    /// Returns the curve at `x`, before clamping to 1.
    #[must_use]
    pub fn curve(&self, x: f32) -> f32 {
        let power = x.powf(self.contrast);
        power / (self.b * power.powf(self.shoulder) + self.c)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tone_curve_goes_through_its_points() {
        let tone = Tone::new(1.25, 0.97, 8.0, 0.18, 0.2);
        assert!((tone.curve(8.0) - 1.0).abs() < 1e-4);
        assert!((tone.curve(0.18) - 0.2).abs() < 1e-4);
        let steps: Vec<f32> = (0..800_u16).map(|i| tone.curve(f32::from(i) * 0.01)).collect();
        assert!(steps.windows(2).all(|pair| pair[0] < pair[1]));
    }

    #[test]
    fn lights_follow_the_khronos_falloff() {
        let mut light = SceneLight {
            name: String::new(),
            kind: LightKind::Point,
            position: Vec3::new(0.0, 3.0, 0.0),
            direction: Vec3::NEG_Y,
            color: Vec3::ONE,
            intensity: 90.0,
            range_m: f32::INFINITY,
        };
        let at_origin = |light: &SceneLight| Light::new(light, 1.0).arrival(Vec3::ZERO).0.x;
        assert!((at_origin(&light) - 10.0).abs() < 1e-5);
        light.range_m = 6.0;
        assert!((at_origin(&light) - 10.0 * (1.0 - 0.5_f32.powi(4))).abs() < 1e-5);
        light.range_m = 2.9;
        assert_eq!(at_origin(&light), 0.0);
        light.range_m = f32::INFINITY;
        light.kind = LightKind::Spot { inner_cone_rad: 0.2, outer_cone_rad: 0.4 };
        assert!((at_origin(&light) - 10.0).abs() < 1e-5);
        for (angle, lit) in [(0.1_f32, 1.0), (0.2, 1.0), (0.4, 0.0), (0.5, 0.0)] {
            light.direction = Vec3::new(angle.sin(), -angle.cos(), 0.0);
            assert!((at_origin(&light) - 10.0 * lit).abs() < 0.05, "{angle}");
        }
    }
}
