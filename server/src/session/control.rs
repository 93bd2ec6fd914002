//! A session's control messages.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use gnomon_protocol::{
    message::{ClientMessage, ServerMessage},
    text::PeerText,
};
use gnomon_transport::control::{ControlError, ControlReader};
use tokio::{
    task::JoinSet,
    time::{MissedTickBehavior, timeout},
};

use super::{driver::DriveError, end::End, outbox::Outbox, stream::Stream, watchdog::Watchdog};
use crate::{admission::services::Services, limits, metrics::ledger::Ledger, phase::Phase};

pub(super) struct Session {
    pub(super) reader: ControlReader<ClientMessage>,
    pub(super) outbox: Outbox,
    pub(super) stream_task: JoinSet<Result<(), DriveError>>,
    /// Taken by Start.
    pub(super) stream: Option<Stream>,
    pub(super) fetches: u32,
    pub(super) ledger: Arc<Ledger>,
    pub(super) services: Arc<Services>,
}

impl Session {
    pub(super) async fn converse(&mut self) -> End {
        let mut phase = self.services.phase.clone();
        let mut notified = Phase::Running;
        let mut watchdog = Watchdog::new(&self.ledger);
        let mut tick = tokio::time::interval(Duration::from_secs(1));
        tick.set_missed_tick_behavior(MissedTickBehavior::Skip);
        tick.tick().await;
        loop {
            let now = *phase.borrow_and_update();
            if now != notified {
                notified = now;
                match now {
                    Phase::Running => {}
                    Phase::Draining => self.notify_draining(),
                    Phase::Stopping => return End::Stopping,
                }
            }
            let pace = |bytes| self.services.capacity.scene_chunk(bytes, Instant::now());
            tokio::select! {
                message = self.reader.next() => match message {
                    Ok(message) => if let Err(end) = self.answer(&message) {
                        return end;
                    },
                    Err(ControlError::Closed) => return End::Left,
                    Err(error @ ControlError::Stream(_)) => return End::Lost(error.to_string()),
                    Err(error) => return End::Violation(error.to_string()),
                },
                sent = self.outbox.pump(&self.services.scene.packed, pace) => if let Err(error) = sent {
                    return End::Lost(error.to_string());
                },
                Some(ended) = self.stream_task.join_next() => return End::of_stream(ended),
                _ = tick.tick() => if let Err(end) = watchdog.check(&self.ledger, self.stream.is_none()) {
                    return end;
                },
                // The server was dropped.
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
                // Dropped if the client does not read its answers.
                self.outbox.reply(ServerMessage::Pong(number));
                Ok(())
            }
            ClientMessage::Bye => Err(End::Left),
            ClientMessage::Hello(_) => violation("a second Hello"),
            ClientMessage::FetchScene { offset } => {
                let length = self.services.scene.packed.len();
                self.fetches += 1;
                if self.stream.is_none() || self.fetches > limits::MAX_SCENE_FETCHES {
                    return violation("the scene may be fetched only before Start, and a few times");
                }
                match usize::try_from(offset).ok().filter(|offset| *offset <= length) {
                    Some(offset) => self.outbox.send_scene_from(offset),
                    None => return Err(End::Violation(format!("scene byte {offset} of {length} does not exist"))),
                }
                Ok(())
            }
            ClientMessage::Start => {
                let Some(stream) = self.stream.take() else { return violation("a second Start") };
                self.outbox.stop_scene();
                self.start(stream);
                Ok(())
            }
        }
    }

    /// Starts the stream in its own task, so that a panic ends only this session.
    fn start(&mut self, stream: Stream) {
        let work = stream.run(Arc::clone(&self.services), Arc::clone(&self.ledger));
        self.stream_task.spawn(tracing::Instrument::in_current_span(work));
    }

    fn notify_draining(&mut self) {
        self.outbox.notify(ServerMessage::Draining {
            reason: "the server stops".into(),
            deadline_ms: self.services.drain_ms,
            alternative: self.services.alternative.as_deref().map(PeerText::from),
        });
    }

    /// Waits for the frames in flight.
    pub(super) async fn finish_frames(&mut self) {
        let finished =
            timeout(limits::FINISH_TIMEOUT, async { while self.stream_task.join_next().await.is_some() {} }).await;
        if finished.is_err() {
            tracing::warn!("frames in flight did not finish in {:?}", limits::FINISH_TIMEOUT);
        }
    }
}
