//! A session over a WebSocket, for browsers behind networks that drop UDP.
//!
//! TCP keeps the order and sends lost bytes again, so that what is written late arrives late. Nothing queues: the gate
//! is closed until the system has taken the last frame, and newer masks replace those that wait for it.

use std::{
    io,
    net::SocketAddr,
    sync::{
        Arc, OnceLock,
        atomic::{AtomicBool, Ordering},
    },
};

use bytes::Bytes;
use tokio::{io::DuplexStream, sync::mpsc};

use super::close_code::CloseCode;

/// Poses that wait for the session, which takes them at once; more are dropped.
const WAITING_POSES: usize = 16;

/// Control bytes between the socket and the session.
const CONTROL_BYTES: usize = 64 * 1024;

/// A peer whose WebSocket is open.
pub(crate) struct SocketArrival {
    pub(crate) peer: SocketAddr,
    pub(crate) control: DuplexStream,
    pub(crate) data: SocketData,
}

/// The session's end of a WebSocket's data.
pub(crate) struct SocketData {
    poses: mpsc::Receiver<Bytes>,
    frames: mpsc::Sender<Vec<u8>>,
    busy: Busy,
    last_words: LastWords,
}

/// The socket's end.
pub(crate) struct SocketEnd {
    pub(crate) control: DuplexStream,
    pub(crate) poses: mpsc::Sender<Bytes>,
    /// Packets of a frame, each after its length (u16, little-endian).
    pub(crate) frames: mpsc::Receiver<Vec<u8>>,
    pub(crate) busy: Busy,
    pub(crate) last_words: LastWords,
}

/// What the socket says when it closes: a code, and a reason.
#[derive(Clone, Default)]
pub(crate) struct LastWords(Arc<OnceLock<(CloseCode, String)>>);

impl LastWords {
    /// The first ones count.
    pub(super) fn set(&self, code: CloseCode, reason: &str) {
        self.0.get_or_init(|| (code, reason.to_owned()));
    }

    pub(crate) fn get(&self) -> Option<(CloseCode, &str)> {
        self.0.get().map(|(code, reason)| (*code, reason.as_str()))
    }
}

/// Whether a frame is being written.
#[derive(Clone, Default)]
pub(crate) struct Busy(Arc<AtomicBool>);

impl Busy {
    /// The system has taken the frame.
    pub(crate) fn written(&self) {
        self.0.store(false, Ordering::Release);
    }
}

/// Returns the session's control stream and data, and the socket's end of both.
pub(crate) fn socket_pair() -> (DuplexStream, SocketData, SocketEnd) {
    let (near, control) = tokio::io::duplex(CONTROL_BYTES);
    let (pose_sender, poses) = mpsc::channel(WAITING_POSES);
    let (frames, frame_receiver) = mpsc::channel(1);
    let (busy, last_words) = (Busy::default(), LastWords::default());
    let data = SocketData { poses, frames, busy: busy.clone(), last_words: last_words.clone() };
    (near, data, SocketEnd { control, poses: pose_sender, frames: frame_receiver, busy, last_words })
}

impl SocketData {
    pub(super) fn last_words(&self) -> LastWords {
        self.last_words.clone()
    }

    pub(super) fn split(self) -> (SocketReceiver, SocketSender) {
        let Self { poses, frames, busy, last_words: _ } = self;
        (SocketReceiver(poses), SocketSender { frames, busy, packets: Vec::new() })
    }
}

pub(crate) struct SocketReceiver(mpsc::Receiver<Bytes>);

impl SocketReceiver {
    pub(super) async fn receive(&mut self) -> io::Result<Bytes> {
        self.0.recv().await.ok_or_else(gone)
    }
}

pub(crate) struct SocketSender {
    frames: mpsc::Sender<Vec<u8>>,
    busy: Busy,
    /// Of the frame that is being put together.
    packets: Vec<u8>,
}

impl SocketSender {
    pub(super) fn has_room(&self) -> bool {
        !self.busy.0.load(Ordering::Acquire)
    }

    pub(super) fn send(&mut self, packet: &[u8]) -> io::Result<()> {
        let length = u16::try_from(packet.len()).map_err(io::Error::other)?;
        self.packets.extend_from_slice(&length.to_le_bytes());
        self.packets.extend_from_slice(packet);
        Ok(())
    }

    /// Hands the frame over. It is dropped if an earlier one has not left, which the gate prevents.
    pub(super) fn flush(&mut self) -> io::Result<()> {
        let frame = std::mem::take(&mut self.packets);
        if frame.is_empty() {
            return Ok(());
        }
        self.busy.0.store(true, Ordering::Release);
        match self.frames.try_send(frame) {
            Ok(()) | Err(mpsc::error::TrySendError::Full(_)) => Ok(()),
            Err(mpsc::error::TrySendError::Closed(_)) => Err(gone()),
        }
    }
}

fn gone() -> io::Error {
    io::Error::new(io::ErrorKind::ConnectionAborted, "the WebSocket is closed")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn one_frame_is_under_way_at_a_time() {
        let (_control, data, mut end) = socket_pair();
        let (mut receiver, mut sender) = data.split();
        sender.flush().unwrap();
        assert!(sender.has_room(), "nothing was sent");
        sender.send(b"ab").unwrap();
        sender.send(b"c").unwrap();
        sender.flush().unwrap();
        assert!(!sender.has_room());
        assert_eq!(end.frames.recv().await.unwrap(), b"\x02\0ab\x01\0c");
        assert!(!sender.has_room(), "it was taken, not written");
        end.busy.written();
        assert!(sender.has_room());
        end.poses.try_send(Bytes::from_static(b"pose")).unwrap();
        assert_eq!(receiver.receive().await.unwrap(), "pose");
        drop(end);
        sender.send(b"d").unwrap();
        assert!(sender.flush().is_err() && receiver.receive().await.is_err());
    }
}
