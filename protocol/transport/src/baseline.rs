//! The dissertation's transports (§3.1), for measurements on loopback: control over TCP, and data over UDP or TCP.
//! Without encryption or authentication.

use std::{
    io,
    net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr},
};

use bytes::{Bytes, BytesMut};
use gnomon_protocol::limits::MAX_LAB_PACKET_BYTES;
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _, BufWriter},
    net::{
        TcpStream, UdpSocket,
        tcp::{OwnedReadHalf, OwnedWriteHalf},
    },
};

use crate::socket::bind_udp;

/// Kernel buffers of a data socket: a frame of words at 1920×1080 has 8 MB.
const SOCKET_BUFFER_BYTES: usize = 16 << 20;

const PREFIX_BYTES: usize = 4;

/// Binds a UDP socket to a free port of `ip`.
///
/// # Errors
/// Errors if no port is free.
pub fn bind_data_socket(ip: IpAddr) -> io::Result<UdpSocket> {
    UdpSocket::from_std(bind_udp(SocketAddr::new(ip, 0), SOCKET_BUFFER_BYTES)?)
}

/// Returns a UDP socket on loopback that exchanges packets with `server` only.
///
/// # Errors
/// Errors if no port is free or `server` is not on loopback.
pub async fn connect_udp(server: SocketAddr) -> io::Result<UdpSocket> {
    let loopback = if server.is_ipv4() { Ipv4Addr::LOCALHOST.into() } else { Ipv6Addr::LOCALHOST.into() };
    let socket = bind_data_socket(loopback)?;
    socket.connect(server).await?;
    Ok(socket)
}

/// Sends one packet over a connected socket. It is lost if the peer's port is closed, as with any UDP.
///
/// # Errors
/// Errors if the socket fails.
pub async fn send_udp(socket: &UdpSocket, packet: &[u8]) -> io::Result<()> {
    match socket.send(packet).await {
        Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => Ok(()),
        sent => sent.map(drop),
    }
}

/// Opens a TCP connection that sends small packets at once.
///
/// # Errors
/// Errors if nobody listens at `server`.
pub async fn connect_tcp(server: SocketAddr) -> io::Result<TcpStream> {
    let stream = TcpStream::connect(server).await?;
    stream.set_nodelay(true)?;
    Ok(stream)
}

/// Reads packets from a TCP stream. Each follows its length, a little-endian `u32`.
#[derive(Debug)]
pub struct PacketReader {
    stream: OwnedReadHalf,
    max_packet_bytes: usize,
    buffer: BytesMut,
}

impl PacketReader {
    /// Packets above `max_packet_bytes` are refused before they are read.
    #[must_use]
    pub fn new(stream: OwnedReadHalf, max_packet_bytes: usize) -> Self {
        Self { stream, max_packet_bytes, buffer: BytesMut::with_capacity(4 * max_packet_bytes) }
    }

    /// Returns the next packet. Cancel-safe.
    ///
    /// # Errors
    /// Errors if the stream ends or fails, or a packet is too long.
    pub async fn receive(&mut self) -> io::Result<Bytes> {
        loop {
            if let Some(prefix) = self.buffer.first_chunk::<PREFIX_BYTES>() {
                let length = u32::from_le_bytes(*prefix) as usize;
                if length > self.max_packet_bytes {
                    let reason = format!("a packet of {length} bytes: at most {} are allowed", self.max_packet_bytes);
                    return Err(io::Error::new(io::ErrorKind::InvalidData, reason));
                }
                if self.buffer.len() >= PREFIX_BYTES + length {
                    return Ok(self.buffer.split_to(PREFIX_BYTES + length).freeze().slice(PREFIX_BYTES..));
                }
            }
            self.buffer.reserve(PREFIX_BYTES + self.max_packet_bytes);
            if self.stream.read_buf(&mut self.buffer).await? == 0 {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
        }
    }
}

/// Writes packets to a TCP stream. Each follows its length, a little-endian `u32`.
#[derive(Debug)]
pub struct PacketWriter {
    stream: BufWriter<OwnedWriteHalf>,
}

impl PacketWriter {
    #[must_use]
    pub fn new(stream: OwnedWriteHalf) -> Self {
        Self { stream: BufWriter::new(stream) }
    }

    /// Writes one packet, which may be buffered until [`Self::flush`].
    ///
    /// # Errors
    /// Errors if the packet has more than [`MAX_LAB_PACKET_BYTES`] or the stream fails.
    pub async fn send(&mut self, packet: &[u8]) -> io::Result<()> {
        let length = u32::try_from(packet.len()).ok().filter(|_| packet.len() <= MAX_LAB_PACKET_BYTES);
        let length = length.ok_or_else(|| {
            io::Error::new(io::ErrorKind::InvalidInput, format!("a packet of {} bytes", packet.len()))
        })?;
        self.stream.write_all(&length.to_le_bytes()).await?;
        self.stream.write_all(packet).await
    }

    /// Hands everything written to the kernel.
    ///
    /// # Errors
    /// Errors if the stream fails.
    pub async fn flush(&mut self) -> io::Result<()> {
        self.stream.flush().await
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn tcp_packets_keep_their_borders_and_their_limit() {
        let listener = tokio::net::TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
        let client = connect_tcp(listener.local_addr().unwrap()).await.unwrap();
        let (server, _) = listener.accept().await.unwrap();
        let mut receiver = PacketReader::new(client.into_split().0, MAX_LAB_PACKET_BYTES);
        let mut sender = PacketWriter::new(server.into_split().1);
        let sent = [vec![1; 5], Vec::new(), vec![2; MAX_LAB_PACKET_BYTES]];
        for packet in &sent {
            sender.send(packet).await.unwrap();
        }
        sender.flush().await.unwrap();
        for packet in &sent {
            assert_eq!(receiver.receive().await.unwrap(), packet);
        }
        assert_eq!(sender.send(&[0; 65_508]).await.unwrap_err().kind(), io::ErrorKind::InvalidInput);
        sender.stream.write_all(&65_508_u32.to_le_bytes()).await.unwrap();
        sender.flush().await.unwrap();
        assert_eq!(receiver.receive().await.unwrap_err().kind(), io::ErrorKind::InvalidData);
    }
}
