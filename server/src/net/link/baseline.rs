//! The dissertation's transports (§3.1), for measurements on loopback: a control connection over TCP, and a data socket
//! per session over UDP or TCP. They have no encryption or authentication.

use std::{
    io,
    net::{IpAddr, SocketAddr},
    sync::Arc,
    time::{Duration, Instant},
};

use bytes::Bytes;
use gnomon_protocol::pose;
use gnomon_transport::baseline::{PacketReader, PacketWriter, bind_data_socket, send_udp};
use tokio::{
    net::{TcpListener, UdpSocket},
    time::timeout,
};

/// Clients send poses and feedback. Longer packets are cut off.
const MAX_RECEIVED_BYTES: usize = 2048;

pub(crate) struct LabUdpData {
    socket: UdpSocket,
    port: u16,
}

impl LabUdpData {
    /// Binds a free port of `ip`. Errors if no port is free.
    pub(crate) fn bind(ip: IpAddr) -> io::Result<Self> {
        let socket = bind_data_socket(ip)?;
        let port = socket.local_addr()?.port();
        Ok(Self { socket, port })
    }

    pub(super) const fn port(&self) -> u16 {
        self.port
    }

    pub(super) fn split(self) -> (LabUdpReceiver, LabUdpSender) {
        let socket = Arc::new(self.socket);
        (
            LabUdpReceiver { socket: Arc::clone(&socket), connected: false },
            LabUdpSender { socket, pace: Pace::new(Instant::now()) },
        )
    }
}

pub(crate) struct LabUdpReceiver {
    socket: Arc<UdpSocket>,
    connected: bool,
}

impl LabUdpReceiver {
    /// Connects to the sender of the first valid pose. From then on the kernel drops all other packets.
    pub(super) async fn receive(&mut self) -> io::Result<Bytes> {
        let mut buffer = [0; MAX_RECEIVED_BYTES];
        loop {
            let received = self.socket.recv_from(&mut buffer).await;
            let (length, from) = match received {
                Ok(received) => received,
                // The client's port is closed, but the control connection decides whether the client is gone.
                Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => continue,
                Err(error) => return Err(error),
            };
            let packet = &buffer[..length];
            if !self.connected && pose::decode_pose_packet(packet).is_ok() {
                self.socket.connect(from).await?;
                self.connected = true;
            }
            return Ok(Bytes::copy_from_slice(packet));
        }
    }
}

pub(crate) struct LabUdpSender {
    socket: Arc<UdpSocket>,
    pace: Pace,
}

/// A token bucket. Loopback has no back-pressure: packets beyond the client's socket buffer are lost, and a frame of
/// words at 1920×1080 exceeds the buffers that systems allow. So a burst is sent at once, and the rest of a larger
/// frame at 2 Gbit/s, twice the rate of the wire in the dissertation.
struct Pace {
    burst_bytes: f64,
    at: Instant,
}

impl Pace {
    const BURST_BYTES: f64 = 2e6;
    const BYTES_PER_S: f64 = 250e6;

    const fn new(now: Instant) -> Self {
        Self { burst_bytes: Self::BURST_BYTES, at: now }
    }

    /// Returns the time to wait before sending these bytes.
    fn delay(&mut self, now: Instant, bytes: u32) -> Duration {
        let refill = now.duration_since(self.at).as_secs_f64() * Self::BYTES_PER_S;
        self.burst_bytes = (self.burst_bytes + refill).min(Self::BURST_BYTES) - f64::from(bytes);
        self.at = now;
        Duration::from_secs_f64((-self.burst_bytes).max(0.0) / Self::BYTES_PER_S)
    }
}

impl LabUdpSender {
    pub(super) async fn send(&mut self, packet: &[u8]) -> io::Result<()> {
        let delay = self.pace.delay(Instant::now(), u32::try_from(packet.len()).unwrap_or(u32::MAX));
        // Timers tick once per millisecond, so shorter delays accumulate first.
        if delay >= Duration::from_millis(1) {
            tokio::time::sleep(delay).await;
        }
        // Frames follow poses, so the address is known. A refused packet means that the client closed its port.
        send_udp(&self.socket, packet).await
    }
}

pub(crate) struct LabTcpData {
    listener: TcpListener,
    port: u16,
}

impl LabTcpData {
    /// Listens on a free port of `ip`. Errors if no port is free.
    pub(crate) async fn bind(ip: IpAddr) -> io::Result<Self> {
        let listener = TcpListener::bind(SocketAddr::new(ip, 0)).await?;
        let port = listener.local_addr()?.port();
        Ok(Self { listener, port })
    }

    pub(super) const fn port(&self) -> u16 {
        self.port
    }

    pub(super) async fn accept(self, limit: Duration) -> io::Result<(PacketReader, PacketWriter)> {
        let (stream, _) = timeout(limit, self.listener.accept()).await.map_err(|_| {
            io::Error::new(io::ErrorKind::TimedOut, format!("nobody connected to data port {}", self.port))
        })??;
        stream.set_nodelay(true)?;
        let (read, write) = stream.into_split();
        Ok((PacketReader::new(read, MAX_RECEIVED_BYTES), PacketWriter::new(write)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_burst_is_free_and_more_is_paced() {
        let start = Instant::now();
        let mut pace = Pace::new(start);
        let sent = (0..127).map(|_| pace.delay(start, 65_507)).collect::<Vec<_>>();
        assert!(sent[..30].iter().all(Duration::is_zero), "{sent:?}");
        // 127 packets of 65,507 bytes, less the burst, at 250 MB/s.
        let expected = (127.0 * 65_507.0 - 2e6) / 250e6;
        assert!((sent[126].as_secs_f64() - expected).abs() < 1e-6, "{:?}", sent[126]);
        assert_eq!(pace.delay(start + Duration::from_secs(1), 65_507), Duration::ZERO, "time pays");
    }
}
