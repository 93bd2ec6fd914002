//! A session: introduced, given the scene, started; then three tasks until either side leaves.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use gnomon_protocol::{
    PROTOCOL_VERSION,
    codec::CodecId,
    ids::{FrameNumber, ResumeToken},
    mask::MaskShape,
    message::{ClientMessage, Hello, ServerMessage, Welcome},
    pose::Pose,
    receive::{FrameReceiver, ReceiverConfig},
};
use gnomon_transport::{
    control::{ControlError, ControlReader, ControlWriter},
    root_cause,
};
use tokio::{
    sync::{oneshot, watch},
    task::JoinHandle,
};

use super::{
    connection::{OpenConnection, QuicHandle, ServerConnection},
    health::{Draining, Health, HealthCell, watch_silence},
    mask_buffer::{MaskReader, mask_buffer},
    mask_files::MaskFiles,
    receive::{Counters, ReceiveTask, Received, Requested},
    receive_options::Reception,
    reconnect::Again,
    send::{OutgoingPose, send_poses},
    url::ServerUrl,
};
use crate::{
    error::ClientError,
    link::scene_cache::{CachedScene, SceneCache},
};

/// How often the round trip is measured.
const PING_INTERVAL: Duration = Duration::from_secs(1);

/// How long a server whose data has ended may take to say why.
const LAST_WORDS: Duration = Duration::from_millis(300);

/// How long the server may take for an answer before the session runs.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(30);

/// Who this client is, and what it wants.
#[derive(Debug, Clone)]
pub(crate) struct Introduction {
    pub(crate) token: Option<String>,
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) codec: CodecId,
    /// Masks a second, at most; 0 for as many as it can get.
    pub(crate) rate_hz: u16,
    /// Bits of a frame that may be wrong, in parts of a million.
    pub(crate) wrong_ppm: u16,
    /// The session that this one goes on with.
    pub(crate) resume: Option<ResumeToken>,
    pub(crate) connect_timeout: Duration,
}

/// Frames a second as the Hello says them: `None` is as many as can be had.
pub(crate) fn rate_hz(fps: Option<f64>) -> u16 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the range")]
    fps.map_or(0, |fps| fps.ceil().clamp(1.0, f64::from(u16::MAX)) as u16)
}

/// An admitted client.
pub(crate) struct Admitted {
    url: ServerUrl,
    link: ServerConnection,
    introduction: Introduction,
    pub(crate) welcome: Welcome,
}

/// Connects and introduces the client.
pub(crate) async fn admit(url: &ServerUrl, introduction: &Introduction) -> Result<Admitted, ClientError> {
    let mut link = ServerConnection::connect(url, introduction.connect_timeout).await?;
    let hello = ClientMessage::Hello(Hello {
        version: PROTOCOL_VERSION,
        token: introduction.token.clone(),
        client: concat!("gnomon-client ", env!("CARGO_PKG_VERSION")).to_owned(),
        width: introduction.width,
        height: introduction.height,
        codec: introduction.codec,
        rate_hz: introduction.rate_hz,
        wrong_ppm: introduction.wrong_ppm,
        resume: introduction.resume,
    });
    let url = url.clone();
    let said = async {
        link.writer.write(&hello).await?;
        link.reader.next_within(ANSWER_TIMEOUT).await
    };
    match said.await {
        Ok(ServerMessage::Welcome(welcome)) => Ok(Admitted { url, link, introduction: introduction.clone(), welcome }),
        Ok(ServerMessage::Refused(refusal)) => Err(ClientError::Refused(refusal)),
        Ok(ServerMessage::Closing { reason } | ServerMessage::Draining { reason, .. }) => {
            Err(ClientError::Connect { url: Box::new(url), reason })
        }
        Ok(message) => Err(unexpected(url, &message)),
        Err(source) => Err(broken(url, &link, source)),
    }
}

fn unexpected(url: ServerUrl, message: &ServerMessage) -> ClientError {
    let name = match message {
        ServerMessage::Welcome(_) => "Welcome",
        ServerMessage::Refused(_) => "Refused",
        ServerMessage::SceneChunk { .. } => "SceneChunk",
        ServerMessage::Pong(_) => "Pong",
        ServerMessage::Draining { .. } => "Draining",
        ServerMessage::Closing { .. } => "Closing",
    };
    ClientError::Protocol { url: Box::new(url), reason: format!("{name} came when it should not") }
}

fn broken(url: ServerUrl, link: &ServerConnection, source: ControlError) -> ClientError {
    match (link.close_reason(), &source) {
        (Some(reason), ControlError::Stream(_) | ControlError::Closed | ControlError::Truncated) => {
            ClientError::Connect { url: Box::new(url), reason }
        }
        _ => ClientError::Conversation { url: Box::new(url), source },
    }
}

