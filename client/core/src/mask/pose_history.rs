//! The latest frames and the masks they requested, for comparison with the masks that arrive.

use gnomon_protocol::{ids::FrameNumber, mask::MaskShape, pose::Pose};
use gnomon_scene::camera::Camera;
use serde::Serialize;
use web_time::Instant;

/// Four seconds at 60 frames/s; more than any lag worth predicting over.
pub const HISTORY_FRAMES: u32 = 256;

/// A frame and the mask requested for it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MaskRequest {
    pub frame: FrameNumber,
    /// The picture's camera.
    pub camera: Camera,
    /// The same with the guard band. Stored as computed: if it were rebuilt from the pose, its quaternion would be
    /// normalised twice, could differ in the last bit, and would count as another view.
    pub mask_camera: Camera,
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
    /// Its size differs from the requested one.
    WrongSize,
}

/// Rejected masks by cause.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Rejections {
    pub future: u64,
    pub forgotten: u64,
    pub never_sent: u64,
    pub before_reconnect: u64,
    pub wrong_size: u64,
}

impl Rejections {
    pub fn count(&mut self, rejection: Rejection) {
        let counter = match rejection {
            Rejection::Future => &mut self.future,
            Rejection::Forgotten => &mut self.forgotten,
            Rejection::NeverSent => &mut self.never_sent,
            Rejection::BeforeReconnect => &mut self.before_reconnect,
            Rejection::WrongSize => &mut self.wrong_size,
        };
        *counter += 1;
    }
}

/// A ring of the latest requests, indexed by frame number.
#[derive(Debug, Clone)]
pub struct PoseHistory {
    slots: Vec<Option<MaskRequest>>,
    newest: Option<FrameNumber>,
    /// First frame whose pose went over the current connection.
    connected_since: FrameNumber,
}

impl Default for PoseHistory {
    fn default() -> Self {
        Self { slots: vec![None; HISTORY_FRAMES as usize], newest: None, connected_since: FrameNumber(0) }
    }
}

impl PoseHistory {
    /// Adds a frame and drops the one [`HISTORY_FRAMES`] before it.
    pub fn insert(&mut self, request: MaskRequest) {
        self.newest = self.newest.max(Some(request.frame));
        self.slots[Self::slot(request.frame)] = Some(request);
    }

    /// Notes that poses from `frame` on go over a new connection.
    pub fn reconnected(&mut self, frame: FrameNumber) {
        self.connected_since = frame;
    }

    /// Returns the frame's request, or `None` if it is too old or was never added.
    #[must_use]
    pub fn get(&self, frame: FrameNumber) -> Option<&MaskRequest> {
        self.slots[Self::slot(frame)].as_ref().filter(|request| request.frame == frame)
    }

    /// Returns the request that a mask of `frame` with this shape answers.
    ///
    /// # Errors
    /// If it answers no request of the current connection.
    pub fn answered(&self, frame: FrameNumber, shape: MaskShape) -> Result<&MaskRequest, Rejection> {
        if self.newest < Some(frame) {
            return Err(Rejection::Future);
        }
        if frame < self.connected_since {
            return Err(Rejection::BeforeReconnect);
        }
        let Some(request) = self.get(frame) else {
            let oldest = self.newest.map_or(0, |newest| newest.0.saturating_sub(HISTORY_FRAMES - 1));
            return Err(if frame.0 < oldest { Rejection::Forgotten } else { Rejection::NeverSent });
        };
        if request.sent_at.is_none() {
            return Err(Rejection::NeverSent);
        }
        if request.pose.mask_px.map(u32::from) != [shape.width(), shape.height()] {
            return Err(Rejection::WrongSize);
        }
        Ok(request)
    }

    fn slot(frame: FrameNumber) -> usize {
        (frame.0 % HISTORY_FRAMES) as usize
    }
}

#[cfg(test)]
#[expect(clippy::disallowed_methods, reason = "tests have a clock")]
mod tests {
    use glam::{DQuat, DVec3};

    use super::*;

    fn request(frame: u32, sent: bool) -> MaskRequest {
        let pose = Pose {
            position_m: [f64::from(frame), 0.0, 0.0],
            orientation: [0.0, 0.0, 0.0, 1.0],
            yfov_rad: 1.0,
            scene_time_s: 0.0,
            client_time_ms: 0,
            mask_px: [64, 36],
            look_ahead_ms: 0,
        };
        let camera = Camera {
            position_m: DVec3::X * f64::from(frame),
            orientation: DQuat::IDENTITY,
            yfov_rad: 1.0,
            width: 64,
            height: 36,
        };
        MaskRequest { frame: FrameNumber(frame), camera, mask_camera: camera, pose, sent_at: sent.then(Instant::now) }
    }

    #[test]
    fn the_latest_frames_are_found_and_older_ones_are_not() {
        let mut history = PoseHistory::default();
        assert_eq!(history.get(FrameNumber(0)), None);
        for frame in 0..400 {
            history.insert(request(frame, true));
        }
        assert_eq!(history.get(FrameNumber(399)).unwrap().pose.position_m[0], 399.0);
        assert_eq!(history.get(FrameNumber(144)).unwrap().pose.position_m[0], 144.0);
        for gone in [0, 143, 400, 399 + 256] {
            assert_eq!(history.get(FrameNumber(gone)), None);
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
        ] {
            counts.count(rejection);
        }
        let expected = Rejections { future: 1, forgotten: 1, never_sent: 1, before_reconnect: 1, wrong_size: 2 };
        assert_eq!(counts, expected);
    }
}
