//! The send task: sends the newest pose, acknowledgement and loss feedback. Older unsent values are skipped.

use std::{convert::Infallible, io};

use gnomon_protocol::{
    acknowledgement::Acknowledgement,
    ids::FrameNumber,
    loss::LossFeedback,
    pose::{Pose, encode_pose_packet},
};
use tokio::sync::watch;

use super::connection::DataSender;

pub(crate) type OutgoingPose = Option<(FrameNumber, Pose)>;

/// Sends until the connection is gone. When a channel closes, it waits to be stopped.
pub(crate) async fn send_poses(
    mut sender: DataSender,
    mut poses: watch::Receiver<OutgoingPose>,
    mut acknowledgements: watch::Receiver<Option<Acknowledgement>>,
    mut losses: watch::Receiver<Option<LossFeedback>>,
) -> io::Result<Infallible> {
    let mut sequence = 0_u32;
    loop {
        // Acknowledgements first: they decide the reference of the next mask.
        tokio::select! {
            biased;
            changed = acknowledgements.changed() => {
                if changed.is_err() {
                    return std::future::pending().await;
                }
                let newest = *acknowledgements.borrow_and_update();
                if let Some(acknowledgement) = newest {
                    sender.send(&acknowledgement.encode()).await?;
                }
                continue;
            }
            changed = losses.changed() => {
                if changed.is_err() {
                    return std::future::pending().await;
                }
                let newest = *losses.borrow_and_update();
                if let Some(feedback) = newest {
                    sender.send(&feedback.encode()).await?;
                }
                continue;
            }
            changed = poses.changed() => if changed.is_err() {
                return std::future::pending().await;
            },
        }
        // Copied, so that the renderer can set the next pose while this one is sent.
        let newest = *poses.borrow_and_update();
        if let Some((frame, pose)) = newest {
            sender.send(&encode_pose_packet(sequence, frame, &pose)).await?;
            sequence = sequence.wrapping_add(1);
        }
    }
}
