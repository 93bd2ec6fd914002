//! A camera that a person flies: it moves where it looks and never rolls. The wheel sets its speed.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::{DQuat, DVec3};
use gnomon_protocol::limits::MAX_POSITION_M;
use gnomon_scene::camera::Camera;

/// Range of speeds: a scene of 0.1 mm is crossed in seconds, and one of 10 km too.
const SPEEDS_M_PER_S: (f64, f64) = (1e-6, 2e4);

/// Speed factor of a notch of the wheel.
const NOTCH: f64 = 1.25;

/// Speed factor while the fast key is held.
const FAST: f64 = 4.0;

/// Largest pitch: not quite vertical, where left and right would swap.
const MOST_PITCH_RAD: f64 = FRAC_PI_2 - 0.01;

/// Longest time step: after a window was dragged or hidden, the camera must not fly through a wall.
const LONGEST_STEP_S: f64 = 0.1;

/// The input of one step.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Motion {
    /// Along the view, −1 to 1.
    pub forward: f64,
    /// To the right, −1 to 1.
    pub right: f64,
    /// Up in the world, −1 to 1.
    pub up: f64,
    /// To the left.
    pub yaw_rad: f64,
    /// Up.
    pub pitch_rad: f64,
    /// Wheel notches; they change the speed from this step on.
    pub faster: f64,
    /// True if the fast key is held.
    pub fast: bool,
}

/// A camera without a picture size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fly {
    position_m: DVec3,
    yaw_rad: f64,
    pitch_rad: f64,
    yfov_rad: f64,
    speed_m_per_s: f64,
}

impl Fly {
    /// Continues from `camera`, without its roll.
    #[must_use]
    pub fn from_camera(camera: &Camera, speed_m_per_s: f64) -> Self {
        let forward = camera.orientation * DVec3::NEG_Z;
        Self {
            position_m: camera.position_m,
            yaw_rad: (-forward.x).atan2(-forward.z),
            pitch_rad: forward.y.clamp(-1.0, 1.0).asin().clamp(-MOST_PITCH_RAD, MOST_PITCH_RAD),
            yfov_rad: camera.yfov_rad,
            speed_m_per_s: speed_m_per_s.clamp(SPEEDS_M_PER_S.0, SPEEDS_M_PER_S.1),
        }
    }

    /// Moves for `step_s` seconds. Returns whether anything changed.
    pub fn step(&mut self, motion: &Motion, step_s: f64) -> bool {
        let before = *self;
        self.speed_m_per_s = (self.speed_m_per_s * NOTCH.powf(motion.faster)).clamp(SPEEDS_M_PER_S.0, SPEEDS_M_PER_S.1);
        self.yaw_rad = (self.yaw_rad + motion.yaw_rad).rem_euclid(TAU);
        self.pitch_rad = (self.pitch_rad + motion.pitch_rad).clamp(-MOST_PITCH_RAD, MOST_PITCH_RAD);
        let along = self.orientation() * DVec3::new(motion.right, 0.0, -motion.forward) + DVec3::Y * motion.up;
        let speed = self.speed_m_per_s * if motion.fast { FAST } else { 1.0 };
        // Diagonal motion is no faster than straight motion.
        let step = along.clamp_length_max(1.0) * speed * step_s.clamp(0.0, LONGEST_STEP_S);
        let most = DVec3::splat(MAX_POSITION_M);
        self.position_m = (self.position_m + step).clamp(-most, most);
        *self != before
    }

    #[must_use]
    pub fn speed_m_per_s(&self) -> f64 {
        self.speed_m_per_s
    }

    /// Returns the camera for a picture of this size in pixels.
    #[must_use]
    pub fn camera(&self, width: u32, height: u32) -> Camera {
        Camera { position_m: self.position_m, orientation: self.orientation(), yfov_rad: self.yfov_rad, width, height }
    }

