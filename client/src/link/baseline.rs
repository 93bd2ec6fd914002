//! Receiving over the dissertation's UDP transport (§3.1).

use std::{io, sync::Arc, time::Duration};

use bytes::Bytes;
use gnomon_protocol::limits::MAX_LAB_PACKET_BYTES;
use tokio::{net::UdpSocket, sync::mpsc, task::JoinHandle};

/// Packets that may wait while the receive task decodes: four frames of words at 1920×1080. The kernel's buffer often
/// holds only three packets of this size.
const WAITING_PACKETS: usize = 512;

/// Packets over UDP. Its own task empties the socket.
pub(crate) struct UdpReceiver {
    packets: mpsc::Receiver<io::Result<Bytes>>,
    task: JoinHandle<()>,
}

impl UdpReceiver {
    pub(super) fn new(socket: Arc<UdpSocket>) -> Self {
        let (queue, packets) = mpsc::channel(WAITING_PACKETS);
        Self { packets, task: tokio::spawn(receive_all(socket, queue)) }
    }

    /// Returns the next packet. Cancel-safe.
    pub(super) async fn receive(&mut self) -> io::Result<Bytes> {
        self.packets.recv().await.ok_or(io::ErrorKind::UnexpectedEof)?
    }
}

impl Drop for UdpReceiver {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn receive_all(socket: Arc<UdpSocket>, queue: mpsc::Sender<io::Result<Bytes>>) {
    let mut buffer = vec![0; MAX_LAB_PACKET_BYTES];
    loop {
        let received = match socket.recv(&mut buffer).await {
            Ok(length) => Ok(Bytes::copy_from_slice(&buffer[..length])),
            // The server has closed its port. The control stream tells whether the session has ended.
            Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {
                tokio::time::sleep(Duration::from_millis(10)).await;
                continue;
            }
            Err(error) => Err(error),
        };
        let last = received.is_err();
        // A packet is dropped if the queue is full, as the kernel would do.
        let closed = matches!(queue.try_send(received), Err(mpsc::error::TrySendError::Closed(_)));
        if last || closed {
            return;
        }
    }
}
