//! The link to a server: sends poses and receives masks. When the server is lost, it reconnects in the background.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use gnomon_client_core::mask::{
    matcher::MaskMatcher,
    received::ReceivedMask,
    world::{Terms, World},
};
use gnomon_protocol::{ids::FrameNumber, mask::MaskShape, pose::Pose};
use tokio::runtime::Runtime;

use super::{
    mask_buffer::{MaskReader, Waited},
    pending_session::PendingSession,
    receive::Received,
    reconnect::{Found, OtherScene, Reconnect},
    scene_cache::SceneCache,
    session::Session,
    state::LinkState,
};
use crate::error::ClientError;

/// Patience for the first mask before its pose is sent again: the server may still be warming up.
const FIRST_RESPONSE: Duration = Duration::from_secs(2);

/// Shortest time before a pose is sent again.
const MIN_PATIENCE: Duration = Duration::from_millis(250);

/// How often a client that waits for its edits looks for the answer.
const SETTLING: Duration = Duration::from_millis(1);

/// Total patience for one frame.
const GIVE_UP: Duration = Duration::from_secs(120);

/// A session with a server, replaced by a new one when the server is lost.
pub(crate) struct ServerLink {
    runtime: Arc<Runtime>,
    cache: SceneCache,
    session: Session,
    masks: MaskReader,
    reconnect: Option<Reconnect>,
    poses_repeated: u32,
    reconnects: u32,
    received_before: Received,
}

/// What [`ServerLink::maintain`] has found.
pub(crate) enum Change {
    /// Poses go over a new connection.
    Reconnected,
    /// The server has another scene. Until [`ServerLink::start`], there are no masks.
    OtherScene(Box<OtherScene>),
}

/// Totals at the end of a link.
#[derive(Debug, Default)]
pub(crate) struct LinkTotals {
    pub(crate) poses_repeated: u32,
    pub(crate) received: Received,
    pub(crate) round_trip: Option<Duration>,
    pub(crate) reconnects: u32,
    /// Why a file of masks could not be written.
    pub(crate) failure: Option<ClientError>,
}

impl ServerLink {
    pub(crate) fn new(runtime: Arc<Runtime>, cache: SceneCache, session: Session, masks: MaskReader) -> Self {
        Self {
            runtime,
            cache,
            session,
            masks,
            reconnect: None,
            poses_repeated: 0,
            reconnects: 0,
            received_before: Received::default(),
        }
    }

    pub(crate) fn state(&self) -> LinkState {
        let health = self.session.health();
        match (&self.reconnect, self.masks.ended(), health.draining) {
            (_, Some(reason), _) if health.dismissed => LinkState::Lost { reason, retry_at: None },
            // The search starts with the next frame.
            (None, Some(reason), _) => LinkState::Lost { reason, retry_at: Some(Instant::now()) },
            (Some(reconnect), Some(_), _) => reconnect.state(),
            (Some(reconnect), None, _) if health.silent => reconnect.state(),
            (_, None, Some(notice)) => LinkState::Draining {
                reason: notice.reason,
                deadline: notice.deadline,
                alternative: notice.alternative,
            },
            (_, None, None) => LinkState::Live,
        }
    }

    /// Starts or ends the search for a new connection. The search runs while the server is lost or silent, or is about
    /// to stop and names an alternative, but never after it has sent the client away. The old connection is used as
    /// long as possible.
    ///
    /// # Errors
    /// Errors if a file of masks could not be written: no other connection can mend that.
    pub(crate) fn maintain(&mut self) -> Result<Option<Change>, ClientError> {
        if let Some(error) = self.session.take_failure() {
            return Err(error);
        }
        if self.is_leaving() {
            return Ok(None);
        }
        let health = self.session.health();
        if health.dismissed {
            self.reconnect = None;
            return Ok(None);
        }
        let lost = self.masks.ended().or_else(|| health.silent.then(|| "the server is silent".to_owned()));
        let alternative = health.draining.and_then(|notice| notice.alternative);
        match (&mut self.reconnect, lost, alternative) {
            (None, None, None) => {}
            (None, lost, alternative) => {
                let reason = lost.unwrap_or_else(|| "the server stops".to_owned());
                let (runtime, spec) = (self.runtime.handle(), self.session.spec().clone());
                self.reconnect = Some(Reconnect::start(runtime, spec, self.cache.clone(), alternative, reason));
            }
            // The outage is over.
            (Some(_), None, None) => self.reconnect = None,
            (Some(reconnect), _, _) => {
                let Some(found) = reconnect.poll() else { return Ok(None) };
                self.reconnect = None;
                return Ok(Some(match found {
                    Found::OtherScene(other) => Change::OtherScene(other),
                    Found::SameScene(found) => {
                        let (session, masks) = *found;
                        self.replace(session, masks);
                        Change::Reconnected
                    }
                }));
            }
        }
        Ok(None)
    }

    /// Starts a session with another scene, with masks of at most `shape`. Blocks.
    ///
    /// # Errors
    /// Errors if the connection breaks. The next [`Self::maintain`] looks for the server again.
    pub(crate) fn start(&mut self, pending: PendingSession, shape: MaskShape) -> Result<(), ClientError> {
        let reception = self.session.spec().reception.clone();
        let (session, masks) = self.runtime.block_on(pending.start(shape, reception))?;
        self.replace(session, masks);
        Ok(())
    }

