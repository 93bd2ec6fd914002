//! Health of an established link: whether the server is silent or about to stop.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use gnomon_protocol::text::PeerText;
use parking_lot::Mutex;

use super::{connection::QuicHandle, url::ServerUrl};

/// Silence that counts as an outage; a server answers one ping a second. A new connection is then tried in parallel.
const OUTAGE: Duration = Duration::from_secs(2);

const CHECK_INTERVAL: Duration = Duration::from_millis(200);

/// A server's notice that it is about to stop.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Draining {
    pub(crate) reason: PeerText,
    pub(crate) deadline: Instant,
    /// The server to move to.
    pub(crate) alternative: Option<ServerUrl>,
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Health {
    /// Nothing has arrived for [`OUTAGE`].
    pub(crate) silent: bool,
    pub(crate) draining: Option<Draining>,
    /// An operator ended the session, or its token ended: the client is not to come back by itself.
    pub(crate) dismissed: bool,
}

/// Health of one session. Its tasks write it; the renderer reads it.
#[derive(Debug, Clone, Default)]
pub(crate) struct HealthCell(Arc<Mutex<Health>>);

impl HealthCell {
    pub(crate) fn get(&self) -> Health {
        self.0.lock().clone()
    }

    pub(crate) fn update(&self, change: impl FnOnce(&mut Health)) {
        change(&mut self.0.lock());
    }
}

/// Watches for silence, without end. Lab transports need no watching: they end when the server does.
pub(crate) async fn watch_silence(quic: QuicHandle, health: HealthCell) {
    let mut checks = tokio::time::interval(CHECK_INTERVAL);
    checks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut silence = Silence::new(Instant::now());
    loop {
        checks.tick().await;
        let Some(received) = quic.datagrams_received() else { return std::future::pending().await };
        let silent = silence.check(received, Instant::now());
        health.update(|health| health.silent = silent);
    }
}

/// Measures how long a counter has not changed.
#[derive(Debug)]
struct Silence {
    received: u64,
    since: Instant,
    checked_at: Instant,
}

impl Silence {
    fn new(now: Instant) -> Self {
        Self { received: 0, since: now, checked_at: now }
    }

    /// Returns whether the silence counts as an outage.
    fn check(&mut self, received: u64, now: Instant) -> bool {
        // If the process was suspended for several checks, it could not receive anything.
        let slept = now.saturating_duration_since(self.checked_at) > CHECK_INTERVAL * 4;
        self.checked_at = now;
        if received != self.received || slept {
            (self.received, self.since) = (received, now);
        }
        now.saturating_duration_since(self.since) >= OUTAGE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_counts_only_while_the_client_listens() {
        let start = Instant::now();
        let at = |ms: u64| start + Duration::from_millis(ms);
        let mut silence = Silence::new(start);
        for (received, ms, silent) in [
            (1, 200, false),
            (2, 400, false),
            (2, 600, false),
            (2, 1400, false),
            (2, 2200, false),
            (2, 2400, true),
            (2, 2600, true),
            (3, 2800, false),
            // The client was stopped for a minute.
            (3, 62_800, false),
            (3, 63_000, false),
        ] {
            assert_eq!(silence.check(received, at(ms)), silent, "at {ms} ms");
        }
    }
}
