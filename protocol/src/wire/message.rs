//! The control conversation, on one reliable stream: it admits a client, transfers the scene and ends the session.
//!
//! ```text
//! client                                    server
//! Hello (version, token, size, …)      →
//!                                      ←    Welcome (session, scene digest and length, …)   or Refused (reason), end
//! FetchScene (offset), unless cached   →
//!                                      ←    SceneChunk … until all bytes are there
//! Start                                →
//! poses and frame packets now flow beside this stream; Ping ↔ Pong measure the round trip
//! Edit (what the client changes)       →
//!                                      ←    Edited (revision, what has changed)             or EditRefused (reason)
//!                                      ←    Clock, in a world that clients share
//!                                      ←    Draining (the server is about to stop), Closing (reason), end
//! Bye                                  →
//! ```
//!
//! A message is its length (u32, little-endian) and its postcard bytes, at most [`MAX_MESSAGE_BYTES`].

use std::time::Duration;

use serde::{Deserialize, Serialize, de::DeserializeOwned};
use thiserror::Error;

use crate::{
    ids::{BearerToken, ResumeToken, SceneDigest, SessionId},
    limits::{MAX_EDITED, MAX_EDITS, MAX_MESSAGE_BYTES, MAX_TEXT_BYTES, MAX_TOKEN_BYTES, SCENE_CHUNK_BYTES},
    text::PeerText,
    wire::{CodecId, edit::Edit},
};

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum ClientMessage {
    /// Opens the conversation. The version comes first, so that any version can read it.
    Hello(Hello),
    /// Asks for the scene's bytes from `offset` on.
    FetchScene {
        offset: u64,
    },
    /// The client has the scene; frames may begin.
    Start,
    /// The server answers with [`ServerMessage::Pong`] and the same number.
    Ping(u64),
    Bye,
    /// Changes the scene, all of it or nothing. Only after Start, and if [`Welcome::may_edit`].
    Edit {
        /// The answer names it. Ascending.
        number: u32,
        /// At most [`crate::limits::MAX_EDITS`].
        edits: Vec<Edit>,
    },
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hello {
    /// [`crate::PROTOCOL_VERSION`] of the client.
    pub version: u16,
    /// Bearer token, if the server requires one.
    pub token: Option<BearerToken>,
    /// Name and version of the client program, for the logs.
    pub client: PeerText,
    /// Width of the requested masks, in pixels.
    pub width: u32,
    /// Height of the requested masks, in pixels.
    pub height: u32,
    pub codec: CodecId,
    /// Most masks a second that it wants; 0 for as many as possible. The server plans with it.
    pub rate_hz: u16,
    /// Bits of a frame that may be wrong to save bytes, in millionths, at most [`crate::limits::MAX_WRONG_PPM`]; 0 for
    /// none.
    pub wrong_ppm: u16,
    /// [`Welcome::resume`] of the session to continue after its connection was lost.
    pub resume: Option<ResumeToken>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum ServerMessage {
    Welcome(Welcome),
    /// The client is not admitted; the connection ends.
    Refused(Refusal),
    /// Bytes of the packed scene.
    SceneChunk {
        offset: u64,
        /// At most [`crate::limits::SCENE_CHUNK_BYTES`] bytes.
        bytes: Vec<u8>,
    },
    /// Answer to [`ClientMessage::Ping`].
    Pong(u64),
    /// The server stops soon: connect to another one.
    Draining {
        reason: PeerText,
        /// Time until it closes.
        deadline_ms: u32,
        /// URL of another server, if configured.
        alternative: Option<PeerText>,
    },
    /// The session ends now.
    Closing {
        reason: PeerText,
        /// False if the session was ended by an operator, or with its token: the client must not come back by itself.
        may_return: bool,
    },
    Edited(Edited),
    /// An [`ClientMessage::Edit`] has changed nothing.
    EditRefused {
        number: u32,
        reason: PeerText,
    },
    /// Time of the scene in a shared world, in microseconds: after Start and after each Pong.
    Clock(u64),
}

/// A new state of the scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Edited {
    /// Ascending. 0 is the scene as its file has it.
    pub revision: u32,
    /// Number of the receiver's own edit that this is, if it is one.
    pub yours: Option<u32>,
    /// True if these are all that differ from the file; false if they change the state before.
    pub whole: bool,
    /// At most [`crate::limits::MAX_EDITED`].
    pub edits: Vec<Edit>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Welcome {
    /// The session's name in the server's logs.
    pub session: SessionId,
    /// Digest of the packed scene.
    pub scene_digest: SceneDigest,
    /// Length of the packed scene, in bytes.
    pub scene_bytes: u64,
    /// Lights of the scene: planes in each mask.
    pub lights: u32,
    /// The tracer: `compute on NVIDIA …`, `cpu, 8 threads, …`.
    pub backend: PeerText,
    /// Local port for poses and packets, on the lab transports only.
    pub data_port: Option<u16>,
    /// Lets the client take its session over after its connection was lost.
    pub resume: ResumeToken,
    /// Whether the client may change the scene.
    pub may_edit: bool,
    /// Whether all clients see one scene and one clock.
    pub shared_world: bool,
    /// Of the scene's state. If it is not 0, the state follows Start as [`ServerMessage::Edited`].
    pub revision: u32,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Error)]
pub enum Refusal {
    #[error("the server speaks protocol version {server}, this client {client}: install matching versions")]
    Version { server: u16, client: u16 },
    #[error("the token is missing or unknown: pass --token or GNOMON_TOKEN")]
    Token,
    #[error("the server is full ({sessions} sessions): try again in {retry_after_ms} ms")]
    Full { sessions: u32, retry_after_ms: u32 },
    #[error("the server cannot serve this: {0}")]
    Unsupported(PeerText),
    #[error("the server is draining: connect to another one")]
    Draining,
    /// The admitted sessions leave too little of the server's time, or would be disturbed.
    #[error("the server is too busy ({reason}): try again in {retry_after_ms} ms")]
    Busy {
        /// What is scarce, with numbers.
        reason: PeerText,
        retry_after_ms: u32,
    },
}

impl Refusal {
    /// Returns how long to wait before asking the same server again; `None` if that is pointless.
    #[must_use]
    pub fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::Full { retry_after_ms, .. } | Self::Busy { retry_after_ms, .. } => {
                Some(Duration::from_millis(u64::from(*retry_after_ms)))
            }
            Self::Version { .. } | Self::Token | Self::Unsupported(_) | Self::Draining => None,
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum MessageError {
    #[error("a message of {0} bytes: at most {MAX_MESSAGE_BYTES} are allowed")]
    TooLong(u64),
    #[error("{field}: {bytes}, at most {limit} are allowed")]
    Text { field: &'static str, bytes: usize, limit: usize },
    /// The bytes do not decode, or some are left over.
    #[error("malformed message: {0}")]
    Malformed(String),
}

/// Returns the message with its length prefix.
///
/// # Errors
/// If the message is longer than [`MAX_MESSAGE_BYTES`].
pub fn encode<M: Serialize>(message: &M) -> Result<Vec<u8>, MessageError> {
    let mut bytes =
        postcard::to_extend(message, vec![0; 4]).map_err(|error| MessageError::Malformed(error.to_string()))?;
    let length = bytes.len() - 4;
    let prefix = u32::try_from(length).ok().filter(|_| length <= MAX_MESSAGE_BYTES);
    bytes[..4].copy_from_slice(&prefix.ok_or(MessageError::TooLong(length as u64))?.to_le_bytes());
    Ok(bytes)
}

/// Returns the length of the message that follows a prefix.
///
/// # Errors
/// If it exceeds [`MAX_MESSAGE_BYTES`].
pub fn decode_length(prefix: [u8; 4]) -> Result<usize, MessageError> {
    let length = u32::from_le_bytes(prefix) as usize;
    if length > MAX_MESSAGE_BYTES { Err(MessageError::TooLong(length as u64)) } else { Ok(length) }
}

/// Returns a message from all the bytes after its prefix.
///
/// # Errors
/// If they are too many or malformed, or a text or a chunk is too long.
pub fn decode<M: DeserializeOwned + CheckText>(bytes: &[u8]) -> Result<M, MessageError> {
    if bytes.len() > MAX_MESSAGE_BYTES {
        return Err(MessageError::TooLong(bytes.len() as u64));
    }
    match postcard::take_from_bytes::<M>(bytes) {
        Ok((message, [])) => message.check_text().map(|()| message),
        Ok((_, rest)) => Err(MessageError::Malformed(format!("{} bytes left over", rest.len()))),
        Err(error) => Err(MessageError::Malformed(error.to_string())),
    }
}

/// Bounds on the texts, chunks and lists inside a message.
pub trait CheckText {
    /// # Errors
    /// If a text or a chunk is too long.
    fn check_text(&self) -> Result<(), MessageError>;
}

fn check(field: &'static str, bytes: usize, limit: usize) -> Result<(), MessageError> {
    if bytes > limit { Err(MessageError::Text { field, bytes, limit }) } else { Ok(()) }
}

impl CheckText for ClientMessage {
    fn check_text(&self) -> Result<(), MessageError> {
        match self {
            Self::Hello(hello) => {
                check("token", hello.token.as_deref().map_or(0, str::len), MAX_TOKEN_BYTES)?;
                check("client", hello.client.unescaped().len(), MAX_TEXT_BYTES)
            }
            Self::Edit { edits, .. } => check("edits", edits.len(), MAX_EDITS),
            Self::FetchScene { .. } | Self::Start | Self::Ping(_) | Self::Bye => Ok(()),
        }
    }
}

impl CheckText for ServerMessage {
    fn check_text(&self) -> Result<(), MessageError> {
        match self {
            Self::Welcome(welcome) => check("backend", welcome.backend.unescaped().len(), MAX_TEXT_BYTES),
            Self::Refused(Refusal::Unsupported(text) | Refusal::Busy { reason: text, .. }) => {
                check("refusal", text.unescaped().len(), MAX_TEXT_BYTES)
            }
            Self::Draining { reason, alternative, .. } => {
                check("reason", reason.unescaped().len(), MAX_TEXT_BYTES)?;
                check("alternative", alternative.as_ref().map_or(0, |url| url.unescaped().len()), MAX_TEXT_BYTES)
            }
            Self::Closing { reason, .. } => check("reason", reason.unescaped().len(), MAX_TEXT_BYTES),
            Self::SceneChunk { bytes, .. } => check("scene chunk", bytes.len(), SCENE_CHUNK_BYTES),
            Self::Edited(edited) => check("edits", edited.edits.len(), MAX_EDITED),
            Self::EditRefused { reason, .. } => check("reason", reason.unescaped().len(), MAX_TEXT_BYTES),
            Self::Refused(_) | Self::Pong(_) | Self::Clock(_) => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::edit::NodeEdit;

    fn hello() -> Hello {
        let client = "gnomon-client 0.1.0".into();
        Hello {
            version: 1,
            token: None,
            client,
            width: 8,
            height: 8,
            codec: CodecId::PlanesLz4,
            rate_hz: 60,
            wrong_ppm: 0,
            resume: None,
        }
    }

    fn decoded<M: Serialize + DeserializeOwned + CheckText>(message: &M) -> Result<M, MessageError> {
        decode(&encode(message).unwrap()[4..])
    }

    #[test]
    fn the_prefix_is_the_length_of_what_follows() {
        let bytes = encode(&ClientMessage::Hello(hello())).unwrap();
        let (prefix, rest) = bytes.split_first_chunk().unwrap();
        assert_eq!(decode_length(*prefix), Ok(rest.len()));
        assert_eq!(decode(rest), Ok(ClientMessage::Hello(hello())));
    }

    #[test]
    fn lengths_are_bounded_before_anything_is_read() {
        let limit = u32::try_from(MAX_MESSAGE_BYTES).unwrap();
        assert_eq!(decode_length(limit.to_le_bytes()), Ok(MAX_MESSAGE_BYTES));
        assert_eq!(decode_length((limit + 1).to_le_bytes()), Err(MessageError::TooLong(u64::from(limit) + 1)));
        assert_eq!(decode_length([0xFF; 4]), Err(MessageError::TooLong(0xFFFF_FFFF)));
        let long = vec![0; MAX_MESSAGE_BYTES + 1];
        assert_eq!(decode::<ClientMessage>(&long), Err(MessageError::TooLong(long.len() as u64)));
        let chunk = ServerMessage::SceneChunk { offset: 0, bytes: long };
        assert!(matches!(encode(&chunk), Err(MessageError::TooLong(_))));
    }

    #[test]
    fn texts_and_chunks_are_bounded() {
        let text = |bytes| "x".repeat(bytes);
        let client = |bytes| ClientMessage::Hello(Hello { client: text(bytes).into(), ..hello() });
        let token = |bytes| ClientMessage::Hello(Hello { token: Some(text(bytes).into()), ..hello() });
        assert_eq!(decoded(&client(1024)), Ok(client(1024)));
        assert_eq!(decoded(&client(1025)), Err(MessageError::Text { field: "client", bytes: 1025, limit: 1024 }));
        assert_eq!(decoded(&token(512)), Ok(token(512)));
        assert_eq!(decoded(&token(513)), Err(MessageError::Text { field: "token", bytes: 513, limit: 512 }));
        let draining = |reason, alternative| ServerMessage::Draining {
            reason: text(reason).into(),
            deadline_ms: 0,
            alternative: Some(text(alternative).into()),
        };
        let chunk = |bytes| ServerMessage::SceneChunk { offset: 0, bytes: vec![0; bytes] };
        let closing = |bytes| ServerMessage::Closing { reason: text(bytes).into(), may_return: true };
        let edit = || Edit::Node(NodeEdit::default());
        let edited =
            |count| ServerMessage::Edited(Edited { revision: 1, yours: None, whole: true, edits: vec![edit(); count] });
        let refused = |bytes| ServerMessage::EditRefused { number: 1, reason: text(bytes).into() };
        let edits = |count| ClientMessage::Edit { number: 1, edits: vec![edit(); count] };
        assert_eq!(decoded(&edits(MAX_EDITS)), Ok(edits(MAX_EDITS)));
        let too_many = MessageError::Text { field: "edits", bytes: MAX_EDITS + 1, limit: MAX_EDITS };
        assert_eq!(decoded(&edits(MAX_EDITS + 1)), Err(too_many));
        let busy = |bytes| ServerMessage::Refused(Refusal::Busy { reason: text(bytes).into(), retry_after_ms: 5 });
        let unsupported = |bytes| ServerMessage::Refused(Refusal::Unsupported(text(bytes).into()));
        for (good, bad, field, limit) in [
            (closing(1024), closing(1025), "reason", 1024),
            (unsupported(1024), unsupported(1025), "refusal", 1024),
            (busy(1024), busy(1025), "refusal", 1024),
            (draining(1024, 0), draining(1025, 0), "reason", 1024),
            (draining(0, 1024), draining(0, 1025), "alternative", 1024),
            (edited(MAX_EDITED), edited(MAX_EDITED + 1), "edits", MAX_EDITED),
            (refused(1024), refused(1025), "reason", 1024),
            (chunk(SCENE_CHUNK_BYTES), chunk(SCENE_CHUNK_BYTES + 1), "scene chunk", SCENE_CHUNK_BYTES),
        ] {
            assert_eq!(decoded(&good), Ok(good));
            assert_eq!(decoded(&bad), Err(MessageError::Text { field, bytes: limit + 1, limit }));
        }
    }

    #[test]
    fn what_is_shown_of_a_message_holds_no_secret_and_no_control_character() {
        let hello = Hello { token: Some("s3cret".into()), client: "a\x1b[2J\nb".into(), ..hello() };
        let shown = format!("{:?}", ClientMessage::Hello(hello));
        assert!(!shown.contains("s3cret") && shown.contains("a\\u{1b}[2J\\nb"), "{shown}");
        let reason = || PeerText::from("a\x1b[2J\nb");
        let refusals = [Refusal::Unsupported(reason()), Refusal::Busy { reason: reason(), retry_after_ms: 1 }];
        for shown in refusals.iter().flat_map(|refusal| [refusal.to_string(), format!("{refusal:?}")]) {
            assert!(shown.contains("a\\u{1b}[2J\\nb") && !shown.contains(char::is_control), "{shown}");
        }
    }

    #[test]
    fn truncated_and_overlong_messages_are_malformed() {
        let bytes = encode(&ClientMessage::Hello(hello())).unwrap();
        for length in 4..bytes.len() {
            let error = decode::<ClientMessage>(&bytes[4..length]).unwrap_err();
            assert!(matches!(error, MessageError::Malformed(_)), "{error}");
        }
        let long = [&bytes[4..], &[0]].concat();
        assert_eq!(decode::<ClientMessage>(&long), Err(MessageError::Malformed("1 bytes left over".to_owned())));
    }
}
