//! What a session's tasks notice about their link while it lives: that the server is silent, or is about to stop.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use super::connection::Watcher;

/// A live server answers a ping a second, and every one of them is acknowledged besides. So much silence is an outage: the connection
/// may outlive it, but a new one is tried beside it.
pub(crate) const SILENCE: Duration = Duration::from_secs(2);

/// How often it is looked whether something has come.
const GLANCE: Duration = Duration::from_millis(200);

/// A server's notice that it stops.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Draining {
    pub(crate) reason: String,
    pub(crate) deadline: Instant,
    /// URL of a server to go to.
    pub(crate) alternative: Option<String>,
}

/// How a link does.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Health {
    /// Whether nothing at all has come for [`SILENCE`].
    pub(crate) silent: bool,
    pub(crate) draining: Option<Draining>,
}

/// The health of one session: its tasks write it, the renderer reads it.
#[derive(Debug, Clone, Default)]
pub(crate) struct HealthCell(Arc<Mutex<Health>>);

impl HealthCell {
    pub(crate) fn get(&self) -> Health {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(crate) fn change(&self, change: impl FnOnce(&mut Health)) {
        change(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner));
    }
}

/// Watches what arrives, for ever. Links that end by themselves when the server does are not watched.
pub(crate) async fn watch_silence(watcher: Watcher, health: HealthCell) {
    let mut glances = tokio::time::interval(GLANCE);
    glances.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut silence = Silence::new(Instant::now());
    loop {
        glances.tick().await;
        let Some(arrived) = watcher.arrived() else { return std::future::pending().await };
        let silent = silence.glance(arrived, Instant::now());
        health.change(|health| health.silent = silent);
    }
}

/// How long a counter has stood still.
#[derive(Debug)]
struct Silence {
    arrived: u64,
    since: Instant,
    glanced_at: Instant,
}

impl Silence {
    fn new(now: Instant) -> Self {
        Self { arrived: 0, since: now, glanced_at: now }
    }

    fn glance(&mut self, arrived: u64, now: Instant) -> bool {
        // Who slept through several glances was stopped itself, and has not listened meanwhile.
        let slept = now.saturating_duration_since(self.glanced_at) > GLANCE * 4;
        self.glanced_at = now;
        if arrived != self.arrived || slept {
            (self.arrived, self.since) = (arrived, now);
        }
        now.saturating_duration_since(self.since) >= SILENCE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_is_what_lasts_while_somebody_listens() {
        let start = Instant::now();
        let at = |ms: u64| start + Duration::from_millis(ms);
        let mut silence = Silence::new(start);
        for (arrived, ms, silent) in [
            (1, 200, false),
            (2, 400, false),
            (2, 600, false),
            (2, 1400, false),
            (2, 2200, false),
            (2, 2400, true),
            (2, 2600, true),
            (3, 2800, false),
            // The client itself was stopped for a minute.
            (3, 62_800, false),
            (3, 63_000, false),
        ] {
            assert_eq!(silence.glance(arrived, at(ms)), silent, "at {ms} ms");
        }
    }
}