impl Admitted {
    /// The packed scene: from the cache, or else from the server. `progress` hears how many bytes are there, of how many.
    pub(crate) async fn scene(
        &mut self,
        cache: &SceneCache,
        mut progress: impl FnMut(u64, u64),
    ) -> Result<Vec<u8>, ClientError> {
        let (digest, length) = (self.welcome.scene_digest, self.welcome.scene_bytes);
        let mut fetch = match cache.look_up(digest, length)? {
            CachedScene::Whole(bytes) => return Ok(bytes),
            CachedScene::Missing(fetch) => fetch,
        };
        loop {
            let offset = fetch.fetched();
            let asked = self.link.writer.write(&ClientMessage::FetchScene { offset }).await;
            asked.map_err(|source| broken(self.url.clone(), &self.link, source))?;
            while fetch.fetched() < length {
                match self.link.reader.next_within(ANSWER_TIMEOUT).await {
                    Ok(ServerMessage::SceneChunk { offset, bytes }) => {
                        fetch.append(offset, &bytes)?;
                        progress(fetch.fetched(), length);
                    }
                    Ok(ServerMessage::Pong(_)) => {}
                    Ok(ServerMessage::Closing { reason } | ServerMessage::Draining { reason, .. }) => {
                        return Err(ClientError::Connect { url: Box::new(self.url.clone()), reason });
                    }
                    Ok(message) => return Err(unexpected(self.url.clone(), &message)),
                    Err(source) => return Err(broken(self.url.clone(), &self.link, source)),
                }
            }
            if let Some(bytes) = fetch.finish()? {
                return Ok(bytes);
            }
        }
    }

    /// Tells the server that frames may begin, and starts the tasks.
    pub(crate) async fn start(
        mut self,
        shape: MaskShape,
        reception: Reception,
    ) -> Result<(Session, MaskReader), ClientError> {
        let files = MaskFiles::open(&reception)?;
        let started = self.link.writer.write(&ClientMessage::Start).await;
        started.map_err(|source| broken(self.url.clone(), &self.link, source))?;
        let introduction = Introduction { resume: Some(self.welcome.resume), ..self.introduction };
        let scene_digest = self.welcome.scene_digest;
        let again = Again { url: self.url.clone(), introduction, scene_digest, shape, reception: reception.clone() };
        let url = Box::new(self.url);
        let OpenConnection { reader, writer, sender, receiver, quic } = (self.link.open_data(&self.welcome).await)
            .map_err(|error| ClientError::Connect { url, reason: format!("data: {error}") })?;
        let (mask_writer, mask_reader) = mask_buffer(shape);
        let (poses, outgoing) = watch::channel(None);
        let (acknowledge, acknowledged) = watch::channel(None);
        let (report_losses, losses) = watch::channel(None);
        let (counters, requested) = (Counters::default(), Requested::default());
        let config = ReceiverConfig {
            policy: reception.policy,
            largest: shape,
            // Masks that are saved are decoded alone.
            keeps_references: reception.save_masks.is_none(),
            reports_losses: reception.reports_losses,
        };
        let task = ReceiveTask {
            datagrams: receiver,
            receiver: FrameReceiver::new(config),
            writer: mask_writer,
            requested: requested.clone(),
            counters: Arc::clone(&counters),
            acknowledge,
            report_losses,
            files,
        };
        let (round_trip, health) = (Arc::new(Mutex::new(None)), HealthCell::default());
        let (leave, left) = oneshot::channel();
        let conversation = Conversation { reader, writer, round_trip: Arc::clone(&round_trip), health: health.clone() };
        let silence = watch_silence(quic.clone(), health.clone());
        let tasks =
            tokio::spawn(tasks(conversation, task, send_poses(sender, outgoing, acknowledged, losses), silence, left));
        let session = Session { poses, counters, requested, round_trip, health, quic, leave, tasks, again };
        Ok((session, mask_reader))
    }
}

/// A session that runs.
#[derive(Debug)]
pub(crate) struct Session {
    poses: watch::Sender<OutgoingPose>,
    counters: Counters,
    requested: Requested,
    round_trip: Arc<Mutex<Option<Duration>>>,
    health: HealthCell,
    quic: QuicHandle,
    leave: oneshot::Sender<()>,
    tasks: JoinHandle<()>,
    again: Again,
}

impl Session {
    /// Hands a frame's pose to the send task, in place of one that it has not sent yet.
    pub(crate) fn send_pose(&self, frame: FrameNumber, pose: Pose) {
        self.requested.change(|requests| requests.request(frame));
        self.poses.send_replace(Some((frame, pose)));
    }

    /// Asks once more for a frame that did not come, or whose mask was `refused`.
    pub(crate) fn send_pose_again(&self, frame: FrameNumber, pose: Pose, refused: bool) {
        self.requested.change(|requests| requests.request_again(frame, refused));
        self.send_pose(frame, pose);
    }

