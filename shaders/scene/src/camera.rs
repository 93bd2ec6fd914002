//! The camera: the ray through each pixel's centre.
//!
//! Right-handed, +Y up, the camera looks along its −Z. Depth is reversed-Z with an infinite far plane: 1 at the near
//! plane, 0 at infinity. Everything is computed in f64, relative to the scene's origin, and then rounded to f32.

use glam::{DMat3, DMat4, DQuat, DVec3, DVec4, Mat4, Vec3};

use crate::Scene;

/// Distance of the near plane in all but small scenes, in metres. Camera paths come within 2 cm of a surface.
pub const NEAR_M: f64 = 0.005;

/// In small scenes, the near plane's distance as a share of the scene's size.
const NEAR_SHARE: f64 = 1e-3;

/// A scene's local space, as cameras see it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Space {
    /// World position of the local origin, in metres.
    pub origin_m: DVec3,
    /// Distance of the near plane, in metres. Reversed-Z depth keeps the same relative precision with any.
    pub near_m: f64,
}

impl Space {
    /// Returns the space of `scene`.
    #[must_use]
    pub fn of(scene: &Scene) -> Self {
        let size_m = (scene.bounds.max.as_dvec3() - scene.bounds.min.as_dvec3()).length();
        let near_m = if size_m > 0.0 { NEAR_M.min(NEAR_SHARE * size_m) } else { NEAR_M };
        Self { origin_m: scene.origin_m, near_m }
    }

    /// Returns the distance within which light from a lamp grows no more, in metres. A punctual light has no size, and
    /// would be infinitely bright at its own position.
    #[must_use]
    pub fn closest_m(&self) -> f64 {
        2.0 * self.near_m
    }
}

/// A camera and the size of its picture, in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Position in world space, in metres.
    pub position_m: DVec3,
    /// Rotation from camera to world space, a unit quaternion.
    pub orientation: DQuat,
    /// Full vertical field of view, in radians.
    pub yfov_rad: f64,
    pub width: u32,
    pub height: u32,
}

/// The ray of each pixel, for kernels: `forward + ndc_x·right + ndc_y·up`, not normalised, where
/// `ndc_x = 2·(x + ½)/width − 1` and `ndc_y = 1 − 2·(y + ½)/height`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayBasis {
    /// The camera's position relative to the scene's origin, in metres.
    pub origin: Vec3,
    /// Unit vector along the view.
    pub forward: Vec3,
    /// Half the picture's width on the plane at distance 1.
    pub right: Vec3,
    /// Half the picture's height on the plane at distance 1.
    pub up: Vec3,
}

impl Camera {
    /// Returns a camera at `position_m` that looks at `target_m`, with +Y up (−Z up if it looks straight up or down).
    #[must_use]
    pub fn looking_at(position_m: DVec3, target_m: DVec3, yfov_rad: f64, width: u32, height: u32) -> Self {
        let forward = (target_m - position_m).try_normalize().unwrap_or(DVec3::NEG_Z);
        let up_hint = if forward.y.abs() > 1.0 - 1e-9 { DVec3::NEG_Z } else { DVec3::Y };
        let right = forward.cross(up_hint).normalize();
        let rotation = DMat3::from_cols(right, right.cross(forward), -forward);
        Self { position_m, orientation: DQuat::from_mat3(&rotation).normalize(), yfov_rad, width, height }
    }

    /// Returns the camera of a pose from the wire. Client and server share this, so that a mask's pixels mean the same
    /// to both. The quaternion is normalised.
    #[must_use]
    pub fn of_pose(position_m: [f64; 3], orientation: [f64; 4], yfov_rad: f64, [width, height]: [u16; 2]) -> Self {
        Self {
            position_m: DVec3::from_array(position_m),
            orientation: DQuat::from_array(orientation).normalize(),
            yfov_rad,
            width: width.into(),
            height: height.into(),
        }
    }

    /// Returns the view with a guard band: `x` more pixels of the same size left and right, and `y` above and below.
    #[must_use]
    pub fn widened(&self, (x, y): (u32, u32)) -> Self {
        let (width, height) = (self.width + 2 * x, self.height + 2 * y);
        let (_, half_height) = self.half_extent();
        let yfov_rad = if y == 0 {
            self.yfov_rad
        } else {
            2.0 * (half_height * f64::from(height) / f64::from(self.height)).atan()
        };
        Self { yfov_rad, width, height, ..*self }
    }

    /// Returns half the picture's width and height on the plane at distance 1.
    #[must_use]
    pub fn half_extent(&self) -> (f64, f64) {
        let half_height = (self.yfov_rad * 0.5).tan();
        (half_height * f64::from(self.width) / f64::from(self.height), half_height)
    }

    /// Returns the origin (metres) and the direction (not normalised) of pixel (x, y)'s ray, in world space.
    #[must_use]
    pub fn ray(&self, x: u32, y: u32) -> (DVec3, DVec3) {
        let (half_width, half_height) = self.half_extent();
        let ndc_x = 2.0 * (f64::from(x) + 0.5) / f64::from(self.width) - 1.0;
        let ndc_y = 1.0 - 2.0 * (f64::from(y) + 0.5) / f64::from(self.height);
        (self.position_m, self.orientation * DVec3::new(ndc_x * half_width, ndc_y * half_height, -1.0))
    }

