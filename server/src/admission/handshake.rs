//! The handshake: Hello in, Welcome or a refusal out. No part of the scene is sent before it succeeds.

use std::net::SocketAddr;

use gnomon_protocol::{
    PROTOCOL_VERSION,
    codec::CodecId,
    limits::{MAX_TEXT_BYTES, MAX_WRONG_PPM},
    mask::MaskShape,
    message::{self, ClientMessage, Hello, Refusal, ServerMessage, Welcome},
};
use gnomon_transport::control::{ControlError, ControlReader};
use thiserror::Error;
use tokio::time::timeout;

use super::{
    addresses::AddressPermit,
    capacity::Reservation,
    permit::SessionPermit,
    services::Services,
    tokens::{scope::Scope, store::TokenRejection},
};
use crate::{
    limits::LINGER,
    metrics::causes::RefusalCause,
    net::link::{CloseCode, Link},
    visibility::engine::{OpenError, SessionPort},
};

/// A client that passed the handshake. The session releases all of its fields when it ends.
pub(crate) struct AdmittedClient {
    pub(crate) permit: SessionPermit,
    /// The session's end of the tracing engine.
    pub(crate) port: SessionPort,
    pub(crate) shape: MaskShape,
    pub(crate) coding: Coding,
    /// Name of the client program.
    pub(crate) client: String,
    pub(crate) address: AddressPermit,
    pub(crate) reservation: Reservation,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Coding {
    pub(crate) codec: CodecId,
    /// Wrong bits allowed per million.
    pub(crate) wrong_ppm: u16,
}

/// Why a peer was not admitted.
#[derive(Debug, Error)]
pub(crate) enum HandshakeError {
    #[error("{0}")]
    Arrival(String),
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
        Ok(hello) => admit(hello, link.peer, services),
        Err(refusal) => Err((RefusalCause::Unsupported, refusal)),
    };
    match admitted {
        Ok(admitted) => {
            let welcome = Welcome {
                session: admitted.permit.id,
                scene_digest: services.scene.digest,
                scene_bytes: services.scene.packed.len() as u64,
                lights: services.scene.lights,
                backend: shortened(services.engine.description()),
                data_port: link.data.port(),
                resume: admitted.permit.resume,
            };
            link.writer.write(&ServerMessage::Welcome(welcome)).await?;
            Ok(admitted)
        }
        Err((cause, refusal)) => {
            services.metrics.refused(cause);
            link.writer.write(&ServerMessage::Refused(refusal.clone())).await?;
            link.writer.finish().await;
            // Closing at once would overtake the refusal, so wait until the client has read it and left.
            let _ = timeout(LINGER, link.reader.drain()).await;
            link.data.closer().close(CloseCode::Refused, "refused");
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

fn admit(hello: Hello, peer: SocketAddr, services: &Services) -> Result<AdmittedClient, (RefusalCause, Refusal)> {
    // First, so that a stranger learns nothing, not even whether the server is full.
    let token = hello.token.as_deref();
    let refuse = |problem: TokenRejection| {
        tracing::info!(%problem, "token refused");
        (RefusalCause::Token, Refusal::Token)
    };
    let resumes = hello.resume.is_some_and(|secret| services.permits.contains(secret));
    if let Some(tokens) = &services.tokens {
        match tokens.check(token, Scope::Session) {
            // This client spent it on the session that it resumes.
            Err(TokenRejection::Spent) if resumes => {}
            checked => checked.map_err(refuse)?,
        }
    }
    let shape = MaskShape::new(hello.width, hello.height, services.scene.lights)
        .map_err(|error| (RefusalCause::Unsupported, Refusal::Unsupported(error.to_string())))?;
    if hello.wrong_ppm > MAX_WRONG_PPM {
        let reason = format!("{} wrong bits per million: at most {MAX_WRONG_PPM} are possible", hello.wrong_ppm);
        return Err((RefusalCause::Unsupported, Refusal::Unsupported(reason)));
    }
    let coding = Coding { codec: hello.codec, wrong_ppm: hello.wrong_ppm };
    // The resumed session soon releases its address permit.
    let addresses = &services.addresses;
    let address = if resumes { addresses.acquire_over_limit(peer.ip()) } else { addresses.acquire(peer.ip()) };
    let address = address.ok_or_else(|| (RefusalCause::Address, services.permits.full()))?;
    let permit = services.permits.acquire(hello.resume).map_err(|refusal| {
        let draining = refusal == Refusal::Draining;
        (if draining { RefusalCause::Draining } else { RefusalCause::Full }, refusal)
    })?;
    let rate_hz = (hello.rate_hz > 0).then(|| f64::from(hello.rate_hz));
    let port = services.engine.open(shape, rate_hz).map_err(|error| match error {
        OpenError::Full(_) | OpenError::Busy => (RefusalCause::Full, services.permits.full()),
        OpenError::Overload(reason) => (RefusalCause::Budget, services.permits.busy(shortened(&reason.to_string()))),
        _ => (RefusalCause::Unsupported, Refusal::Unsupported(shortened(&error.to_string()))),
    })?;
    let reservation = services
        .capacity
        .reserve(shape, rate_hz)
        .map_err(|reason| (RefusalCause::Budget, services.permits.busy(reason.to_string())))?;
    // Last, so that a refused client does not spend its single-use token.
    if let Some(tokens) = services.tokens.as_ref().filter(|_| !resumes) {
        tokens.admit(token, Scope::Session).map_err(refuse)?;
    }
    Ok(AdmittedClient { permit, port, shape, coding, client: hello.client, address, reservation })
}

/// Cuts a text to [`MAX_TEXT_BYTES`] at a character boundary.
fn shortened(text: &str) -> String {
    let end = (0..=MAX_TEXT_BYTES.min(text.len())).rev().find(|end| text.is_char_boundary(*end)).unwrap_or(0);
    text[..end].to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_version_of_any_hello_can_be_read() {
        for version in [0, 1, 127, 128, 16_383, 16_384, u16::MAX] {
            let hello = Hello {
                version,
                token: Some("t".into()),
                client: "test".into(),
                width: 1,
                height: 1,
                codec: CodecId::PlanesLz4,
                rate_hz: 60,
                wrong_ppm: 0,
                resume: None,
            };
            let bytes = message::encode(&ClientMessage::Hello(hello)).unwrap();
            assert_eq!(peek_version(&bytes[4..]), Some(version));
        }
        let start = message::encode(&ClientMessage::Start).unwrap();
        for bytes in [&[][..], &[0], &[0, 0x80], &[0, 0xff, 0xff, 0xff, 0], &start[4..]] {
            assert_eq!(peek_version(bytes), None, "{bytes:?}");
        }
    }

    #[test]
    fn texts_are_cut_between_characters() {
        let text = "é".repeat(MAX_TEXT_BYTES);
        assert_eq!(shortened(&text).len(), MAX_TEXT_BYTES);
        assert_eq!(shortened(&format!("a{text}")).len(), MAX_TEXT_BYTES - 1);
        assert_eq!(shortened("short"), "short");
    }
}
