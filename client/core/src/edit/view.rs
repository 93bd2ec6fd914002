//! Between pixels and the world. Pixels count from the picture's upper left corner; centres are at halves.

use glam::{DVec2, DVec3};
use gnomon_scene::camera::{Camera, Space};

/// A camera, and how near it sees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    pub camera: Camera,
    /// Distance of the near plane, in metres.
    pub near_m: f64,
}

impl View {
    #[must_use]
    pub fn new(camera: Camera, space: Space) -> Self {
        Self { camera, near_m: space.near_m }
    }

    /// Unit vector along the view.
    #[must_use]
    pub fn forward(&self) -> DVec3 {
        self.camera.orientation * DVec3::NEG_Z
    }

    /// Returns the direction of a pixel's ray in the world. Its length is 1 along the view.
    #[must_use]
    pub fn ray(&self, px: DVec2) -> DVec3 {
        let (half_width, half_height) = self.camera.half_extent();
        let ndc = px / self.size_px() * 2.0 - 1.0;
        self.camera.orientation * DVec3::new(ndc.x * half_width, -ndc.y * half_height, -1.0)
    }

    /// Distance of a point along the view, in metres.
    #[must_use]
    pub fn depth_m(&self, point: DVec3) -> f64 {
        (point - self.camera.position_m).dot(self.forward())
    }

    /// Pixels of a metre at this depth, across the view.
    #[must_use]
    pub fn px_per_m(&self, depth_m: f64) -> f64 {
        self.focal_px() / depth_m
    }

    /// Returns where a point of the world is in the picture. `None` if it is nearer than the near plane.
    #[must_use]
    pub fn project(&self, point: DVec3) -> Option<DVec2> {
        let seen = self.seen(point - self.camera.position_m);
        (seen.z >= self.near_m).then(|| self.px(seen))
    }

    /// Returns the part of a segment beyond the near plane. `None` if there is none.
    #[must_use]
    pub fn segment(&self, ends: [DVec3; 2]) -> Option<[DVec2; 2]> {
        let [one, other] = ends.map(|end| self.seen(end - self.camera.position_m));
        let cut = |inside: DVec3, outside: DVec3| {
            let share = (self.near_m - inside.z) / (outside.z - inside.z);
            inside.lerp(outside, share)
        };
        let (one, other) = match (one.z >= self.near_m, other.z >= self.near_m) {
            (true, true) => (one, other),
            (true, false) => (one, cut(one, other)),
            (false, true) => (cut(other, one), other),
            (false, false) => return None,
        };
        Some([self.px(one), self.px(other)])
    }

    /// Returns how a point's pixel moves, in pixels per metre, when the point moves along `direction`, a unit vector.
    #[must_use]
    pub fn pace(&self, point: DVec3, direction: DVec3) -> DVec2 {
        let (seen, along) = (self.seen(point - self.camera.position_m), self.seen(direction));
        let slope = (along.truncate() * seen.z - seen.truncate() * along.z) / (seen.z * seen.z);
        slope * DVec2::new(1.0, -1.0) * self.focal_px()
    }

    fn size_px(&self) -> DVec2 {
        DVec2::new(self.camera.width.into(), self.camera.height.into())
    }

    fn focal_px(&self) -> f64 {
        let (_, half_height) = self.camera.half_extent();
        f64::from(self.camera.height) * 0.5 / half_height
    }

    /// Right, up and along the view.
    fn seen(&self, offset: DVec3) -> DVec3 {
        self.camera.orientation.inverse() * offset * DVec3::new(1.0, 1.0, -1.0)
    }

    fn px(&self, seen: DVec3) -> DVec2 {
        self.size_px() * 0.5 + seen.truncate() / seen.z * DVec2::new(1.0, -1.0) * self.focal_px()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view() -> View {
        let (from, to) = (DVec3::new(1e5, 2.0, -3.0), DVec3::new(1e5 + 4.0, 2.5, -7.0));
        View { camera: Camera::looking_at(from, to, 1.0, 640, 360), near_m: 0.005 }
    }

    #[test]
    fn a_point_on_a_pixels_ray_is_seen_in_that_pixel() {
        let view = view();
        for px in [DVec2::new(0.5, 0.5), DVec2::new(639.5, 12.25), DVec2::new(320.0, 180.0)] {
            let point = view.camera.position_m + view.ray(px) * 7.0;
            // Coordinates of 1e5 m are rounded by 1e-11 m, which is 1e-9 of a pixel at 7 m.
            assert!(view.project(point).unwrap().distance(px) < 1e-8, "{px}");
            assert!((view.depth_m(point) - 7.0).abs() < 1e-10);
        }
        // The ray of a pixel is the one that kernels use.
        let (_, direction) = view.camera.ray(17, 300);
        assert!(view.ray(DVec2::new(17.5, 300.5)).distance(direction) < 1e-12);
    }

    #[test]
    fn what_lies_behind_is_cut_off_at_the_near_plane() {
        let view = view();
        let at = |px: DVec2, depth_m: f64| view.camera.position_m + view.ray(px) * depth_m;
        let (front, behind) = (at(DVec2::new(100.0, 50.0), 5.0), at(DVec2::new(300.0, 90.0), -5.0));
        assert_eq!((view.project(behind), view.segment([behind, behind])), (None, None));
        let [one, other] = view.segment([front, behind]).unwrap();
        assert!(one.distance(DVec2::new(100.0, 50.0)) < 1e-8 && other.is_finite());
        let [other_way, _] = view.segment([behind, front]).unwrap();
        // The cut is at 5 mm: a rounding of 1e-11 m is 1e-6 of a pixel there.
        assert!(other.distance(other_way) < 1e-5 * other.length().max(1.0));
    }

    #[test]
    fn the_pace_is_how_far_a_small_step_goes() {
        let view = view();
        let point = view.camera.position_m + view.ray(DVec2::new(500.0, 90.0)) * 3.0;
        for direction in [DVec3::X, DVec3::Y, DVec3::new(0.6, 0.0, -0.8)] {
            let step_m = 1e-4;
            let [before, after] = [-step_m, step_m].map(|step| view.project(point + direction * step).unwrap());
            let pace = view.pace(point, direction);
            // The third derivative over six, times the step's square, relative to the pace: about (1e-4 / 3)².
            assert!(((after - before) / (2.0 * step_m)).distance(pace) < 1e-4 * pace.length().max(1.0), "{direction}");
        }
    }
}
