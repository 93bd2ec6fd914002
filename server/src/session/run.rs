//! A session's lifetime: setup, control messages, frames in flight, goodbye, counters.

use std::{sync::Arc, time::Instant};

use gnomon_protocol::message::ServerMessage;
use tokio::{task::JoinSet, time::timeout};

use super::{control::Session, end::End, outbox::Outbox, stream::Stream};
use crate::{
    admission::{end_reason::EndReason, handshake::AdmittedClient, services::Services, tokens::grant::Grant},
    limits,
    metrics::registry::About,
    net::link::Link,
};

/// Serves an admitted client until it leaves, is lost, or the server stops. Then releases its permits.
pub(crate) async fn run(link: Link, admitted: AdmittedClient, services: Arc<Services>) {
    let started_at = Instant::now();
    let AdmittedClient { mut permit, port, shape, coding, rate_hz, client, reservation, mut grant, world } = admitted;
    let codec = coding.codec;
    tracing::info!(%client, width = shape.width(), height = shape.height(), %codec, "session started");
    let closer = link.data.closer();
    let ledger = reservation.ledger();
    let about = About {
        id: permit.id.0,
        client: client.to_string(),
        peer: link.peer,
        carrier: link.carrier,
        size_px: [shape.width(), shape.height()],
        codec: codec.to_string(),
        token: grant.as_ref().map(|grant| grant.name().to_owned()),
        declared_hz: rate_hz,
    };
    let mut registration = services.metrics.register(about, Arc::clone(&ledger), closer.clone());
    let mut session = Session {
        reader: link.reader,
        outbox: Outbox::start(link.writer),
        stream_task: JoinSet::new(),
        stream: Some(Stream { data: link.data, port, shape, coding, in_background: rate_hz.is_none() }),
        fetches: 0,
        world,
        ledger: Arc::clone(&ledger),
        services,
    };
    let end = tokio::select! {
        end = session.converse() => end,
        reason = permit.ended() => End::by(reason),
        reason = token_ended(&mut grant) => End::by(reason),
    };
    if matches!(end, End::Stopping) {
        session.finish_frames().await;
    }
    // Its tasks must end before the ledger is closed below.
    session.stream_task.shutdown().await;
    closer.announce(end.code(), &end.reason());
    if !matches!(end, End::Left | End::Lost(_)) {
        let (reason, may_return) = (end.reason().as_ref().into(), end.may_return());
        session.outbox.notify(ServerMessage::Closing { reason, may_return });
        // Closing at once would overtake the message, so wait until the client has read it and left.
        session.outbox.finish(limits::LINGER).await;
        let _ = timeout(limits::LINGER, session.reader.drain()).await;
    }
    closer.close(end.code(), &end.reason());
    registration.set_cause(end.cause());
    // Closes the ledger.
    drop(registration);
    ledger.totals().log_end(&client, started_at.elapsed(), &end.reason());
    drop((permit, reservation, grant));
}

/// Waits until the session's token is withdrawn or expires.
async fn token_ended(grant: &mut Option<Grant>) -> EndReason {
    match grant {
        Some(grant) => grant.ended().await,
        None => std::future::pending().await,
    }
}
