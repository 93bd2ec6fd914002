//! Turns input into camera motion. Pure, so that tests can drive it.
//!
//! [`keys`] names keys and [`touch`] follows fingers. [`Controls`] collects input between two frames and returns one
//! [`fly::Motion`], which moves a [`fly::Fly`].

pub mod fly;
pub mod keys;
pub mod touch;

use self::{fly::Motion, keys::Held, touch::Touches};

/// Turn of the view while the pointer moves by the window's height.
const TURN_PER_HEIGHT_RAD: f64 = 2.0;

/// Turning rate at full deflection of a stick.
const STICK_TURN_RAD_PER_S: f64 = 2.2;

/// Share of a stick's travel that counts as released.
const DEAD_ZONE: f64 = 0.15;

/// Sticks and triggers of a gamepad, each from −1 to 1; right and up are positive.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Sticks {
    /// Left stick.
    pub walk: (f64, f64),
    /// Right stick.
    pub look: (f64, f64),
    /// Right trigger minus left trigger.
    pub climb: f64,
}

/// Input that moves the camera, collected since the previous frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Controls {
    pub held: Held,
    pub touches: Touches,
    pub sticks: Sticks,
    dragging: bool,
    dragged_px: (f64, f64),
    pointer_px: Option<(f64, f64)>,
    wheel: f64,
}

impl Controls {
    /// Sets the pointer's position, in pixels from the window's upper left corner.
    pub fn pointer_at(&mut self, x: f64, y: f64) {
        if let Some((old_x, old_y)) = self.pointer_px.replace((x, y)).filter(|_| self.dragging) {
            self.dragged_px.0 += x - old_x;
            self.dragged_px.1 += y - old_y;
        }
    }

    /// Records the press or release of the button that turns the view.
    pub fn drag(&mut self, pressed: bool) {
        self.dragging = pressed;
    }

    /// Adds notches of the wheel; away from the person is positive.
    pub fn wheel(&mut self, notches: f64) {
        self.wheel += notches;
    }

    /// The window lost focus: everything held counts as released, since no release will be reported.
    pub fn let_go(&mut self) {
        *self = Self { pointer_px: self.pointer_px, ..Self::default() };
    }

    /// Returns the motion for `step_s` seconds in a window of this height, and clears what was collected.
    #[must_use]
    pub fn take(&mut self, step_s: f64, height_px: f64) -> Motion {
        let (dragged_x, dragged_y) = std::mem::take(&mut self.dragged_px);
        let (touched_x, touched_y) = self.touches.take_look_px();
        let (walk_x, walk_y) = self.touches.walk(height_px);
        let stick = |(x, y): (f64, f64)| {
            // Radial, so that slow turns are equally slow in every direction.
            let length = x.hypot(y).min(1.0);
            let scale = if length > DEAD_ZONE { (length - DEAD_ZONE) / (1.0 - DEAD_ZONE) / length } else { 0.0 };
            (x * scale, y * scale)
        };
        let (stick_x, stick_y) = stick(self.sticks.walk);
        let (look_x, look_y) = stick(self.sticks.look);
        let (climb, _) = stick((self.sticks.climb, 0.0));
        let per_px = TURN_PER_HEIGHT_RAD / height_px.max(1.0);
        Motion {
            forward: (self.held.forward() + stick_y + walk_y).clamp(-1.0, 1.0),
            right: (self.held.right() + stick_x + walk_x).clamp(-1.0, 1.0),
            up: (self.held.up() + climb).clamp(-1.0, 1.0),
            // The view follows the pointer. A finger drags the scene, so the view turns the other way.
            yaw_rad: (touched_x - dragged_x) * per_px - look_x * STICK_TURN_RAD_PER_S * step_s,
            pitch_rad: (touched_y - dragged_y) * per_px + look_y * STICK_TURN_RAD_PER_S * step_s,
            faster: std::mem::take(&mut self.wheel),
            fast: self.held.fast(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{keys::MoveKey, *};

    #[test]
    fn no_input_is_no_motion() {
        assert_eq!(Controls::default().take(0.1, 720.0), Motion::default());
    }

    #[test]
    fn keys_walk_for_as_long_as_they_are_held() {
        let mut controls = Controls::default();
        controls.held.set(MoveKey::Forward, true);
        controls.held.set(MoveKey::Left, true);
        for _ in 0..2 {
            let motion = controls.take(0.1, 720.0);
            assert_eq!((motion.forward, motion.right, motion.fast), (1.0, -1.0, false));
        }
        controls.held.set(MoveKey::Back, true);
        controls.held.set(MoveKey::Fast, true);
        let motion = controls.take(0.1, 720.0);
        assert_eq!((motion.forward, motion.fast), (0.0, true), "opposite keys cancel out");
        controls.let_go();
        assert_eq!(controls.take(0.1, 720.0), Motion::default());
    }

    #[test]
    fn the_pointer_turns_the_view_only_while_its_button_is_down() {
        let mut controls = Controls::default();
        controls.pointer_at(10.0, 10.0);
        controls.pointer_at(400.0, 10.0);
        assert_eq!(controls.take(0.1, 720.0).yaw_rad, 0.0);
        controls.drag(true);
        controls.pointer_at(400.0 - 360.0, 10.0 + 72.0);
        let motion = controls.take(0.1, 720.0);
        assert_eq!((motion.yaw_rad, motion.pitch_rad), (1.0, -0.2));
        assert_eq!(controls.take(0.1, 720.0).yaw_rad, 0.0);
        controls.drag(false);
        controls.pointer_at(0.0, 0.0);
        assert_eq!(controls.take(0.1, 720.0).yaw_rad, 0.0);
    }

    #[test]
    fn losing_focus_ends_a_drag_and_does_not_jump() {
        let mut controls = Controls::default();
        controls.pointer_at(100.0, 100.0);
        controls.drag(true);
        controls.let_go();
        controls.pointer_at(500.0, 100.0);
        assert_eq!(controls.take(0.1, 720.0), Motion::default());
    }

    #[test]
    fn sticks_turn_over_time_and_have_a_dead_zone() {
        let mut controls = Controls::default();
        controls.sticks.look = (1.0, 0.0);
        controls.sticks.walk = (0.0, -1.0);
        let motion = controls.take(0.5, 720.0);
        assert!((motion.yaw_rad + 1.1).abs() < 1e-12 && (motion.forward + 1.0).abs() < 1e-12, "{motion:?}");
        controls.sticks = Sticks { walk: (0.1, 0.1), look: (0.14, 0.0), climb: 0.1 };
        assert_eq!(controls.take(0.5, 720.0), Motion::default());
    }

    #[test]
    fn the_wheel_counts_once() {
        let mut controls = Controls::default();
        controls.wheel(1.0);
        controls.wheel(0.5);
        assert_eq!((controls.take(0.1, 720.0).faster, controls.take(0.1, 720.0).faster), (1.5, 0.0));
    }

    #[test]
    fn a_press_between_two_frames_moves_the_next_one() {
        let camera = crate::render::testing::camera(96, 54);
        let mut controls = Controls::default();
        let mut fly = fly::Fly::from_camera(&camera, 1.0);
        let before = fly.camera(96, 54);
        fly.step(&controls.take(0.016, 54.0), 0.016);
        assert_eq!(fly.camera(96, 54), before);
        controls.held.set(MoveKey::Forward, true);
        fly.step(&controls.take(0.016, 54.0), 0.016);
        assert!(fly.camera(96, 54) != before);
    }
}
