//! Closes a link and reads its counters.

use std::net::SocketAddr;

use super::{close_code::CloseCode, counts::TransportCounts, quic::QuicData, socket::LastWords};

/// Lab links close when their sockets are dropped, WebSockets with their control stream.
#[derive(Clone)]
pub(crate) struct Closer(Kind);

#[derive(Clone)]
enum Kind {
    Lab,
    Quic(QuicData),
    Socket(LastWords),
}

impl Closer {
    pub(super) const fn quic(data: QuicData) -> Self {
        Self(Kind::Quic(data))
    }

    pub(super) const fn socket(last_words: LastWords) -> Self {
        Self(Kind::Socket(last_words))
    }

    /// Says how the session will be closed, before its control stream ends. A WebSocket closes with the stream, and
    /// says it then.
    pub(crate) fn announce(&self, code: CloseCode, reason: &str) {
        if let Kind::Socket(last_words) = &self.0 {
            last_words.set(code, reason);
        }
    }

    /// Closes the connection now. Data in flight is lost.
    pub(crate) fn close(&self, code: CloseCode, reason: &str) {
        if let Kind::Quic(data) = &self.0 {
            data.close(code, reason);
        }
    }

    /// For a link without a connection.
    pub(crate) const fn none() -> Self {
        Self(Kind::Lab)
    }

    /// The peer's address now; `None` where it cannot change.
    pub(crate) fn peer(&self) -> Option<SocketAddr> {
        self.data().map(QuicData::peer)
    }

    /// `None` where the system counts.
    pub(crate) fn counts(&self) -> Option<TransportCounts> {
        self.data().map(QuicData::counts)
    }

    const fn data(&self) -> Option<&QuicData> {
        match &self.0 {
            Kind::Quic(data) => Some(data),
            Kind::Lab | Kind::Socket(_) => None,
        }
    }
}
