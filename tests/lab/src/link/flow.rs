//! One client's datagrams inside a link.

use std::{
    cmp::Reverse,
    collections::BinaryHeap,
    io,
    net::{Ipv4Addr, Ipv6Addr, SocketAddr},
    sync::Arc,
    time::Duration,
};

use bytes::Bytes;
use tokio::{
    net::UdpSocket,
    sync::mpsc,
    time::{Instant, sleep_until, timeout},
};

use super::{
    counters::{LinkCounts, Shared},
    impairment::{Counts, Direction, Impairment},
    settings::{LinkSettings, Settings},
};

pub(super) const MAX_DATAGRAM_BYTES: usize = 65_507;
/// Most bytes in flight in one direction: 1 Gbit/s for half a second.
const MAX_ON_THE_WAY_BYTES: usize = 64 << 20;
/// Memory of a datagram besides its bytes.
const OVERHEAD_BYTES: usize = 128;
/// Silence after which a client is forgotten.
const IDLE: Duration = Duration::from_secs(60);
/// Timers have millisecond resolution and fire a tick late, so a datagram due within a tick is sent now: delays are
/// right on average.
const TICK: Duration = Duration::from_millis(1);
/// Kernel buffers hold an uncompressed frame at 1920×1080.
const SOCKET_BUFFER_BYTES: usize = 16 << 20;

struct DelayLine {
    impairment: Impairment,
    /// Ordered by due time, then by number.
    on_the_way: BinaryHeap<Reverse<(Duration, u64, Bytes)>>,
    bytes: usize,
    number: u64,
}

impl DelayLine {
    fn new(settings: Settings, seed: u64, direction: Direction) -> Self {
        let impairment = Impairment::new(settings, seed, direction);
        Self { impairment, on_the_way: BinaryHeap::new(), bytes: 0, number: 0 }
    }

    fn push(&mut self, now: Duration, datagram: Bytes, counts: &mut Counts) {
        for delivery in self.impairment.push(now, datagram, counts).into_iter().flatten() {
            let cost = delivery.bytes.len() + OVERHEAD_BYTES;
            if self.bytes + cost > MAX_ON_THE_WAY_BYTES {
                counts.overrun += 1;
                continue;
            }
            self.bytes += cost;
            self.number += 1;
            self.on_the_way.push(Reverse((delivery.due, self.number, delivery.bytes)));
        }
    }

    fn next_due(&self) -> Option<Duration> {
        self.on_the_way.peek().map(|Reverse((due, ..))| *due)
    }

    fn pop(&mut self, now: Duration) -> Option<Bytes> {
        self.next_due().filter(|&due| due <= now + TICK)?;
        let Reverse((.., bytes)) = self.on_the_way.pop()?;
        self.bytes -= bytes.len() + OVERHEAD_BYTES;
        Some(bytes)
    }
}

pub(super) fn socket(address: SocketAddr) -> io::Result<UdpSocket> {
    let socket = socket2::Socket::new(socket2::Domain::for_address(address), socket2::Type::DGRAM, None)?;
    // The kernel clamps these to its limits.
    let _ = socket.set_recv_buffer_size(SOCKET_BUFFER_BYTES);
    let _ = socket.set_send_buffer_size(SOCKET_BUFFER_BYTES);
    socket.set_nonblocking(true)?;
    socket.bind(&address.into())?;
    UdpSocket::from_std(socket.into())
}

/// Carries one client's datagrams until it has been silent for a minute or the sender is dropped.
pub(super) async fn carry(
    mut from_client: mpsc::Receiver<Bytes>,
    listener: Arc<UdpSocket>,
    client: SocketAddr,
    server: SocketAddr,
    settings: LinkSettings,
    shared: Shared,
) -> io::Result<()> {
    let local: SocketAddr =
        if server.is_ipv4() { (Ipv4Addr::LOCALHOST, 0).into() } else { (Ipv6Addr::LOCALHOST, 0).into() };
    let to_server = socket(local)?;
    to_server.connect(server).await?;
    let mut up = DelayLine::new(settings.up, settings.seed, Direction::Up);
    let mut down = DelayLine::new(settings.down, settings.seed, Direction::Down);
    let mut buffer = vec![0; MAX_DATAGRAM_BYTES];
    let start = Instant::now();
    loop {
        let due = [up.next_due(), down.next_due()].into_iter().flatten().min();
        let mut counts = LinkCounts::default();
        let event = async {
            tokio::select! {
                datagram = from_client.recv() => Ok(datagram.map(|bytes| (Direction::Up, bytes))),
                received = to_server.recv(&mut buffer) => match received {
                    Ok(length) => Ok(Some((Direction::Down, Bytes::copy_from_slice(&buffer[..length])))),
                    Err(error) => Err(error),
                },
                () = sleep_until(start + due.unwrap_or_default().saturating_sub(TICK)), if due.is_some() => {
                    Err(io::ErrorKind::WouldBlock.into())
                }
            }
        };
        match timeout(IDLE, event).await {
            Ok(Ok(Some((Direction::Up, bytes)))) => up.push(start.elapsed(), bytes, &mut counts.up),
            Ok(Ok(Some((Direction::Down, bytes)))) => down.push(start.elapsed(), bytes, &mut counts.down),
            // The sender is gone, or the client has been silent for too long.
            Ok(Ok(None)) | Err(_) => return Ok(()),
            // A timer fired, or the peer's port is closed for now.
            Ok(Err(error)) if is_passing(&error) => {}
            Ok(Err(error)) => return Err(error),
        }
        shared.add(counts);
        let now = start.elapsed();
        while let Some(bytes) = up.pop(now) {
            passed(to_server.send(&bytes).await)?;
        }
        while let Some(bytes) = down.pop(now) {
            passed(listener.send_to(&bytes, client).await)?;
        }
    }
}

fn is_passing(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::ConnectionRefused)
}

/// Treats a closed port as a lost datagram.
fn passed(sent: io::Result<usize>) -> io::Result<()> {
    sent.map(drop).or_else(|error| if is_passing(&error) { Ok(()) } else { Err(error) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn datagrams_leave_in_time_and_memory_is_bounded() {
        let mut lane = DelayLine::new("delay=5ms".parse().unwrap(), 1, Direction::Up);
        let mut counts = Counts::default();
        for number in 0..3_u64 {
            lane.push(Duration::from_millis(number), Bytes::copy_from_slice(&number.to_le_bytes()), &mut counts);
        }
        assert_eq!(lane.next_due(), Some(Duration::from_millis(5)));
        assert_eq!(lane.pop(Duration::from_micros(3_999)), None);
        assert_eq!(lane.pop(Duration::from_millis(4)).unwrap()[0], 0);
        assert_eq!(lane.pop(Duration::from_micros(4_999)), None);
        assert_eq!([5, 6].map(|ms| lane.pop(Duration::from_millis(ms)).unwrap()[0]), [1, 2]);
        assert_eq!((lane.bytes, lane.next_due()), (0, None));
        let large = Bytes::from(vec![0; MAX_DATAGRAM_BYTES]);
        for _ in 0..2000 {
            lane.push(Duration::from_secs(1), large.clone(), &mut counts);
        }
        assert!(lane.bytes <= MAX_ON_THE_WAY_BYTES);
        let fit = u64::try_from(MAX_ON_THE_WAY_BYTES / (MAX_DATAGRAM_BYTES + OVERHEAD_BYTES)).unwrap();
        assert_eq!((counts.delivered, counts.overrun), (2003, 2000 - fit));
    }
}
