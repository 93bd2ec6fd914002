//! A session's control messages.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use gnomon_protocol::{
    edit::Edit,
    message::{ClientMessage, ServerMessage},
    text::PeerText,
};
use gnomon_transport::control::{ControlError, ControlReader};
use tokio::{
    task::JoinSet,
    time::{MissedTickBehavior, timeout},
};

use super::{driver::DriveError, end::End, outbox::Outbox, stream::Stream, watchdog::Watchdog};
use crate::{admission::services::Services, limits, metrics::ledger::Ledger, phase::Phase, world::WorldOf};

pub(super) struct Session {
    pub(super) reader: ControlReader<ClientMessage>,
    pub(super) outbox: Outbox,
    pub(super) stream_task: JoinSet<Result<(), DriveError>>,
    /// Taken by Start.
    pub(super) stream: Option<Stream>,
    pub(super) fetches: u32,
    pub(super) world: WorldOf,
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
        let mut revisions = self.world.world.subscribe();
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
                    Ok(message) => if let Err(end) = self.answer(message) {
                        return end;
                    },
                    Err(ControlError::Closed) => return End::Left,
                    Err(error @ ControlError::Stream(_)) => return End::Lost(error.to_string()),
                    Err(error) => return End::Violation(error.to_string()),
                },
                sent = self.outbox.pump(&self.services.scene.packed, pace) => if let Err(error) = sent {
                    return End::Lost(error.to_string());
                },
                // A client that does not read is told later, and then perhaps the whole state.
                changed = revisions.changed(), if self.stream.is_none() && self.outbox.is_empty() => {
                    if changed.is_err() {
                        return End::Stopping;
                    }
                    self.tell_news();
                }
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

    fn answer(&mut self, message: ClientMessage) -> Result<(), End> {
        self.ledger.messages.one();
        let violation = |reason: &str| Err(End::Violation(reason.to_owned()));
        match message {
            ClientMessage::Ping(number) => {
                // Dropped if the client does not read its answers.
                self.outbox.reply(ServerMessage::Pong(number));
                if let Some(clock) = self.world.clock().filter(|_| self.stream.is_none()) {
                    self.outbox.reply(clock);
                }
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
                for message in self.world.begin().into_iter().chain(self.world.clock()) {
                    self.outbox.notify(message);
                }
                self.tell_news();
                self.start(stream);
                Ok(())
            }
            ClientMessage::Edit { number, edits } => self.edit(number, edits),
        }
    }

    fn edit(&mut self, number: u32, edits: Vec<Edit>) -> Result<(), End> {
        if self.stream.is_some() {
            return Err(End::Violation("an edit before Start".to_owned()));
        }
        self.ledger.edits.one();
        if let Err(reason) = self.world.edit(number, edits, &self.services.scene.stage) {
            self.ledger.edits_refused.one();
            tracing::debug!(number, reason, "an edit is refused");
            self.outbox.reply(ServerMessage::EditRefused { number, reason: reason.as_str().into() });
        }
        Ok(())
    }

    /// Tells the client of the scene's new states.
    fn tell_news(&mut self) {
        for message in self.world.news() {
            self.outbox.notify(message);
        }
    }

    /// Starts the stream in its own task, so that a panic ends only this session.
    fn start(&mut self, stream: Stream) {
        let world = Arc::clone(&self.world.world);
        let work = stream.run(Arc::clone(&self.services), world, Arc::clone(&self.ledger));
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
