//! One frame after the other: pose out, surfaces, mask in, shading, picture shown.
//!
//! A headless run and a window share all of it. They differ in where poses come from, which they pass to [`FrameLoop::draw`], and in
//! where pictures go, which is a [`Sink`].

use std::time::{Duration, Instant};

use glam::DVec3;
use gnomon_protocol::{ids::FrameNumber, limits::MAX_LAYERS, pose::Pose};
use gnomon_scene::camera::Camera;

use crate::{
    error::ClientError,
    guard::GuardChoice,
    headless::stats::{FrameStats, millis},
    link::receive::Received,
    live::{Live, Taken, view_of},
    mode::{Decision, ModeMachine, Observation, State},
    pose_history::{Asked, PoseHistory, Rejections},
    record::{Record, Recorder},
    render::FrameRenderer,
};

/// Where pictures go.
pub(crate) trait Sink {
    /// Shades the surfaces that `renderer` has drawn for `camera` ([`FrameRenderer::shade`]) and shows the picture.
    fn show(
        &mut self,
        frame: FrameNumber,
        renderer: &mut FrameRenderer,
        camera: &Camera,
        visibility_share: f32,
    ) -> Result<Shown, ClientError>;
}

/// What showing a picture took.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Shown {
    /// Handing over the passes.
    pub(crate) shade: Duration,
    /// Waiting for the adapter, or for the screen.
    pub(crate) readback: Duration,
}

/// Everything that frames need.
pub(crate) struct FrameLoop {
    pub(crate) renderer: FrameRenderer,
    pub(crate) live: Option<Live>,
    pub(crate) wait: bool,
    pub(crate) predict_pose: bool,
    pub(crate) machine: ModeMachine,
    pub(crate) guard: GuardChoice,
    pub(crate) recorder: Option<Recorder>,
    pub(crate) memory: Memory,
}

/// What the server's end came to, at the end.
#[derive(Debug, Default)]
pub(crate) struct Served {
    pub(crate) poses_repeated: u32,
    pub(crate) received: Received,
    pub(crate) rejections: Rejections,
    pub(crate) round_trip: Option<Duration>,
    /// Why the server was lost on the way, the first time.
    pub(crate) lost: Option<String>,
    /// How often a server was found again.
    pub(crate) reconnects: u32,
}

/// What the loop remembers from frame to frame.
pub(crate) struct Memory {
    pub(crate) started: Instant,
    history: PoseHistory,
    /// The frame before: its camera, and when it began.
    before: Option<(Camera, Instant)>,
    state: Option<State>,
    /// Frames drawn.
    frames: u32,
    /// Frames that shall be drawn, where that is known.
    wanted: u32,
    lost: Option<String>,
    /// How it stood with the server when that was written down last.
    link: Option<&'static str>,
}

impl Memory {
    /// Before the first of `wanted` frames.
    pub(crate) fn new(wanted: u32) -> Self {
        Self {
            started: Instant::now(),
            history: PoseHistory::default(),
            before: None,
            state: None,
            frames: 0,
            wanted,
            lost: None,
            link: None,
        }
    }
}

impl FrameLoop {
    /// Frames that the masks were older than the last picture that was drawn, the newest first.
    pub(crate) fn mask_lags(&self) -> [u32; MAX_LAYERS] {
        let frame = FrameNumber(self.memory.frames.saturating_sub(1));
        self.live.as_ref().map_or([0; MAX_LAYERS], |live| live.lags(frame, self.renderer.mask_views()))
    }

    /// Leaves the server, and says how it was.
    pub(crate) fn leave(&mut self) -> Served {
        let mut served = Served { lost: self.memory.lost.take(), ..Served::default() };
        if let Some(live) = self.live.take() {
            served.received = live.received();
            served.reconnects = live.reconnects;
            let Live { runtime, session, masks, rejections, poses_repeated, .. } = live;
            served.rejections = rejections;
            // Most are found out before a mask is made of them.
            served.rejections.future += served.received.future;
            served.poses_repeated = poses_repeated;
            served.round_trip = session.round_trip();
            drop(masks);
            runtime.block_on(session.leave());
        }
        served
    }

