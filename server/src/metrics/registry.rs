//! What an operator can see: which sessions are open, and the sum of all that were ever served.
//!
//! Nothing is counted twice. A session's ledger is the only place that its work is written to; what Prometheus reads is added up from the
//! open sessions' ledgers and the closed ones' totals at the moment it asks.

use std::{
    collections::BTreeMap,
    net::SocketAddr,
    sync::{Arc, Mutex, MutexGuard, PoisonError, atomic::AtomicU64, atomic::Ordering},
    time::Instant,
};

use serde::Serialize;

use super::ledger::{Ledger, StageCounts, Totals, as_f64};
use crate::net::{
    link::{Closer, Wire},
    socket::SocketCounts,
};

/// Numbered causes with names, for counters.
macro_rules! causes {
    ($(#[$meta:meta])* $name:ident { $($(#[$doc:meta])* $variant:ident = $label:literal,)* }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub(crate) enum $name {
            $($(#[$doc])* $variant,)*
        }

        impl $name {
            /// What they are called in metrics.
            pub(crate) const LABELS: &[&str] = &[$($label),*];
        }
    };
}

causes! {
    /// Why a peer got no session.
    RefusalCause {
        /// It was refused for its token.
        Token = "token",
        /// There was no room.
        Full = "full",
        /// The devices would have been too busy.
        Budget = "budget",
        /// Its address had as many sessions as one may have.
        Address = "address",
        /// The server drains.
        Draining = "draining",
        /// It speaks another version, or asks for what is not there.
        Unsupported = "unsupported",
        /// It broke off, or spoke out of turn.
        Broken = "broken",
        /// It did not say Hello in time.
        Silent = "silent",
        /// So many handshakes were under way that it was sent away.
        Handshakes = "handshakes",
    }
}

causes! {
    /// How a session ended.
    EndCause {
        /// The client said so.
        Left = "left",
        /// The link was gone, or the client silent.
        Lost = "lost",
        /// The client broke the protocol.
        Violation = "violation",
        /// The server failed in this session.
        Failed = "failed",
        /// The server stopped.
        Stopping = "stopping",
    }
}

/// All that is counted of a server.
#[derive(Debug, Default)]
pub(crate) struct Metrics {
    sessions: Mutex<Sessions>,
    refusals: [AtomicU64; RefusalCause::LABELS.len()],
    pub(crate) socket: Arc<SocketCounts>,
    /// UDP datagrams that no session accounted for, as last reported: that sum may not fall.
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

/// What a session is, for the list of sessions.
#[derive(Debug, Clone)]
pub(crate) struct About {
    pub(crate) id: u64,
    pub(crate) client: String,
    pub(crate) peer: SocketAddr,
    pub(crate) carrier: &'static str,
    pub(crate) size_px: [u32; 2],
    pub(crate) codec: String,
}

struct Entry {
    about: About,
    opened_at: Instant,
    ledger: Arc<Ledger>,
    link: Closer,
}

impl std::fmt::Debug for Entry {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.about.fmt(f)
    }
}

/// Totals of many sessions.
#[derive(Debug, Clone, Default)]
pub(crate) struct Sum {
    pub(crate) totals: Totals,
    pub(crate) stages: StageCounts,
}

/// All counters at one moment.
#[derive(Debug, Clone, Default)]
pub(crate) struct Snapshot {
    pub(crate) open: usize,
    pub(crate) opened: u64,
    pub(crate) closed: [u64; EndCause::LABELS.len()],
    pub(crate) refusals: [u64; RefusalCause::LABELS.len()],
    pub(crate) sum: Sum,
    pub(crate) unowned_received: u64,
    pub(crate) unowned_sent: u64,
}

/// A line of the list of sessions.
#[derive(Debug, Serialize)]
pub(crate) struct Listed {
    id: u64,
    client: String,
    peer: SocketAddr,
    carrier: &'static str,
    size_px: [u32; 2],
    codec: String,
    seconds: f64,
    poses: u64,
    frames_traced: u64,
    frames_sent: u64,
    bytes: u64,
    gpu_ms: f64,
    pose_to_sent_ms_p50: f64,
    pose_to_sent_ms_p99: f64,
}

/// A session in the list; leaves it when it is dropped.
pub(crate) struct Opened {
    metrics: Arc<Metrics>,
    id: u64,
    cause: EndCause,
}

impl Opened {
    /// Says how the session ended. A session that never comes to say so has broken off.
    pub(crate) const fn ends(&mut self, cause: EndCause) {
        self.cause = cause;
    }
}

impl Drop for Opened {
    fn drop(&mut self) {
        self.metrics.close(self.id, self.cause);
    }
}

impl Metrics {
    fn sessions(&self) -> MutexGuard<'_, Sessions> {
        // Numbers stay numbers, whoever panicked.
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Lists a session.
    pub(crate) fn open(self: &Arc<Self>, about: About, ledger: Arc<Ledger>, link: Closer) -> Opened {
        let id = about.id;
        let mut sessions = self.sessions();
        sessions.opened += 1;
        sessions.open.insert(id, Entry { about, opened_at: Instant::now(), ledger, link });
        Opened { metrics: Arc::clone(self), id, cause: EndCause::Failed }
    }

    fn close(&self, id: u64, cause: EndCause) {
        let mut sessions = self.sessions();
        let Some(entry) = sessions.open.remove(&id) else { return };
        entry.ledger.close(entry.link.wire());
        sessions.past.totals.add(&entry.ledger.totals());
        sessions.past.stages.add(&entry.ledger.stages.counts());
        sessions.closed[cause as usize] += 1;
    }

    /// Counts a peer that got no session.
    pub(crate) fn refused(&self, cause: RefusalCause) {
        self.refusals[cause as usize].fetch_add(1, Ordering::Relaxed);
    }

    /// Everything, added up.
    pub(crate) fn snapshot(&self) -> Snapshot {
        let sessions = self.sessions();
        let mut sum = sessions.past.clone();
        for entry in sessions.open.values() {
            let mut totals = entry.ledger.totals();
            let Wire { udp_received, udp_sent, quic_lost, .. } = entry.link.wire().unwrap_or_default();
            (totals.udp_received, totals.udp_sent, totals.quic_lost) = (udp_received, udp_sent, quic_lost);
            sum.totals.add(&totals);
            sum.stages.add(&entry.ledger.stages.counts());
        }
        // After the sessions: what arrives meanwhile belongs to nobody for a moment, never to somebody twice.
        let rest = |all: u64, owned: u64, last: &AtomicU64| {
            let rest = all.saturating_sub(owned);
            rest.max(last.fetch_max(rest, Ordering::Relaxed))
        };
        Snapshot {
            open: sessions.open.len(),
            opened: sessions.opened,
            closed: sessions.closed,
            refusals: std::array::from_fn(|cause| self.refusals[cause].load(Ordering::Relaxed)),
            unowned_received: rest(self.socket.received(), sum.totals.udp_received, &self.unowned_received),
            unowned_sent: rest(self.socket.sent(), sum.totals.udp_sent, &self.unowned_sent),
            sum,
        }
    }

    /// The open sessions.
    pub(crate) fn list(&self) -> Vec<Listed> {
        let listed = |entry: &Entry| {
            let (totals, stages) = (entry.ledger.totals(), entry.ledger.stages.counts());
            let About { id, client, peer, carrier, size_px, codec } = entry.about.clone();
            let [.., pose_to_sent] = &stages.0;
            Listed {
                id,
                client,
                peer,
                carrier,
                size_px,
                codec,
                seconds: entry.opened_at.elapsed().as_secs_f64(),
                poses: totals.poses,
                frames_traced: totals.frames_traced,
                frames_sent: totals.frames_sent,
                bytes: totals.bytes,
                gpu_ms: as_f64(totals.gpu_us) / 1e3,
                pose_to_sent_ms_p50: pose_to_sent.quantile_ms(0.5),
                pose_to_sent_ms_p99: pose_to_sent.quantile_ms(0.99),
            }
        };
        self.sessions().open.values().map(listed).collect()
    }
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
        }
    }

    #[test]
    fn a_session_counts_the_same_while_it_is_open_and_afterwards() {
        let metrics = Arc::new(Metrics::default());
        let ledger = Arc::new(Ledger::default());
        let mut opened = metrics.open(about(7), Arc::clone(&ledger), Closer::none());
        ledger.poses.add(5);
        ledger.frames_traced.add(3);
        ledger.frames_sent.add(2);
        ledger.stages.encode.record_ms(2.0);
        let open = metrics.snapshot();
        assert_eq!((open.open, open.opened, open.closed), (1, 1, [0; 5]));
        assert_eq!(metrics.list().len(), 1);
        opened.ends(EndCause::Left);
        drop(opened);
        let closed = metrics.snapshot();
        assert_eq!((closed.open, closed.opened, closed.closed), (0, 1, [1, 0, 0, 0, 0]));
        let expected = Totals { frames_abandoned: 1, ..open.sum.totals };
        assert_eq!((closed.sum.totals, closed.sum.stages), (expected, open.sum.stages));
        // A session that breaks off without a word is counted as such.
        drop(metrics.open(about(8), Arc::default(), Closer::none()));
        assert_eq!(metrics.snapshot().closed, [1, 0, 0, 1, 0]);
    }
}
