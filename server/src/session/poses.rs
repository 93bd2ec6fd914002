//! Poses in: each newer one becomes the session's only request, anything else is counted and dropped.

use std::{convert::Infallible, io, time::Instant};

use glam::{DQuat, DVec3};
use gnomon_protocol::{ids::FrameNumber, mask::MaskShape, pose, pose::Pose};
use gnomon_shaders::camera::Camera;

use super::ledger::Ledger;
use crate::{
    net::link::DataReceiver,
    visibility::{TraceRequest, port::RequestSender},
};

/// Which poses are newer than the newest.
///
/// Frame numbers grow. A client that has lost a frame and waits for it may ask for the same frame again, with a later
/// sequence number; a packet that the network has duplicated has the same one.
#[derive(Debug, Default)]
struct Newest(Option<(FrameNumber, u32)>);

impl Newest {
    fn take(&mut self, frame: FrameNumber, sequence: u32) -> bool {
        let newer = self.0.is_none_or(|newest| newest < (frame, sequence));
        if newer {
            self.0 = Some((frame, sequence));
        }
        newer
    }
}

/// Receives poses until the link is gone.
///
/// # Errors
/// When the link is gone.
pub(super) async fn receive(
    mut receiver: DataReceiver,
    requests: &RequestSender,
    shape: MaskShape,
    ledger: &Ledger,
) -> io::Result<Infallible> {
    let mut newest = Newest::default();
    loop {
        let datagram = receiver.receive().await?;
        let received_at = Instant::now();
        let (sequence, frame, pose) = match pose::decode_pose_packet(&datagram) {
            Ok(decoded) => decoded,
            Err(error) => {
                ledger.poses_bad.one();
                tracing::debug!(%error, bytes = datagram.len(), "bad pose");
                continue;
            }
        };
        if !newest.take(frame, sequence) {
            ledger.poses_stale.one();
            continue;
        }
        ledger.poses.one();
        // Noted first, so that a session which finishes never takes an earlier frame for the last one.
        ledger.set_newest_requested(frame);
        requests.request(TraceRequest { frame, camera: camera(&pose, shape), received_at });
    }
}

/// The camera of a pose whose values are valid.
fn camera(pose: &Pose, shape: MaskShape) -> Camera {
    Camera {
        position_m: DVec3::from_array(pose.position_m),
        orientation: DQuat::from_array(pose.orientation).normalize(),
        yfov_rad: pose.yfov_rad,
        width: shape.width(),
        height: shape.height(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_newer_poses_are_taken() {
        let mut newest = Newest::default();
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
            assert_eq!(newest.take(FrameNumber(frame), sequence), taken, "frame {frame}, sequence {sequence}");
        }
    }
}
