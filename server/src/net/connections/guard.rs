//! Closes a connection, on whatever path its owner ends.

use std::{sync::OnceLock, time::Duration};

use tokio::time::{sleep, timeout};

use super::{
    place::{Place, Tenure},
    table::Stage,
};
use crate::{
    limits::{
        ACKNOWLEDGED_SHARE, CLOSE_TIMEOUT, MAX_BYTES_BEFORE_ADMISSION, MAX_RECEIVED_BYTES_PER_SECOND,
        RECEIVE_WINDOW_BYTES,
    },
    net::{
        alpn::is_web,
        link::{CloseCode, QuicData},
    },
};

/// Interval at which bytes before admission are counted.
const METER: Duration = Duration::from_millis(50);

/// Dropping it closes the connection at once.
pub(crate) struct Guard {
    transport: Transport,
    place: Place,
}

enum Transport {
    Quic {
        connection: quinn::Connection,
        /// Closes with a reason that a browser's page sees, too.
        session: OnceLock<QuicData>,
    },
    /// Its owner drops its sockets, which closes them.
    Lab { _tenure: Tenure },
}

/// Why a peer has to go before it is admitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Expelled {
    Evicted,
    TooMuch,
}

impl Guard {
    pub(crate) const fn quic(connection: quinn::Connection, place: Place) -> Self {
        Self { transport: Transport::Quic { connection, session: OnceLock::new() }, place }
    }

    pub(crate) const fn lab(place: Place, tenure: Tenure) -> Self {
        Self { transport: Transport::Lab { _tenure: tenure }, place }
    }

    /// From now on, closing tells the peer the reason through the session.
    pub(crate) fn carry(&self, data: &QuicData) {
        if let Transport::Quic { session, .. } = &self.transport {
            let _ = session.set(data.clone());
        }
    }

    /// Counts the connection as a session's.
    pub(crate) fn admit(&self) {
        self.place.set(Stage::Admitted);
        if let Transport::Quic { connection, .. } = &self.transport {
            connection.set_receive_window(RECEIVE_WINDOW_BYTES.into());
        }
    }

    /// Waits until the peer has to go before it is admitted.
    pub(crate) async fn expelled(&self) -> Expelled {
        let too_much = async {
            let Transport::Quic { connection, .. } = &self.transport else { return std::future::pending().await };
            while connection.stats().udp_rx.bytes <= MAX_BYTES_BEFORE_ADMISSION {
                sleep(METER).await;
            }
        };
        tokio::select! {
            () = self.place.evicted() => Expelled::Evicted,
            () = too_much => Expelled::TooMuch,
        }
    }

    /// Waits until an admitted peer floods the connection. Frames of HTTP/3 that belong to no stream of the session
    /// are seen nowhere else.
    pub(crate) async fn flooded(&self) {
        let Transport::Quic { connection, .. } = &self.transport else { return std::future::pending().await };
        let mut last = connection.stats();
        loop {
            sleep(Duration::from_secs(1)).await;
            let now = connection.stats();
            let received = now.udp_rx.bytes - last.udp_rx.bytes;
            let sent = now.udp_tx.bytes - last.udp_tx.bytes;
            if received > MAX_RECEIVED_BYTES_PER_SECOND + sent / ACKNOWLEDGED_SHARE {
                return;
            }
            last = now;
        }
    }

    /// Begins to close the connection. The owner still waits for its session.
    pub(crate) fn begin_close(&self, code: CloseCode, reason: &str) {
        if let Transport::Quic { connection, session } = &self.transport {
            match session.get() {
                Some(session) => session.close(code, reason),
                None => close(connection, code, reason),
            }
        }
    }

    /// Closes the connection, and waits until the peer knows.
    pub(crate) async fn close(self, code: CloseCode, reason: &str) {
        self.begin_close(code, reason);
        self.finish().await;
    }

    /// Closes the connection without waiting for anything.
    pub(crate) fn close_now(self, code: CloseCode, reason: &str) {
        if let Transport::Quic { connection, .. } = &self.transport {
            close(connection, code, reason);
        }
    }

    /// Waits until the peer knows that its session has closed. A WebTransport session tells it on a stream, which needs
    /// a round trip.
    pub(crate) async fn finish(self) {
        self.place.set(Stage::Closing);
        if let Transport::Quic { connection, .. } = &self.transport {
            let _ = timeout(CLOSE_TIMEOUT, connection.closed()).await;
        }
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        if let Transport::Quic { connection, .. } = &self.transport {
            close(connection, CloseCode::Internal, "the server ended this connection");
        }
    }
}

/// Does nothing if the connection is closed already.
fn close(connection: &quinn::Connection, code: CloseCode, reason: &str) {
    if connection.close_reason().is_none() {
        let code = if is_web(connection) { code.http3() } else { quinn::VarInt::from_u32(code as u32) };
        connection.close(code, reason.as_bytes());
    }
}