    /// Returns the ray basis in f32, relative to the scene's origin.
    #[must_use]
    pub fn ray_basis(&self, origin_m: DVec3) -> RayBasis {
        let (half_width, half_height) = self.half_extent();
        RayBasis {
            origin: (self.position_m - origin_m).as_vec3(),
            forward: (self.orientation * DVec3::NEG_Z).as_vec3(),
            right: (self.orientation * DVec3::X * half_width).as_vec3(),
            up: (self.orientation * DVec3::Y * half_height).as_vec3(),
        }
    }

    /// Returns the matrix to clip space from the scene's local space (positions relative to its origin).
    #[must_use]
    pub fn clip_from_local(&self, space: Space) -> Mat4 {
        // The tracer's rays start at the position rounded to f32, so the rasteriser looks from there too.
        let position = (self.position_m - space.origin_m).as_vec3().as_dvec3();
        (self.clip_from_camera(space.near_m)
            * DMat4::from_quat(self.orientation.inverse())
            * DMat4::from_translation(-position))
        .as_mat4()
    }

    /// Returns the matrix to clip space from camera space: reversed-Z, infinite far plane, near plane at `near_m`.
    #[must_use]
    pub fn clip_from_camera(&self, near_m: f64) -> DMat4 {
        let (half_width, half_height) = self.half_extent();
        DMat4::from_cols(
            DVec4::new(1.0 / half_width, 0.0, 0.0, 0.0),
            DVec4::new(0.0, 1.0 / half_height, 0.0, 0.0),
            DVec4::new(0.0, 0.0, 0.0, -1.0),
            DVec4::new(0.0, 0.0, near_m, 0.0),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera::looking_at(DVec3::new(1e5, 2.0, -3.0), DVec3::new(1e5 + 4.0, 2.5, -7.0), 1.0, 640, 360)
    }

    #[test]
    fn a_point_on_a_pixels_ray_lands_on_that_pixels_centre() {
        let camera = camera();
        let origin = DVec3::new(1e5, 0.0, 0.0);
        let clip_from_local = camera.clip_from_local(Space { origin_m: origin, near_m: NEAR_M });
        for (x, y) in [(0, 0), (639, 359), (320, 180), (17, 300)] {
            let (from, direction) = camera.ray(x, y);
            let clip = clip_from_local * (from + direction * 7.0 - origin).as_vec3().extend(1.0);
            let ndc = clip / clip.w;
            let px = (f64::from(ndc.x) + 1.0) * 320.0 - 0.5;
            let py = (1.0 - f64::from(ndc.y)) * 180.0 - 0.5;
            // f32 coordinates of about 10 m carry 1e-6 m, which is 4e-5 of a pixel at 7 m.
            assert!((px - f64::from(x)).abs() < 1e-3 && (py - f64::from(y)).abs() < 1e-3, "({x}, {y}) → ({px}, {py})");
            assert!((f64::from(ndc.z) - NEAR_M / 7.0).abs() < 1e-8);
        }
    }

    #[test]
    fn the_rounded_basis_agrees_with_the_rays() {
        let camera = camera();
        let basis = camera.ray_basis(camera.position_m);
        let (_, direction) = camera.ray(3, 5);
        let ndc = (2.0 * 3.5 / 640.0 - 1.0, 1.0 - 2.0 * 5.5 / 360.0);
        let rounded = basis.forward + basis.right * ndc.0 + basis.up * ndc.1;
        assert!((rounded.as_dvec3() - direction).length() < 1e-6);
        assert_eq!(basis.origin, Vec3::ZERO);
    }

    #[test]
    fn a_guard_band_leaves_every_pixel_where_it_was() {
        let camera = camera();
        for (x, y) in [(0, 0), (7, 0), (0, 3), (128, 72)] {
            let wide = camera.widened((x, y));
            assert_eq!((wide.width, wide.height), (640 + 2 * x, 360 + 2 * y));
            for (px, py) in [(0, 0), (639, 359), (17, 200)] {
                let (one, other) = (camera.ray(px, py), wide.ray(px + x, py + y));
                assert!((one.1 - other.1).length() < 1e-12, "{one:?} {other:?}");
            }
        }
        assert_eq!(camera.widened((0, 0)), camera);
    }

    #[test]
    fn the_near_plane_follows_small_scenes() {
        let near_m = |size: f32| {
            let mut scene = crate::scene::check::tests::scene();
            (scene.bounds.min, scene.bounds.max) = (Vec3::ZERO, Vec3::X * size);
            Space::of(&scene).near_m
        };
        assert_eq!([1e4, 30.0, 5.0, 0.0].map(near_m), [NEAR_M; 4]);
        assert!((near_m(1e-3) - 1e-6).abs() < 1e-12);
    }

    #[test]
    fn looking_straight_down_is_a_rotation() {
        let camera = Camera::looking_at(DVec3::ZERO, DVec3::NEG_Y, 1.0, 4, 4);
        assert!((camera.orientation * DVec3::NEG_Z - DVec3::NEG_Y).length() < 1e-12);
    }
}
