//! One admitted client, from Welcome to its end: the control conversation, and beside it poses in and frames out.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use bytes::Bytes;
use gnomon_protocol::{
    ids::SceneDigest,
    mask::MaskShape,
    message::{ClientMessage, ServerMessage},
    refresh::Refresh,
};
use gnomon_transport::control::{ControlError, ControlReader};
use tokio::{
    sync::{Semaphore, watch},
    task::{JoinError, JoinSet},
    time::{MissedTickBehavior, timeout},
};

use super::{
    driver::{self, DriveError, FrameSender},
    feedback,
    outbox::Outbox,
    poses,
};
use crate::{
    admission::{
        addresses::Addresses,
        capacity::Plan,
        handshake::{Admitted, Coding},
        permit::Admission,
        tokens::store::TokenStore,
    },
    limits,
    metrics::{
        ledger::{Ledger, StageCounts, Totals},
        registry::{About, EndCause, Metrics},
    },
    net::link::{CloseCode, DataLink, Link},
    visibility::engine::{Fleet, SessionPort},
};

/// How far the server's end has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Phase {
    /// Everybody is served.
    Running,
    /// Nobody new is admitted; clients look for another server.
    Draining,
    /// Sessions finish what is on its way, and end.
    Stopping,
}

/// Waits until sessions have to end.
pub(crate) async fn stopping(phase: &mut watch::Receiver<Phase>) {
    // An error says that the server is gone: that is an end as well.
    drop(phase.wait_for(|phase| *phase == Phase::Stopping).await);
}

/// The scene as it travels.
#[derive(Debug)]
pub(crate) struct SceneAsset {
    /// Its packed bytes.
    pub(crate) packed: Bytes,
    /// Their name.
    pub(crate) digest: SceneDigest,
    /// Planes of a mask of it.
    pub(crate) lights: u32,
    /// How much of each counts, as `brightness::weights` has it.
    pub(crate) weights: Vec<u32>,
}

/// What all sessions share.
pub(crate) struct Services {
    pub(crate) scene: SceneAsset,
    pub(crate) engine: Fleet,
    pub(crate) tokens: Option<Arc<TokenStore>>,
    pub(crate) addresses: Arc<Addresses>,
    pub(crate) metrics: Arc<Metrics>,
    pub(crate) admission: Admission,
    pub(crate) plan: Plan,
    pub(crate) phase: watch::Receiver<Phase>,
    pub(crate) encoders: Arc<Semaphore>,
    pub(crate) handshake_timeout: Duration,
    pub(crate) drain_ms: u32,
    pub(crate) alternative: Option<String>,
}

/// How a session ended.
#[derive(Debug)]
enum End {
    /// The client said so, or ended its stream.
    Left,
    /// The server stops.
    Stopping,
    /// The link is gone.
    Lost(String),
    /// The client broke the protocol.
    Violation(String),
    /// The server failed.
    Failed(String),
}

impl End {
    fn of_frames(ended: Result<Result<(), DriveError>, JoinError>) -> Self {
        match ended {
            // Only `Phase::Stopping` ends frames in peace.
            Ok(Ok(())) => Self::Stopping,
            Ok(Err(DriveError::Link(error))) => Self::Lost(error.to_string()),
            Ok(Err(error)) => Self::Failed(error.to_string()),
            Err(panic) => {
                tracing::error!(%panic, "a task of the session broke off");
                Self::Failed("the server failed in this session".to_owned())
            }
        }
    }

    const fn code(&self) -> CloseCode {
        match self {
            Self::Left | Self::Stopping | Self::Lost(_) => CloseCode::Done,
            Self::Violation(_) => CloseCode::Violation,
            Self::Failed(_) => CloseCode::Internal,
        }
    }

    const fn cause(&self) -> EndCause {
        match self {
            Self::Left => EndCause::Left,
            Self::Stopping => EndCause::Stopping,
            Self::Lost(_) => EndCause::Lost,
            Self::Violation(_) => EndCause::Violation,
            Self::Failed(_) => EndCause::Failed,
        }
    }

    fn reason(&self) -> &str {
        match self {
            Self::Left => "the client left",
            Self::Stopping => "the server stops",
            Self::Lost(reason) | Self::Violation(reason) | Self::Failed(reason) => reason,
        }
    }
}

