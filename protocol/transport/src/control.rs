//! Messages on the control stream, over QUIC or TCP: each follows its length, a little-endian `u32`.

use std::{io, marker::PhantomData, time::Duration};

use bytes::{Buf as _, BytesMut};
use gnomon_protocol::{
    message::{self, CheckText, MessageError},
    text::Escaped,
};
use serde::{Serialize, de::DeserializeOwned};
use thiserror::Error;
use tokio::{
    io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _},
    time::timeout,
};

const PREFIX_BYTES: usize = 4;

/// Why a control stream ended.
#[derive(Debug, Error)]
pub enum ControlError {
    /// Reading or writing failed.
    #[error("control stream: {}", Escaped(.0))]
    Stream(#[from] io::Error),
    /// The peer ended the stream after a whole message.
    #[error("the peer closed the connection")]
    Closed,
    /// The peer ended the stream within a message.
    #[error("the control stream ended within a message")]
    Truncated,
    /// The bytes are no message.
    #[error(transparent)]
    Message(#[from] MessageError),
    /// The length prefix exceeds the reader's limit.
    #[error("a message of {bytes} bytes: at most {limit} are allowed")]
    TooLong { bytes: usize, limit: usize },
    /// [`ControlReader::next_within`] timed out.
    #[error("no answer for {} s", .0.as_secs_f64())]
    Silent(Duration),
    /// The peer did not read what was written to it.
    #[error("the peer did not read its control stream for {} s", .0.as_secs_f64())]
    Stalled(Duration),
}

/// Reads messages from the peer.
pub struct ControlReader<M> {
    stream: Box<dyn AsyncRead + Send + Unpin>,
    max_message_bytes: usize,
    buffer: BytesMut,
    messages: PhantomData<fn() -> M>,
}

impl<M: DeserializeOwned + CheckText> ControlReader<M> {
    /// Messages above `max_message_bytes` are refused before they are read.
    pub fn new(stream: impl AsyncRead + Send + Unpin + 'static, max_message_bytes: usize) -> Self {
        Self { stream: Box::new(stream), max_message_bytes, buffer: BytesMut::new(), messages: PhantomData }
    }

    /// Returns the next message without its prefix, not decoded yet. Cancel-safe.
    ///
    /// # Errors
    /// Errors if the stream ends or fails, or the message is too long.
    pub async fn next_bytes(&mut self) -> Result<BytesMut, ControlError> {
        loop {
            if let Some(prefix) = self.buffer.first_chunk::<PREFIX_BYTES>() {
                let bytes = message::decode_length(*prefix)?;
                if bytes > self.max_message_bytes {
                    return Err(ControlError::TooLong { bytes, limit: self.max_message_bytes });
                }
                if self.buffer.len() >= PREFIX_BYTES + bytes {
                    self.buffer.advance(PREFIX_BYTES);
                    return Ok(self.buffer.split_to(bytes));
                }
            }
            self.buffer.reserve(PREFIX_BYTES + self.max_message_bytes);
            if self.stream.read_buf(&mut self.buffer).await? == 0 {
                let whole = self.buffer.is_empty();
                return Err(if whole { ControlError::Closed } else { ControlError::Truncated });
            }
        }
    }

    /// Returns the next message. Cancel-safe.
    ///
    /// # Errors
    /// Errors if the stream ends or fails, or the bytes are no message.
    pub async fn next(&mut self) -> Result<M, ControlError> {
        Ok(message::decode(&self.next_bytes().await?)?)
    }

    /// Returns the next message. Cancel-safe.
    ///
    /// # Errors
    /// As [`Self::next`], and [`ControlError::Silent`] after `limit`.
    pub async fn next_within(&mut self, limit: Duration) -> Result<M, ControlError> {
        timeout(limit, self.next()).await.map_err(|_| ControlError::Silent(limit))?
    }

    /// Discards what the peer still sends, until it ends the stream.
    pub async fn drain(&mut self) {
        let mut scratch = [0; 1024];
        while matches!(self.stream.read(&mut scratch).await, Ok(1..)) {}
    }
}

/// Writes messages to the peer.
pub struct ControlWriter<M> {
    stream: Box<dyn AsyncWrite + Send + Unpin>,
    write_timeout: Duration,
    messages: PhantomData<fn(M)>,
}

impl<M: Serialize> ControlWriter<M> {
    /// A write fails once the peer has not read for `write_timeout`.
    pub fn new(stream: impl AsyncWrite + Send + Unpin + 'static, write_timeout: Duration) -> Self {
        Self { stream: Box::new(stream), write_timeout, messages: PhantomData }
    }

    /// Writes a message, and waits while the peer is slow to read. Not cancel-safe: a message may be written in part.
    ///
    /// # Errors
    /// Errors if the message is too long, the stream fails, or the peer does not read.
    pub async fn write(&mut self, message: &M) -> Result<(), ControlError> {
        let bytes = message::encode(message)?;
        let write = async {
            self.stream.write_all(&bytes).await?;
            self.stream.flush().await
        };
        Ok(timeout(self.write_timeout, write).await.map_err(|_| ControlError::Stalled(self.write_timeout))??)
    }

    /// Ends the stream. It is no error if the peer is already gone.
    pub async fn finish(&mut self) {
        let _ = timeout(self.write_timeout, self.stream.shutdown()).await;
    }
}

#[cfg(test)]
mod tests {
    use gnomon_protocol::message::{ClientMessage, ServerMessage};

    use super::*;

    const LIMIT_BYTES: usize = 100_000;

    async fn read_all<M>(bytes: &[u8], chunk: usize, limit: usize) -> (Vec<M>, ControlError)
    where
        M: DeserializeOwned + CheckText,
    {
        let (mut peer, ours) = tokio::io::duplex(chunk);
        let mut reader = ControlReader::new(ours, limit);
        let bytes = bytes.to_vec();
        let writing = tokio::spawn(async move {
            // The reader may give up early.
            let _ = peer.write_all(&bytes).await;
        });
        let mut messages = Vec::new();
        let end = loop {
            match reader.next().await {
                Ok(message) => messages.push(message),
                Err(error) => break error,
            }
        };
        drop(reader);
        writing.await.unwrap();
        (messages, end)
    }

    #[tokio::test]
    async fn messages_survive_any_fragmentation() {
        let sent = [
            ServerMessage::Pong(u64::MAX),
            ServerMessage::SceneChunk { offset: 3, bytes: vec![9; 60_000] },
            ServerMessage::Closing { reason: "test".into(), may_return: true },
        ];
        let bytes: Vec<u8> = sent.iter().flat_map(|message| message::encode(message).unwrap()).collect();
        for chunk in [1, 2, 3, 7, 4096, 100_000] {
            let (messages, end) = read_all::<ServerMessage>(&bytes, chunk, LIMIT_BYTES).await;
            assert_eq!(messages, sent);
            assert!(matches!(end, ControlError::Closed));
        }
        let (messages, end) = read_all::<ServerMessage>(&bytes[..bytes.len() - 1], 5, LIMIT_BYTES).await;
        assert_eq!(messages.len(), 2);
        assert!(matches!(end, ControlError::Truncated));
    }

    #[tokio::test]
    async fn garbage_is_an_error_and_costs_no_memory() {
        for (bytes, expected) in [
            (&[255, 255, 255, 255][..], "at most 131072"),
            (&[1, 16, 0, 0], "at most 4096"),
            (&[2, 0, 0, 0, 250, 1], "malformed message"),
        ] {
            let (messages, end) = read_all::<ClientMessage>(bytes, 64, 4096).await;
            let end = end.to_string();
            assert!(messages.is_empty() && end.contains(expected), "{end}");
        }
    }
}
