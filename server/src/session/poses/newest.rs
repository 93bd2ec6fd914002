//! Recognizes poses that are newer than all before.

use gnomon_protocol::ids::FrameNumber;

/// The newest frame, and the sequence number of its pose.
///
/// Frame numbers grow. A client that lost a frame may request it again with a later sequence number. A packet that the
/// network duplicates keeps its sequence number.
#[derive(Debug, Default)]
pub(super) struct NewestPose(Option<(FrameNumber, u32)>);

impl NewestPose {
    /// Returns false if the pose is not newer.
    pub(super) fn replace(&mut self, frame: FrameNumber, sequence: u32) -> bool {
        let newer = self.0.is_none_or(|newest| newest < (frame, sequence));
        if newer {
            self.0 = Some((frame, sequence));
        }
        newer
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_newer_poses_are_taken() {
        let mut newest = NewestPose::default();
        for (frame, sequence, taken) in [
            (0, 0, true),
            (0, 0, false),
            (2, 1, true),
            (1, 2, false),
            (2, 1, false),
            (2, 3, true),
            (3, 0, true),
            (u32::MAX - 1, 5, true),
            (3, 6, false),
        ] {
            assert_eq!(newest.replace(FrameNumber(frame), sequence), taken, "frame {frame}, sequence {sequence}");
        }
    }
}
