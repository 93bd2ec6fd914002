//! The control conversation, on one reliable stream: who the peers are, which scene, and how a session ends.
//!
//! ```text
//! client                                    server
//! Hello (version, token, size, codec)  →
//!                                      ←    Welcome (session, scene digest and length, …)   or Refused (reason), end
//! FetchScene (offset), unless cached   →
//!                                      ←    SceneChunk … until all bytes are there
//! Start                                →
//! poses and frame packets now flow beside this stream; Ping ↔ Pong measure the round trip
//!                                      ←    Draining (the server is about to stop), Closing (reason), end
//! Bye                                  →
//! ```
//!
//! A message is its length (u32, little-endian) and its postcard bytes, at most [`MAX_MESSAGE_BYTES`].

use serde::{Deserialize, Serialize, de::DeserializeOwned};
use thiserror::Error;

use crate::{
    codec::CodecId,
    ids::{SceneDigest, SessionId},
    limits::{MAX_MESSAGE_BYTES, MAX_TEXT_BYTES, MAX_TOKEN_BYTES},
};

/// What a client says.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum ClientMessage {
    /// Opens the conversation. The version stands first, so that any version can read it.
    Hello(Hello),
    /// Asks for the scene's bytes from `offset` on.
    FetchScene {
        /// First byte wanted.
        offset: u64,
    },
    /// The client has the scene; frames may begin.
    Start,
    /// To be answered by [`ServerMessage::Pong`] with the same number.
    Ping(u64),
    /// The client leaves.
    Bye,
}

/// A client's introduction.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hello {
    /// [`crate::PROTOCOL_VERSION`] of the client.
    pub version: u16,
    /// Bearer token, where the server wants one.
    pub token: Option<String>,
    /// Name and version of the client program, for the logs.
    pub client: String,
    /// Width of the masks that it wants, in pixels.
    pub width: u32,
    /// Height of the masks that it wants, in pixels.
    pub height: u32,
    /// Codec that it wants.
    pub codec: CodecId,
}

/// What a server says.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum ServerMessage {
    /// The client is admitted.
    Welcome(Welcome),
    /// The client is not admitted; the connection ends.
    Refused(Refusal),
    /// Bytes of the packed scene.
    SceneChunk {
        /// Place of the first byte.
        offset: u64,
        /// At most [`crate::limits::SCENE_CHUNK_BYTES`] bytes.
        bytes: Vec<u8>,
    },
    /// Answer to [`ClientMessage::Ping`].
    Pong(u64),
    /// The server stops soon: look for another one.
    Draining {
        /// Why.
        reason: String,
        /// Time until it closes, in milliseconds.
        deadline_ms: u32,
        /// URL of a server to go to, if one is configured.
        alternative: Option<String>,
    },
    /// The session ends now.
    Closing {
        /// Why.
        reason: String,
    },
}

/// A server's answer to an admitted client.
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
    /// What traces: `compute on NVIDIA …`, `cpu, 8 threads, …`.
    pub backend: String,
    /// Local port for poses and packets, on the lab transports only.
    pub data_port: Option<u16>,
}

/// Why a client is not admitted.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Error)]
pub enum Refusal {
    /// The peers speak different versions.
    #[error("the server speaks protocol version {server}, this client {client}: install matching versions")]
    Version {
        /// Version of the server.
        server: u16,
        /// Version of the client.
        client: u16,
    },
    /// No token, or one that is not listed.
    #[error("the server wants a token that it knows: pass --token or GNOMON_TOKEN")]
    Token,
    /// All sessions are taken.
    #[error("the server is full ({sessions} sessions): try again in {retry_after_ms} ms")]
    Full {
        /// Sessions there are.
        sessions: u32,
        /// Time after which asking again makes sense, in milliseconds.
        retry_after_ms: u32,
    },
    /// The size or the codec is not to be had.
    #[error("the server cannot serve this: {0}")]
    Unsupported(String),
    /// The server admits nobody any more.
    #[error("the server is draining: connect to another one")]
    Draining,
}