/// Serves an admitted client until it leaves, is lost, or the server stops. Its slot is free afterwards.
pub(crate) async fn run(link: Link, admitted: Admitted, services: Arc<Services>) {
    let started_at = Instant::now();
    let Admitted { slot, port, shape, coding, client, held, share } = admitted;
    let codec = coding.codec;
    tracing::info!(client, width = shape.width(), height = shape.height(), %codec, "session started");
    let closer = link.data.closer();
    let ledger = share.ledger();
    let about = About {
        id: slot.id.0,
        client: client.clone(),
        peer: link.peer,
        carrier: link.carrier,
        size_px: [shape.width(), shape.height()],
        codec: codec.to_string(),
    };
    let mut opened = services.metrics.open(about, Arc::clone(&ledger), closer.clone());
    let mut session = Session {
        reader: link.reader,
        outbox: Outbox::start(link.writer),
        frames: JoinSet::new(),
        waiting: Some(Waiting { data: link.data, port, shape, coding }),
        fetches: 0,
        ledger: Arc::clone(&ledger),
        services,
    };
    let end = tokio::select! {
        end = session.converse() => end,
        () = slot.superseded() => End::Lost("the client went on over another connection".to_owned()),
    };
    if matches!(end, End::Stopping) {
        session.finish_frames().await;
    }
    // Waits for their end: the books are closed below.
    session.frames.shutdown().await;
    if !matches!(end, End::Left | End::Lost(_)) {
        session.outbox.notify(ServerMessage::Closing { reason: end.reason().to_owned() });
        // Closing at once would overtake the message: the client leaves when it has read it.
        session.outbox.finish(limits::LINGER).await;
        let _ = timeout(limits::LINGER, session.reader.drain()).await;
    }
    closer.close(end.code(), end.reason());
    opened.ends(end.cause());
    // It closes the ledger.
    drop(opened);
    ledger.totals().log_end(&client, started_at.elapsed(), end.reason());
    drop((slot, held, share));
}

/// What frames need, until the client says Start.
struct Waiting {
    data: DataLink,
    port: SessionPort,
    shape: MaskShape,
    coding: Coding,
}

struct Session {
    reader: ControlReader<ClientMessage>,
    outbox: Outbox,
    frames: JoinSet<Result<(), DriveError>>,
    waiting: Option<Waiting>,
    fetches: u32,
    ledger: Arc<Ledger>,
    services: Arc<Services>,
}

impl Session {
    /// The control conversation, until something ends the session.
    async fn converse(&mut self) -> End {
        let mut phase = self.services.phase.clone();
        let mut told = Phase::Running;
        let mut books = Books::open(&self.ledger);
        let mut tick = tokio::time::interval(Duration::from_secs(1));
        tick.set_missed_tick_behavior(MissedTickBehavior::Skip);
        tick.tick().await;
        loop {
            let now = *phase.borrow_and_update();
            if now != told {
                told = now;
                match now {
                    Phase::Running => {}
                    Phase::Draining => self.tell_draining(),
                    Phase::Stopping => return End::Stopping,
                }
            }
            tokio::select! {
                message = self.reader.next() => match message {
                    Ok(message) => if let Err(end) = self.answer(&message) {
                        return end;
                    },
                    Err(ControlError::Closed) => return End::Left,
                    Err(error @ ControlError::Stream(_)) => return End::Lost(error.to_string()),
                    Err(error) => return End::Violation(error.to_string()),
                },
                sent = self.outbox.pump(&self.services.scene.packed) => if let Err(error) = sent {
                    return End::Lost(error.to_string());
                },
                Some(ended) = self.frames.join_next() => return End::of_frames(ended),
                _ = tick.tick() => if let Err(end) = books.second(&self.ledger, self.waiting.is_none()) {
                    return end;
                },
                // Without a server nobody needs this session.
                changed = phase.changed() => if changed.is_err() {
                    return End::Stopping;
                },
            }
        }
    }

    fn answer(&mut self, message: &ClientMessage) -> Result<(), End> {
        self.ledger.messages.one();
        let violation = |reason: &str| Err(End::Violation(reason.to_owned()));
        match *message {
            ClientMessage::Ping(number) => {
                // A client that does not read its answers gets fewer.
                self.outbox.answer(ServerMessage::Pong(number));
                Ok(())
            }
            ClientMessage::Bye => Err(End::Left),
            ClientMessage::Hello(_) => violation("a second Hello"),
            ClientMessage::FetchScene { offset } => {
                let length = self.services.scene.packed.len();
                self.fetches += 1;
                if self.waiting.is_none() || self.fetches > limits::MAX_SCENE_FETCHES {
                    return violation("the scene is sent before Start, and not over and over");
                }
                match usize::try_from(offset).ok().filter(|offset| *offset <= length) {
                    Some(offset) => self.outbox.send_scene_from(offset),
                    None => return Err(End::Violation(format!("scene byte {offset} of {length} does not exist"))),
                }
                Ok(())
            }
            ClientMessage::Start => {
                let Some(waiting) = self.waiting.take() else { return violation("a second Start") };
                self.outbox.stop_scene();
                self.start(waiting);
                Ok(())
            }
        }
    }