    /// Draws a frame that is looked at from `camera`, at `scene_time_s`, into `sink`. Frames are numbered in their order.
    pub(crate) fn draw(
        &mut self,
        frame: FrameNumber,
        camera: Camera,
        scene_time_s: f64,
        sink: &mut dyn Sink,
    ) -> Result<FrameStats, ClientError> {
        let begun = Instant::now();
        let mut clock = Clock(begun);
        let look_ahead_ms = self.ask(frame, &camera, scene_time_s, begun);
        let (mut surfaces, mut wait) = (Duration::ZERO, Duration::ZERO);
        if self.wait {
            // The surfaces are drawn while the mask is on its way.
            self.renderer.draw_surfaces(&camera)?;
            surfaces = clock.lap();
            if let Some(live) = &mut self.live {
                let (rendered, wanted) = (self.memory.frames, self.memory.wanted);
                live.wait_for(frame, &self.memory.history, |reason| ClientError::Ended { rendered, wanted, reason })?;
            }
            wait = clock.lap();
        }
        let taken = self.take_mask(begun)?;
        self.record_masks(&taken)?;
        let _upload = clock.lap();
        let (shown, decision) = self.decide(frame, &camera, begun);
        if !self.wait {
            self.renderer.draw_surfaces(&shown)?;
            surfaces = clock.lap();
        }
        let Shown { shade, readback } = sink.show(frame, &mut self.renderer, &shown, decision.visibility_share)?;

        let known_share = self.renderer.known_share();
        let current = self.live.as_ref().and_then(|live| live.current);
        let lag = current.map(|current| current.lag(frame));
        let response_ms = taken.response.map(millis);
        self.memory.frames += 1;
        let [mask_width, mask_height] = self.memory.history.get(frame).map_or([0, 0], |asked| asked.pose.mask_px);
        let stats = FrameStats {
            frame: frame.0,
            t_ms: millis(begun.duration_since(self.memory.started)),
            state: decision.state,
            link: self.live.as_ref().map_or("offline", |live| live.link_state().name()),
            visibility_share: decision.visibility_share,
            known_share,
            mask_frame: current.map(|current| current.asked.frame.0),
            lag,
            mask_width,
            mask_height,
            look_ahead_ms,
            response_ms,
            surfaces_ms: millis(surfaces),
            wait_ms: millis(wait),
            upload_ms: millis(taken.upload),
            shade_ms: millis(shade),
            readback_ms: millis(readback),
            bytes: current.map(|current| current.bytes),
            packets: current.map(|current| current.packets),
        };
        if let Some(recorder) = &mut self.recorder {
            recorder.write(&Record::Frame {
                frame: frame.0,
                requested: (&camera).into(),
                shown: (&shown).into(),
                visibility_share: decision.visibility_share,
                timing: (&stats).into(),
            })?;
        }
        self.record_link(stats.link)?;
        Ok(stats)
    }

    /// Writes down how it stands with the server, when that has changed.
    fn record_link(&mut self, link: &'static str) -> Result<(), ClientError> {
        let (Some(recorder), Some(live)) = (&mut self.recorder, &self.live) else { return Ok(()) };
        if self.memory.link.replace(link) == Some(link) {
            return Ok(());
        }
        let message = live.link_state().message(Instant::now());
        let text = message.map_or_else(|| link.to_owned(), |message| format!("{link}: {message}"));
        recorder.write(&Record::Event { frame: self.memory.frames - 1, text })
    }

    /// Writes down the masks that the renderer has just been given.
    fn record_masks(&mut self, taken: &Taken) -> Result<(), ClientError> {
        let (Some(recorder), Some(live), Some(_)) = (&mut self.recorder, &self.live, taken.response) else {
            return Ok(());
        };
        for received in live.masks.taken() {
            if let Ok((_, traced_for)) = view_of(received, &self.memory.history) {
                recorder.write_mask(received.frame.0, &traced_for, (&received.mask, &received.coverage))?;
            }
        }
        Ok(())
    }

    /// Remembers a frame, and asks the server for its mask. How far ahead that is wanted is the answer, in milliseconds.
    fn ask(&mut self, frame: FrameNumber, camera: &Camera, scene_time_s: f64, begun: Instant) -> u16 {
        let memory = &mut self.memory;
        if let Some(live) = self.live.as_mut().filter(|_| !self.wait) {
            live.tend(frame, &mut memory.history);
        }
        let turn_px = memory.before.map_or((0.0, 0.0), |(before, _)| turn_px(&before, camera));
        let current = self.live.as_ref().and_then(|live| live.current);
        let lag = current.map_or(0, |current| current.lag(frame));
        let wide = camera.widened(self.guard.next(f64::from(lag), turn_px).per_side());
        // A mask that is shown with its own frame is wanted for exactly that.
        let looks_ahead = self.predict_pose && !self.wait && memory.state != Some(State::Sequential);
        let look_ahead_ms = self.live.as_ref().filter(|_| looks_ahead).map_or(0, Live::look_ahead_ms);
        // It wraps after 49 days, as the pose says.
        #[expect(clippy::cast_possible_truncation, reason = "milliseconds modulo 2³²")]
        let client_time_ms = begun.duration_since(memory.started).as_millis() as u32;
        let pose = Pose {
            position_m: wide.position_m.to_array(),
            orientation: wide.orientation.to_array(),
            yfov_rad: wide.yfov_rad,
            scene_time_s,
            client_time_ms,
            // Sides are at most 4096.
            mask_px: [wide.width, wide.height].map(|side| u16::try_from(side).unwrap_or(u16::MAX)),
            look_ahead_ms,
        };
        let wait = self.wait;
        let sent_at = self.live.as_mut().and_then(|live| {
            let ask = live.should_ask(frame, &wide, begun) || wait;
            ask.then(|| {
                live.session.send_pose(frame, pose);
                begun
            })
        });
        memory.history.remember(Asked { frame, camera: *camera, mask_camera: wide, pose, sent_at });
        look_ahead_ms
    }

