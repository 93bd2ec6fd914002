//! The send queue of a session's control stream. Sends in order, never faster than the client reads.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use gnomon_protocol::{limits::SCENE_CHUNK_BYTES, message::ServerMessage};
use gnomon_transport::control::{ControlError, ControlWriter};
use tokio::{sync::mpsc, task::JoinHandle, time::timeout};

use crate::limits::CONTROL_QUEUE;

/// Replies kept while the client does not read. More are dropped.
const MAX_QUEUED_REPLIES: usize = 16;

pub(super) struct Outbox {
    queue: Option<mpsc::Sender<ServerMessage>>,
    priority: VecDeque<ServerMessage>,
    /// Offset of the next scene chunk while the scene is being sent.
    scene_next: Option<usize>,
    /// When the next chunk may go.
    scene_due: Instant,
    writing: JoinHandle<Result<(), ControlError>>,
}

impl Outbox {
    pub(super) fn start(mut writer: ControlWriter<ServerMessage>) -> Self {
        let (queue, mut messages) = mpsc::channel(CONTROL_QUEUE);
        let writing = tokio::spawn(async move {
            while let Some(message) = messages.recv().await {
                writer.write(&message).await?;
            }
            writer.finish().await;
            Ok(())
        });
        Self { queue: Some(queue), priority: VecDeque::new(), scene_next: None, scene_due: Instant::now(), writing }
    }

    /// Queues a message ahead of the rest of the scene.
    pub(super) fn notify(&mut self, message: ServerMessage) {
        self.priority.push_back(message);
    }

    /// Queues a message, or drops it if the client does not read.
    pub(super) fn reply(&mut self, message: ServerMessage) {
        if self.priority.len() < MAX_QUEUED_REPLIES {
            self.priority.push_back(message);
        }
    }

    /// Whether no message waits for the writer.
    pub(super) fn is_empty(&self) -> bool {
        self.priority.is_empty()
    }

    pub(super) fn send_scene_from(&mut self, offset: usize) {
        self.scene_next = Some(offset);
    }

    pub(super) fn stop_scene(&mut self) {
        self.scene_next = None;
    }

    /// Hands one message to the writer once it has room. Waits forever if there is nothing to send. Chunks of the scene
    /// keep the `pace`, which returns when the one after it may go. Cancel-safe. Errors if the stream is broken, or the
    /// client has not read for too long.
    pub(super) async fn pump(&mut self, scene: &[u8], pace: impl FnOnce(usize) -> Instant) -> Result<(), ControlError> {
        let Some(queue) = self.queue.clone() else { return std::future::pending().await };
        let due = self.scene_due;
        let is_chunk = self.priority.is_empty();
        let room = async {
            if is_chunk {
                tokio::time::sleep_until(due.into()).await;
            }
            queue.reserve_owned().await
        };
        let permit = tokio::select! {
            ended = &mut self.writing => return self.writer_ended(ended),
            permit = room, if !is_chunk || self.scene_next.is_some() => permit,
        };
        let Ok(permit) = permit else {
            let ended = (&mut self.writing).await;
            return self.writer_ended(ended);
        };
        if let Some(message) = self.priority.pop_front() {
            permit.send(message);
        } else if let Some(first) = self.scene_next {
            let end = scene.len().min(first + SCENE_CHUNK_BYTES);
            permit.send(ServerMessage::SceneChunk { offset: first as u64, bytes: scene[first..end].to_vec() });
            self.scene_next = (end < scene.len()).then_some(end);
            self.scene_due = pace(end - first);
        }
        Ok(())
    }

    fn writer_ended(
        &mut self,
        ended: Result<Result<(), ControlError>, tokio::task::JoinError>,
    ) -> Result<(), ControlError> {
        self.queue = None;
        match ended {
            Ok(result) => result,
            Err(error) => Err(ControlError::Stream(std::io::Error::other(error))),
        }
    }

    /// Writes the queued messages and ends the stream, within `limit`.
    pub(super) async fn finish(&mut self, limit: Duration) {
        self.scene_next = None;
        let finish = async {
            while !self.priority.is_empty() && self.queue.is_some() {
                if self.pump(&[], |_| Instant::now()).await.is_err() {
                    return;
                }
            }
            if self.queue.take().is_some() {
                // A failed write needs no report: the session is over.
                let _ = (&mut self.writing).await;
            }
        };
        let _ = timeout(limit, finish).await;
    }
}