    fn replace(&mut self, session: Session, masks: MaskReader) {
        tracing::info!(server = %session.spec().url, "connected again");
        self.received_before = self.received();
        self.masks = masks;
        let old = std::mem::replace(&mut self.session, session);
        self.runtime.spawn(old.leave());
        self.reconnects += 1;
    }

    /// Returns whether the run is to end: the session then leaves the server by itself.
    pub(crate) fn is_leaving(&self) -> bool {
        self.session.spec().options.stop.asked().is_some()
    }

    /// How the server keeps its scene.
    pub(crate) fn terms(&self) -> Terms {
        self.session.terms()
    }

    /// Takes what the server has said of its scene, and sends what this client changes.
    pub(crate) fn exchange(&mut self, world: &mut World, now: Instant) {
        self.session.exchange(world, now);
    }

    /// As [`Self::exchange`], until the server has answered every change. Blocks.
    pub(crate) fn settle(&mut self, world: &mut World) {
        let begun = Instant::now();
        self.exchange(world, begun);
        while world.is_waiting() && self.ended().is_none() && begun.elapsed() < GIVE_UP {
            std::thread::sleep(SETTLING);
            self.exchange(world, Instant::now());
        }
    }

    pub(crate) fn send_pose(&self, frame: FrameNumber, pose: Pose) {
        self.session.send_pose(frame, pose);
    }

    /// Returns why no more masks will arrive over this connection, or `None` while they may.
    pub(crate) fn ended(&self) -> Option<String> {
        self.masks.ended()
    }

    /// Takes the masks that have arrived since the last call, oldest first.
    pub(crate) fn take_masks(&mut self) -> impl Iterator<Item = &ReceivedMask> {
        let fresh = self.masks.newest().is_some_and(|(_, fresh)| fresh);
        self.masks.taken().filter(move |_| fresh)
    }

    /// Returns the masks taken last, oldest first.
    pub(crate) fn taken_masks(&self) -> impl Iterator<Item = &ReceivedMask> {
        self.masks.taken()
    }

    /// Waits for exactly this frame's mask, which is then in [`Self::taken_masks`]. Sends the pose again at once if
    /// part of the mask was lost; otherwise after four round trips and twice the slowest recent response. The delay
    /// doubles each time, so that a slow server is not flooded.
    ///
    /// # Errors
    /// Errors with `ended(reason)` if no more masks will arrive, and with [`ClientError::NoVisibility`] after
    /// [`GIVE_UP`].
    pub(crate) fn wait_for(
        &mut self,
        frame: FrameNumber,
        matcher: &mut MaskMatcher,
        ended: impl FnOnce(String) -> ClientError,
    ) -> Result<(), ClientError> {
        let begun = Instant::now();
        let round_trip = self.session.round_trip().unwrap_or_default();
        let usual = matcher.slowest_response().map_or(FIRST_RESPONSE, |slowest| slowest * 2);
        let mut patience = (round_trip * 4).max(MIN_PATIENCE).max(usual);
        let mut asked = 1;
        // True if this frame's mask is in the front buffer and was rejected: waiting for the frame would return at
        // once.
        let mut rejected = false;
        loop {
            let deadline = Instant::now() + patience;
            let mut waited =
                if rejected { self.masks.wait_for_any(deadline) } else { self.masks.wait_for(frame, deadline) };
            if waited == Waited::Arrived {
                let front = self.masks.front().filter(|front| front.frame == frame);
                match front.map(|front| matcher.find(front)) {
                    Some(Ok(_)) => return Ok(()),
                    Some(Err(rejection)) => {
                        // A mask may overtake the news of what it was traced with.
                        self.session.exchange(&mut matcher.world, Instant::now());
                        matcher.count_rejection(rejection);
                        rejected = true;
                        waited = Waited::Lost;
                    }
                    None => {
                        rejected = false;
                        continue;
                    }
                }
            }
            match waited {
                Waited::Ended(reason) => return Err(self.session.take_failure().unwrap_or_else(|| ended(reason))),
                Waited::Arrived | Waited::TimedOut | Waited::Lost if begun.elapsed() > GIVE_UP => {
                    return Err(ClientError::NoVisibility { frame, after: begun.elapsed(), asked });
                }
                waited => {
                    if let Some(request) = matcher.request(frame) {
                        self.session.send_pose_again(frame, request.pose, rejected);
                        matcher.repeated(frame);
                        self.poses_repeated += 1;
                        asked += 1;
                    }
                    if waited == Waited::TimedOut {
                        patience = (patience * 2).min(GIVE_UP / 4);
                    }
                }
            }
        }
    }

    /// Returns the sum over all connections.
    pub(crate) fn received(&self) -> Received {
        self.received_before + self.session.received()
    }

    pub(crate) fn round_trip(&self) -> Option<Duration> {
        self.session.round_trip()
    }

    /// Says goodbye to the server. Blocks.
    pub(crate) fn leave(mut self) -> LinkTotals {
        let totals = LinkTotals {
            poses_repeated: self.poses_repeated,
            received: self.received(),
            round_trip: self.round_trip(),
            reconnects: self.reconnects,
            failure: self.session.take_failure(),
        };
        drop(self.masks);
        let found = self.reconnect.take().and_then(|mut reconnect| reconnect.poll());
        self.runtime.block_on(async {
            match found {
                Some(Found::SameScene(found)) => found.0.leave().await,
                Some(Found::OtherScene(other)) => other.pending.leave().await,
                None => {}
            }
            self.session.leave().await;
        });
        totals
    }
}
