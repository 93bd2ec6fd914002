//! Accepts peers. Each one's handshake and session run in their own task.

use std::{pin::pin, sync::Arc};

use gnomon_protocol::message::Refusal;
use thiserror::Error;
use tokio::{sync::mpsc, task::JoinSet};
use tracing::Instrument as _;

use crate::{
    admission::{
        handshake::{self, AdmittedClient, HandshakeError},
        services::Services,
        time_limit,
    },
    metrics::causes::RefusalCause,
    net::{
        connections::{Expelled, Guard, Place, Tenure, Turned},
        endpoint::{Arrival, ArrivalError, Endpoint, Opening},
        link::{CloseCode, Link, SocketArrival},
        page::PageError,
    },
    phase::stopping,
    session,
};

/// Serves peers until the server stops. Then refuses new peers and waits for the sessions to end.
pub(super) async fn accept(
    endpoint: Arc<Endpoint>,
    mut sockets: mpsc::Receiver<SocketArrival>,
    services: Arc<Services>,
) {
    let mut phase = services.phase.clone();
    let mut sessions = JoinSet::new();
    loop {
        let arrival = async {
            tokio::select! {
                arrival = endpoint.accept() => arrival,
                Some(arrival) = sockets.recv() => Some(Arrival::Socket(Box::new(arrival))),
            }
        };
        tokio::select! {
            arrival = arrival => {
                let Some(arrival) = arrival else { break };
                match services.metrics.connections.arrive(arrival.peer().ip()) {
                    Ok(place) => {
                        let span = tracing::info_span!("peer", address = %arrival.peer());
                        sessions.spawn(serve(arrival, place, Arc::clone(&services)).instrument(span));
                    }
                    Err(turned) => {
                        services.metrics.refused(match turned {
                            Turned::TooFast => RefusalCause::Rate,
                            Turned::TooMany => RefusalCause::Connections,
                        });
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
            Some(arrival) = sockets.recv() => drop(arrival),
        }
    }
}

fn log_panic(ended: Result<(), tokio::task::JoinError>) {
    if let Err(error) = ended {
        tracing::error!(%error, "a session panicked");
    }
}

/// Why a peer was not admitted.
#[derive(Debug, Error)]
enum NotAdmitted {
    #[error("{0}")]
    Arrival(#[from] ArrivalError),
    #[error("{0}")]
    Handshake(#[from] HandshakeError),
    #[error("no Hello in time")]
    Silent,
    #[error("too many connections are being made: try again later")]
    Evicted,
    #[error("too many bytes before Hello")]
    TooMuch,
    #[error("the server stops")]
    Stopping,
}

impl NotAdmitted {
    /// `None` if it was counted where it was decided, or is no fault of either side.
    const fn cause(&self) -> Option<RefusalCause> {
        match self {
            Self::Handshake(HandshakeError::Refused(_)) | Self::Stopping => None,
            Self::Arrival(ArrivalError::Page(PageError::Origin(_))) => Some(RefusalCause::Origin),
            Self::Arrival(_) | Self::Handshake(_) | Self::TooMuch => Some(RefusalCause::Broken),
            Self::Silent => Some(RefusalCause::Silent),
            Self::Evicted => Some(RefusalCause::Handshakes),
        }
    }

    /// Closes the peer's connection, and tells it why.
    async fn tell(&self, guard: Guard) {
        let reason = self.to_string();
        match self {
            // It was told.
            Self::Handshake(HandshakeError::Refused(_)) => guard.finish().await,
            Self::Arrival(ArrivalError::Page(PageError::Origin(_))) => {
                guard.close_now(CloseCode::Refused, "the page's origin is not listed");
            }
            // Its place is wanted now.
            Self::Evicted => guard.close_now(CloseCode::Refused, &reason),
            Self::Stopping => guard.close(CloseCode::Done, &reason).await,
            Self::Arrival(_) | Self::Handshake(_) | Self::Silent | Self::TooMuch => {
                guard.close(CloseCode::Violation, &reason).await;
            }
        }
    }
}

async fn serve(arrival: Arrival, place: (Place, Tenure), services: Arc<Services>) {
    let opened = arrival.open(place).map_err(NotAdmitted::from);
    let (reason, guard) = match opened {
        Ok((guard, opening)) => match greet(&guard, opening, &services).await {
            Ok((link, admitted)) => {
                guard.admit();
                let span = tracing::info_span!("session", id = admitted.permit.id.0, carrier = link.carrier);
                let mut serving = pin!(session::run::run(link, admitted, services).instrument(span));
                tokio::select! {
                    () = &mut serving => {}
                    () = guard.flooded() => {
                        tracing::info!("closed: the peer floods its connection");
                        guard.begin_close(CloseCode::Violation, "too many bytes per second");
                        serving.await;
                    }
                }
                return guard.finish().await;
            }
            Err(reason) => (reason, Some(guard)),
        },
        Err(reason) => (reason, None),
    };
    if let Some(cause) = reason.cause() {
        services.metrics.refused(cause);
    }
    // Wrong tokens are logged as counts.
    if !matches!(reason, NotAdmitted::Handshake(HandshakeError::Refused(Refusal::Token))) {
        tracing::info!(%reason, "not admitted");
    }
    if let Some(guard) = guard {
        reason.tell(guard).await;
    }
}

async fn greet(guard: &Guard, opening: Opening, services: &Services) -> Result<(Link, AdmittedClient), NotAdmitted> {
    let greeting = async {
        let mut link = opening.into_link(guard, services.origins.as_ref()).await?;
        let admitted = handshake::greet(&mut link, services).await?;
        Ok((link, admitted))
    };
    let under_way = || services.metrics.connections.handshakes();
    let mut phase = services.phase.clone();
    tokio::select! {
        greeted = time_limit::within(services.handshake_timeout, under_way, greeting) => {
            greeted.unwrap_or(Err(NotAdmitted::Silent))
        }
        expelled = guard.expelled() => Err(match expelled {
            Expelled::Evicted => NotAdmitted::Evicted,
            Expelled::TooMuch => NotAdmitted::TooMuch,
        }),
        // A peer that has not sent Hello by now does not delay the stop.
        () = stopping(&mut phase) => Err(NotAdmitted::Stopping),
    }
}
