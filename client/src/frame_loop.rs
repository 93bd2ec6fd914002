//! The frames of a headless run, one after the other: pose out, surfaces, mask in, shading, picture to disk.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use gnomon_protocol::{ids::FrameNumber, pose::Pose};
use gnomon_shaders::camera::Camera;
use tokio::runtime::Runtime;

use crate::{
    camera_path::CameraPath,
    error::ClientError,
    mask_buffer::{MaskReader, ReceivedMask, Waited},
    net::{receive::Received, session::Session},
    pictures::PictureWriter,
    pose_history::PoseHistory,
    progress::Progress,
    render::{FrameRenderer, predict::MaskView, readback::PictureReader},
    stats::{FrameStats, StatsFile, millis},
};

/// How long the first mask may take before its pose is sent again: the server may still warm up.
const FIRST_RESPONSE: Duration = Duration::from_secs(2);

/// Least time before a pose is sent again.
const LEAST_PATIENCE: Duration = Duration::from_millis(250);

/// How long one frame is waited for in all.
const GIVE_UP: Duration = Duration::from_secs(120);

/// When frames are, and where on the path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Timing {
    pub(crate) frames: u32,
    pub(crate) start_s: f64,
    pub(crate) step_s: f64,
    /// Whether a step also takes that long.
    pub(crate) paced: bool,
}

impl Timing {
    /// Where on the path the frame is, in seconds.
    pub(crate) fn time_s(&self, frame: u32) -> f64 {
        self.start_s + f64::from(frame) * self.step_s
    }
}

/// A server that masks come from.
pub(crate) struct Live {
    pub(crate) runtime: Arc<Runtime>,
    pub(crate) session: Session,
    pub(crate) masks: MaskReader,
}

/// Everything that frames need.
pub(crate) struct FrameLoop<'a> {
    pub(crate) renderer: FrameRenderer,
    pub(crate) picture_reader: PictureReader,
    pub(crate) camera_path: &'a CameraPath,
    pub(crate) timing: Timing,
    pub(crate) live: Option<Live>,
    pub(crate) wait: bool,
    pub(crate) pictures: Option<PictureWriter>,
    pub(crate) stats: Option<StatsFile>,
    pub(crate) progress: &'a Progress,
}

/// What a run's frames came to.
#[derive(Debug, Default)]
pub(crate) struct Outcome {
    pub(crate) frames: u32,
    pub(crate) frames_with_mask: u32,
    pub(crate) poses_repeated: u32,
    pub(crate) lags: Vec<f64>,
    pub(crate) responses_ms: Vec<f64>,
    pub(crate) received: Received,
    pub(crate) round_trip: Option<Duration>,
    pub(crate) duration: Duration,
}

/// What the loop remembers from frame to frame.
struct Memory {
    started: Instant,
    history: PoseHistory,
    /// When each frame's pose left, in the history's places.
    sent: Vec<Option<(FrameNumber, Instant)>>,
    /// Longest response of late, to poses that were sent once: a maximum that fades.
    slowest_response: Option<Duration>,
    /// The last frame whose pose was sent more than once.
    repeated: Option<FrameNumber>,
    outcome: Outcome,
}

/// The mask that a frame is shaded with.
struct Used {
    frame: FrameNumber,
    bytes: usize,
    packets: u16,
    response: Option<Duration>,
}

