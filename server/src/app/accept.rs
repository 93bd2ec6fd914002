//! Accepts peers. Each one's handshake and session run in their own task.

use std::sync::Arc;

use tokio::{
    sync::{OwnedSemaphorePermit, Semaphore},
    task::JoinSet,
};
use tracing::Instrument as _;

use crate::{
    admission::{
        addresses::{AddressLimit, AddressPermit},
        handshake::{self, HandshakeError},
        services::Services,
        time_limit,
    },
    limits,
    metrics::causes::RefusalCause,
    net::{
        endpoint::{Arrival, ArrivalError, Endpoint},
        page::PageError,
    },
    phase::stopping,
    session,
};

/// Serves peers until the server stops. Then refuses new peers and waits for the sessions to end.
pub(super) async fn accept(endpoint: Arc<Endpoint>, services: Arc<Services>) {
    let handshakes = Arc::new(Semaphore::new(limits::MAX_HANDSHAKES));
    let addresses = AddressLimit::new(limits::MAX_HANDSHAKES_PER_ADDRESS, true);
    let mut phase = services.phase.clone();
    let mut sessions = JoinSet::new();
    loop {
        tokio::select! {
            arrival = endpoint.accept() => {
                let Some(arrival) = arrival else { break };
                let permit = Arc::clone(&handshakes).try_acquire_owned().ok();
                match permit.zip(addresses.acquire(arrival.peer().ip())) {
                    Some(handshake) => {
                        let span = tracing::info_span!("peer", address = %arrival.peer());
                        sessions.spawn(serve(arrival, handshake, Arc::clone(&services)).instrument(span));
                    }
                    None => {
                        services.metrics.refused(RefusalCause::Handshakes);
                        arrival.refuse();
                    }
                }
            }
            Some(ended) = sessions.join_next() => log_panic(ended),
            () = stopping(&mut phase) => break,
        }
    }
    while !sessions.is_empty() {
        tokio::select! {
            Some(ended) = sessions.join_next() => log_panic(ended),
            Some(arrival) = endpoint.accept() => arrival.refuse(),
        }
    }
}

fn log_panic(ended: Result<(), tokio::task::JoinError>) {
    if let Err(error) = ended {
        tracing::error!(%error, "a session panicked");
    }
}

async fn serve(arrival: Arrival, handshake: (OwnedSemaphorePermit, AddressPermit), services: Arc<Services>) {
    let greeting = async {
        let mut link = arrival.into_link(services.origins.as_ref()).await.map_err(|error| match error {
            ArrivalError::Page(PageError::Origin(_)) => HandshakeError::Origin(error.to_string()),
            error => HandshakeError::Arrival(error.to_string()),
        })?;
        let admitted = handshake::greet(&mut link, &services).await?;
        Ok::<_, HandshakeError>((link, admitted))
    };
    let mut phase = services.phase.clone();
    let greeted = tokio::select! {
        greeted = time_limit::within(services.handshake_timeout, &handshake.0, greeting) => greeted,
        // A peer that has not sent Hello by now does not delay the stop.
        () = stopping(&mut phase) => return tracing::info!(reason = "the server stops", "not admitted"),
    };
    let (link, admitted) = match greeted {
        Some(Ok(greeted)) => greeted,
        Some(Err(error)) => {
            // Refusals were counted where they were made, with their cause.
            match error {
                HandshakeError::Refused(_) => {}
                HandshakeError::Origin(_) => services.metrics.refused(RefusalCause::Origin),
                _ => services.metrics.refused(RefusalCause::Broken),
            }
            return tracing::info!(reason = %error, "not admitted");
        }
        None => {
            services.metrics.refused(RefusalCause::Silent);
            return tracing::info!(reason = "no Hello in time", "not admitted");
        }
    };
    drop(handshake);
    let span = tracing::info_span!("session", id = admitted.permit.id.0, carrier = link.carrier);
    session::run::run(link, admitted, services).instrument(span).await;
}