    /// Lets poses and frames flow, in a task of their own: its panic would end this session only.
    fn start(&mut self, waiting: Waiting) {
        let Waiting { data, port, shape, coding } = waiting;
        let (services, ledger) = (Arc::clone(&self.services), Arc::clone(&self.ledger));
        let work = async move {
            let (receiver, sender) = data.open(services.handshake_timeout).await?;
            let SessionPort { requests, masks, .. } = port;
            let (heard, said) = watch::channel(feedback::Heard::default());
            let sender = FrameSender::new(
                sender,
                coding,
                Refresh::new(services.scene.weights.clone()),
                Arc::clone(&services.encoders),
                said,
            );
            let mut phase = services.phase.clone();
            let poses = async {
                tokio::select! {
                    lost = poses::receive(receiver, &requests, &heard, shape, &ledger) => lost.map(|never| match never {}),
                    // Stopping takes no more poses, but frames on their way need their session.
                    () = stopping(&mut phase) => std::future::pending().await,
                }
            };
            tokio::select! {
                lost = poses => lost.map_err(DriveError::from),
                ended = driver::drive(masks, &requests, sender, &ledger, services.phase.clone()) => ended,
            }
        };
        self.frames.spawn(tracing::Instrument::in_current_span(work));
    }

    fn tell_draining(&mut self) {
        self.outbox.notify(ServerMessage::Draining {
            reason: "the server stops".to_owned(),
            deadline_ms: self.services.drain_ms,
            alternative: self.services.alternative.clone(),
        });
    }

    /// Waits for frames that are on their way.
    async fn finish_frames(&mut self) {
        let finished =
            timeout(limits::FINISH_TIMEOUT, async { while self.frames.join_next().await.is_some() {} }).await;
        if finished.is_err() {
            tracing::warn!("a frame on its way did not finish in {:?}", limits::FINISH_TIMEOUT);
        }
    }
}

/// What is looked at once a second.
struct Books {
    opened_at: Instant,
    heard_at: Instant,
    at: Instant,
    totals: Totals,
    stages: Box<StageCounts>,
}

impl Books {
    fn open(ledger: &Ledger) -> Self {
        let now = Instant::now();
        Self {
            opened_at: now,
            heard_at: now,
            at: now,
            totals: ledger.totals(),
            stages: Box::new(ledger.stages.counts()),
        }
    }

    /// Writes the line of the last second, and ends a session whose client has been silent or noisy for too long.
    fn second(&mut self, ledger: &Ledger, started: bool) -> Result<(), End> {
        let (now, totals) = (Instant::now(), ledger.totals());
        let seconds = now.duration_since(self.at).as_secs_f64();
        let latest = totals.since(&self.totals);
        (self.at, self.totals) = (now, totals);
        if started {
            let stages = ledger.stages.counts();
            latest.log_rates(&stages.since(&self.stages), seconds);
            *self.stages = stages;
        } else if now.duration_since(self.opened_at) > limits::SETUP_TIMEOUT {
            return Err(End::Violation(format!("no Start in {} s", limits::SETUP_TIMEOUT.as_secs())));
        }
        if latest.messages + latest.poses > 0 {
            self.heard_at = now;
        } else if started && now.duration_since(self.heard_at) > limits::SILENCE_TIMEOUT {
            return Err(End::Lost(format!("no pose and no message in {} s", limits::SILENCE_TIMEOUT.as_secs())));
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few seconds")]
        let allowed = limits::MAX_MESSAGES_PER_SECOND * seconds.ceil() as u64;
        if latest.messages > allowed {
            return Err(End::Violation(format!("{} control messages in {seconds:.1} s", latest.messages)));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_panic_ends_its_session_and_is_not_told_to_the_client() {
        let mut frames: JoinSet<Result<(), DriveError>> = JoinSet::new();
        frames.spawn(async { panic!("inner secrets") });
        let end = End::of_frames(frames.join_next().await.unwrap());
        assert_eq!(end.code(), CloseCode::Internal);
        assert!(matches!(&end, End::Failed(reason) if !reason.contains("secrets")), "{end:?}");
    }

    #[test]
    fn silence_noise_and_endless_setups_end_a_session() {
        let ledger = Ledger::default();
        let ago = |time: Duration| Instant::now().checked_sub(time).unwrap();
        let books = |silent: Duration| Books { heard_at: ago(silent), ..Books::open(&ledger) };
        assert!(books(limits::SILENCE_TIMEOUT / 2).second(&ledger, true).is_ok());
        let silent = books(limits::SILENCE_TIMEOUT + Duration::from_secs(1)).second(&ledger, true);
        assert!(matches!(silent, Err(End::Lost(_))));
        let mut late = Books::open(&ledger);
        late.opened_at = ago(limits::SETUP_TIMEOUT + Duration::from_secs(1));
        assert!(late.second(&ledger, true).is_ok());
        assert!(matches!(late.second(&ledger, false), Err(End::Violation(_))));
        let mut noisy = Books::open(&ledger);
        ledger.messages.add(limits::MAX_MESSAGES_PER_SECOND + 1);
        assert!(matches!(noisy.second(&ledger, true), Err(End::Violation(_))));
    }
}
