//! The control task of a running session: sends pings and handles the server's messages.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use gnomon_client_core::mask::world::News;
use gnomon_protocol::message::{ClientMessage, ServerMessage};
use gnomon_transport::{
    control::{ControlReader, ControlWriter},
    root_cause,
};
use parking_lot::Mutex;
use tokio::{sync::mpsc, time::MissedTickBehavior};

use super::{
    alternative,
    health::{Draining, HealthCell},
    url::Transport,
};

/// Interval of the pings that measure the round trip.
const PING_INTERVAL: Duration = Duration::from_secs(1);

/// The smoothed round trip of pings; `None` before the first answer.
pub(super) type RoundTrip = Arc<Mutex<Option<Duration>>>;

pub(super) struct ControlTask {
    pub(super) reader: ControlReader<ServerMessage>,
    pub(super) writer: ControlWriter<ClientMessage>,
    pub(super) round_trip: RoundTrip,
    pub(super) health: HealthCell,
    /// Of this session: it bounds what the server may name as an alternative.
    pub(super) transport: Transport,
    /// Messages that change the scene.
    pub(super) edits: mpsc::Receiver<ClientMessage>,
    /// Waits while the frame loop does not take them.
    pub(super) news: mpsc::Sender<News>,
}

impl ControlTask {
    /// Runs until the session ends. Returns the reason.
    pub(super) async fn run(&mut self) -> String {
        let mut interval = tokio::time::interval(PING_INTERVAL);
        interval.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut next = 0_u64;
        let mut unanswered: Option<(u64, Instant)> = None;
        loop {
            let event = tokio::select! {
                Some(edit) = self.edits.recv() => {
                    if let Err(error) = self.writer.write(&edit).await {
                        return format!("connection lost: {}", root_cause(&error));
                    }
                    continue;
                }
                _ = interval.tick() => None,
                message = self.reader.next() => Some(message),
            };
            match event {
                // One ping at a time: a late answer only means a long round trip.
                None if unanswered.is_some() => {}
                None => {
                    unanswered = Some((next, Instant::now()));
                    if let Err(error) = self.writer.write(&ClientMessage::Ping(next)).await {
                        return format!("connection lost: {}", root_cause(&error));
                    }
                    next += 1;
                }
                Some(Ok(ServerMessage::Pong(number))) => {
                    if let Some((_, sent)) = unanswered.take_if(|(awaited, _)| *awaited == number) {
                        let mut round_trip = self.round_trip.lock();
                        *round_trip = Some(smoothed(*round_trip, sent.elapsed()));
                    }
                }
                Some(Ok(ServerMessage::Draining { reason, deadline_ms, alternative })) => {
                    let alternative = alternative.and_then(|text| {
                        let refused = |error: &_| tracing::warn!(%error, url = %text, "the server names no usable URL");
                        alternative::alternative(&text, self.transport).inspect_err(refused).ok()
                    });
                    let redirect = alternative.as_ref().map(|url| format!("; continuing at {url}")).unwrap_or_default();
                    tracing::warn!("the server stops in {deadline_ms} ms: {reason}{redirect}");
                    let deadline = Instant::now() + Duration::from_millis(deadline_ms.into());
                    self.health.update(|health| health.draining = Some(Draining { reason, deadline, alternative }));
                }
                Some(Ok(ServerMessage::Closing { reason, may_return })) => {
                    self.health.update(|health| health.dismissed = !may_return);
                    return format!("closed by the server: {reason}");
                }
                Some(Ok(message)) => {
                    let message = match News::try_from(message) {
                        Ok(news) => {
                            // Without a receiver the session is over.
                            let _ = self.news.send(news).await;
                            continue;
                        }
                        Err(message) => message,
                    };
                    let violation = format!("the server violates the protocol: {message:?}");
                    return violation.chars().take(200).collect();
                }
                Some(Err(error)) => return format!("connection lost: {}", root_cause(&error)),
            }
        }
    }

    /// Sends Bye and ends the stream.
    pub(super) async fn leave(&mut self) {
        // The server may have left first.
        let _ = self.writer.write(&ClientMessage::Bye).await;
        self.writer.finish().await;
    }
}

/// Exponential smoothing with weight 1/8 (RFC 6298).
fn smoothed(before: Option<Duration>, sample: Duration) -> Duration {
    before.map_or(sample, |before| (before * 7 + sample) / 8)
}
