//! All sessions: the open ones, and totals over all that were ever served.
//!
//! Nothing is counted twice. Work is recorded in a session's ledger only. A snapshot adds the ledgers of the open
//! sessions and the totals of the closed ones.

use std::{
    collections::BTreeMap,
    net::SocketAddr,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Instant,
};

use parking_lot::Mutex;
use serde::Serialize;

use super::causes::{EndCause, RefusalCause};
use super::ledger::{Ledger, StageCounts, Totals, as_f64};
use crate::{
    clock,
    net::{
        connections::{Connections, Stage},
        link::{Closer, TransportCounts},
        socket::SocketCounts,
    },
};

#[derive(Debug, Default)]
pub(crate) struct Metrics {
    sessions: Mutex<Sessions>,
    refusals: [AtomicU64; RefusalCause::LABELS.len()],
    pub(crate) socket: Arc<SocketCounts>,
    pub(crate) connections: Connections,
    /// UDP datagrams outside any session, as last reported, so that the counter never falls.
    unowned_received: AtomicU64,
    unowned_sent: AtomicU64,
}

#[derive(Debug, Default)]
struct Sessions {
    open: BTreeMap<u64, Entry>,
    opened: u64,
    closed: [u64; EndCause::LABELS.len()],
    past: Sum,
}

#[derive(Debug, Clone, Serialize)]
pub(crate) struct About {
    pub(crate) id: u64,
    pub(crate) client: String,
    pub(crate) peer: SocketAddr,
    pub(crate) carrier: &'static str,
    pub(crate) size_px: [u32; 2],
    pub(crate) codec: String,
    /// Name of its token in the token file. `None` on a server without tokens.
    pub(crate) token: Option<String>,
    /// Declared masks per second. `None`: as many as others leave.
    pub(crate) declared_hz: Option<f64>,
}

struct Entry {
    about: About,
    opened_at: Instant,
    /// By the wall clock, for people.
    since: String,
    ledger: Arc<Ledger>,
    link: Closer,
}

impl std::fmt::Debug for Entry {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.about.fmt(f)
    }
}

#[derive(Debug, Clone, Default)]
pub(crate) struct Sum {
    pub(crate) totals: Totals,
    pub(crate) stages: StageCounts,
}

#[derive(Debug, Clone, Default)]
pub(crate) struct Snapshot {
    pub(crate) open: usize,
    pub(crate) opened: u64,
    pub(crate) closed: [u64; EndCause::LABELS.len()],
    pub(crate) refusals: [u64; RefusalCause::LABELS.len()],
    /// Open connections, by [`Stage`].
    pub(crate) connections: [usize; Stage::LABELS.len()],
    pub(crate) sum: Sum,
    pub(crate) unowned_received: u64,
    pub(crate) unowned_sent: u64,
}

/// An entry of `/sessions`.
#[derive(Debug, Serialize)]
pub(crate) struct Listed {
    #[serde(flatten)]
    about: About,
    since: String,
    seconds: f64,
    poses_per_s: f64,
    frames_per_s: f64,
    bytes_per_s: f64,
    device_ms_per_s: f64,
    poses: u64,
    frames_traced: u64,
    frames_sent: u64,
    bytes: u64,
    gpu_ms: f64,
    pose_to_sent_ms_p50: f64,
    pose_to_sent_ms_p99: f64,
}

/// An open session. Dropping it closes the session's ledger and adds it to the totals.
pub(crate) struct Registration {
    metrics: Arc<Metrics>,
    id: u64,
    cause: EndCause,
}

impl Registration {
    /// Sets how the session ended. The default is [`EndCause::Failed`].
    pub(crate) const fn set_cause(&mut self, cause: EndCause) {
        self.cause = cause;
    }
}

impl Drop for Registration {
    fn drop(&mut self) {
        self.metrics.close(self.id, self.cause);
    }
}

impl Metrics {
    pub(crate) fn register(self: &Arc<Self>, about: About, ledger: Arc<Ledger>, link: Closer) -> Registration {
        let id = about.id;
        let mut sessions = self.sessions.lock();
        sessions.opened += 1;
        let since = clock::utc(clock::wall());
        sessions.open.insert(id, Entry { about, opened_at: Instant::now(), since, ledger, link });
        Registration { metrics: Arc::clone(self), id, cause: EndCause::Failed }
    }

    fn close(&self, id: u64, cause: EndCause) {
        let mut sessions = self.sessions.lock();
        let Some(entry) = sessions.open.remove(&id) else { return };
        entry.ledger.close(entry.link.counts());
        sessions.past.totals.add(&entry.ledger.totals());
        sessions.past.stages.add(&entry.ledger.stages.counts());
        sessions.closed[cause as usize] += 1;
    }

