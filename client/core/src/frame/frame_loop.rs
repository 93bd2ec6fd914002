//! The decisions of each frame, in order: request a mask, take the masks that have arrived, choose what to draw.
//!
//! The program around it supplies time and masks, sends the poses, shows the pictures and measures the stages.

use std::{sync::Arc, time::Duration};

use glam::DVec3;
use gnomon_protocol::{ids::FrameNumber, limits::MAX_LAYERS, pose::Pose};
use gnomon_scene::{Edit, SceneAt, camera::Camera};
use web_time::Instant;

use super::{
    guard::GuardChoice,
    mode::{Decision, ModeMachine, Observation, State},
    stats::{FrameStats, StageTimes, millis},
};
use crate::{
    mask::{matcher::MaskMatcher, pose_history::MaskRequest, received::ReceivedMask, world::WorldError},
    render::{FrameRenderer, RenderError, predict::MaskView},
};

/// How a client gets masks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MaskSource {
    /// There is no server.
    Offline,
    /// Each frame waits for its own mask.
    Awaited,
    /// Frames use the newest mask that has arrived. With `look_ahead`, the server predicts the pose that will be shown.
    Streamed { look_ahead: bool },
}

#[derive(Debug, Clone, Copy)]
pub struct PoseRequest {
    /// `None` if the frame needs no new mask.
    pub pose: Option<Pose>,
    pub look_ahead_ms: u16,
}

/// What a frame draws.
#[derive(Debug, Clone)]
pub struct Drawing {
    pub camera: Camera,
    pub scene: SceneAt,
    pub decision: Decision,
}

/// Makes the decisions of each frame, and owns the renderer.
///
/// An application that moves things itself hands their transforms over before each frame:
///
/// ```
/// use gnomon_client_core::{frame::frame_loop::FrameLoop, mask::world::WorldError};
/// use gnomon_scene::{Edit, NodeEdit};
///
/// /// `door` is the number of a node that may be edited: its place in `scene.animation`'s nodes.
/// fn turn(frames: &mut FrameLoop, door: u32, angle_rad: f64) -> Result<(), WorldError> {
///     let rotation = Some(glam::DQuat::from_rotation_y(angle_rad));
///     frames.edit(&[Edit::Node(door, NodeEdit { rotation, ..NodeEdit::default() })])
/// }
/// ```
#[derive(Debug)]
pub struct FrameLoop {
    pub renderer: FrameRenderer,
    pub machine: ModeMachine,
    pub guard: GuardChoice,
    pub matcher: MaskMatcher,
    source: MaskSource,
    started: Instant,
    /// The previous frame's camera and start.
    previous: Option<(Camera, Instant)>,
    state: Option<State>,
}

impl FrameLoop {
    #[must_use]
    pub fn new(
        renderer: FrameRenderer,
        machine: ModeMachine,
        guard: GuardChoice,
        source: MaskSource,
        now: Instant,
    ) -> Self {
        let matcher = MaskMatcher::new(renderer.moves());
        Self { renderer, machine, guard, matcher, source, started: now, previous: None, state: None }
    }

    /// When the first frame began.
    #[must_use]
    pub fn started(&self) -> Instant {
        self.started
    }

    #[must_use]
    pub fn source(&self) -> MaskSource {
        self.source
    }

    /// Takes the newest masks from now on, instead of waiting for each frame's own.
    pub fn stream(&mut self, look_ahead: bool) {
        self.source = MaskSource::Streamed { look_ahead };
    }

    /// Sets the start from which [`FrameStats::t_ms`] and [`Pose::client_time_ms`] count.
    pub fn restart(&mut self, now: Instant) {
        self.started = now;
    }

    /// Draws with another scene's renderer from `frame` on, without the masks so far.
    pub fn change_scene(&mut self, frame: FrameNumber, renderer: FrameRenderer) {
        self.renderer = renderer;
        self.matcher.scene_changed(frame, self.renderer.moves());
    }

