//! Receives poses and feedback. Each newer pose becomes the session's only request; others are counted and dropped.

use std::{convert::Infallible, io, time::Instant};

use gnomon_protocol::{
    mask::MaskShape,
    pose::{self, Pose},
};
use gnomon_scene::SceneAt;
use tokio::sync::watch;

use super::{
    interval::PoseInterval,
    look_ahead::{LookAhead, pose_camera},
    newest::NewestPose,
    rate::RateLimit,
};
use crate::{
    metrics::ledger::Ledger,
    net::link::DataReceiver,
    session::feedback::{Feedback, receive_feedback},
    visibility::{TraceRequest, engine::RequestSender},
    world::{Newest, World},
};

/// Returns only if the link is lost.
pub(in crate::session) async fn receive_poses(
    mut receiver: DataReceiver,
    requests: &RequestSender,
    feedback: &watch::Sender<Feedback>,
    (shape, scene_moves, world): (MaskShape, bool, &World),
    ledger: &Ledger,
) -> io::Result<Infallible> {
    let mut newest = NewestPose::default();
    let mut look_ahead = LookAhead::new(scene_moves);
    let mut interval = PoseInterval::new(Instant::now());
    let mut rate = RateLimit::new(Instant::now());
    loop {
        let datagram = receiver.receive().await?;
        let received_at = Instant::now();
        if !rate.allows(received_at) {
            ledger.poses_over_rate.one();
            continue;
        }
        if receive_feedback(&datagram, received_at, feedback, ledger) {
            continue;
        }
        let (sequence, frame, pose) = match pose::decode_pose_packet(&datagram) {
            Ok(decoded) => decoded,
            Err(error) => {
                ledger.poses_bad.one();
                tracing::debug!(%error, bytes = datagram.len(), "bad pose");
                continue;
            }
        };
        let [width, height] = pose.mask_px.map(u32::from);
        if width > shape.width() || height > shape.height() {
            ledger.poses_bad.one();
            tracing::debug!(width, height, ?shape, "a pose requests a larger mask than agreed");
            continue;
        }
        if !newest.replace(frame, sequence) {
            ledger.poses_stale.one();
            continue;
        }
        ledger.poses.one();
        // Before the request, so that a stopping session waits for this frame's mask.
        ledger.set_newest_requested(frame);
        let Newest { revision, edits } = world.newest();
        // The client learns from the frame's head that it was traced with another state.
        let newer = (pose.revision != revision).then_some(pose);
        let ahead = look_ahead.predict(&pose).or(newer).map(|ahead| Pose { revision, ..ahead });
        let traced = ahead.as_ref().unwrap_or(&pose);
        let scene = SceneAt { time_s: traced.scene_time_s, edits };
        let scene = if scene_moves { scene } else { scene.at_any_time() };
        let camera = pose_camera(traced);
        let interval = interval.update(received_at);
        requests.request(TraceRequest { frame, camera, scene, ahead, received_at, interval });
    }
}