    pub(crate) fn received(&self) -> Received {
        *self.counters.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How the link does.
    pub(crate) fn health(&self) -> Health {
        self.health.get()
    }

    /// What it takes to start this session again.
    pub(crate) fn again(&self) -> &Again {
        &self.again
    }

    /// The smoothed round trip of pings, or what the transport measured before the first one was answered.
    pub(crate) fn round_trip(&self) -> Option<Duration> {
        self.round_trip.lock().unwrap_or_else(PoisonError::into_inner).or_else(|| self.quic.round_trip())
    }

    /// Leaves the server in peace.
    pub(crate) async fn leave(self) {
        // A session that has ended already needs no farewell.
        let _ = self.leave.send(());
        let _ = self.tasks.await;
        self.quic.close().await;
    }
}

/// Runs the session's tasks until the client leaves or any of them ends.
async fn tasks(
    mut conversation: Conversation,
    receive: ReceiveTask,
    send: impl Future<Output = std::io::Result<std::convert::Infallible>> + Send + 'static,
    silence: impl Future<Output = ()> + Send,
    left: oneshot::Receiver<()>,
) {
    let renderer = receive.writer.ender();
    // Decoding takes long: in tasks of their own, packets hold up neither pings nor poses.
    let mut receiving = tokio::spawn(receive.run());
    let mut sending = tokio::spawn(send);
    // A dropped writer ends the masks with a reason of its own, so it lives until the right one is said.
    let (reason, _masks) = {
        let mut conversation = std::pin::pin!(conversation.run());
        let data = async {
            tokio::select! {
                ended = &mut receiving => match ended {
                    Ok((reason, masks)) => (reason, Some(masks)),
                    Err(error) => (error.to_string(), None),
                },
                ended = &mut sending => match ended {
                    Ok(Ok(never)) => match never {},
                    Ok(Err(error)) => (format!("connection lost: {}", root_cause(&error)), None),
                    Err(error) => (error.to_string(), None),
                },
            }
        };
        tokio::select! {
            _ = left => (None, None),
            // It never ends before the others.
            () = silence => (None, None),
            reason = &mut conversation => (Some(reason), None),
            // Data and control end together, and the control stream says why.
            (reason, masks) = data => {
                let last_words = tokio::time::timeout(LAST_WORDS, conversation).await;
                (Some(last_words.unwrap_or(reason)), masks)
            }
        }
    };
    match reason {
        Some(reason) => renderer.end(reason),
        None => {
            let _ = conversation.writer.write(&ClientMessage::Bye).await;
            conversation.writer.finish().await;
        }
    }
    receiving.abort();
    sending.abort();
}

/// The control conversation of a session that runs.
struct Conversation {
    reader: ControlReader<ServerMessage>,
    writer: ControlWriter<ClientMessage>,
    round_trip: Arc<Mutex<Option<Duration>>>,
    health: HealthCell,
}

impl Conversation {
    /// Pings, and listens for what ends the session, which is given back.
    async fn run(&mut self) -> String {
        let mut interval = tokio::time::interval(PING_INTERVAL);
        interval.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut next = 0_u64;
        let mut waiting: Option<(u64, Instant)> = None;
        loop {
            tokio::select! {
                _ = interval.tick() => {
                    // One at a time: a late answer is a long round trip, not a reason for more questions.
                    if waiting.is_none() {
                        waiting = Some((next, Instant::now()));
                        if let Err(error) = self.writer.write(&ClientMessage::Ping(next)).await {
                            return format!("connection lost: {}", root_cause(&error));
                        }
                        next += 1;
                    }
                }
                message = self.reader.next() => match message {
                    Ok(ServerMessage::Pong(number)) => {
                        if let Some((_, sent)) = waiting.take_if(|(waited, _)| *waited == number) {
                            let mut place = self.round_trip.lock().unwrap_or_else(PoisonError::into_inner);
                            *place = Some(smoothed(*place, sent.elapsed()));
                        }
                    }
                    Ok(ServerMessage::Draining { reason, deadline_ms, alternative }) => {
                        let elsewhere = alternative.as_ref().map(|url| format!("; go on at {url}")).unwrap_or_default();
                        tracing::warn!("the server stops in {deadline_ms} ms: {reason}{elsewhere}");
                        let deadline = Instant::now() + Duration::from_millis(deadline_ms.into());
                        self.health.update(|health| health.draining = Some(Draining { reason, deadline, alternative }));
                    }
                    Ok(ServerMessage::Closing { reason }) => return format!("the server closed it: {reason}"),
                    Ok(message @ (ServerMessage::Welcome(_) | ServerMessage::Refused(_) | ServerMessage::SceneChunk { .. })) => {
                        let surprise = format!("the server does not keep to the protocol: {message:?}");
                        return surprise.chars().take(200).collect();
                    }
                    Err(error) => return format!("connection lost: {}", root_cause(&error)),
                },
            }
        }
    }
}

/// A new sample counts for an eighth, as in TCP (RFC 6298).
fn smoothed(before: Option<Duration>, sample: Duration) -> Duration {
    before.map_or(sample, |before| (before * 7 + sample) / 8)
}