    /// Changes nodes and lights from the next frame on. An edit replaces what was said of its node or light before.
    ///
    /// # Errors
    /// If the server does not let this client edit.
    pub fn edit(&mut self, edits: &[Edit]) -> Result<(), WorldError> {
        self.matcher.world.edit(edits)
    }

    /// Remembers the frame and decides whether it needs a new mask. `scene_time_s` is the scene's time, in seconds,
    /// unless the server's clock gives it; `connected` is false while no mask can arrive.
    pub fn request(
        &mut self,
        frame: FrameNumber,
        camera: &Camera,
        scene_time_s: f64,
        now: Instant,
        connected: bool,
    ) -> PoseRequest {
        let turn_px = self.previous.map_or((0.0, 0.0), |(previous, _)| turn_px(&previous, camera));
        let lag = self.matcher.current().map_or(0, |current| current.lag(frame));
        let wide = camera.widened(self.guard.next(f64::from(lag), turn_px).per_side());
        // In sequential mode a mask is shown with its own frame, so it must be traced for exactly that pose.
        let looks_ahead =
            self.source == MaskSource::Streamed { look_ahead: true } && self.state != Some(State::Sequential);
        let look_ahead_ms = if looks_ahead { self.matcher.look_ahead_ms() } else { 0 };
        // Wraps after 49 days, as documented at the field.
        #[expect(clippy::cast_possible_truncation, reason = "milliseconds modulo 2³²")]
        let client_time_ms = now.duration_since(self.started).as_millis() as u32;
        let (now_s, world) = (self.matcher.world.scene_time_s(now), &self.matcher.world);
        let scene = SceneAt { time_s: now_s.unwrap_or(scene_time_s), edits: Arc::clone(world.drawn()) };
        let pose = Pose {
            position_m: wide.position_m.to_array(),
            orientation: wide.orientation.to_array(),
            yfov_rad: wide.yfov_rad,
            scene_time_s: scene.time_s,
            client_time_ms,
            // Sides are at most 4096.
            mask_px: [wide.width, wide.height].map(|side| u16::try_from(side).unwrap_or(u16::MAX)),
            look_ahead_ms,
            revision: world.revision(),
        };
        let view = self.matcher.viewpoint(wide, &scene);
        let needed = connected && self.matcher.should_request(frame, &view, now);
        let sends = match self.source {
            MaskSource::Offline => false,
            MaskSource::Awaited => true,
            MaskSource::Streamed { .. } => needed,
        };
        let sent_at = sends.then_some(now);
        self.matcher.insert(MaskRequest {
            frame,
            begun: now,
            camera: *camera,
            mask_camera: wide,
            scene,
            pose,
            sent_at,
        });
        PoseRequest { pose: sends.then_some(pose), look_ahead_ms }
    }

    /// Lets the renderer show what the frame, which was requested, shows of the scene.
    pub fn show_requested(&mut self, frame: FrameNumber) {
        if let Some(request) = self.matcher.request(frame) {
            self.renderer.set_time(&request.scene);
        }
    }

