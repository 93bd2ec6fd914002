//! Messages on the control stream, whatever carries it.

use std::{io, time::Duration};

use bytes::{Buf as _, BytesMut};
use gnomon_protocol::{
    limits::MAX_MESSAGE_BYTES,
    message::{self, ClientMessage, MessageError, ServerMessage},
};
use thiserror::Error;
use tokio::{
    io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _},
    time::timeout,
};

const PREFIX_BYTES: usize = 4;

/// How long the server may take to read what is written to it.
const WRITE_TIMEOUT: Duration = Duration::from_secs(10);

/// Why the conversation broke off.
#[derive(Debug, Error)]
pub enum ControlError {
    /// The stream failed.
    #[error("{0}")]
    Stream(#[from] io::Error),
    /// The server ended the stream.
    #[error("the server closed the connection")]
    Closed,
    /// The server's bytes are no message.
    #[error(transparent)]
    Message(#[from] MessageError),
    /// The server did not read, or not answer, for too long.
    #[error("no answer for {} s", .0.as_secs_f64())]
    Silent(Duration),
}

/// The server's half of the conversation.
pub(crate) struct ControlReader {
    stream: Box<dyn AsyncRead + Send + Unpin>,
    buffer: BytesMut,
}

impl ControlReader {
    pub(crate) fn new(stream: impl AsyncRead + Send + Unpin + 'static) -> Self {
        Self { stream: Box::new(stream), buffer: BytesMut::new() }
    }

    /// The next message. Cancelling it loses nothing.
    pub(crate) async fn next(&mut self) -> Result<ServerMessage, ControlError> {
        loop {
            if let Some(prefix) = self.buffer.first_chunk::<PREFIX_BYTES>() {
                let length = message::decode_length(*prefix)?;
                if self.buffer.len() >= PREFIX_BYTES + length {
                    self.buffer.advance(PREFIX_BYTES);
                    return Ok(message::decode(&self.buffer.split_to(length))?);
                }
            }
            self.buffer.reserve(PREFIX_BYTES + MAX_MESSAGE_BYTES);
            if self.stream.read_buf(&mut self.buffer).await? == 0 {
                return Err(ControlError::Closed);
            }
        }
    }

    /// The next message, if it comes in time.
    pub(crate) async fn next_within(&mut self, patience: Duration) -> Result<ServerMessage, ControlError> {
        timeout(patience, self.next()).await.map_err(|_| ControlError::Silent(patience))?
    }
}

/// This client's half of the conversation.
pub(crate) struct ControlWriter {
    stream: Box<dyn AsyncWrite + Send + Unpin>,
}

impl ControlWriter {
    pub(crate) fn new(stream: impl AsyncWrite + Send + Unpin + 'static) -> Self {
        Self { stream: Box::new(stream) }
    }

    /// Writes a message. Cancelling it breaks the stream.
    pub(crate) async fn write(&mut self, message: &ClientMessage) -> Result<(), ControlError> {
        let bytes = message::encode(message)?;
        let write = async {
            self.stream.write_all(&bytes).await?;
            self.stream.flush().await
        };
        Ok(timeout(WRITE_TIMEOUT, write).await.map_err(|_| ControlError::Silent(WRITE_TIMEOUT))??)
    }

    /// Ends the stream.
    pub(crate) async fn finish(&mut self) {
        // A server that is gone already needs no end.
        let _ = timeout(WRITE_TIMEOUT, self.stream.shutdown()).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn messages_survive_any_fragmentation_and_the_end_is_seen() {
        let sent = [
            ServerMessage::Pong(7),
            ServerMessage::SceneChunk { offset: 3, bytes: vec![9; 60_000] },
            ServerMessage::Closing { reason: "test".into() },
        ];
        for chunk in [1, 7, 100_000] {
            let (mut peer, ours) = tokio::io::duplex(chunk);
            let bytes: Vec<u8> = sent.iter().flat_map(|message| message::encode(message).unwrap()).collect();
            let writing = tokio::spawn(async move { peer.write_all(&bytes).await.unwrap() });
            let mut reader = ControlReader::new(ours);
            for message in &sent {
                assert_eq!(&reader.next().await.unwrap(), message);
            }
            assert!(matches!(reader.next().await, Err(ControlError::Closed)));
            writing.await.unwrap();
        }
    }

    #[tokio::test]
    async fn a_message_beyond_the_limit_is_refused_before_it_is_read() {
        let (mut peer, ours) = tokio::io::duplex(64);
        peer.write_all(&u32::MAX.to_le_bytes()).await.unwrap();
        let error = ControlReader::new(ours).next().await.unwrap_err();
        assert!(matches!(error, ControlError::Message(MessageError::TooLong(_))), "{error}");
    }
}
