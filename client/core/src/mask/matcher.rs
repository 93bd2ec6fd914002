//! Finds the request that each received mask answers, and decides when to request another one.

use std::{collections::VecDeque, sync::Arc, time::Duration};

use gnomon_protocol::{
    coverage::Coverage,
    ids::FrameNumber,
    limits::{MAX_LAYERS, MAX_LOOK_AHEAD_MS},
    pose::Pose,
};
use gnomon_scene::{SceneAt, camera::Camera};
use web_time::Instant;

use super::{
    pose_history::{MaskRequest, PoseHistory, Rejection, Rejections},
    received::ReceivedMask,
    world::World,
};
use crate::camera::Viewpoint;

/// Interval of requests while camera and scene are still and the mask is complete: keeps the server warm at almost no
/// cost.
const REFRESH: Duration = Duration::from_secs(1);

/// Matches masks with requests and keeps the latencies that follow from it.
#[derive(Debug, Default)]
pub struct MaskMatcher {
    /// What people have changed in the scene.
    pub world: World,
    history: PoseHistory,
    rejections: Rejections,
    current: Option<CurrentMask>,
    /// Tiles that have arrived for the current mask's view, from all masks of that view.
    coverage: Option<Coverage>,
    /// Views of the latest masks and the frames that requested them, newest first; at most one for each layer.
    views: VecDeque<(Viewpoint, FrameNumber)>,
    /// Whether something in the scene moves with time.
    scene_moves: bool,
    last_request: Option<Instant>,
    /// The last frame whose pose was sent more than once.
    repeated: Option<FrameNumber>,
    /// Decaying maximum of response times.
    slowest_response: Option<Duration>,
    /// From sending a pose until its mask is shown, smoothed.
    latency: Option<Duration>,
}

/// The mask that the renderer uses.
#[derive(Debug, Clone)]
pub struct CurrentMask {
    pub request: MaskRequest,
    /// The view that it was traced for.
    traced_for: Viewpoint,
    /// The newest frame that it fully answers: its own, or a later one if nothing has moved since.
    as_of: FrameNumber,
    /// When that frame began.
    as_of_begun: Instant,
    /// Size of its frame on the wire, without packet headers.
    pub bytes: usize,
    pub packets: u16,
}

impl CurrentMask {
    /// Returns the mask's age in frames.
    #[must_use]
    pub fn lag(&self, frame: FrameNumber) -> u32 {
        frame.0.saturating_sub(self.as_of.0)
    }

    /// Returns the mask's age in a frame that began at `begun`.
    #[must_use]
    pub fn age(&self, begun: Instant) -> Duration {
        begun.saturating_duration_since(self.as_of_begun)
    }
}

/// A mask that answers a request.
#[derive(Debug, Clone)]
pub struct MatchedMask {
    /// The view that it was traced for.
    pub traced_for: Viewpoint,
    /// True if it adds tiles to the previous mask.
    pub more: bool,
    /// From sending the pose until the mask arrived.
    pub response: Option<Duration>,
}

impl MaskMatcher {
    /// A matcher for a scene in which something moves with time, or nothing.
    #[must_use]
    pub fn new(scene_moves: bool) -> Self {
        Self { scene_moves, ..Self::default() }
    }

    /// Returns what a camera sees of the scene in this state.
    #[must_use]
    pub fn viewpoint(&self, camera: Camera, scene: &SceneAt) -> Viewpoint {
        let scene = scene.clone();
        Viewpoint { camera, scene: if self.scene_moves { scene } else { scene.at_any_time() } }
    }

    /// Returns whether to request a mask for `view`, and counts it as requested if so. False while every tile of that
    /// view has arrived, except once per [`REFRESH`].
    pub fn should_request(&mut self, frame: FrameNumber, view: &Viewpoint, now: Instant) -> bool {
        let complete = self.coverage.as_ref().is_some_and(Coverage::is_whole);
        let answer = self.current.as_mut().filter(|current| complete && current.traced_for == *view);
        let recent = self.last_request.is_some_and(|last| now.saturating_duration_since(last) < REFRESH);
        let skip = answer.is_some() && recent;
        if let Some(current) = answer {
            (current.as_of, current.as_of_begun) = (frame, now);
        }
        if !skip {
            self.last_request = Some(now);
        }
        !skip
    }

    /// Remembers a frame, whether or not its pose was sent.
    pub fn insert(&mut self, request: MaskRequest) {
        self.history.insert(request);
    }

    /// Returns the frame's request while it is remembered.
    #[must_use]
    pub fn request(&self, frame: FrameNumber) -> Option<&MaskRequest> {
        self.history.get(frame)
    }

    /// Notes that the pose of `frame` was sent again.
    pub fn repeated(&mut self, frame: FrameNumber) {
        self.repeated = Some(frame);
    }

    /// Notes that poses from `frame` on go over a new connection.
    pub fn reconnected(&mut self, frame: FrameNumber) {
        self.last_request = None;
        self.history.reconnected(frame);
    }

    /// Forgets all masks: from `frame` on, they are of another scene and go over a new connection.
    pub fn scene_changed(&mut self, frame: FrameNumber, moves: bool) {
        self.scene_moves = moves;
        self.world.forget();
        self.reconnected(frame);
        self.forget_masks();
    }

    /// Takes back the last [`Self::accept`]: the renderer cannot use the mask, and has dropped the others with it.
    pub fn refused(&mut self) {
        self.rejections.count(Rejection::WrongSize);
        self.forget_masks();
    }

