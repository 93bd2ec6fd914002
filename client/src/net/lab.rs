//! The dissertation's transports (§3.1), for measurements on loopback: control over TCP, and a data socket beside it.

use std::{
    io,
    net::{Ipv4Addr, Ipv6Addr, SocketAddr},
    sync::Arc,
    time::Duration,
};

use bytes::{Bytes, BytesMut};
use gnomon_protocol::limits::MAX_LAB_PACKET_BYTES;
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::{TcpStream, UdpSocket, tcp::OwnedReadHalf},
    sync::mpsc,
    task::JoinHandle,
};

/// Kernel buffer for packets on their way: a frame of words at 1920×1080 has 8 MB.
const SOCKET_BUFFER_BYTES: usize = 16 << 20;

/// A socket that speaks with the server's data port only.
pub(super) async fn connect_udp(server: SocketAddr) -> io::Result<Arc<UdpSocket>> {
    let local: SocketAddr =
        if server.is_ipv4() { (Ipv4Addr::LOCALHOST, 0).into() } else { (Ipv6Addr::LOCALHOST, 0).into() };
    let socket = socket2::Socket::new(socket2::Domain::for_address(local), socket2::Type::DGRAM, None)?;
    // The kernel clamps it to what it allows; what does not fit is lost, as on any UDP.
    let _ = socket.set_recv_buffer_size(SOCKET_BUFFER_BYTES);
    socket.set_nonblocking(true)?;
    socket.bind(&local.into())?;
    let socket = UdpSocket::from_std(socket.into())?;
    socket.connect(server).await?;
    Ok(Arc::new(socket))
}

/// Packets that may wait while the receive task decodes: four frames of words at 1920×1080. The kernel's own buffer
/// often holds only three packets of this size.
const WAITING_PACKETS: usize = 512;

/// Packets over UDP, taken off the socket by a task that does nothing else.
pub(super) struct UdpReceiver {
    packets: mpsc::Receiver<io::Result<Bytes>>,
    packet: Bytes,
    task: JoinHandle<()>,
}

impl UdpReceiver {
    pub(super) fn new(socket: Arc<UdpSocket>) -> Self {
        let (queue, packets) = mpsc::channel(WAITING_PACKETS);
        Self { packets, packet: Bytes::new(), task: tokio::spawn(take_packets(socket, queue)) }
    }

    pub(super) async fn receive(&mut self) -> io::Result<&[u8]> {
        self.packet = self.packets.recv().await.ok_or(io::ErrorKind::UnexpectedEof)??;
        Ok(&self.packet)
    }
}

impl Drop for UdpReceiver {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn take_packets(socket: Arc<UdpSocket>, queue: mpsc::Sender<io::Result<Bytes>>) {
    let mut buffer = vec![0; MAX_LAB_PACKET_BYTES];
    loop {
        let received = match socket.recv(&mut buffer).await {
            Ok(length) => Ok(Bytes::copy_from_slice(&buffer[..length])),
            // The server has closed its port; that its session has ended, the control stream says.
            Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {
                tokio::time::sleep(Duration::from_millis(10)).await;
                continue;
            }
            Err(error) => Err(error),
        };
        let last = received.is_err();
        // A packet that finds no room is lost, as it would be in the kernel.
        let closed = matches!(queue.try_send(received), Err(mpsc::error::TrySendError::Closed(_)));
        if last || closed {
            return;
        }
    }
}

/// Packets over TCP, each after its length (u32, little-endian).
pub(super) struct TcpReceiver {
    stream: OwnedReadHalf,
    buffer: BytesMut,
}

impl TcpReceiver {
    pub(super) fn new(stream: OwnedReadHalf) -> Self {
        Self { stream, buffer: BytesMut::with_capacity(4 * MAX_LAB_PACKET_BYTES) }
    }

    pub(super) async fn receive(&mut self) -> io::Result<Bytes> {
        loop {
            if let Some(prefix) = self.buffer.first_chunk::<4>() {
                let length = u32::from_le_bytes(*prefix) as usize;
                if length > MAX_LAB_PACKET_BYTES {
                    let reason = format!("a packet of {length} bytes: at most {MAX_LAB_PACKET_BYTES} are allowed");
                    return Err(io::Error::new(io::ErrorKind::InvalidData, reason));
                }
                if self.buffer.len() >= 4 + length {
                    return Ok(self.buffer.split_to(4 + length).freeze().slice(4..));
                }
            }
            self.buffer.reserve(4 + MAX_LAB_PACKET_BYTES);
            if self.stream.read_buf(&mut self.buffer).await? == 0 {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
        }
    }
}

/// Opens the TCP data connection.
pub(super) async fn connect_tcp(server: SocketAddr) -> io::Result<TcpStream> {
    let stream = TcpStream::connect(server).await?;
    stream.set_nodelay(true)?;
    Ok(stream)
}

/// Writes a packet after its length.
pub(super) async fn write_packet(stream: &mut tokio::net::tcp::OwnedWriteHalf, packet: &[u8]) -> io::Result<()> {
    let length = u32::try_from(packet.len()).map_err(|_| io::Error::from(io::ErrorKind::InvalidInput))?;
    stream.write_all(&[&length.to_le_bytes(), packet].concat()).await
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn tcp_packets_keep_their_borders_and_their_limit() {
        let listener = tokio::net::TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
        let client = connect_tcp(listener.local_addr().unwrap()).await.unwrap();
        let (server, _) = listener.accept().await.unwrap();
        let (mut receiver, mut sender) = (TcpReceiver::new(client.into_split().0), server.into_split().1);
        let sent = [vec![1; 5], Vec::new(), vec![2; MAX_LAB_PACKET_BYTES]];
        for packet in &sent {
            write_packet(&mut sender, packet).await.unwrap();
        }
        for packet in &sent {
            assert_eq!(receiver.receive().await.unwrap(), packet);
        }
        sender.write_all(&65_508_u32.to_le_bytes()).await.unwrap();
        assert_eq!(receiver.receive().await.unwrap_err().kind(), io::ErrorKind::InvalidData);
    }
}
