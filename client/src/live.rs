//! The server's end of a run: poses go out, masks come in and are matched with what was asked for. A server that is lost is
//! looked for while the client draws on.

use std::{
    collections::VecDeque,
    sync::Arc,
    time::{Duration, Instant},
};

use gnomon_protocol::{coverage::Coverage, ids::FrameNumber, limits::MAX_LAYERS};
use gnomon_scene::camera::Camera;
use tokio::runtime::Runtime;

use crate::{
    error::ClientError,
    link::{receive::Received, reconnect::Redial, session::Session, state::LinkState},
    mask_buffer::{MaskReader, ReceivedMask, Waited},
    pose_history::{Asked, PoseHistory, Rejection, Rejections},
    render::{FrameRenderer, RenderError, predict::MaskView},
};

/// How long the first mask may take before its pose is sent again: the server may still warm up.
const FIRST_RESPONSE: Duration = Duration::from_secs(2);

/// Least time before a pose is sent again.
const LEAST_PATIENCE: Duration = Duration::from_millis(250);

/// How long one frame is waited for in all.
const GIVE_UP: Duration = Duration::from_secs(120);

/// How often a mask is asked for while the camera stands still and its mask is there: often enough that the server stays warm, and
/// seldom enough that standing still costs nothing.
const REFRESH: Duration = Duration::from_secs(1);

/// A server that masks come from.
pub(crate) struct Live {
    pub(crate) runtime: Arc<Runtime>,
    pub(crate) session: Session,
    pub(crate) masks: MaskReader,
    /// The mask that the renderer has.
    pub(crate) current: Option<Current>,
    /// What has come for its view, of it and of those before it that were for the same.
    covered: Option<Coverage>,
    /// What it and those before it were traced for, and the frames that asked for them: as many as the renderer keeps.
    views: VecDeque<(Camera, FrameNumber)>,
    pub(crate) rejections: Rejections,
    pub(crate) poses_repeated: u32,
    /// Longest response of late, to poses that were sent once: a maximum that fades.
    slowest_response: Option<Duration>,
    /// The last frame whose pose was sent more than once.
    repeated: Option<FrameNumber>,
    /// From a pose's departure until the frame that showed its mask, smoothed.
    pub(crate) way: Option<Duration>,
    /// When a pose left last.
    asked_at: Option<Instant>,
    redial: Option<Redial>,
    /// What earlier connections have brought.
    received_before: Received,
    /// How often a server was found again.
    pub(crate) reconnects: u32,
}

/// The mask that the renderer has, and what it was asked for with.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Current {
    pub(crate) asked: Asked,
    /// What it was traced for.
    view: Camera,
    /// The newest frame that it is the whole answer to: its own, or a later one of a camera that has not moved since.
    as_of: FrameNumber,
    /// Bytes of its frame on the wire, packet headers not counted.
    pub(crate) bytes: usize,
    pub(crate) packets: u16,
}

/// What the renderer has just been given: the newest mask, and those before it that it lies over.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Taken {
    /// From its pose's departure until it came.
    pub(crate) response: Option<Duration>,
    /// What handing it to the renderer took.
    pub(crate) upload: Duration,
}

impl Current {
    /// Frames since this mask was the answer.
    pub(crate) fn lag(&self, frame: FrameNumber) -> u32 {
        frame.0.saturating_sub(self.as_of.0)
    }
}

impl Live {
    pub(crate) fn new(runtime: Arc<Runtime>, session: Session, masks: MaskReader) -> Self {
        Self {
            runtime,
            session,
            masks,
            current: None,
            covered: None,
            views: VecDeque::new(),
            rejections: Rejections::default(),
            poses_repeated: 0,
            slowest_response: None,
            repeated: None,
            way: None,
            asked_at: None,
            redial: None,
            received_before: Received::default(),
            reconnects: 0,
        }
    }

    /// How the client stands with its server.
    pub(crate) fn link_state(&self) -> LinkState {
        let health = self.session.health();
        match (&self.redial, self.masks.ended(), health.draining) {
            (None, Some(reason), _) => LinkState::Lost { reason, retry_at: None },
            (Some(redial), Some(_), _) => redial.state(),
            (Some(redial), None, _) if health.silent => redial.state(),
            (_, None, Some(notice)) => LinkState::Draining {
                reason: notice.reason,
                deadline: notice.deadline,
                alternative: notice.alternative,
            },
            (_, None, None) => LinkState::Live,
        }
    }