impl FrameLoop<'_> {
    /// Draws all frames, writes all files, and leaves the server.
    pub(crate) fn run(mut self) -> Result<Outcome, ClientError> {
        let mut memory = Memory {
            started: Instant::now(),
            history: PoseHistory::default(),
            sent: vec![None; crate::pose_history::HISTORY_FRAMES],
            slowest_response: None,
            repeated: None,
            outcome: Outcome::default(),
        };
        let drawn = self.draw_all(&mut memory);
        self.progress.finish();
        let mut outcome = memory.outcome;
        outcome.duration = memory.started.elapsed();
        if let Some(Live { runtime, session, masks }) = self.live.take() {
            outcome.received = session.received();
            outcome.round_trip = session.round_trip();
            drop(masks);
            runtime.block_on(session.leave());
        }
        drawn?;
        if let Some(pictures) = self.pictures {
            pictures.finish()?;
        }
        if let Some(stats) = self.stats {
            stats.finish()?;
        }
        Ok(outcome)
    }

    fn draw_all(&mut self, memory: &mut Memory) -> Result<(), ClientError> {
        for index in 0..self.timing.frames {
            if self.timing.paced {
                let due = Duration::from_secs_f64(f64::from(index) * self.timing.step_s);
                std::thread::sleep(due.saturating_sub(memory.started.elapsed()));
            }
            let stats = self.draw(FrameNumber(index), memory)?;
            if let Some(file) = &mut self.stats {
                file.write(&stats)?;
            }
            self.progress.drawing(index + 1, self.timing.frames);
        }
        while self.keep_oldest_picture()? {}
        Ok(())
    }

    fn draw(&mut self, frame: FrameNumber, memory: &mut Memory) -> Result<FrameStats, ClientError> {
        let begun = Instant::now();
        let mut clock = Clock(begun);
        let (camera, pose) = self.pose(frame, begun.duration_since(memory.started));
        memory.history.remember(frame, pose);
        if let Some(live) = &self.live {
            memory.sent[frame.0 as usize % crate::pose_history::HISTORY_FRAMES] = Some((frame, begun));
            live.session.send_pose(frame, pose);
        }
        self.renderer.draw_surfaces(&camera)?;
        let surfaces = clock.lap();
        let used = self.mask_of(frame, memory)?;
        let (wait, upload) = (clock.lap_without(used.1), used.1);
        let target = self.picture_reader.target();
        let copied = self.pictures.is_some();
        let submission = self.renderer.shade(&camera, 1.0, &target, |encoder| {
            if copied {
                self.picture_reader.copy(encoder);
            }
        })?;
        self.picture_reader.submitted(frame.0.into(), submission, copied);
        let shade = clock.lap();
        while self.picture_reader.is_full() {
            self.keep_oldest_picture()?;
        }
        let readback = clock.lap();

        memory.outcome.frames += 1;
        let used = used.0;
        let lag = used.as_ref().map(|used| frame.0.saturating_sub(used.frame.0));
        if let Some(lag) = lag {
            memory.outcome.frames_with_mask += 1;
            memory.outcome.lags.push(lag.into());
        }
        let response_ms = used.as_ref().and_then(|used| used.response).map(millis);
        memory.outcome.responses_ms.extend(response_ms);
        Ok(FrameStats {
            frame: frame.0,
            t_ms: millis(begun.duration_since(memory.started)),
            mask_frame: used.as_ref().map(|used| used.frame.0),
            lag,
            response_ms,
            surfaces_ms: millis(surfaces),
            wait_ms: millis(wait),
            upload_ms: millis(upload),
            shade_ms: millis(shade),
            readback_ms: millis(readback),
            bytes: used.as_ref().map(|used| used.bytes),
            packets: used.as_ref().map(|used| used.packets),
        })
    }

    fn pose(&self, frame: FrameNumber, since_first: Duration) -> (Camera, Pose) {
        let time_s = self.timing.time_s(frame.0);
        let camera = self.camera_path.camera(time_s, 1, 1);
        // It wraps after 49 days, as the pose says.
        #[expect(clippy::cast_possible_truncation, reason = "milliseconds modulo 2³²")]
        let client_time_ms = since_first.as_millis() as u32;
        let pose = Pose {
            position_m: camera.position_m.to_array(),
            orientation: camera.orientation.to_array(),
            yfov_rad: camera.yfov_rad,
            scene_time_s: time_s,
            client_time_ms,
        };
        (camera, pose)
    }

    /// Gives the renderer the mask for this frame, if it is another one than before. Also says how long that took.
    fn mask_of(&mut self, frame: FrameNumber, memory: &mut Memory) -> Result<(Option<Used>, Duration), ClientError> {
        let Some(live) = &mut self.live else { return Ok((None, Duration::ZERO)) };
        if self.wait {
            wait_for_mask(live, frame, memory, self.timing.frames)?;
        } else if let Some(reason) = live.masks.ended() {
            return Err(ended(memory, self.timing.frames, reason));
        }
        let (received, changed) = if self.wait {
            (live.masks.front(), true)
        } else {
            live.masks.newest().map_or((None, false), |(received, changed)| (Some(received), changed))
        };
        let Some(received) = received else { return Ok((None, Duration::ZERO)) };
        let mut upload = Duration::ZERO;
        if changed {
            let begun = Instant::now();
            let shape = received.mask.shape();
            let pose = memory.history.get(received.frame);
            let traced_for = pose.map(|pose| camera_of(pose, shape.width(), shape.height()));
            let mask = traced_for.as_ref().map(|traced_for| MaskView { mask: &received.mask, traced_for });
            self.renderer.set_mask(mask)?;
            upload = begun.elapsed();
        }
        let response = changed.then(|| memory.response(received)).flatten();
        let used = Used { frame: received.frame, bytes: received.payload_bytes, packets: received.packets, response };
        Ok((Some(used), upload))
    }

    /// Waits for the oldest picture under way and hands it to the writers; whether there was one is the answer.
    fn keep_oldest_picture(&mut self) -> Result<bool, ClientError> {
        let Some(picture) = self.picture_reader.take_oldest()? else { return Ok(false) };
        if let (Some(picture), Some(writer)) = (picture, &self.pictures) {
            writer.write(picture)?;
        }
        Ok(true)
    }
}

