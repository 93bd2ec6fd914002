//! Closes a link and reads its counters.

use std::net::SocketAddr;

use super::{close_code::CloseCode, counts::TransportCounts, quic::QuicData};

/// Does nothing for lab links, which close when their sockets are dropped.
#[derive(Clone)]
pub(crate) struct Closer(Option<QuicData>);

impl Closer {
    pub(super) const fn new(data: QuicData) -> Self {
        Self(Some(data))
    }

    /// Closes the connection now. Data in flight is lost.
    pub(crate) fn close(&self, code: CloseCode, reason: &str) {
        if let Some(data) = &self.0 {
            data.close(code, reason);
        }
    }

    /// For a link without a connection.
    pub(crate) const fn none() -> Self {
        Self(None)
    }

    /// The peer's address now; `None` on lab links.
    pub(crate) fn peer(&self) -> Option<SocketAddr> {
        self.0.as_ref().map(QuicData::peer)
    }

    /// `None` on lab links.
    pub(crate) fn counts(&self) -> Option<TransportCounts> {
        self.0.as_ref().map(QuicData::counts)
    }
}
