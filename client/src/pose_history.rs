//! Where the client looked from in its latest frames: what a mask that arrives later has to be compared with.

use gnomon_protocol::{ids::FrameNumber, pose::Pose};

/// Frames that are remembered: a second at 60 frames/s. A mask that is later than that is of no use.
pub const HISTORY_FRAMES: usize = 64;

/// A ring of poses, found by their frame's number.
#[derive(Debug, Clone)]
pub struct PoseHistory {
    slots: Vec<Option<(FrameNumber, Pose)>>,
}

impl Default for PoseHistory {
    fn default() -> Self {
        Self { slots: vec![None; HISTORY_FRAMES] }
    }
}

impl PoseHistory {
    /// Remembers a frame's pose, in place of that of [`HISTORY_FRAMES`] frames ago.
    pub fn remember(&mut self, frame: FrameNumber, pose: Pose) {
        let place = Self::place(frame);
        self.slots[place] = Some((frame, pose));
    }

    /// The frame's pose, unless it is too old or has not been.
    #[must_use]
    pub fn get(&self, frame: FrameNumber) -> Option<&Pose> {
        self.slots[Self::place(frame)].as_ref().filter(|(found, _)| *found == frame).map(|(_, pose)| pose)
    }

    fn place(frame: FrameNumber) -> usize {
        frame.0 as usize % HISTORY_FRAMES
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(x: f64) -> Pose {
        Pose {
            position_m: [x, 0.0, 0.0],
            orientation: [0.0, 0.0, 0.0, 1.0],
            yfov_rad: 1.0,
            scene_time_s: 0.0,
            client_time_ms: 0,
        }
    }

    #[test]
    fn the_latest_frames_are_found_and_older_ones_are_not() {
        let mut history = PoseHistory::default();
        assert_eq!(history.get(FrameNumber(0)), None);
        for frame in 0..200 {
            history.remember(FrameNumber(frame), pose(f64::from(frame)));
        }
        assert_eq!(history.get(FrameNumber(199)).unwrap().position_m[0], 199.0);
        assert_eq!(history.get(FrameNumber(136)).unwrap().position_m[0], 136.0);
        for gone in [0, 135, 200, 199 + 64] {
            assert_eq!(history.get(FrameNumber(gone)), None);
        }
    }
}
