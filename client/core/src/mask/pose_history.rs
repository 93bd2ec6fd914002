//! The latest frames and the masks they requested, for comparison with the masks that arrive.

use std::{collections::VecDeque, time::Duration};

use gnomon_protocol::{ids::FrameNumber, mask::MaskShape, pose::Pose};
use gnomon_scene::{SceneAt, camera::Camera};
use serde::Serialize;
use web_time::Instant;

/// How long a frame is remembered, in s: longer than any lag worth predicting over.
pub const HISTORY_S: f64 = 4.0;

/// Frames that are remembered even longer, for clients that draw slowly.
const MIN_FRAMES: usize = 256;

/// Most frames that are remembered: four seconds at 16 thousand frames/s.
const MAX_FRAMES: usize = 1 << 16;

/// A frame and the mask requested for it.
#[derive(Debug, Clone, PartialEq)]
pub struct MaskRequest {
    pub frame: FrameNumber,
    /// When the frame began.
    pub begun: Instant,
    /// The picture's camera.
    pub camera: Camera,
    /// The same with the guard band. Stored as computed: if it were rebuilt from the pose, its quaternion would be
    /// normalised twice, could differ in the last bit, and would count as another view.
    pub mask_camera: Camera,
    /// What the picture shows of the scene.
    pub scene: SceneAt,
    /// The pose as sent, with the mask's size and field of view.
    pub pose: Pose,
    /// `None` if no server was connected or the frame needed no mask.
    pub sent_at: Option<Instant>,
}

/// Why a mask is not used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Rejection {
    /// Its frame has not been drawn yet.
    Future,
    /// Its frame is older than the history.
    Forgotten,
    /// Its frame's pose was never sent.
    NeverSent,
    /// Its frame was drawn before the current connection.
    BeforeReconnect,
    /// Its size or its number of lights differs from the requested one.
    WrongSize,
    /// It was traced with a state of the scene that the client has not heard of yet.
    UnknownRevision,
    /// It was traced with a state of the scene that the client has forgotten.
    OldRevision,
}

/// Rejected masks by cause.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Rejections {
    pub future: u64,
    pub forgotten: u64,
    pub never_sent: u64,
    pub before_reconnect: u64,
    pub wrong_size: u64,
    pub unknown_revision: u64,
    pub old_revision: u64,
}

impl Rejections {
    pub fn count(&mut self, rejection: Rejection) {
        let counter = match rejection {
            Rejection::Future => &mut self.future,
            Rejection::Forgotten => &mut self.forgotten,
            Rejection::NeverSent => &mut self.never_sent,
            Rejection::BeforeReconnect => &mut self.before_reconnect,
            Rejection::WrongSize => &mut self.wrong_size,
            Rejection::UnknownRevision => &mut self.unknown_revision,
            Rejection::OldRevision => &mut self.old_revision,
        };
        *counter += 1;
    }
}

/// The latest requests.
#[derive(Debug, Clone)]
pub struct PoseHistory {
    /// In ascending order of their frames.
    requests: VecDeque<MaskRequest>,
    /// First frame whose pose went over the current connection.
    connected_since: FrameNumber,
}

impl Default for PoseHistory {
    fn default() -> Self {
        Self { requests: VecDeque::new(), connected_since: FrameNumber(0) }
    }
}

impl PoseHistory {
    /// Adds a frame that is newer than all others, and drops those that are older than [`HISTORY_S`].
    pub fn insert(&mut self, request: MaskRequest) {
        // A counter that starts again, as after the last of all numbers, leaves nothing to compare with.
        if self.newest().is_some_and(|newest| newest >= request.frame) {
            self.requests.clear();
        }
        let is_old = |oldest: &MaskRequest| {
            request.begun.saturating_duration_since(oldest.begun) > Duration::from_secs_f64(HISTORY_S)
        };
        while self.requests.len() >= MAX_FRAMES
            || self.requests.len() >= MIN_FRAMES && self.requests.front().is_some_and(is_old)
        {
            self.requests.pop_front();
        }
        self.requests.push_back(request);
    }

    fn newest(&self) -> Option<FrameNumber> {
        self.requests.back().map(|request| request.frame)
    }

    /// Notes that poses from `frame` on go over a new connection.
    pub fn reconnected(&mut self, frame: FrameNumber) {
        self.connected_since = frame;
    }

    /// Returns the frame's request, or `None` if it is too old or was never added.
    #[must_use]
    pub fn get(&self, frame: FrameNumber) -> Option<&MaskRequest> {
        let place = self.requests.binary_search_by_key(&frame, |request| request.frame).ok()?;
        self.requests.get(place)
    }

    /// Returns the request that a mask of `frame` with this shape answers.
    ///
    /// # Errors
    /// If it answers no request of the current connection.
    pub fn answered(&self, frame: FrameNumber, shape: MaskShape) -> Result<&MaskRequest, Rejection> {
        if self.newest() < Some(frame) {
            return Err(Rejection::Future);
        }
        if frame < self.connected_since {
            return Err(Rejection::BeforeReconnect);
        }
        let Some(request) = self.get(frame) else {
            let is_older = self.requests.front().is_some_and(|oldest| frame < oldest.frame);
            return Err(if is_older { Rejection::Forgotten } else { Rejection::NeverSent });
        };
        if request.sent_at.is_none() {
            return Err(Rejection::NeverSent);
        }
        if request.pose.mask_px.map(u32::from) != [shape.width(), shape.height()] {
            return Err(Rejection::WrongSize);
        }
        Ok(request)
    }
}

