//! What the client asked for in its latest frames: what a mask that arrives later has to be compared with.

use gnomon_protocol::{ids::FrameNumber, mask::MaskShape, pose::Pose};
use gnomon_scene::camera::Camera;
use serde::Serialize;
use web_time::Instant;

/// Frames that are remembered: four seconds at 60 frames/s, and more than any lag that is worth predicting over.
pub const HISTORY_FRAMES: u32 = 256;

/// A frame, and the mask that was asked for it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Asked {
    /// The frame's number.
    pub frame: FrameNumber,
    /// Where the picture was looked at from.
    pub camera: Camera,
    /// What the mask was asked for: the same with the guard band around it. Kept as it was drawn, not made again from the pose:
    /// a quaternion that is brought to unit length twice may differ in its last bit, and then this would be another view.
    pub mask_camera: Camera,
    /// The pose as it was sent, with the mask's size and field of view.
    pub pose: Pose,
    /// When it was sent; `None` when there was no server to send it to.
    pub sent_at: Option<Instant>,
}

/// Why a mask is not used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Rejection {
    /// Its frame is one that the client has not drawn yet.
    Future,
    /// Its frame was drawn so long ago that the client has forgotten its pose.
    Forgotten,
    /// Its frame's pose was never sent.
    NeverSent,
    /// Its frame was drawn before this connection was there.
    BeforeReconnect,
    /// It has not the size that was asked for.
    WrongSize,
}

/// How many masks were not used, by cause.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Rejections {
    /// [`Rejection::Future`].
    pub future: u64,
    /// [`Rejection::Forgotten`].
    pub forgotten: u64,
    /// [`Rejection::NeverSent`].
    pub never_sent: u64,
    /// [`Rejection::BeforeReconnect`].
    pub before_reconnect: u64,
    /// [`Rejection::WrongSize`].
    pub wrong_size: u64,
}

impl Rejections {
    /// Counts one.
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

/// A ring of the latest frames, found by their numbers.
#[derive(Debug, Clone)]
pub struct PoseHistory {
    slots: Vec<Option<Asked>>,
    newest: Option<FrameNumber>,
    /// First frame whose pose went over the connection that there is now.
    connected_since: FrameNumber,
}

impl Default for PoseHistory {
    fn default() -> Self {
        Self { slots: vec![None; HISTORY_FRAMES as usize], newest: None, connected_since: FrameNumber(0) }
    }
}

impl PoseHistory {
    /// Remembers a frame, in place of that of [`HISTORY_FRAMES`] frames ago.
    pub fn remember(&mut self, asked: Asked) {
        self.newest = self.newest.max(Some(asked.frame));
        self.slots[Self::place(asked.frame)] = Some(asked);
    }

    /// Says that from `frame` on poses go over a new connection.
    pub fn reconnected(&mut self, frame: FrameNumber) {
        self.connected_since = frame;
    }

    /// The frame, unless it is too old or has not been.
    #[must_use]
    pub fn get(&self, frame: FrameNumber) -> Option<&Asked> {
        self.slots[Self::place(frame)].as_ref().filter(|asked| asked.frame == frame)
    }

    /// What a mask that has come for `frame` was asked for with.
    ///
    /// # Errors
    /// When it cannot be the answer to anything that the client remembers to have asked on this connection.
    pub fn answered(&self, frame: FrameNumber, shape: MaskShape) -> Result<&Asked, Rejection> {
        if self.newest < Some(frame) {
            return Err(Rejection::Future);
        }
        if frame < self.connected_since {
            return Err(Rejection::BeforeReconnect);
        }
        let Some(asked) = self.get(frame) else {
            let oldest = self.newest.map_or(0, |newest| newest.0.saturating_sub(HISTORY_FRAMES - 1));
            return Err(if frame.0 < oldest { Rejection::Forgotten } else { Rejection::NeverSent });
        };
        if asked.sent_at.is_none() {
            return Err(Rejection::NeverSent);
        }
        if asked.pose.mask_px.map(u32::from) != [shape.width(), shape.height()] {
            return Err(Rejection::WrongSize);
        }
        Ok(asked)
    }

    fn place(frame: FrameNumber) -> usize {
        (frame.0 % HISTORY_FRAMES) as usize
    }
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};

    use super::*;

    fn asked(frame: u32, sent: bool) -> Asked {
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
        Asked { frame: FrameNumber(frame), camera, mask_camera: camera, pose, sent_at: sent.then(Instant::now) }
    }

    #[test]
    fn the_latest_frames_are_found_and_older_ones_are_not() {
        let mut history = PoseHistory::default();
        assert_eq!(history.get(FrameNumber(0)), None);
        for frame in 0..400 {
            history.remember(asked(frame, true));
        }
        assert_eq!(history.get(FrameNumber(399)).unwrap().pose.position_m[0], 399.0);
        assert_eq!(history.get(FrameNumber(144)).unwrap().pose.position_m[0], 144.0);
        for gone in [0, 143, 400, 399 + 256] {
            assert_eq!(history.get(FrameNumber(gone)), None);
        }
    }

    #[test]
    fn masks_that_answer_nothing_are_told_apart() {
        let mut history = PoseHistory::default();
        let shape = |width| MaskShape::new(width, 36, 3).unwrap();
        assert_eq!(history.answered(FrameNumber(0), shape(64)), Err(Rejection::Future));
        for frame in 10..400 {
            // The connection came up with frame 350; frames 370 to 374 found the server's door closed; 380 was skipped.
            if frame == 350 {
                history.reconnected(FrameNumber(350));
            }
            if frame != 380 {
                history.remember(asked(frame, !(370..375).contains(&frame)));
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