    fn forget_masks(&mut self) {
        (self.current, self.coverage) = (None, None);
        self.views.clear();
    }

    /// Returns the request that `mask` answers and the view that it was traced for.
    ///
    /// # Errors
    /// If it answers no request of the current connection, or was traced with an unknown state of the scene.
    pub fn find(&self, mask: &ReceivedMask) -> Result<(MaskRequest, Viewpoint), Rejection> {
        let request = self.history.answered(mask.frame, mask.mask.shape())?.clone();
        let pose = mask.traced_for.as_ref();
        let revision = pose.map_or(request.pose.revision, |pose| pose.revision);
        let edits = Arc::clone(self.world.state(revision)?);
        // As computed: see `MaskRequest::mask_camera`.
        let same_camera = |pose: &Pose| {
            let own = &request.pose;
            pose.position_m == own.position_m && pose.orientation == own.orientation && pose.yfov_rad == own.yfov_rad
        };
        let camera = pose.filter(|pose| !same_camera(pose)).map_or(request.mask_camera, |pose| {
            Camera::of_pose(pose.position_m, pose.orientation, pose.yfov_rad, request.pose.mask_px)
        });
        let scene = SceneAt { time_s: pose.map_or(request.scene.time_s, |pose| pose.scene_time_s), edits };
        let traced_for = self.viewpoint(camera, &scene);
        Ok((request, traced_for))
    }

    /// Makes `mask` the current one. Returns `None` and counts a rejection if it answers no request.
    pub fn accept(&mut self, mask: &ReceivedMask, shown_at: Instant) -> Option<MatchedMask> {
        let (request, traced_for) = match self.find(mask) {
            Ok(found) => found,
            Err(rejection) => {
                tracing::debug!(frame = mask.frame.0, ?rejection, "mask rejected");
                self.rejections.count(rejection);
                return None;
            }
        };
        let more = self.current.as_ref().is_some_and(|current| current.request.frame == request.frame);
        let response = request.sent_at.map(|sent| mask.received_at.saturating_duration_since(sent));
        let same_view = self.current.as_ref().filter(|before| before.traced_for == traced_for);
        let (as_of, as_of_begun) = same_view
            .filter(|before| before.as_of > request.frame)
            .map_or((request.frame, request.begun), |before| (before.as_of, before.as_of_begun));
        let is_same = same_view.is_some();
        let before = self.coverage.take().filter(|_| is_same);
        self.coverage = Some(before.map_or_else(|| mask.coverage.clone(), |before| before.or(&mask.coverage)));
        let (bytes, packets) = (mask.payload_bytes, mask.packets);
        self.views.truncate(MAX_LAYERS - 1);
        self.views.push_front((traced_for.clone(), request.frame));
        let (frame, sent_at) = (request.frame, request.sent_at);
        let seen = traced_for.clone();
        self.current = Some(CurrentMask { request, traced_for: seen, as_of, as_of_begun, bytes, packets });
        // Karn's rule for round trips: the response to a repeated pose says nothing about the server. If it counted,
        // one lost frame would make the next loss cost twice as much.
        if self.repeated != Some(frame) && !more {
            let faded = self.slowest_response.map_or(Duration::ZERO, |slowest| slowest * 7 / 8);
            self.slowest_response = response.map(|response| response.max(faded)).or(self.slowest_response);
            let latency = sent_at.map(|sent| shown_at.saturating_duration_since(sent));
            let smoothed = latency.map(|latency| self.latency.map_or(latency, |before| (before * 7 + latency) / 8));
            self.latency = smoothed.or(self.latency);
        }
        Some(MatchedMask { traced_for, more, response })
    }

    /// Counts a mask that was rejected elsewhere.
    pub fn count_rejection(&mut self, rejection: Rejection) {
        self.rejections.count(rejection);
    }

    #[must_use]
    pub fn rejections(&self) -> Rejections {
        self.rejections
    }

    /// Returns the mask that was accepted last.
    #[must_use]
    pub fn current(&self) -> Option<&CurrentMask> {
        self.current.as_ref()
    }

    /// Returns the age in frames of the masks traced for `views`, newest first.
    #[must_use]
    pub fn lags<'a>(&self, frame: FrameNumber, mut views: impl Iterator<Item = &'a Viewpoint>) -> [u32; MAX_LAYERS] {
        let newest = views.next().zip(self.current.as_ref()).map_or(0, |(_, current)| current.lag(frame));
        let requested_by =
            |view: &Viewpoint| self.views.iter().find(|(known, _)| known == view).map(|(_, frame)| frame.0);
        let older = views.map(|view| requested_by(view).map_or(newest, |requested| frame.0.saturating_sub(requested)));
        let mut lags = [newest; MAX_LAYERS];
        lags[1..].iter_mut().zip(older).for_each(|(lag, older)| *lag = older);
        lags
    }

    /// Returns the longest recent response to a pose that was sent once.
    #[must_use]
    pub fn slowest_response(&self) -> Option<Duration> {
        self.slowest_response
    }

    /// Returns how far ahead to trace masks, in milliseconds: the smoothed time from sending a pose to showing its
    /// mask.
    #[must_use]
    pub fn look_ahead_ms(&self) -> u16 {
        let latency = self.latency.map_or(0, |latency| latency.as_millis());
        u16::try_from(latency).unwrap_or(MAX_LOOK_AHEAD_MS).min(MAX_LOOK_AHEAD_MS)
    }
}