    /// Gives the renderer the mask that has come. A server that is gone ends a run that waits, or that it never answered;
    /// others go on with what they have, and look for it.
    fn take_mask(&mut self, shown_at: Instant) -> Result<Taken, ClientError> {
        let memory = &mut self.memory;
        let Some(live) = &mut self.live else { return Ok(Taken::default()) };
        let taken = if self.wait {
            live.take_front(&memory.history, &mut self.renderer, shown_at)?
        } else {
            live.take_newest(&memory.history, &mut self.renderer, shown_at)?
        };
        if let Some(reason) = live.masks.ended().filter(|_| !self.wait && memory.lost.is_none()) {
            if live.current.is_none() {
                return Err(ClientError::Ended { rendered: memory.frames, wanted: memory.wanted, reason });
            }
            tracing::warn!(%reason, "the server is gone: drawing on without it");
            memory.lost = Some(reason);
        }
        Ok(taken)
    }

    /// What is drawn in this frame: from where, and with how much received visibility.
    fn decide(&mut self, frame: FrameNumber, camera: &Camera, begun: Instant) -> (Camera, Decision) {
        let memory = &mut self.memory;
        let current = self.live.as_ref().and_then(|live| live.current);
        let step_s = memory.before.map_or(0.0, |(_, before)| begun.duration_since(before).as_secs_f64());
        memory.before = Some((*camera, begun));
        if self.wait || self.live.is_none() {
            return (*camera, Decision { state: State::Concurrent, visibility_share: 1.0 });
        }
        let lag = current.map(|current| current.lag(frame));
        let jumped = current.is_some_and(|current| has_jumped(&current.asked.camera, camera, lag.unwrap_or(0)));
        let decision = self.machine.step(Observation { lag, jumped, step_s });
        if memory.state.replace(decision.state) != Some(decision.state) {
            match decision.state {
                State::Degraded => tracing::warn!(frame = frame.0, ?lag, "degraded: visibility is too late"),
                state => tracing::info!(frame = frame.0, ?lag, ?state, "visibility"),
            }
        }
        let shown = match (decision.state, current) {
            (State::Sequential, Some(current)) => current.asked.camera,
            _ => *camera,
        };
        (shown, decision)
    }
}

/// By how many pixels the middle of the picture moves when the camera turns from `before` to `now`, across and up.
fn turn_px(before: &Camera, now: &Camera) -> (f64, f64) {
    let forward = before.orientation.inverse() * (now.orientation * DVec3::NEG_Z);
    let (half_width, half_height) = now.half_extent();
    // A turn of more than a quarter is beyond any guard band.
    let depth = (-forward.z).max(1e-3);
    let px = |along: f64, half: f64, side: u32| along / depth / half * f64::from(side) * 0.5;
    (px(forward.x, half_width, now.width), px(forward.y, half_height, now.height))
}

/// Farthest that a camera moves in a frame without having jumped, in metres.
const JUMP_M: f64 = 0.5;

/// Whether the camera has jumped since `then`, so that next to nothing can be carried over: it looks elsewhere, or is too far away.
fn has_jumped(then: &Camera, now: &Camera, lag: u32) -> bool {
    let frames = f64::from(lag.max(1));
    then.orientation.angle_between(now.orientation) > now.yfov_rad
        || then.position_m.distance(now.position_m) > JUMP_M * frames
}

/// Time by stage.
struct Clock(Instant);

impl Clock {
    /// Time since the last lap.
    fn lap(&mut self) -> Duration {
        let now = Instant::now();
        let lap = now.duration_since(self.0);
        self.0 = now;
        lap
    }
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;

    fn camera(position_m: DVec3, yaw: f64, pitch: f64) -> Camera {
        let orientation = DQuat::from_rotation_y(yaw) * DQuat::from_rotation_x(pitch);
        Camera { position_m, orientation, yfov_rad: 1.0, width: 1920, height: 1080 }
    }

    #[test]
    fn turning_is_measured_in_pixels() {
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
    fn a_jump_is_a_great_turn_or_a_long_way_in_a_short_time() {
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
}