    fn orientation(&self) -> DQuat {
        DQuat::from_rotation_y(self.yaw_rad) * DQuat::from_rotation_x(self.pitch_rad)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at_origin() -> Fly {
        Fly::from_camera(&Camera::looking_at(DVec3::ZERO, DVec3::NEG_Z, 1.0, 16, 9), 2.0)
    }

    fn close(found: DVec3, expected: DVec3) {
        assert!((found - expected).length() < 1e-9, "{found} is not {expected}");
    }

    #[test]
    fn it_continues_from_any_camera_without_roll() {
        for target in [DVec3::X, DVec3::new(0.3, 0.8, -0.2), DVec3::new(-4.0, -1.0, 3.0), DVec3::Z] {
            let camera = Camera::looking_at(DVec3::new(1.0, 2.0, 3.0), DVec3::new(1.0, 2.0, 3.0) + target, 0.9, 64, 36);
            let taken = Fly::from_camera(&camera, 1.0).camera(64, 36);
            close(taken.position_m, camera.position_m);
            close(taken.orientation * DVec3::NEG_Z, camera.orientation * DVec3::NEG_Z);
            close(taken.orientation * DVec3::Y, camera.orientation * DVec3::Y);
            assert_eq!((taken.yfov_rad, taken.width, taken.height), (0.9, 64, 36));
        }
    }

    #[test]
    fn it_walks_where_it_looks_and_climbs_in_the_world() {
        let mut fly = at_origin();
        assert!(fly.step(&Motion { forward: 1.0, ..Motion::default() }, 0.1));
        close(fly.position_m, DVec3::new(0.0, 0.0, -0.2));
        fly.step(&Motion { yaw_rad: -FRAC_PI_2, ..Motion::default() }, 0.1);
        fly.step(&Motion { forward: 1.0, ..Motion::default() }, 0.1);
        close(fly.position_m, DVec3::new(0.2, 0.0, -0.2));
        fly.step(&Motion { pitch_rad: -0.7, ..Motion::default() }, 0.1);
        fly.step(&Motion { up: 1.0, fast: true, ..Motion::default() }, 0.1);
        close(fly.position_m, DVec3::new(0.2, 0.8, -0.2));
        assert!(!fly.step(&Motion::default(), 0.1));
    }

    #[test]
    fn diagonals_are_no_faster_and_long_steps_are_capped() {
        let mut fly = at_origin();
        fly.step(&Motion { forward: 1.0, right: 1.0, up: 1.0, ..Motion::default() }, 0.1);
        assert!((fly.position_m.length() - 0.2).abs() < 1e-9);
        let mut fly = at_origin();
        fly.step(&Motion { forward: 1.0, ..Motion::default() }, 3600.0);
        assert!((fly.position_m.length() - 0.2).abs() < 1e-9);
    }

    #[test]
    fn pitch_and_position_stay_in_range() {
        let mut fly = at_origin();
        for _ in 0..100 {
            fly.step(&Motion { pitch_rad: 1.0, yaw_rad: 3.0, faster: 9.0, forward: 1.0, ..Motion::default() }, 0.1);
        }
        let up = fly.camera(1, 1).orientation * DVec3::Y;
        assert!(up.y > 0.0 && fly.yaw_rad < TAU);
        assert!(fly.speed_m_per_s() <= SPEEDS_M_PER_S.1);
        fly.position_m = DVec3::splat(MAX_POSITION_M);
        fly.step(&Motion { up: 1.0, ..Motion::default() }, 0.1);
        assert!(fly.position_m.max_element() <= MAX_POSITION_M);
    }

    #[test]
    fn wheel_steps_up_and_down_cancel_out() {
        let mut fly = at_origin();
        fly.step(&Motion { faster: 3.0, ..Motion::default() }, 0.1);
        assert!((fly.speed_m_per_s() - 2.0 * NOTCH.powi(3)).abs() < 1e-9);
        fly.step(&Motion { faster: -3.0, ..Motion::default() }, 0.1);
        assert!((fly.speed_m_per_s() - 2.0).abs() < 1e-9);
    }
}
