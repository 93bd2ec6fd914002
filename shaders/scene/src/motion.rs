//! Extrapolates a camera's latest poses, so that visibility can be traced for the moment that shows it.
//!
//! Times are the client's, so that uneven arrival does not matter. The camera continues in a straight line and turns
//! about a fixed axis, at its mean rates over a short window: long enough to average a hand's tremor, short enough to
//! notice that it stops.

use std::collections::VecDeque;

use glam::{DQuat, DVec3};

use crate::camera::Camera;

/// Most poses kept.
const MAX_POSES: usize = 16;

/// Window that rates are measured over, in seconds: about four frames at 60 Hz.
const WINDOW_S: f64 = 0.07;

/// Longest extrapolation, in seconds. A hand does not keep its motion for longer.
const MAX_AHEAD_S: f64 = 0.4;

/// A step between poses is a jump, and not motion, if it is longer than this many metres or turns by more than
/// [`JUMP_RAD`], and is more than [`JUMP_RATIO`] times as fast as the camera was before.
const JUMP_M: f64 = 0.5;
const JUMP_RAD: f64 = 0.35;
const JUMP_RATIO: f64 = 4.0;

/// A camera's latest poses, oldest first.
#[derive(Debug, Clone, Default)]
pub struct Motion {
    poses: VecDeque<(f64, Camera)>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Rate {
    metres_per_s: DVec3,
    /// Along the axis of rotation in world space; its length is in radians per second.
    turn_per_s: DVec3,
}

impl Motion {
    /// Adds the camera at `time_s`, unless a later one is known. A jump, a gap or a restarted clock (a difference of
    /// more than [`MAX_AHEAD_S`] either way) forgets the poses before.
    pub fn push(&mut self, time_s: f64, camera: Camera) {
        if !time_s.is_finite() {
            return;
        }
        if let Some((newest_s, newest)) = self.poses.back() {
            let step_s = time_s - newest_s;
            if step_s <= 0.0 && step_s > -MAX_AHEAD_S {
                return;
            }
            if step_s <= 0.0 || step_s > MAX_AHEAD_S || self.is_jump(newest, &camera, step_s) {
                self.poses.clear();
            }
        }
        if self.poses.len() == MAX_POSES {
            self.poses.pop_front();
        }
        self.poses.push_back((time_s, camera));
    }

    /// Returns the newest camera moved on to `time_s` at constant velocity and turning rate, by at most
    /// [`MAX_AHEAD_S`]. `None` before the first pose; the newest pose for times before it.
    #[must_use]
    pub fn extrapolate(&self, time_s: f64) -> Option<Camera> {
        let (newest_s, newest) = self.poses.back()?;
        let ahead_s = (time_s - newest_s).clamp(0.0, MAX_AHEAD_S);
        let Some(rate) = self.rate() else { return Some(*newest) };
        Some(Camera {
            position_m: newest.position_m + rate.metres_per_s * ahead_s,
            orientation: (DQuat::from_scaled_axis(rate.turn_per_s * ahead_s) * newest.orientation).normalize(),
            ..*newest
        })
    }

    /// Returns the mean rates over the window that ends at the newest pose. Over the last step if that is longer.
    fn rate(&self) -> Option<Rate> {
        let last = self.poses.len().checked_sub(1)?;
        let (to_s, to) = self.poses.get(last)?;
        let first = self.poses.iter().take(last).position(|(time_s, _)| *time_s >= to_s - WINDOW_S * 1.01);
        let (from_s, from) = self.poses.get(first.or(last.checked_sub(1))?)?;
        Some(rate_between(from, to, to_s - from_s))
    }