    /// Looks after the connection, before `frame` is asked for: when the server is lost, silent, or about to stop and has named
    /// another one, a new connection is looked for, and taken when it is there. The old one serves for as long as it can.
    pub(crate) fn tend(&mut self, frame: FrameNumber, history: &mut PoseHistory) {
        let health = self.session.health();
        let lost = self.masks.ended().or_else(|| health.silent.then(|| "the server is silent".to_owned()));
        let elsewhere = health.draining.and_then(|notice| {
            let url = notice.alternative?;
            url.parse().inspect_err(|error| tracing::warn!(%error, url, "the server names no server")).ok()
        });
        match (&mut self.redial, lost, elsewhere) {
            (None, None, None) => {}
            (None, lost, elsewhere) => {
                let reason = lost.unwrap_or_else(|| "the server stops".to_owned());
                let (runtime, again) = (self.runtime.handle(), self.session.again().clone());
                self.redial = Some(Redial::start(runtime, again, elsewhere, reason));
            }
            // It was an outage, and it is over.
            (Some(_), None, None) => self.redial = None,
            (Some(redial), _, _) => {
                if let Some((session, masks)) = redial.take_found() {
                    tracing::info!(server = %session.again().url, "connected again");
                    self.redial = None;
                    self.received_before = sum(self.received_before, self.session.received());
                    self.masks = masks;
                    let old = std::mem::replace(&mut self.session, session);
                    self.runtime.spawn(old.leave());
                    self.asked_at = None;
                    self.reconnects += 1;
                    history.reconnected(frame);
                }
            }
        }
    }

    /// Whether a frame that is looked at from `view` should be asked for: not when there is nobody to ask, and not when all that
    /// there is to see from there has come, except now and then.
    pub(crate) fn should_ask(&mut self, frame: FrameNumber, view: &Camera, now: Instant) -> bool {
        if self.masks.ended().is_some() {
            return false;
        }
        let whole = self.covered.as_ref().is_some_and(Coverage::is_whole);
        let answered = self.current.as_mut().filter(|current| whole && current.view == *view);
        let idle = answered.is_some();
        if let Some(current) = answered {
            current.as_of = frame;
        }
        let recent = self.asked_at.is_some_and(|asked| now.saturating_duration_since(asked) < REFRESH);
        let ask = !idle || !recent;
        if ask {
            self.asked_at = Some(now);
        }
        ask
    }

    /// What has come over all connections.
    pub(crate) fn received(&self) -> Received {
        sum(self.received_before, self.session.received())
    }