    /// Passes those of `masks` that answer a request to the renderer, oldest first. Returns the newest response time.
    ///
    /// # Errors
    /// If the adapter failed.
    pub fn accept_masks<'a>(
        &mut self,
        masks: impl Iterator<Item = &'a ReceivedMask>,
        shown_at: Instant,
    ) -> Result<Option<Duration>, RenderError> {
        let mut response = None;
        for mask in masks {
            let Some(matched) = self.matcher.accept(mask, shown_at) else { continue };
            let used = self.renderer.set_mask(Some(MaskView {
                mask: &mask.mask,
                coverage: Some(&mask.coverage),
                more: matched.more,
                traced_for: &matched.traced_for.camera,
                scene: &matched.traced_for.scene,
            }))?;
            if used {
                response = matched.response;
            } else {
                tracing::debug!(frame = mask.frame.0, "the renderer cannot use the mask");
                self.matcher.refused();
                response = None;
            }
        }
        Ok(response)
    }

    /// Chooses the camera to draw from, at which time of the scene, and the weight of received visibility. The frame
    /// was requested.
    pub fn choose(&mut self, frame: FrameNumber, camera: &Camera, now: Instant) -> Drawing {
        let scene = self.matcher.request(frame).map(|request| request.scene.clone()).unwrap_or_default();
        let previous = self.previous.replace((*camera, now));
        if !matches!(self.source, MaskSource::Streamed { .. }) {
            let decision = Decision { state: State::Concurrent, visibility_share: 1.0 };
            return Drawing { camera: *camera, scene, decision };
        }
        let current = self.matcher.current();
        let step_s = previous.map_or(0.0, |(_, previous)| now.duration_since(previous).as_secs_f64());
        let lag = current.map(|current| current.lag(frame));
        let jumped = current.is_some_and(|current| has_jumped(&current.request.camera, camera, lag.unwrap_or(0)));
        let age_s = current.map_or(0.0, |current| current.age(now).as_secs_f64());
        let decision = self.machine.step(Observation { lag, age_s, jumped, step_s });
        if self.state.replace(decision.state) != Some(decision.state) {
            match decision.state {
                State::Degraded => tracing::warn!(frame = frame.0, ?lag, "degraded: visibility is too late"),
                state => tracing::info!(frame = frame.0, ?lag, ?state, "visibility"),
            }
        }
        let (camera, scene) = match (decision.state, current) {
            (State::Sequential, Some(current)) => (current.request.camera, current.request.scene.clone()),
            _ => (*camera, scene),
        };
        Drawing { camera, scene, decision }
    }

    /// Returns the statistics of a frame that was shown.
    pub fn stats(
        &mut self,
        frame: FrameNumber,
        begun: Instant,
        (drawing, look_ahead_ms, response): (&Drawing, u16, Option<Duration>),
        times: &StageTimes,
        link: &'static str,
    ) -> FrameStats {
        let known_share = self.renderer.known_share();
        let current = self.matcher.current();
        let [mask_width, mask_height] = self.matcher.request(frame).map_or([0, 0], |request| request.pose.mask_px);
        FrameStats {
            frame: frame.0,
            t_ms: millis(begun.duration_since(self.started)),
            state: drawing.decision.state,
            link,
            visibility_share: drawing.decision.visibility_share,
            known_share,
            mask_frame: current.map(|current| current.request.frame.0),
            lag: current.map(|current| current.lag(frame)),
            age_ms: current.map(|current| millis(current.age(begun))),
            mask_width,
            mask_height,
            look_ahead_ms,
            response_ms: response.map(millis),
            surfaces_ms: millis(times.surfaces),
            wait_ms: millis(times.wait),
            upload_ms: millis(times.upload),
            shade_ms: millis(times.shade),
            readback_ms: millis(times.readback),
            bytes: current.map(|current| current.bytes),
            packets: current.map(|current| current.packets),
        }
    }

    /// Returns the age in frames of the renderer's masks when `frame` was drawn, newest first.
    #[must_use]
    pub fn mask_lags(&self, frame: FrameNumber) -> [u32; MAX_LAYERS] {
        match self.source {
            MaskSource::Offline => [0; MAX_LAYERS],
            _ => self.matcher.lags(frame, self.renderer.mask_views()),
        }
    }
}

/// Returns how many pixels the picture's centre moves, right and up, when the camera turns from `before` to `now`.
fn turn_px(before: &Camera, now: &Camera) -> (f64, f64) {
    let forward = before.orientation.inverse() * (now.orientation * DVec3::NEG_Z);
    let (half_width, half_height) = now.half_extent();
    // A turn by more than 90° is beyond any guard band.
    let depth = (-forward.z).max(1e-3);
    let px = |along: f64, half: f64, side: u32| along / depth / half * f64::from(side) * 0.5;
    (px(forward.x, half_width, now.width), px(forward.y, half_height, now.height))
}