/// Why bytes are no message.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum MessageError {
    /// The length prefix exceeds the limit.
    #[error("a message of {0} bytes: at most {MAX_MESSAGE_BYTES} are allowed")]
    TooLong(u64),
    /// A text inside exceeds its limit.
    #[error("{field} has {bytes} bytes, at most {limit} are allowed")]
    Text {
        /// Name of the field.
        field: &'static str,
        /// Its length.
        bytes: usize,
        /// The most allowed.
        limit: usize,
    },
    /// The bytes do not decode, or some are left over.
    #[error("malformed message: {0}")]
    Malformed(String),
}

/// The message with its length prefix.
///
/// # Errors
/// When the message is longer than [`MAX_MESSAGE_BYTES`].
pub fn encode<M: Serialize>(message: &M) -> Result<Vec<u8>, MessageError> {
    let mut bytes =
        postcard::to_extend(message, vec![0; 4]).map_err(|error| MessageError::Malformed(error.to_string()))?;
    let length = bytes.len() - 4;
    let prefix = u32::try_from(length).ok().filter(|_| length <= MAX_MESSAGE_BYTES);
    bytes[..4].copy_from_slice(&prefix.ok_or(MessageError::TooLong(length as u64))?.to_le_bytes());
    Ok(bytes)
}

/// The length of the message that follows a prefix.
///
/// # Errors
/// When it exceeds [`MAX_MESSAGE_BYTES`].
pub fn decode_length(prefix: [u8; 4]) -> Result<usize, MessageError> {
    let length = u32::from_le_bytes(prefix) as usize;
    if length > MAX_MESSAGE_BYTES { Err(MessageError::TooLong(length as u64)) } else { Ok(length) }
}

/// A message from the bytes after its prefix, all of them.
///
/// # Errors
/// When they are no message, or a text in it is too long.
pub fn decode<M: DeserializeOwned + CheckText>(bytes: &[u8]) -> Result<M, MessageError> {
    match postcard::take_from_bytes::<M>(bytes) {
        Ok((message, [])) => message.check_text().map(|()| message),
        Ok((_, rest)) => Err(MessageError::Malformed(format!("{} bytes left over", rest.len()))),
        Err(error) => Err(MessageError::Malformed(error.to_string())),
    }
}

/// Bounds on the texts inside a message.
pub trait CheckText {
    /// # Errors
    /// When a text is too long.
    fn check_text(&self) -> Result<(), MessageError>;
}

fn check(field: &'static str, text: &str, limit: usize) -> Result<(), MessageError> {
    if text.len() > limit { Err(MessageError::Text { field, bytes: text.len(), limit }) } else { Ok(()) }
}

impl CheckText for ClientMessage {
    fn check_text(&self) -> Result<(), MessageError> {
        match self {
            Self::Hello(hello) => {
                check("token", hello.token.as_deref().unwrap_or_default(), MAX_TOKEN_BYTES)?;
                check("client", &hello.client, MAX_TEXT_BYTES)
            }
            Self::FetchScene { .. } | Self::Start | Self::Ping(_) | Self::Bye => Ok(()),
        }
    }
}

impl CheckText for ServerMessage {
    fn check_text(&self) -> Result<(), MessageError> {
        match self {
            Self::Welcome(welcome) => check("backend", &welcome.backend, MAX_TEXT_BYTES),
            Self::Refused(Refusal::Unsupported(text)) => check("refusal", text, MAX_TEXT_BYTES),
            Self::Draining { reason, alternative, .. } => {
                check("reason", reason, MAX_TEXT_BYTES)?;
                check("alternative", alternative.as_deref().unwrap_or_default(), MAX_TEXT_BYTES)
            }
            Self::Closing { reason } => check("reason", reason, MAX_TEXT_BYTES),
            Self::Refused(_) | Self::SceneChunk { .. } | Self::Pong(_) => Ok(()),
        }
    }
}
