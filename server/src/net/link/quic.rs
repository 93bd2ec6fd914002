//! A session over QUIC, native or WebTransport.

use std::{io, mem::size_of, net::SocketAddr, sync::Arc, time::Duration};

use bytes::Bytes;
use gnomon_protocol::{limits::MAX_PACKET_BYTES, refresh::PathState};
use gnomon_transport::congestion::ignore_app_limit;
use web_transport_quinn::{RecvStream, SendStream, Session, SessionError};

use super::{close_code::CloseCode, counts::TransportCounts};
use crate::limits::{SEND_BACKLOG_FLOOR_BYTES, SEND_BACKLOG_FRAMES};

#[derive(Clone)]
pub(crate) struct QuicData {
    session: Arc<Session>,
    buffer_bytes: usize,
}

/// WebTransport allows no longer reason (draft-ietf-webtrans-http3 §6), and QUIC's must fit into one packet.
const MAX_CLOSE_REASON_BYTES: usize = 1024;

/// quinn's overhead per queued datagram, besides its bytes.
const QUEUED_OVERHEAD_BYTES: usize = size_of::<Bytes>();

impl QuicData {
    /// `buffer_bytes` is the size of the session's datagram send buffer.
    pub(crate) fn new(session: Session, buffer_bytes: usize) -> Self {
        Self { session: Arc::new(session), buffer_bytes }
    }

    /// Waits for the peer's next stream.
    pub(crate) async fn accept_bi(&self) -> Result<(SendStream, RecvStream), SessionError> {
        self.session.accept_bi().await
    }

    /// Largest datagram that the path carries.
    pub(crate) fn max_datagram_bytes(&self) -> usize {
        self.session.max_datagram_size()
    }

    pub(super) async fn receive(&self) -> io::Result<Bytes> {
        self.session.read_datagram().await.map_err(io::Error::other)
    }

    pub(super) fn send(&self, packet: Bytes) -> io::Result<()> {
        self.session.send_datagram(packet).map_err(io::Error::other)
    }

    /// Smaller over WebTransport, which adds a few bytes to each datagram.
    pub(super) fn max_packet_bytes(&self) -> usize {
        self.max_datagram_bytes().min(MAX_PACKET_BYTES)
    }

    /// quinn silently drops the oldest datagrams when its buffer overflows, which would cut off the front of a frame.
    /// So a frame is sent only if all of it fits, and less than a frame is queued before it.
    pub(super) fn has_room(&self, packets: usize, bytes: usize) -> bool {
        let space = self.session.datagram_send_buffer_space();
        let frame = bytes.saturating_add(packets.saturating_mul(QUEUED_OVERHEAD_BYTES));
        frame_fits(self.buffer_bytes.saturating_sub(space), frame, space)
    }

    /// Byte budget of a frame if the next one follows after `interval`.
    pub(super) fn frame_budget(&self, interval: Duration) -> usize {
        let connection: &quinn::Connection = &self.session;
        let waiting = self.buffer_bytes.saturating_sub(self.session.datagram_send_buffer_space());
        let path = PathState {
            window_bytes: connection.stats().path.cwnd,
            round_trip: connection.rtt(),
            waiting_bytes: waiting as u64,
        };
        path.frame_budget(interval)
    }

    /// Sets whether frames are being reduced to what the path can carry.
    pub(super) fn hold_back(&self, held_back: bool) {
        let connection: &quinn::Connection = &self.session;
        ignore_app_limit(connection, held_back);
    }

    /// Where the peer is now: it may have moved.
    pub(super) fn peer(&self) -> SocketAddr {
        let connection: &quinn::Connection = &self.session;
        connection.remote_address()
    }

    pub(super) fn counts(&self) -> TransportCounts {
        // The session's own statistics lack these.
        let connection: &quinn::Connection = &self.session;
        let stats = connection.stats();
        TransportCounts {
            datagrams_received: stats.frame_rx.datagram,
            datagrams_sent: stats.frame_tx.datagram,
            udp_received: stats.udp_rx.datagrams,
            udp_sent: stats.udp_tx.datagrams,
            quic_lost: stats.path.lost_packets,
        }
    }

    /// Closes the session with a reason that the peer's user can read. A browser's page gets it as
    /// `WebTransportCloseInfo`.
    pub(crate) fn close(&self, code: CloseCode, reason: &str) {
        let end = reason.floor_char_boundary(MAX_CLOSE_REASON_BYTES);
        self.session.close(code as u32, &reason.as_bytes()[..end]);
    }
}

/// Returns whether a frame of `frame` bytes fits into `space`, behind `waiting` queued bytes.
fn frame_fits(waiting: usize, frame: usize, space: usize) -> bool {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "a share of a frame, which has at most 40 MB"
    )]
    let backlog = (frame as f64 * (SEND_BACKLOG_FRAMES - 1.0)) as usize;
    frame <= space && waiting <= backlog.max(SEND_BACKLOG_FLOOR_BYTES)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gate_opens_for_whole_frames_behind_less_than_one() {
        for (waiting, frame, space, fits) in [
            (0, 100_000, 200_000, true),
            (60_000, 100_000, 200_000, true),
            (60_001, 100_000, 200_000, false),
            (0, 100_000, 99_999, false),
            (16 * 1024, 500, 200_000, true),
            (16 * 1024 + 1, 500, 200_000, false),
        ] {
            assert_eq!(frame_fits(waiting, frame, space), fits, "{waiting} {frame} {space}");
        }
    }
}
