//! The handshake: Hello in, Welcome or a refusal out. No part of the scene is sent before it succeeds.

use std::{net::SocketAddr, sync::Arc, time::Instant};

use gnomon_protocol::{
    PROTOCOL_VERSION,
    limits::{MAX_TEXT_BYTES, MAX_WRONG_PPM},
    mask::MaskShape,
    message::{self, ClientMessage, Hello, Refusal, ServerMessage, Welcome},
    text::PeerText,
};
use gnomon_transport::control::{ControlError, ControlReader};
use thiserror::Error;
use tokio::time::timeout;

use super::{
    capacity::{Demand, OverCapacity, Reservation},
    coding::Coding,
    failed_tokens::BLOCKED,
    permit::{Holding, ResumeClaim, SessionPermit},
    services::Services,
    tokens::{
        file::{Digest, sha256},
        grant::Grant,
    },
};
use crate::{
    limits::{LINGER, MAX_RATE_HZ},
    metrics::causes::RefusalCause,
    net::link::{CloseCode, Link},
    visibility::engine::{OpenError, SessionPort},
    world::{World, WorldOf},
};

/// A client that passed the handshake. The session releases all of its fields when it ends.
pub(crate) struct AdmittedClient {
    pub(crate) permit: SessionPermit,
    /// The session's end of the tracing engine.
    pub(crate) port: SessionPort,
    pub(crate) shape: MaskShape,
    pub(crate) coding: Coding,
    /// Declared masks per second. `None`: as many as others leave.
    pub(crate) rate_hz: Option<f64>,
    /// Name of the client program.
    pub(crate) client: PeerText,
    pub(crate) reservation: Reservation,
    /// Its token; `None` on a server without tokens.
    pub(crate) grant: Option<Grant>,
    pub(crate) world: WorldOf,
}

impl AdmittedClient {
    /// Spends the token and ends the session that this one resumes. Until then a failure leaves both as they were.
    fn take_over(&mut self) {
        if let Some(grant) = &mut self.grant {
            grant.keep();
        }
        self.permit.take_over();
    }
}

type Refused = (RefusalCause, Refusal);

/// A client whose Hello is read, and the session that it alone may resume now.
struct Applicant {
    hello: Hello,
    token: Option<Digest>,
    claim: Option<ResumeClaim>,
}