    /// Frames that the masks in the renderer are older than this frame's picture, the newest first.
    pub(crate) fn lags<'a>(
        &self,
        frame: FrameNumber,
        mut views: impl Iterator<Item = &'a Camera>,
    ) -> [u32; MAX_LAYERS] {
        let newest = views.next().zip(self.current).map_or(0, |(_, current)| current.lag(frame));
        let asked = |view: &Camera| self.views.iter().find(|(known, _)| known == view).map(|(_, asked)| asked.0);
        let before = views.map(|view| asked(view).map_or(newest, |asked| frame.0.saturating_sub(asked)));
        let mut lags = [newest; MAX_LAYERS];
        lags[1..].iter_mut().zip(before).for_each(|(lag, before)| *lag = before);
        lags
    }

    /// How far ahead masks should be traced, in milliseconds.
    pub(crate) fn look_ahead_ms(&self) -> u16 {
        let most = gnomon_protocol::limits::MAX_LOOK_AHEAD_MS;
        self.way.map_or(0, |way| u16::try_from(way.as_millis()).unwrap_or(most).min(most))
    }

    /// Gives the renderer the newest mask, when there is one that it has not seen and that answers something.
    pub(crate) fn take_newest(
        &mut self,
        history: &PoseHistory,
        renderer: &mut FrameRenderer,
        shown_at: Instant,
    ) -> Result<Taken, RenderError> {
        let fresh = self.masks.newest().is_some_and(|(_, fresh)| fresh);
        if fresh { self.take_front(history, renderer, shown_at) } else { Ok(Taken::default()) }
    }

    /// Waits for exactly this frame's mask and gives it to the renderer. Asks again for it: at once when a part of it was
    /// lost, or else after some round trips and longer than masks took of late, and then after twice as long each time, so that
    /// a slow server is not asked in vain. `ended` makes an error of the reason why no more masks will come.
    pub(crate) fn wait_for(
        &mut self,
        frame: FrameNumber,
        history: &PoseHistory,
        ended: impl FnOnce(String) -> ClientError,
    ) -> Result<(), ClientError> {
        let begun = Instant::now();
        let round_trip = self.session.round_trip().unwrap_or_default();
        let usual = self.slowest_response.map_or(FIRST_RESPONSE, |slowest| slowest * 2);
        let mut patience = (round_trip * 4).max(LEAST_PATIENCE).max(usual);
        let mut asked = 1;
        // Whether the mask in the front buffer is this frame's and was refused: it is of no use to wait for it again.
        let mut refused = false;
        loop {
            let deadline = Instant::now() + patience;
            let mut waited =
                if refused { self.masks.wait_for_any(deadline) } else { self.masks.wait_for(frame, deadline) };
            if waited == Waited::Arrived {
                let front = self.masks.front().filter(|front| front.frame == frame);
                match front.map(|front| history.answered(frame, front.mask.shape())) {
                    Some(Ok(_)) => return Ok(()),
                    Some(Err(rejection)) => {
                        self.rejections.count(rejection);
                        refused = true;
                        waited = Waited::Lost;
                    }
                    None => {
                        refused = false;
                        continue;
                    }
                }
            }
            match waited {
                Waited::Ended(reason) => return Err(ended(reason)),
                Waited::Arrived | Waited::TimedOut | Waited::Lost if begun.elapsed() > GIVE_UP => {
                    return Err(ClientError::NoVisibility { frame, after: begun.elapsed(), asked });
                }
                waited => {
                    if let Some(sent) = history.get(frame) {
                        self.session.send_pose_again(frame, sent.pose, refused);
                        self.repeated = Some(frame);
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

    /// Gives the renderer the masks that were taken last. One that answers nothing is counted and passed over: the renderer keeps
    /// what it has.
    pub(crate) fn take_front(
        &mut self,
        history: &PoseHistory,
        renderer: &mut FrameRenderer,
        shown_at: Instant,
    ) -> Result<Taken, RenderError> {
        let mut all = Taken::default();
        for received in self.masks.taken() {
            let (asked, traced_for) = match view_of(received, history) {
                Ok(view) => view,
                Err(rejection) => {
                    tracing::debug!(frame = received.frame.0, ?rejection, "a mask that answers nothing");
                    self.rejections.count(rejection);
                    continue;
                }
            };
            let begun = Instant::now();
            // How long it took has been measured.
            let more = self.current.is_some_and(|current| current.asked.frame == asked.frame);
            let (mask, coverage) = (&received.mask, Some(&received.coverage));
            renderer.set_mask(Some(MaskView { mask, coverage, more, traced_for: &traced_for }))?;
            all.upload += begun.elapsed();
            let response = asked.sent_at.map(|sent| received.received_at.saturating_duration_since(sent));
            all.response = response;
            let before = self.current.filter(|before| before.view == traced_for);
            let as_of = before.map_or(asked.frame, |before| before.as_of.max(asked.frame));
            let covered = self.covered.take().filter(|_| before.is_some());
            self.covered =
                Some(covered.map_or_else(|| received.coverage.clone(), |before| before.or(&received.coverage)));
            self.current = Some(Current {
                asked,
                view: traced_for,
                as_of,
                bytes: received.payload_bytes,
                packets: received.packets,
            });
            self.views.truncate(MAX_LAYERS - 1);
            self.views.push_front((traced_for, asked.frame));
            // What a repeated pose took says nothing about the server (Karn's rule for round trips): taken for a response, a
            // lost frame would make the next loss cost twice as much.
            if self.repeated != Some(asked.frame) && !more {
                let faded = self.slowest_response.map_or(Duration::ZERO, |slowest| slowest * 7 / 8);
                self.slowest_response = response.map(|response| response.max(faded)).or(self.slowest_response);
                let way = asked.sent_at.map(|sent| shown_at.saturating_duration_since(sent));
                self.way = way.map(|way| self.way.map_or(way, |before| (before * 7 + way) / 8)).or(self.way);
            }
        }
        Ok(all)
    }
}

/// What a mask was asked for with, and the view that it was traced for, if it answers something.
pub(crate) fn view_of(received: &ReceivedMask, history: &PoseHistory) -> Result<(Asked, Camera), Rejection> {
    let asked = *history.answered(received.frame, received.mask.shape())?;
    let traced_for = received.traced_for.map_or(asked.mask_camera, |pose| {
        Camera::of_pose(pose.position_m, pose.orientation, pose.yfov_rad, asked.pose.mask_px)
    });
    Ok((asked, traced_for))
}

/// What has come in two connections' lives.
fn sum(mut all: Received, more: Received) -> Received {
    all.frames += more.frames;
    all.cut += more.cut;
    all.partial += more.partial;
    all.incomplete += more.incomplete;
    all.future += more.future;
    all.bad += more.bad;
    all.payload_bytes += more.payload_bytes;
    all.packets += more.packets;
    all
}