/// Camera motion per frame above which it counts as a jump, in metres.
const JUMP_M: f64 = 0.5;

/// Returns whether the camera turned or moved so far in `lag` frames that almost no visibility can be carried over.
fn has_jumped(then: &Camera, now: &Camera, lag: u32) -> bool {
    let frames = f64::from(lag.max(1));
    then.orientation.angle_between(now.orientation) > now.yfov_rad
        || then.position_m.distance(now.position_m) > JUMP_M * frames
}

#[cfg(test)]
#[expect(clippy::disallowed_methods, reason = "tests have a clock")]
mod tests {
    use glam::DQuat;
    use gnomon_protocol::mask::MaskShape;

    use super::*;
    use crate::{
        frame::{
            guard::{Guard, GuardSize},
            mode::{Mode, Thresholds},
        },
        render::testing,
    };

    fn camera(position_m: DVec3, yaw: f64, pitch: f64) -> Camera {
        let orientation = DQuat::from_rotation_y(yaw) * DQuat::from_rotation_x(pitch);
        Camera { position_m, orientation, yfov_rad: 1.0, width: 1920, height: 1080 }
    }

    #[test]
    fn a_turn_is_measured_in_pixels() {
        let here = camera(DVec3::ZERO, 0.3, 0.0);
        assert_eq!(turn_px(&here, &here), (0.0, 0.0));
        let half_height = 0.5_f64.tan();
        let (x, y) = turn_px(&here, &camera(DVec3::X, 0.3 - 0.01, 0.0));
        assert!((x - 0.01_f64.tan() / half_height * 540.0).abs() < 1e-6 && y.abs() < 1e-9, "{x} {y}");
        let (x, y) = turn_px(&here, &camera(DVec3::ZERO, 0.3, 0.02));
        assert!((y - 0.02_f64.tan() / half_height * 540.0).abs() < 1e-6 && x.abs() < 1e-9, "{x} {y}");
        assert!(turn_px(&here, &camera(DVec3::ZERO, 2.3, 0.0)).0.is_finite());
    }

    #[test]
    fn a_jump_is_a_large_turn_or_a_fast_move() {
        let here = camera(DVec3::ZERO, 0.0, 0.0);
        for (there, lag, jumped) in [
            (camera(DVec3::X * 0.4, 0.9, 0.0), 1, false),
            (camera(DVec3::X * 0.6, 0.0, 0.0), 1, true),
            (camera(DVec3::X * 0.6, 0.0, 0.0), 2, false),
            (camera(DVec3::ZERO, 1.1, 0.0), 50, true),
        ] {
            assert_eq!(has_jumped(&here, &there, lag), jumped, "{there:?}");
        }
    }