/// Waits for exactly this frame's mask, and asks again for it: at once when a part of it was lost, or else after some
/// round trips and longer than masks took of late, and then after twice as long each time, so that a slow server is not
/// asked in vain.
fn wait_for_mask(live: &mut Live, frame: FrameNumber, memory: &mut Memory, wanted: u32) -> Result<(), ClientError> {
    let begun = Instant::now();
    let round_trip = live.session.round_trip().unwrap_or_default();
    let usual = memory.slowest_response.map_or(FIRST_RESPONSE, |slowest| slowest * 2);
    let mut patience = (round_trip * 4).max(LEAST_PATIENCE).max(usual);
    let mut asked = 1;
    loop {
        match live.masks.wait_for(frame, Instant::now() + patience) {
            Waited::Arrived => return Ok(()),
            Waited::Ended(reason) => return Err(ended(memory, wanted, reason)),
            Waited::TimedOut | Waited::Lost if begun.elapsed() > GIVE_UP => {
                return Err(ClientError::NoVisibility { frame, after: begun.elapsed(), asked });
            }
            waited @ (Waited::TimedOut | Waited::Lost) => {
                if let Some(pose) = memory.history.get(frame) {
                    live.session.send_pose_again(frame, *pose);
                    memory.repeated = Some(frame);
                    memory.outcome.poses_repeated += 1;
                    asked += 1;
                }
                if waited == Waited::TimedOut {
                    patience = (patience * 2).min(GIVE_UP / 4);
                }
            }
        }
    }
}

/// The camera of a pose, for a picture of this size.
fn camera_of(pose: &Pose, width: u32, height: u32) -> Camera {
    Camera {
        position_m: pose.position_m.into(),
        orientation: glam::DQuat::from_array(pose.orientation),
        yfov_rad: pose.yfov_rad,
        width,
        height,
    }
}

fn ended(memory: &Memory, wanted: u32, reason: String) -> ClientError {
    ClientError::Ended { rendered: memory.outcome.frames, wanted, reason }
}

impl Memory {
    /// How long the mask took from its pose's departure.
    fn response(&mut self, received: &ReceivedMask) -> Option<Duration> {
        let place = received.frame.0 as usize % self.sent.len();
        let (_, sent) = self.sent[place].filter(|(frame, _)| *frame == received.frame)?;
        let response = received.received_at.saturating_duration_since(sent);
        // What a repeated pose took says nothing about the server (Karn's rule for round trips): taken for a response, a
        // lost frame would make the next loss cost twice as much.
        if self.repeated != Some(received.frame) {
            let faded = self.slowest_response.map_or(Duration::ZERO, |slowest| slowest * 7 / 8);
            self.slowest_response = Some(response.max(faded));
        }
        Some(response)
    }
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

    /// The same, less a part that is counted elsewhere.
    fn lap_without(&mut self, part: Duration) -> Duration {
        self.lap().saturating_sub(part)
    }
}
