//! The first exchange: Hello in, Welcome or a refusal out. Nothing of the scene leaves before it is done.

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
    addresses::Held,
    capacity::Share,
    permit::Slot,
    tokens::store::{Scope, TokenProblem},
};
use crate::{
    limits::LINGER,
    metrics::registry::RefusalCause,
    net::link::{CloseCode, Link},
    session::run::Services,
    visibility::engine::{OpenError, SessionPort},
};

/// What was agreed on with an admitted client.
pub(crate) struct Admitted {
    /// The place that the session takes.
    pub(crate) slot: Slot,
    /// The session's end of the engine.
    pub(crate) port: SessionPort,
    /// Size of its masks.
    pub(crate) shape: MaskShape,
    /// How its frames are coded.
    pub(crate) coding: Coding,
    /// Name of the client program.
    pub(crate) client: String,
    /// Its share of what its address may have.
    pub(crate) held: Held,
    /// Its part of what cores and network bear.
    pub(crate) share: Share,
}

/// How a session's frames are coded.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Coding {
    pub(crate) codec: CodecId,
    /// Bits of a frame that may be wrong, in parts of a million.
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
    #[error("it left without a word")]
    Left,
    #[error("it opened with another message than Hello")]
    NoHello,
}

/// Reads the Hello, and answers it. The caller bounds the time.
///
/// # Errors
/// When the client is refused, which it has then been told, or breaks off.
pub(crate) async fn greet(link: &mut Link, services: &Services) -> Result<Admitted, HandshakeError> {
    let admitted = match read_hello(&mut link.reader).await? {
        Ok(hello) => admit(hello, link.peer, services),
        Err(refusal) => Err((RefusalCause::Unsupported, refusal)),
    };
    match admitted {
        Ok(admitted) => {
            let welcome = Welcome {
                session: admitted.slot.id,
                scene_digest: services.scene.digest,
                scene_bytes: services.scene.packed.len() as u64,
                lights: services.scene.lights,
                backend: shortened(services.engine.description()),
                data_port: link.data.port(),
                resume: admitted.slot.resume,
            };
            link.writer.write(&ServerMessage::Welcome(welcome)).await?;
            Ok(admitted)
        }
        Err((cause, refusal)) => {
            services.metrics.refused(cause);
            link.writer.write(&ServerMessage::Refused(refusal.clone())).await?;
            link.writer.finish().await;
            // Closing at once would overtake the refusal: the client leaves when it has read it.
            let _ = timeout(LINGER, link.reader.drain()).await;
            link.data.closer().close(CloseCode::Refused, "refused");
            Err(HandshakeError::Refused(refusal))
        }
    }
}

/// The client's Hello, or a refusal when another version wrote it.
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

/// The version in a Hello of any version: the message's number is 0, and the version follows it as a varint.
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

fn admit(hello: Hello, peer: SocketAddr, services: &Services) -> Result<Admitted, (RefusalCause, Refusal)> {
    // First: a stranger learns nothing, not even whether there is room.
    let token = hello.token.as_deref();
    let refuse = |problem: TokenProblem| {
        tracing::info!(%problem, "token refused");
        (RefusalCause::Token, Refusal::Token)
    };
    let resumes = hello.resume.is_some_and(|secret| services.admission.knows(secret));
    if let Some(tokens) = &services.tokens {
        match tokens.check(token, Scope::Session) {
            // It was this client who spent it.
            Err(TokenProblem::Spent) if resumes => {}
            checked => checked.map_err(refuse)?,
        }
    }
    let shape = MaskShape::new(hello.width, hello.height, services.scene.lights)
        .map_err(|error| (RefusalCause::Unsupported, Refusal::Unsupported(error.to_string())))?;
    if hello.wrong_ppm > MAX_WRONG_PPM {
        let reason = format!("{} wrong bits in a million: at most {MAX_WRONG_PPM} are possible", hello.wrong_ppm);
        return Err((RefusalCause::Unsupported, Refusal::Unsupported(reason)));
    }
    let coding = Coding { codec: hello.codec, wrong_ppm: hello.wrong_ppm };
    // Who comes back takes the place of a session over, whose share comes free in a moment.
    let addresses = &services.addresses;
    let held = if resumes { addresses.take_over(peer.ip()) } else { addresses.take(peer.ip()) };
    let held = held.ok_or_else(|| (RefusalCause::Address, services.admission.full()))?;
    let slot = services.admission.admit(hello.resume).map_err(|refusal| {
        let draining = refusal == Refusal::Draining;
        (if draining { RefusalCause::Draining } else { RefusalCause::Full }, refusal)
    })?;
    let rate_hz = (hello.rate_hz > 0).then(|| f64::from(hello.rate_hz));
    let port = services.engine.open(shape, rate_hz).map_err(|error| match error {
        OpenError::Full(_) | OpenError::Busy => (RefusalCause::Full, services.admission.full()),
        OpenError::Overload(reason) => (RefusalCause::Budget, services.admission.busy(shortened(&reason.to_string()))),
        _ => (RefusalCause::Unsupported, Refusal::Unsupported(shortened(&error.to_string()))),
    })?;
    let share = services.plan.take(shape, rate_hz);
    let share = share.map_err(|scarce| (RefusalCause::Budget, services.admission.busy(scarce.to_string())))?;
    // Last, so that a token for one use is not spent in vain.
    if let Some(tokens) = services.tokens.as_ref().filter(|_| !resumes) {
        tokens.admit(token, Scope::Session).map_err(refuse)?;
    }
    Ok(Admitted { slot, port, shape, coding, client: hello.client, held, share })
}

/// At most as much of a text as a message may carry.
pub(crate) fn shortened(text: &str) -> String {
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