    pub(crate) fn refused(&self, cause: RefusalCause) {
        self.refusals[cause as usize].fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn snapshot(&self) -> Snapshot {
        let sessions = self.sessions.lock();
        let mut sum = sessions.past.clone();
        for entry in sessions.open.values() {
            let mut totals = entry.ledger.totals();
            let TransportCounts { udp_received, udp_sent, quic_lost, .. } = entry.link.counts().unwrap_or_default();
            (totals.udp_received, totals.udp_sent, totals.quic_lost) = (udp_received, udp_sent, quic_lost);
            sum.totals.add(&totals);
            sum.stages.add(&entry.ledger.stages.counts());
        }
        // Read after the sessions: a datagram may briefly count as unowned, but never twice.
        let rest = |all: u64, owned: u64, last: &AtomicU64| {
            let rest = all.saturating_sub(owned);
            rest.max(last.fetch_max(rest, Ordering::Relaxed))
        };
        Snapshot {
            open: sessions.open.len(),
            opened: sessions.opened,
            closed: sessions.closed,
            connections: self.connections.counts(),
            refusals: std::array::from_fn(|cause| self.refusals[cause].load(Ordering::Relaxed)),
            unowned_received: rest(self.socket.received(), sum.totals.udp_received, &self.unowned_received),
            unowned_sent: rest(self.socket.sent(), sum.totals.udp_sent, &self.unowned_sent),
            sum,
        }
    }

    pub(crate) fn list(&self) -> Vec<Listed> {
        let listed = |entry: &Entry| {
            let (totals, stages) = (entry.ledger.totals(), entry.ledger.stages.counts());
            let [.., pose_to_sent] = &stages.0;
            let latest = entry.ledger.latest();
            // A QUIC client may have moved.
            let peer = entry.link.peer().unwrap_or(entry.about.peer);
            Listed {
                about: About { peer, ..entry.about.clone() },
                since: entry.since.clone(),
                seconds: entry.opened_at.elapsed().as_secs_f64(),
                poses_per_s: tenths(latest.poses_per_s),
                frames_per_s: tenths(latest.frames_per_s),
                bytes_per_s: latest.bytes_per_s.round(),
                device_ms_per_s: tenths(latest.device_ms_per_s),
                poses: totals.poses,
                frames_traced: totals.frames_traced,
                frames_sent: totals.frames_sent,
                bytes: totals.bytes,
                gpu_ms: as_f64(totals.gpu_us) / 1e3,
                pose_to_sent_ms_p50: pose_to_sent.quantile_ms(0.5),
                pose_to_sent_ms_p99: pose_to_sent.quantile_ms(0.99),
            }
        };
        self.sessions.lock().open.values().map(listed).collect()
    }
}

fn tenths(number: f64) -> f64 {
    (number * 10.0).round() / 10.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn about(id: u64) -> About {
        About {
            id,
            client: "test".to_owned(),
            peer: "127.0.0.1:1".parse().unwrap(),
            carrier: "quic",
            size_px: [64, 36],
            codec: "planes-lz4".to_owned(),
            token: None,
            declared_hz: Some(60.0),
        }
    }

    #[test]
    fn a_session_counts_the_same_while_it_is_open_and_afterwards() {
        let metrics = Arc::new(Metrics::default());
        let ledger = Arc::new(Ledger::default());
        let mut registration = metrics.register(about(7), Arc::clone(&ledger), Closer::none());
        ledger.poses.add(5);
        ledger.frames_traced.add(3);
        ledger.frames_sent.add(2);
        ledger.stages.encode.record_ms(2.0);
        let open = metrics.snapshot();
        assert_eq!((open.open, open.opened, open.closed), (1, 1, [0; EndCause::LABELS.len()]));
        assert_eq!(metrics.list().len(), 1);
        registration.set_cause(EndCause::Left);
        drop(registration);
        let closed = metrics.snapshot();
        assert_eq!((closed.open, closed.opened, closed.closed), (0, 1, [1, 0, 0, 0, 0, 0, 0]));
        let expected = Totals { frames_abandoned: 1, ..open.sum.totals };
        assert_eq!((closed.sum.totals, closed.sum.stages), (expected, open.sum.stages));
        // Without a cause it counts as failed.
        drop(metrics.register(about(8), Arc::default(), Closer::none()));
        assert_eq!(metrics.snapshot().closed, [1, 0, 0, 1, 0, 0, 0]);
    }
}
