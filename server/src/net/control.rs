//! Messages on a session's control stream, whatever carries it.

use std::io;

use bytes::{Buf as _, BytesMut};
use gnomon_protocol::message::{self, ClientMessage, MessageError, ServerMessage};
use thiserror::Error;
use tokio::{
    io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _},
    time::timeout,
};

use crate::limits::{MAX_CLIENT_MESSAGE_BYTES, WRITE_TIMEOUT};

const PREFIX_BYTES: usize = 4;

/// Why the conversation broke off.
#[derive(Debug, Error)]
pub(crate) enum ControlError {
    /// The stream failed.
    #[error("control stream: {0}")]
    Stream(#[from] io::Error),
    /// The peer ended the stream within a message.
    #[error("the control stream ended within a message")]
    Truncated,
    /// The peer's bytes are no message.
    #[error(transparent)]
    Message(#[from] MessageError),
    /// A message that is longer than any that a client has to send.
    #[error("a message of {0} bytes: a client's have at most {MAX_CLIENT_MESSAGE_BYTES}")]
    TooLong(usize),
    /// The peer did not read for too long.
    #[error("the client did not read its control stream for {} s", WRITE_TIMEOUT.as_secs())]
    Stalled,
}

/// What a control stream is read from.
pub(crate) type BoxRead = Box<dyn AsyncRead + Send + Unpin>;

/// What a control stream is written to.
pub(crate) type BoxWrite = Box<dyn AsyncWrite + Send + Unpin>;

/// The client's half of the conversation.
pub(crate) struct ControlReader {
    stream: BoxRead,
    buffer: BytesMut,
}

impl ControlReader {
    pub(crate) fn new(stream: BoxRead) -> Self {
        Self { stream, buffer: BytesMut::new() }
    }

    /// The bytes of the next message, without their prefix; `None` when the client has ended the stream. Cancelling it
    /// loses nothing.
    pub(crate) async fn next_bytes(&mut self) -> Result<Option<BytesMut>, ControlError> {
        loop {
            if let Some(prefix) = self.buffer.first_chunk::<PREFIX_BYTES>() {
                let length = message::decode_length(*prefix)?;
                if length > MAX_CLIENT_MESSAGE_BYTES {
                    return Err(ControlError::TooLong(length));
                }
                if self.buffer.len() >= PREFIX_BYTES + length {
                    self.buffer.advance(PREFIX_BYTES);
                    return Ok(Some(self.buffer.split_to(length)));
                }
            }
            self.buffer.reserve(PREFIX_BYTES + MAX_CLIENT_MESSAGE_BYTES);
            if self.stream.read_buf(&mut self.buffer).await? == 0 {
                return if self.buffer.is_empty() { Ok(None) } else { Err(ControlError::Truncated) };
            }
        }
    }

    /// The next message; `None` when the client has ended the stream. Cancelling it loses nothing.
    pub(crate) async fn next(&mut self) -> Result<Option<ClientMessage>, ControlError> {
        Ok(self.next_bytes().await?.map(|bytes| message::decode(&bytes)).transpose()?)
    }

    /// Waits until the client ends the stream, and throws away what it still sends.
    pub(crate) async fn drain(&mut self) {
        let mut scratch = [0; 1024];
        while matches!(self.stream.read(&mut scratch).await, Ok(1..)) {}
    }
}

/// The server's half of the conversation.
pub(crate) struct ControlWriter {
    stream: BoxWrite,
}

impl ControlWriter {
    pub(crate) fn new(stream: BoxWrite) -> Self {
        Self { stream }
    }

    /// Writes a message, and waits while the client is slow to read. Cancelling it breaks the stream.
    pub(crate) async fn write(&mut self, message: &ServerMessage) -> Result<(), ControlError> {
        let bytes = message::encode(message)?;
        timeout(WRITE_TIMEOUT, self.stream.write_all(&bytes)).await.map_err(|_| ControlError::Stalled)??;
        Ok(())
    }

    /// Ends the stream.
    pub(crate) async fn finish(&mut self) {
        // A peer that is gone already needs no end.
        let _ = timeout(WRITE_TIMEOUT, self.stream.shutdown()).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    async fn read_all(bytes: &[u8], chunk: usize) -> (Vec<ClientMessage>, Option<ControlError>) {
        let (mut peer, ours) = tokio::io::duplex(chunk);
        let mut reader = ControlReader::new(Box::new(ours));
        let bytes = bytes.to_vec();
        let writing = tokio::spawn(async move {
            // The reader may give up before the end.
            let _ = peer.write_all(&bytes).await;
        });
        let mut messages = Vec::new();
        let end = loop {
            match reader.next().await {
                Ok(Some(message)) => messages.push(message),
                Ok(None) => break None,
                Err(error) => break Some(error),
            }
        };
        drop(reader);
        writing.await.unwrap();
        (messages, end)
    }

    #[tokio::test]
    async fn messages_survive_any_fragmentation() {
        let sent = [ClientMessage::FetchScene { offset: 7 }, ClientMessage::Start, ClientMessage::Ping(u64::MAX)];
        let bytes: Vec<u8> = sent.iter().flat_map(|message| message::encode(message).unwrap()).collect();
        for chunk in [1, 2, 3, 7, 4096] {
            let (messages, end) = read_all(&bytes, chunk).await;
            assert_eq!(messages, sent);
            assert!(end.is_none());
        }
        let (messages, end) = read_all(&bytes[..bytes.len() - 1], 5).await;
        assert_eq!(messages.len(), 2);
        assert!(matches!(end, Some(ControlError::Truncated)));
    }

    #[tokio::test]
    async fn garbage_is_an_error_and_costs_no_memory() {
        for (bytes, expected) in [
            (&[255, 255, 255, 255][..], "at most 131072"),
            (&[1, 16, 0, 0], "at most 4096"),
            (&[2, 0, 0, 0, 250, 1], "malformed message"),
        ] {
            let (messages, end) = read_all(bytes, 64).await;
            let end = end.unwrap().to_string();
            assert!(messages.is_empty() && end.contains(expected), "{end}");
        }
    }
}