#[cfg(test)]
#[expect(clippy::disallowed_methods, reason = "tests have a clock")]
mod tests {
    use glam::{DQuat, DVec3};

    use super::*;

    fn request(frame: u32, sent: bool) -> MaskRequest {
        request_at(frame, sent, Instant::now())
    }

    fn request_at(frame: u32, sent: bool, begun: Instant) -> MaskRequest {
        let pose = Pose {
            position_m: [f64::from(frame), 0.0, 0.0],
            orientation: [0.0, 0.0, 0.0, 1.0],
            yfov_rad: 1.0,
            scene_time_s: 0.0,
            client_time_ms: 0,
            mask_px: [64, 36],
            look_ahead_ms: 0,
            revision: 0,
        };
        let camera = Camera {
            position_m: DVec3::X * f64::from(frame),
            orientation: DQuat::IDENTITY,
            yfov_rad: 1.0,
            width: 64,
            height: 36,
        };
        let sent_at = sent.then_some(begun);
        MaskRequest {
            frame: FrameNumber(frame),
            begun,
            camera,
            mask_camera: camera,
            scene: SceneAt::default(),
            pose,
            sent_at,
        }
    }

    /// Inserts 8 s of frames at this rate. Returns how many of them are remembered.
    fn remembered(frames_per_s: u32) -> u32 {
        let (mut history, first) = (PoseHistory::default(), Instant::now());
        assert_eq!(history.get(FrameNumber(0)), None);
        let frames = 8 * frames_per_s;
        for frame in 0..frames {
            history.insert(request_at(frame, true, first + Duration::from_secs(1) * frame / frames_per_s));
        }
        let known: Vec<u32> = (0..frames + 1000).filter(|frame| history.get(FrameNumber(*frame)).is_some()).collect();
        assert_eq!((known.last(), known.windows(2).all(|pair| pair[1] == pair[0] + 1)), (Some(&(frames - 1)), true));
        let oldest = history.get(FrameNumber(known[0])).unwrap();
        assert_eq!(oldest.pose.position_m[0], f64::from(known[0]));
        u32::try_from(known.len()).unwrap()
    }

    #[test]
    fn frames_are_remembered_for_a_time_whatever_their_rate() {
        for (frames_per_s, expected) in [(60, 256), (100, 401), (1000, 4001), (4, 32), (20_000, 1 << 16)] {
            assert_eq!(remembered(frames_per_s), expected, "{frames_per_s} frames/s");
        }
    }

    #[test]
    fn each_reason_for_a_rejection_is_recognised() {
        let mut history = PoseHistory::default();
        let shape = |width| MaskShape::new(width, 36, 3).unwrap();
        assert_eq!(history.answered(FrameNumber(0), shape(64)), Err(Rejection::Future));
        for frame in 10..400 {
            // The connection came up with frame 350; frames 370 to 374 had no server; 380 was skipped.
            if frame == 350 {
                history.reconnected(FrameNumber(350));
            }
            if frame != 380 {
                history.insert(request(frame, !(370..375).contains(&frame)));
            }
        }
        for (frame, width, expected) in [
            (399, 64, None),
            (350, 64, None),
            (400, 64, Some(Rejection::Future)),
            (u32::MAX, 64, Some(Rejection::Future)),
            (349, 64, Some(Rejection::BeforeReconnect)),
            (3, 64, Some(Rejection::BeforeReconnect)),
            (372, 64, Some(Rejection::NeverSent)),
            (380, 64, Some(Rejection::NeverSent)),
            (390, 65, Some(Rejection::WrongSize)),
        ] {
            assert_eq!(history.answered(FrameNumber(frame), shape(width)).err(), expected, "frame {frame}");
        }
        history.reconnected(FrameNumber(0));
        // Old ones are dropped when a new one comes.
        let later = Instant::now() + Duration::from_secs_f64(2.0 * HISTORY_S);
        history.insert(request_at(400, true, later));
        for (frame, expected) in [(143, Rejection::Forgotten), (0, Rejection::Forgotten), (380, Rejection::NeverSent)] {
            assert_eq!(history.answered(FrameNumber(frame), shape(64)), Err(expected), "frame {frame}");
        }
        let mut counts = Rejections::default();
        for rejection in [
            Rejection::Future,
            Rejection::Forgotten,
            Rejection::NeverSent,
            Rejection::BeforeReconnect,
            Rejection::WrongSize,
            Rejection::WrongSize,
            Rejection::UnknownRevision,
            Rejection::OldRevision,
        ] {
            counts.count(rejection);
        }
        let expected = Rejections {
            future: 1,
            forgotten: 1,
            never_sent: 1,
            before_reconnect: 1,
            wrong_size: 2,
            unknown_revision: 1,
            old_revision: 1,
        };
        assert_eq!(counts, expected);
    }
}