impl Drop for Outbox {
    fn drop(&mut self) {
        self.writing.abort();
    }
}

#[cfg(test)]
mod tests {
    use gnomon_protocol::message;
    use tokio::io::AsyncReadExt as _;

    use super::*;

    fn at_once(_: usize) -> Instant {
        Instant::now()
    }

    async fn read(stream: &mut tokio::io::DuplexStream) -> Option<ServerMessage> {
        let mut prefix = [0; 4];
        stream.read_exact(&mut prefix).await.ok()?;
        let mut bytes = vec![0; message::decode_length(prefix).unwrap()];
        stream.read_exact(&mut bytes).await.unwrap();
        Some(message::decode(&bytes).unwrap())
    }

    #[tokio::test]
    async fn the_scene_obeys_back_pressure_and_messages_overtake_it() {
        let scene: Vec<u8> = (0..=250).cycle().take(20 * SCENE_CHUNK_BYTES + 5).collect();
        let (ours, mut theirs) = tokio::io::duplex(1000);
        let mut outbox = Outbox::start(ControlWriter::new(ours, Duration::from_secs(5)));
        outbox.send_scene_from(7);
        let unread = timeout(Duration::from_millis(50), async {
            loop {
                outbox.pump(&scene, at_once).await.unwrap();
            }
        });
        assert!(unread.await.is_err());
        let queued = outbox.scene_next.unwrap();
        assert!(
            queued <= 7 + (CONTROL_QUEUE + 1) * SCENE_CHUNK_BYTES,
            "{queued} bytes queued for a client that reads none"
        );
        outbox.notify(ServerMessage::Closing { reason: "test".into(), may_return: true });

        let whole = scene.clone();
        let pumping = tokio::spawn(async move {
            while outbox.scene_next.is_some() {
                outbox.pump(&whole, at_once).await.unwrap();
            }
            outbox.finish(Duration::from_secs(5)).await;
        });
        let (mut received, mut closing_at) = (scene[..7].to_vec(), None);
        while let Some(message) = read(&mut theirs).await {
            match message {
                ServerMessage::SceneChunk { offset, bytes } => {
                    assert_eq!(offset, received.len() as u64);
                    received.extend_from_slice(&bytes);
                }
                ServerMessage::Closing { .. } => closing_at = Some(received.len()),
                other => panic!("{other:?}"),
            }
        }
        pumping.await.unwrap();
        assert_eq!(received, scene);
        assert!(closing_at.unwrap() < scene.len(), "a message does not wait for the scene");
    }

    #[tokio::test]
    async fn a_broken_stream_is_reported() {
        let (ours, theirs) = tokio::io::duplex(64);
        drop(theirs);
        let mut outbox = Outbox::start(ControlWriter::new(ours, Duration::from_secs(5)));
        for number in 0..100 {
            outbox.reply(ServerMessage::Pong(number));
        }
        assert_eq!(outbox.priority.len(), MAX_QUEUED_REPLIES);
        let broken = async { while outbox.pump(&[], at_once).await.is_ok() {} };
        timeout(Duration::from_secs(5), broken).await.unwrap();
    }

    #[tokio::test]
    async fn chunks_keep_their_pace_and_other_messages_do_not_wait() {
        let scene = vec![7_u8; 3 * SCENE_CHUNK_BYTES];
        let (ours, mut theirs) = tokio::io::duplex(8 * SCENE_CHUNK_BYTES);
        let mut outbox = Outbox::start(ControlWriter::new(ours, Duration::from_secs(5)));
        outbox.send_scene_from(0);
        outbox
            .pump(&scene, |bytes| {
                assert_eq!(bytes, SCENE_CHUNK_BYTES);
                Instant::now() + Duration::from_secs(3600)
            })
            .await
            .unwrap();
        assert!(timeout(Duration::from_millis(30), outbox.pump(&scene, at_once)).await.is_err(), "it is not due");
        outbox.reply(ServerMessage::Pong(1));
        timeout(Duration::from_secs(5), outbox.pump(&scene, at_once)).await.unwrap().unwrap();
        assert!(matches!(read(&mut theirs).await, Some(ServerMessage::SceneChunk { offset: 0, .. })));
        assert_eq!(read(&mut theirs).await, Some(ServerMessage::Pong(1)));
        outbox.scene_due = Instant::now();
        outbox.pump(&scene, at_once).await.unwrap();
        assert!(matches!(read(&mut theirs).await, Some(ServerMessage::SceneChunk { offset: 1.., .. })));
    }
}
