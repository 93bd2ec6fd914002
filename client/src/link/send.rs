//! The send task: the newest pose goes out, and the newest that is to be said of the masks and packets that came; what was overtaken before its
//! turn is not sent.

use std::{convert::Infallible, io};

use gnomon_protocol::{
    acknowledgement::Acknowledgement,
    ids::FrameNumber,
    loss::LossFeedback,
    pose::{Pose, encode_pose_packet},
};
use tokio::sync::watch;

use super::connection::DataSender;

/// The newest pose, and the frame that it is for.
pub(crate) type Outgoing = Option<(FrameNumber, Pose)>;

/// Sends until the link is gone. When nobody gives poses any more, it waits to be stopped.
pub(crate) async fn send_poses(
    mut sender: DataSender,
    mut newest: watch::Receiver<Outgoing>,
    mut acknowledged: watch::Receiver<Option<Acknowledgement>>,
    mut losses: watch::Receiver<Option<LossFeedback>>,
) -> io::Result<Infallible> {
    let mut sequence = 0_u32;
    loop {
        // What is said of masks first: the next one is coded against it.
        tokio::select! {
            biased;
            changed = acknowledged.changed() => {
                // When the receive task is gone, so is the session.
                if changed.is_err() {
                    return std::future::pending().await;
                }
                let said = *acknowledged.borrow_and_update();
                if let Some(said) = said {
                    sender.send(&said.encode()).await?;
                }
                continue;
            }
            changed = losses.changed() => {
                if changed.is_err() {
                    return std::future::pending().await;
                }
                let told = *losses.borrow_and_update();
                if let Some(told) = told {
                    sender.send(&told.encode()).await?;
                }
                continue;
            }
            changed = newest.changed() => if changed.is_err() {
                return std::future::pending().await;
            },
        }
        // Copied, so that the renderer can hand over the next one while this one is sent.
        let outgoing = *newest.borrow_and_update();
        if let Some((frame, pose)) = outgoing {
            sender.send(&encode_pose_packet(sequence, frame, &pose)).await?;
            sequence = sequence.wrapping_add(1);
        }
    }
}
