//! Poses in, and what is said beside them ([`feedback`]): each newer one becomes the session's only request, anything else is counted and dropped.
//!
//! A client that says how long its masks are under way gets them traced for where its camera will be by then ([`ahead`]). Only the
//! client sees the whole way, from its pose to the frame that shows the mask, so it measures and the server extrapolates.

use std::{
    convert::Infallible,
    io,
    time::{Duration, Instant},
};

use gnomon_protocol::{ids::FrameNumber, mask::MaskShape, pose, pose::Pose};
use gnomon_scene::{camera::Camera, motion::Motion};
use tokio::sync::watch;

use super::feedback::{self, Heard};
use crate::{
    limits::MAX_POSES_PER_SECOND,
    metrics::ledger::Ledger,
    net::link::DataReceiver,
    visibility::{TraceRequest, engine::RequestSender},
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

/// How many poses a client may send.
#[derive(Debug)]
struct Rate {
    /// When the count began anew.
    since: Instant,
    left: u32,
}

impl Rate {
    const fn new(now: Instant) -> Self {
        Self { since: now, left: MAX_POSES_PER_SECOND }
    }

    /// Counts a datagram, and says whether it is within the bound.
    fn allows(&mut self, now: Instant) -> bool {
        if now.saturating_duration_since(self.since) >= Duration::from_secs(1) {
            *self = Self::new(now);
        }
        let allowed = self.left > 0;
        self.left = self.left.saturating_sub(1);
        allowed
    }
}

/// Receives poses, and what the client says beside them, until the link is gone.
///
/// # Errors
/// When the link is gone.
pub(super) async fn receive(
    mut receiver: DataReceiver,
    requests: &RequestSender,
    heard: &watch::Sender<Heard>,
    shape: MaskShape,
    ledger: &Ledger,
) -> io::Result<Infallible> {
    let mut newest = Newest::default();
    let mut ahead = Ahead::default();
    let mut interval = Interval::new(Instant::now());
    let mut rate = Rate::new(Instant::now());
    loop {
        let datagram = receiver.receive().await?;
        let received_at = Instant::now();
        if !rate.allows(received_at) {
            ledger.poses_over_rate.one();
            continue;
        }
        if feedback::hear(&datagram, received_at, heard, ledger) {
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
            tracing::debug!(width, height, ?shape, "a pose asks for a larger mask than was agreed on");
            continue;
        }
        if !newest.take(frame, sequence) {
            ledger.poses_stale.one();
            continue;
        }
        ledger.poses.one();
        // Noted first, so that a session which finishes never takes an earlier frame for the last one.
        ledger.set_newest_requested(frame);
        let predicted = ahead.of(&pose);
        let camera = camera(predicted.as_ref().unwrap_or(&pose));
        let interval = interval.since_last(received_at);
        requests.request(TraceRequest { frame, camera, ahead: predicted, received_at, interval });
    }
}

/// The time between poses, smoothed: how soon a mask is due.
#[derive(Debug)]
struct Interval {
    last: Instant,
    smoothed: Duration,
}

impl Interval {
    /// Of a client that sends a pose seldom, or has paused.
    const LONGEST: Duration = Duration::from_millis(250);

    fn new(now: Instant) -> Self {
        Self { last: now, smoothed: Self::LONGEST }
    }

    fn since_last(&mut self, now: Instant) -> Duration {
        let sample = now.saturating_duration_since(self.last).min(Self::LONGEST);
        self.last = now;
        self.smoothed = (self.smoothed * 7 + sample) / 8;
        self.smoothed
    }
}

/// The camera of a pose whose values are valid.
fn camera(pose: &Pose) -> Camera {
    Camera::of_pose(pose.position_m, pose.orientation, pose.yfov_rad, pose.mask_px)
}

/// Metres, and radians, that no pixel can tell from standing still.
const STANDS_STILL: f64 = 1e-6;

/// Follows a client's motion, and says where it will be when a mask is shown.
#[derive(Debug, Default)]
struct Ahead {
    motion: Motion,
    /// The newest pose's time, and how often the client's clock had wrapped by then.
    clock: Clock,
}

impl Ahead {
    /// The pose to trace instead of `pose`, the client's newest; `None` where that is the same.
    fn of(&mut self, pose: &Pose) -> Option<Pose> {
        let time_s = self.clock.seconds(pose.client_time_ms);
        let now = camera(pose);
        self.motion.push(time_s, now);
        let then_s = time_s + f64::from(pose.look_ahead_ms) * 1e-3;
        let then = self.motion.extrapolate(then_s)?;
        let stays = then.position_m.distance(now.position_m) < STANDS_STILL
            && then.orientation.angle_between(now.orientation) < STANDS_STILL;
        if pose.look_ahead_ms == 0 || stays {
            return None;
        }
        // The mask's size and field of view are those that were asked for.
        let predicted = Pose {
            position_m: then.position_m.to_array(),
            orientation: then.orientation.to_array(),
            scene_time_s: pose.scene_time_s + f64::from(pose.look_ahead_ms) * 1e-3,
            ..*pose
        };
        // A camera that is about to leave the world's limits is not followed.
        predicted.validate().ok().map(|()| predicted)
    }
}

/// A clock of milliseconds that wraps, as seconds that do not.
#[derive(Debug, Default)]
struct Clock {
    newest_ms: u64,
}

impl Clock {
    fn seconds(&mut self, client_time_ms: u32) -> f64 {
        const WRAP_MS: u64 = 1 << 32;
        let base = self.newest_ms - self.newest_ms % WRAP_MS;
        let here = base + u64::from(client_time_ms);
        // More than half a wrap back is a wrap; anything less is a late pose, or a clock that began anew.
        let time_ms = if here + WRAP_MS / 2 < self.newest_ms { here + WRAP_MS } else { here };
        self.newest_ms = time_ms;
        Duration::from_millis(time_ms).as_secs_f64()
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

    #[test]
    fn the_time_between_poses_is_learnt_and_bounded() {
        let start = Instant::now();
        let mut interval = Interval::new(start);
        let mut found = Duration::ZERO;
        for pose in 1..=60 {
            found = interval.since_last(start + Duration::from_millis(16) * pose);
        }
        assert!(found > Duration::from_millis(16) && found < Duration::from_millis(17), "{found:?}");
        assert!(interval.since_last(start + Duration::from_secs(3600)) <= Interval::LONGEST);
    }

    #[test]
    fn a_client_may_send_so_many_poses_a_second_and_no_more() {
        let start = Instant::now();
        let mut rate = Rate::new(start);
        let within = |rate: &mut Rate, at| (0..2 * MAX_POSES_PER_SECOND).filter(|_| rate.allows(at)).count();
        assert_eq!(within(&mut rate, start), MAX_POSES_PER_SECOND as usize);
        assert_eq!(within(&mut rate, start + Duration::from_millis(999)), 0);
        assert_eq!(within(&mut rate, start + Duration::from_secs(1)), MAX_POSES_PER_SECOND as usize);
    }

    fn pose(x: f64, client_time_ms: u32, look_ahead_ms: u16) -> Pose {
        Pose {
            position_m: [x, 0.0, 0.0],
            orientation: [0.0, 0.0, 0.0, 1.0],
            yfov_rad: 1.0,
            scene_time_s: 0.0,
            client_time_ms,
            mask_px: [64, 36],
            look_ahead_ms,
        }
    }

    #[test]
    fn a_moving_camera_is_traced_where_it_will_be() {
        let mut ahead = Ahead::default();
        for frame in 0..10_u32 {
            // One metre a second; the clock wraps on the way.
            let time_ms = u32::MAX.wrapping_sub(80).wrapping_add(frame * 16);
            let found = ahead.of(&pose(f64::from(frame) * 0.016, time_ms, 100));
            if frame > 0 {
                let found = found.unwrap();
                assert!((found.position_m[0] - f64::from(frame) * 0.016 - 0.1).abs() < 1e-7, "{found:?}");
                assert_eq!((found.client_time_ms, found.mask_px), (time_ms, [64, 36]));
            }
        }
        // Who does not ask for it, or stands still, gets the pose as it is.
        assert_eq!(ahead.of(&pose(0.16, u32::MAX.wrapping_sub(80).wrapping_add(160), 0)), None);
        let mut still = Ahead::default();
        assert!((0..5_u32).all(|frame| still.of(&pose(1.0, frame * 16, 100)).is_none()));
    }

    #[test]
    fn a_camera_is_not_followed_out_of_the_world() {
        let mut ahead = Ahead::default();
        let edge = gnomon_protocol::limits::MAX_POSITION_M;
        ahead.of(&pose(edge - 0.02, 0, 1000));
        assert_eq!(ahead.of(&pose(edge - 0.01, 10, 1000)), None);
    }
}