    #[test]
    fn only_masks_that_the_renderer_uses_count() {
        let (gpu, scene) = (testing::gpu(), testing::floor_and_lights());
        let shape = |lights| MaskShape::new(16, 16, lights).unwrap();
        let fresh = || testing::renderer(&gpu, &scene, shape(2));
        let (machine, no_band) =
            (ModeMachine::new(Mode::Auto, Thresholds::default()), GuardSize { width: 0, height: 0 });
        let guard = GuardChoice::new(Guard::Fixed(no_band), (16, 16));
        let (source, now) = (MaskSource::Streamed { look_ahead: false }, Instant::now());
        let mut frames = FrameLoop::new(fresh(), machine, guard, source, now);
        // Each frame has another view, so each is requested.
        let view = |frame: u32| {
            let camera = testing::camera(16, 16);
            Camera { position_m: camera.position_m + DVec3::X * 0.01 * f64::from(frame), ..camera }
        };
        let answer = |frames: &mut FrameLoop, frame: u32, lights: u32| {
            let (camera, number) = (view(frame), FrameNumber(frame));
            assert!(frames.request(number, &camera, 0.0, now, true).pose.is_some());
            let mask = ReceivedMask { frame: number, ..ReceivedMask::blank(shape(lights), now) };
            let taken = frames.accept_masks([mask].iter(), now).unwrap().is_some();
            let lag = frames.matcher.current().map(|current| current.lag(number));
            (taken, lag, frames.choose(number, &camera, now).decision.state)
        };
        assert_eq!(answer(&mut frames, 0, 2), (true, Some(0), State::Concurrent));
        // The scene has two lights, and the renderer drops its masks.
        assert_eq!(answer(&mut frames, 1, 3), (false, None, State::Degraded));
        assert_eq!((frames.matcher.rejections().wrong_size, frames.renderer.mask_views().count()), (1, 0));
        assert_eq!(answer(&mut frames, 2, 2), (true, Some(0), State::Concurrent));
        // Another scene's renderer takes no mask of the old one.
        frames.change_scene(FrameNumber(3), fresh());
        assert!(frames.matcher.current().is_none());
        let old = ReceivedMask { frame: FrameNumber(2), ..ReceivedMask::blank(shape(2), now) };
        assert_eq!(frames.accept_masks([old].iter(), now).unwrap(), None);
        assert_eq!(frames.matcher.rejections().before_reconnect, 1);
        assert_eq!(answer(&mut frames, 3, 2), (true, Some(0), State::Concurrent));
    }

    #[test]
    fn a_still_camera_asks_for_masks_while_the_scene_moves() {
        let gpu = testing::gpu();
        let shape = MaskShape::new(16, 16, 2).unwrap();
        let mut living = testing::floor_and_lights();
        let intensity_track = Some(gnomon_scene::Track {
            period_s: 2.0,
            interpolation: gnomon_scene::Interpolation::Linear,
            times_s: vec![0.0, 2.0],
            values: vec![1.0, 9.0],
        });
        let lamp = gnomon_scene::AnimatedLight { light: 1, intensity_track, ..Default::default() };
        let animation = gnomon_scene::Animation { lights: vec![lamp], ..Default::default() };
        living.animation = Some(Box::new(animation));
        // One that nothing moves in but a camera.
        let mut filmed = testing::floor_and_lights();
        let camera = gnomon_scene::AnimatedCamera { camera: 0, place: None, yfov_track: None };
        let animation = gnomon_scene::Animation { cameras: vec![camera], ..Default::default() };
        filmed.animation = Some(Box::new(animation));
        for (scene, moves) in [(testing::floor_and_lights(), false), (living, true), (filmed, false)] {
            let machine = ModeMachine::new(Mode::Auto, Thresholds::default());
            let guard = GuardChoice::new(Guard::Fixed(GuardSize { width: 0, height: 0 }), (16, 16));
            let (source, now) = (MaskSource::Streamed { look_ahead: false }, Instant::now());
            let renderer = testing::renderer(&gpu, &scene, shape);
            assert_eq!(renderer.moves(), moves);
            let mut frames = FrameLoop::new(renderer, machine, guard, source, now);
            let camera = testing::camera(16, 16);
            // The scene's time of each frame: it stands still in between.
            let asked = [0.0, 0.1, 0.2, 0.2, 0.2, 0.3].map(|scene_time_s| {
                let number = FrameNumber(frames.matcher.current().map_or(0, |current| current.request.frame.0 + 1));
                let asks = frames.request(number, &camera, scene_time_s, now, true).pose.is_some();
                if asks {
                    let mask = ReceivedMask { frame: number, ..ReceivedMask::blank(shape, now) };
                    frames.accept_masks([mask].iter(), now).unwrap();
                    assert_eq!(frames.choose(number, &camera, now).scene, scene_time_s.into());
                    assert_eq!(frames.mask_lags(number), [0; MAX_LAYERS]);
                }
                asks
            });
            let expected =
                if moves { [true, true, true, false, false, true] } else { [true, false, false, false, false, false] };
            assert_eq!(asked, expected, "moves: {moves}");
        }
    }
}
