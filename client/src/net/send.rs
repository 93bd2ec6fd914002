//! The send task: the newest pose goes out; poses that were overtaken before their turn are not sent.

use std::{convert::Infallible, io};

use gnomon_protocol::{
    ids::FrameNumber,
    pose::{Pose, encode_pose_packet},
};
use tokio::sync::watch;

use super::link::DataSender;

/// The newest pose, and the frame that it is for.
pub(crate) type Outgoing = Option<(FrameNumber, Pose)>;

/// Sends until the link is gone. When nobody gives poses any more, it waits to be stopped.
pub(crate) async fn send_poses(
    mut sender: DataSender,
    mut newest: watch::Receiver<Outgoing>,
) -> io::Result<Infallible> {
    let mut sequence = 0_u32;
    loop {
        if newest.changed().await.is_err() {
            return std::future::pending().await;
        }
        // Copied, so that the renderer can hand over the next one while this one is sent.
        let outgoing = *newest.borrow_and_update();
        if let Some((frame, pose)) = outgoing {
            sender.send(&encode_pose_packet(sequence, frame, &pose)).await?;
            sequence = sequence.wrapping_add(1);
        }
    }
}