    fn is_jump(&self, from: &Camera, to: &Camera, step_s: f64) -> bool {
        let step = rate_between(from, to, step_s);
        let before = self.rate().unwrap_or(Rate { metres_per_s: DVec3::ZERO, turn_per_s: DVec3::ZERO });
        let far = |step: f64, before: f64, least: f64| step * step_s > least && step > JUMP_RATIO * before;
        far(step.metres_per_s.length(), before.metres_per_s.length(), JUMP_M)
            || far(step.turn_per_s.length(), before.turn_per_s.length(), JUMP_RAD)
    }
}

fn rate_between(from: &Camera, to: &Camera, step_s: f64) -> Rate {
    let mut turn = to.orientation * from.orientation.inverse();
    // Take the shorter way round.
    if turn.w < 0.0 {
        turn = -turn;
    }
    Rate { metres_per_s: (to.position_m - from.position_m) / step_s, turn_per_s: turn.to_scaled_axis() / step_s }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(position_m: DVec3, turned_rad: f64) -> Camera {
        let orientation = DQuat::from_rotation_y(turned_rad);
        Camera { position_m, orientation, yfov_rad: 1.0, width: 64, height: 36 }
    }

    /// Poses 60 times a second along this motion.
    fn followed(at: impl Fn(f64) -> Camera, frames: u32) -> Motion {
        let mut motion = Motion::default();
        for frame in 0..frames {
            let time_s = f64::from(frame) / 60.0;
            motion.push(time_s, at(time_s));
        }
        motion
    }

    fn apart(one: &Camera, other: &Camera) -> (f64, f64) {
        (one.position_m.distance(other.position_m), one.orientation.angle_between(other.orientation))
    }

    #[test]
    fn straight_lines_and_steady_turns_go_on() {
        let at = |time_s: f64| camera(DVec3::new(1e6 + 2.0 * time_s, 1.0, -time_s), 1.5 * time_s);
        let motion = followed(at, 20);
        for ahead_s in [0.0, 0.016, 0.1, 0.4] {
            let time_s = 19.0 / 60.0 + ahead_s;
            let (metres, radians) = apart(&motion.extrapolate(time_s).unwrap(), &at(time_s));
            assert!(metres < 1e-8 && radians < 1e-7, "{ahead_s}: {metres} m, {radians} rad");
        }
        assert_eq!(motion.extrapolate(0.0), Some(at(19.0 / 60.0)));
    }

    #[test]
    fn steps_longer_than_the_window_are_followed_too() {
        let at = |time_s: f64| camera(DVec3::X * time_s, 0.3 * time_s);
        let mut motion = Motion::default();
        for frame in 0..5 {
            motion.push(f64::from(frame) * 0.2, at(f64::from(frame) * 0.2));
        }
        let (metres, radians) = apart(&motion.extrapolate(1.0).unwrap(), &at(1.0));
        assert!(metres < 1e-8 && radians < 1e-7, "{metres} m, {radians} rad");
    }

    #[test]
    fn a_growing_speed_is_followed_better_than_by_the_newest_pose() {
        let at = |time_s: f64| camera(DVec3::X * (3.0 * time_s * time_s), 2.0 * time_s * time_s);
        let (newest_s, time_s) = (29.0 / 60.0, 29.0 / 60.0 + 0.1);
        let extrapolated = followed(at, 30).extrapolate(time_s).unwrap();
        assert!(apart(&extrapolated, &at(time_s)).0 < 0.5 * apart(&at(newest_s), &at(time_s)).0);
    }

    #[test]
    fn a_stop_is_noticed_within_the_window() {
        let at = |time_s: f64| camera(DVec3::X * time_s.min(0.25), 0.0);
        let (moving, stopped) = (followed(at, 15), followed(at, 21));
        assert!(moving.extrapolate(0.35).unwrap().position_m.x > 0.3);
        assert!((stopped.extrapolate(0.45).unwrap().position_m.x - 0.25).abs() < 1e-9);
    }

    #[test]
    fn a_jump_is_not_motion() {
        let mut motion = followed(|time_s| camera(DVec3::X * time_s, 0.0), 10);
        let there = camera(DVec3::new(50.0, 0.0, 0.0), 3.0);
        motion.push(10.0 / 60.0, there);
        assert_eq!(motion.extrapolate(0.3), Some(there));
        // From a standstill to a quick turn of the head is motion: 3 rad/s in steps of 1/60 s.
        let mut motion = followed(|_| camera(DVec3::ZERO, 0.0), 10);
        for frame in 1..=5 {
            motion.push(f64::from(9 + frame) / 60.0, camera(DVec3::ZERO, f64::from(frame) * 0.05));
        }
        assert!(motion.extrapolate(14.0 / 60.0 + 0.1).unwrap().orientation.to_scaled_axis().y > 0.4);
    }

    #[test]
    fn late_repeated_and_non_finite_times_are_ignored() {
        let here = camera(DVec3::ZERO, 0.0);
        let mut motion = Motion::default();
        assert_eq!(motion.extrapolate(0.0), None);
        motion.push(1.0, here);
        motion.push(1.0, camera(DVec3::X, 0.0));
        motion.push(0.9, camera(DVec3::X, 0.0));
        assert_eq!(motion.extrapolate(5.0), Some(here));
        // A client that starts anew.
        motion.push(0.1, camera(DVec3::Y, 0.0));
        assert_eq!(motion.extrapolate(0.2), Some(camera(DVec3::Y, 0.0)));
        motion.push(f64::NAN, here);
        assert!(motion.extrapolate(f64::INFINITY).is_some());
        for frame in 0..1000 {
            motion.push(f64::from(frame) * 0.01, here);
        }
        assert!(motion.poses.len() <= MAX_POSES);
    }
}