/// Why a peer was not admitted.
#[derive(Debug, Error)]
pub(crate) enum HandshakeError {
    #[error("refused: {0}")]
    Refused(Refusal),
    #[error(transparent)]
    Control(#[from] ControlError),
    #[error("the client left before its Hello")]
    Left,
    #[error("the client's first message was not Hello")]
    NoHello,
}

/// Reads and answers the Hello. The caller limits the time. Errors if the client is refused (and told) or disconnects.
pub(crate) async fn greet(link: &mut Link, services: &Services) -> Result<AdmittedClient, HandshakeError> {
    let admitted = match read_hello(&mut link.reader).await? {
        Ok(hello) => apply(hello, services).and_then(|applicant| decide(applicant, link.peer, services)),
        Err(refusal) => Err((RefusalCause::Unsupported, refusal)),
    };
    match admitted {
        Ok(mut admitted) => {
            let welcome = Welcome {
                session: admitted.permit.id,
                scene_digest: services.scene.digest,
                scene_bytes: services.scene.packed.len() as u64,
                lights: services.scene.lights,
                backend: shortened(services.engine.description()).into(),
                data_port: link.data.port(),
                resume: admitted.permit.resume,
                may_edit: admitted.world.may_edit,
                shared_world: admitted.world.shared,
                revision: admitted.world.told,
            };
            link.writer.write(&ServerMessage::Welcome(welcome)).await?;
            admitted.take_over();
            Ok(admitted)
        }
        Err((cause, refusal)) => {
            services.metrics.refused(cause);
            link.writer.write(&ServerMessage::Refused(refusal.clone())).await?;
            link.writer.finish().await;
            // Closing at once would overtake the refusal, so wait until the client has read it and left.
            let _ = timeout(LINGER, link.reader.drain()).await;
            link.data.closer().close(CloseCode::Refused, &refusal.to_string());
            Err(HandshakeError::Refused(refusal))
        }
    }
}

/// Returns a refusal if the Hello has another protocol version.
async fn read_hello(reader: &mut ControlReader<ClientMessage>) -> Result<Result<Hello, Refusal>, HandshakeError> {
    let bytes = reader.next_bytes().await.map_err(|error| match error {
        ControlError::Closed => HandshakeError::Left,
        error => error.into(),
    })?;
    match peek_version(&bytes) {
        Some(PROTOCOL_VERSION) => {}
        Some(client) => return Ok(Err(Refusal::Version { server: PROTOCOL_VERSION, client })),
        None => return Err(HandshakeError::NoHello),
    }
    match message::decode(&bytes).map_err(ControlError::from)? {
        ClientMessage::Hello(hello) => Ok(Ok(hello)),
        _ => Err(HandshakeError::NoHello),
    }
}

/// Reads the version in a Hello of any protocol version: message number 0, then the version as a varint.
fn peek_version(bytes: &[u8]) -> Option<u16> {
    let (&0, varint) = bytes.split_first()? else { return None };
    let mut version = 0u32;
    for (index, byte) in varint.iter().take(3).enumerate() {
        version |= u32::from(byte & 0x7f) << (7 * index);
        if byte & 0x80 == 0 {
            return u16::try_from(version).ok();
        }
    }
    None
}

/// Claims the session that the Hello resumes, before anything is decided. Errors if an operator has ended it.
fn apply(hello: Hello, services: &Services) -> Result<Applicant, Refused> {
    let token = services.tokens.as_ref().and(hello.token.as_deref()).map(|token| sha256(token.as_bytes()));
    let claim = services.permits.claim(hello.resume, token).map_err(|refusal| (RefusalCause::Dismissed, refusal))?;
    Ok(Applicant { hello, token, claim })
}

/// Grants all that a session needs, or nothing.
fn decide(applicant: Applicant, peer: SocketAddr, services: &Services) -> Result<AdmittedClient, Refused> {
    let Applicant { hello, token, claim } = applicant;
    let old = claim.as_ref().map(|claim| Arc::clone(&claim.holding));
    // First, so that a stranger learns nothing, not even whether the server is full.
    let grant = check_token(&hello, claim.is_some(), peer, services)?;
    let shape = MaskShape::new(hello.width, hello.height, services.scene.lights)
        .map_err(|error| (RefusalCause::Unsupported, Refusal::Unsupported(error.to_string().into())))?;
    if hello.wrong_ppm > MAX_WRONG_PPM {
        let reason = format!("{} wrong bits per million: at most {MAX_WRONG_PPM} are possible", hello.wrong_ppm);
        return Err((RefusalCause::Unsupported, Refusal::Unsupported(reason.into())));
    }
    let coding = Coding { codec: hello.codec, wrong_ppm: hello.wrong_ppm };
    // A client that comes back from the same address needs no second permit.
    let address = match old.as_ref().filter(|old| old.address.covers(peer.ip())) {
        Some(old) => Arc::clone(&old.address),
        None => services
            .addresses
            .acquire(peer.ip())
            .map(Arc::new)
            .ok_or_else(|| (RefusalCause::Address, services.permits.full()))?,
    };
    let place = services.permits.place(claim.as_ref()).map_err(|refusal| {
        let draining = refusal == Refusal::Draining;
        (if draining { RefusalCause::Draining } else { RefusalCause::Full }, refusal)
    })?;
    let rate_hz = (hello.rate_hz > 0).then(|| f64::from(hello.rate_hz.min(MAX_RATE_HZ)));
    let replaced = old.as_ref().map(|old| &old.costs);
    let port = services.engine.open_instead(shape, rate_hz, replaced).map_err(|error| match error {
        OpenError::Full(_) | OpenError::Busy => (RefusalCause::Full, services.permits.full()),
        OpenError::Overload(reason) => (RefusalCause::Budget, services.permits.busy(shortened(&reason.to_string()))),
        _ => (RefusalCause::Unsupported, Refusal::Unsupported(shortened(&error.to_string()).into())),
    })?;
    let reservation = services
        .capacity
        .reserve(Demand { shape, coding, rate_hz }, old.as_ref().map(|old| &old.share))
        .map_err(|reason| match reason {
            OverCapacity::TooLarge { .. } => (RefusalCause::Budget, Refusal::Unsupported(reason.to_string().into())),
            _ => (RefusalCause::Budget, services.permits.busy(reason.to_string())),
        })?;
    let holding = Holding { token, address, costs: Arc::clone(&port.costs), share: reservation.share() };
    let permit = services.permits.register(place, holding, claim).map_err(|refusal| (RefusalCause::Full, refusal))?;
    let may_edit = grant.as_ref().is_none_or(Grant::may_edit);
    let world = match &services.shared_world {
        Some(world) => WorldOf::shared(world, permit.id, may_edit),
        None => WorldOf::own(World::new(Instant::now()), permit.id, may_edit),
    };
    Ok(AdmittedClient { permit, port, shape, coding, rate_hz, client: hello.client, reservation, grant, world })
}

/// `resumes`: the client has proved that it knows an open session's secret, so its address does not matter.
fn check_token(hello: &Hello, resumes: bool, peer: SocketAddr, services: &Services) -> Result<Option<Grant>, Refused> {
    let Some(tokens) = &services.tokens else { return Ok(None) };
    let (failed, now) = (&services.failed_tokens, Instant::now());
    if let Some(left) = failed.blocked(peer.ip(), now).filter(|_| !resumes) {
        failed.count_blocked(now);
        let retry_after_ms = u32::try_from(left.as_millis()).unwrap_or(u32::MAX);
        return Err((RefusalCause::Token, Refusal::Busy { reason: BLOCKED.into(), retry_after_ms }));
    }
    let claimed = Grant::claim(tokens, hello.token.as_deref(), resumes);
    claimed.map(Some).map_err(|problem| {
        failed.count(peer.ip(), problem, now);
        (RefusalCause::Token, Refusal::Token)
    })
}

/// Cuts a text to [`MAX_TEXT_BYTES`] at a character boundary.
fn shortened(text: &str) -> String {
    let end = (0..=MAX_TEXT_BYTES.min(text.len())).rev().find(|end| text.is_char_boundary(*end)).unwrap_or(0);
    text[..end].to_owned()
}

#[cfg(test)]
mod tests;
