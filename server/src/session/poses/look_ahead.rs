//! Predicts where a client's camera will be when its mask is shown, and what moves in the scene.
//!
//! The client measures the time from pose to screen, since only it sees the whole path, and sends it as
//! `look_ahead_ms`. The server extrapolates the camera's motion by it, and traces the mask there, at the time that the
//! scene will have reached.

use gnomon_protocol::pose::Pose;
use gnomon_scene::{camera::Camera, motion::Motion};

use super::client_clock::ClientClock;

/// Motion too small for any pixel to show, in metres and in radians.
const STANDS_STILL: f64 = 1e-6;

#[derive(Debug, Default)]
pub(super) struct LookAhead {
    motion: Motion,
    clock: ClientClock,
    scene_moves: bool,
}

impl LookAhead {
    /// For a scene in which something moves, or nothing.
    pub(super) fn new(scene_moves: bool) -> Self {
        Self { scene_moves, ..Self::default() }
    }

    /// Returns the pose to trace instead of `pose`, the client's newest. `None` if camera and scene stand still or the
    /// client requests no prediction.
    pub(super) fn predict(&mut self, pose: &Pose) -> Option<Pose> {
        let time_s = self.clock.seconds(pose.client_time_ms);
        let now = pose_camera(pose);
        self.motion.push(time_s, now);
        let then_s = time_s + f64::from(pose.look_ahead_ms) * 1e-3;
        let then = self.motion.extrapolate(then_s)?;
        let stays = then.position_m.distance(now.position_m) < STANDS_STILL
            && then.orientation.angle_between(now.orientation) < STANDS_STILL;
        if pose.look_ahead_ms == 0 || stays && !self.scene_moves {
            return None;
        }
        let mut predicted = Pose { scene_time_s: pose.scene_time_s + f64::from(pose.look_ahead_ms) * 1e-3, ..*pose };
        if !stays {
            predicted.position_m = then.position_m.to_array();
            predicted.orientation = then.orientation.to_array();
        }
        // If the prediction leaves the world's limits, trace the client's own pose.
        predicted.validate().ok().map(|()| predicted)
    }
}

pub(super) fn pose_camera(pose: &Pose) -> Camera {
    Camera::of_pose(pose.position_m, pose.orientation, pose.yfov_rad, pose.mask_px)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(x: f64, client_time_ms: u32, look_ahead_ms: u16) -> Pose {
        Pose {
            position_m: [x, 0.0, 0.0],
            orientation: [0.0, 0.0, 0.0, 1.0],
            yfov_rad: 1.0,
            scene_time_s: 0.0,
            client_time_ms,
            mask_px: [64, 36],
            look_ahead_ms,
            revision: 0,
        }
    }

    #[test]
    fn a_moving_camera_is_traced_where_it_will_be() {
        let mut look_ahead = LookAhead::default();
        for frame in 0..10_u32 {
            // One metre per second. The clock wraps on the way.
            let time_ms = u32::MAX.wrapping_sub(80).wrapping_add(frame * 16);
            let found = look_ahead.predict(&pose(f64::from(frame) * 0.016, time_ms, 100));
            if frame > 0 {
                let found = found.unwrap();
                assert!((found.position_m[0] - f64::from(frame) * 0.016 - 0.1).abs() < 1e-7, "{found:?}");
                assert_eq!((found.client_time_ms, found.mask_px), (time_ms, [64, 36]));
            }
        }
        // The client requested no prediction.
        assert_eq!(look_ahead.predict(&pose(0.16, u32::MAX.wrapping_sub(80).wrapping_add(160), 0)), None);
        let mut still = LookAhead::default();
        assert!((0..5_u32).all(|frame| still.predict(&pose(1.0, frame * 16, 100)).is_none()));
        // Whatever the camera does, a moving scene is traced as it will be.
        let (mut living, here) = (LookAhead::new(true), pose(1.0, 16, 100));
        let found = living.predict(&here).unwrap();
        assert_eq!(found, Pose { scene_time_s: here.scene_time_s + 0.1, ..here });
        assert_eq!(living.predict(&pose(1.0, 32, 0)), None);
    }

    #[test]
    fn no_camera_is_predicted_outside_the_world() {
        let mut look_ahead = LookAhead::default();
        let edge = gnomon_protocol::limits::MAX_POSITION_M;
        look_ahead.predict(&pose(edge - 0.02, 0, 1000));
        assert_eq!(look_ahead.predict(&pose(edge - 0.01, 10, 1000)), None);
    }
}
