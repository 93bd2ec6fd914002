//! Counters of one session: everything received, sent, or dropped, by cause.

use std::{
    sync::atomic::{AtomicU64, Ordering},
    time::Duration,
};

use gnomon_protocol::{ids::FrameNumber, text::PeerText};
use parking_lot::Mutex;

use super::times::{Counts, Times};
use crate::{
    net::link::TransportCounts,
    visibility::{RayShares, TraceCost},
};

/// Target of the log lines that a timer writes, once a second for each session: no peer can make them more.
pub(crate) const TIMED: &str = "gnomon_server::rates";

macro_rules! ledger {
    ($($(#[$doc:meta])* $name:ident,)*) => {
        /// Counters of one session, shared by its tasks.
        #[derive(Debug, Default)]
        pub(crate) struct Ledger {
            $($(#[$doc])* pub(crate) $name: Counter,)*
            pub(crate) stages: Stages,
            newest_requested: AtomicU64,
            latest: Mutex<Latest>,
        }

        #[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
        pub(crate) struct Totals {
            $($(#[$doc])* pub(crate) $name: u64,)*
        }

        impl Ledger {
            pub(crate) fn totals(&self) -> Totals {
                Totals { $($name: self.$name.get(),)* }
            }
        }

        impl Totals {
            /// Returns the difference to an earlier reading.
            pub(crate) fn since(&self, earlier: &Self) -> Self {
                Self { $($name: self.$name.saturating_sub(earlier.$name),)* }
            }

            pub(crate) fn add(&mut self, other: &Self) {
                $(self.$name += other.$name;)*
            }
        }
    };
}

ledger! {
    messages,
    /// Messages that change the scene.
    edits,
    /// Those of them that changed nothing.
    edits_refused,
    /// Poses used.
    poses,
    acknowledgements,
    /// Datagrams that are not valid poses.
    poses_bad,
    /// Poses not newer than one already used.
    poses_stale,
    /// Datagrams dropped because they exceeded the rate limit.
    poses_over_rate,
    /// Datagrams dropped unread, because newer ones displaced them or the session ended.
    poses_unread,
    frames_traced,
    /// Masks encoded, including failed attempts.
    frames_encoded,
    /// Core time of encoding, in microseconds.
    encode_us,
    frames_sent,
    /// Frames sent in part, because the network carried no more.
    frames_cut,
    /// Frames replaced by a newer mask before encoding.
    frames_superseded,
    /// Frames dropped because the network was busy with earlier ones, or carried too little.
    frames_gated,
    /// Frames dropped because they could not be encoded, or were too long for the header.
    frames_unsendable,
    /// Frames dropped at the session's end.
    frames_abandoned,
    /// Packets handed to the transport.
    packets,
    /// Packets that the transport dropped, because the session ended or the link was too slow.
    packets_unsent,
    /// Bytes sent in packets, headers included.
    bytes,
    /// Tracing time on the device or processor, with the time to move what moves, in microseconds.
    gpu_us,
    /// Primary rays of the masks traced: those tested against a list, and those traced one by one.
    primary_listed,
    primary_traced,
    /// Shadow rays of the masks traced, by how their bits were found.
    rays_proven_lit,
    rays_proven_dark,
    rays_listed,
    rays_traced,
    /// UDP datagrams received on the connection.
    udp_received,
    /// UDP datagrams sent on the connection.
    udp_sent,
    /// QUIC packets declared lost.
    quic_lost,
}

/// What a session did in its last second, as measured.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Latest {
    pub(crate) poses_per_s: f64,
    pub(crate) frames_per_s: f64,
    pub(crate) bytes_per_s: f64,
    pub(crate) device_ms_per_s: f64,
}

#[derive(Debug, Default)]
pub(crate) struct Stages {
    /// Tracing: primary rays and shadow rays.
    pub(crate) trace: Times,
    /// From the end of tracing until the mask is in host memory.
    pub(crate) readback: Times,
    /// Encoding, including the wait for a core.
    pub(crate) encode: Times,
    /// Packetizing, and handing over to the transport.
    pub(crate) send: Times,
    /// From a pose's arrival until the transport has its frame.
    pub(crate) pose_to_sent: Times,
}

/// A reading of [`Stages`], in their order.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct StageCounts(pub(crate) [Counts; 5]);

impl StageCounts {
    /// Names in logs and metrics.
    pub(crate) const NAMES: [&str; 5] = ["trace", "readback", "encode", "send", "pose_to_sent"];

    pub(crate) fn since(&self, earlier: &Self) -> Self {
        Self(std::array::from_fn(|stage| self.0[stage].since(&earlier.0[stage])))
    }

    pub(crate) fn add(&mut self, other: &Self) {
        for (mine, others) in self.0.iter_mut().zip(&other.0) {
            mine.add(others);
        }
    }
}

impl Stages {
    pub(crate) fn counts(&self) -> StageCounts {
        let Self { trace, readback, encode, send, pose_to_sent } = self;
        StageCounts([trace, readback, encode, send, pose_to_sent].map(Times::counts))
    }
}

#[derive(Debug, Default)]
pub(crate) struct Counter(AtomicU64);

impl Counter {
    pub(crate) fn one(&self) {
        self.add(1);
    }

    pub(crate) fn add(&self, more: u64) {
        self.0.fetch_add(more, Ordering::Relaxed);
    }

    pub(crate) fn add_us(&self, spent: Duration) {
        self.add(u64::try_from(spent.as_micros()).unwrap_or(u64::MAX));
    }

    pub(crate) fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

impl Ledger {
    pub(crate) fn traced(&self, cost: &TraceCost) {
        self.frames_traced.one();
        let spent = Duration::try_from_secs_f64(cost.device_ms() * 1e-3).unwrap_or_default();
        self.gpu_us.add_us(spent);
        self.primary_listed.add(cost.primary_listed);
        self.primary_traced.add(cost.primary_rays.saturating_sub(cost.primary_listed));
        let RayShares { proven_lit, proven_dark, listed, traced } = cost.shares;
        self.rays_proven_lit.add(proven_lit);
        self.rays_proven_dark.add(proven_dark);
        self.rays_listed.add(listed);
        self.rays_traced.add(traced);
        self.stages.trace.record(spent);
        self.stages.readback.record_ms(cost.readback_ms);
    }

    /// Accounts at the session's end for what was never read, and for what was traced and never sent. `transport`: the
    /// transport's counters, if any.
    pub(crate) fn close(&self, transport: Option<TransportCounts>) {
        let totals = self.totals();
        if let Some(counts) = transport {
            self.poses_unread.add(counts.datagrams_received.saturating_sub(totals.datagrams_in()));
            self.packets_unsent.add(totals.packets.saturating_sub(counts.datagrams_sent));
            self.udp_received.add(counts.udp_received);
            self.udp_sent.add(counts.udp_sent);
            self.quic_lost.add(counts.quic_lost);
        }
        self.frames_abandoned.add(totals.frames_traced.saturating_sub(totals.frames_out()));
    }

    /// Records what was counted within the last `seconds`.
    pub(crate) fn set_latest(&self, counted: &Totals, seconds: f64) {
        let rate = |count: u64| as_f64(count) / seconds.max(f64::EPSILON);
        *self.latest.lock() = Latest {
            poses_per_s: rate(counted.poses),
            frames_per_s: rate(counted.frames_sent),
            bytes_per_s: rate(counted.bytes),
            device_ms_per_s: rate(counted.gpu_us) / 1e3,
        };
    }

    pub(crate) fn latest(&self) -> Latest {
        *self.latest.lock()
    }

    pub(crate) fn set_newest_requested(&self, frame: FrameNumber) {
        self.newest_requested.store(u64::from(frame.0) + 1, Ordering::Release);
    }

    /// The newest frame requested from the engine.
    pub(crate) fn newest_requested(&self) -> Option<FrameNumber> {
        let stored = self.newest_requested.load(Ordering::Acquire);
        stored.checked_sub(1).and_then(|frame| u32::try_from(frame).ok()).map(FrameNumber)
    }
}

impl Totals {
    /// Received datagrams of all kinds.
    pub(crate) const fn datagrams_in(&self) -> u64 {
        self.poses
            + self.acknowledgements
            + self.poses_bad
            + self.poses_stale
            + self.poses_over_rate
            + self.poses_unread
    }

    /// Traced frames with any outcome.
    pub(crate) const fn frames_out(&self) -> u64 {
        self.frames_sent + self.frames_superseded + self.frames_gated + self.frames_unsendable + self.frames_abandoned
    }

    pub(crate) fn log_rates(&self, stages: &StageCounts, seconds: f64) {
        let rate = |count: u64| (as_f64(count) / seconds * 10.0).round() / 10.0;
        let [trace, _, encode, send, pose_to_sent] = &stages.0;
        tracing::info!(
            target: TIMED,
            poses_per_s = rate(self.poses),
            traced_per_s = rate(self.frames_traced),
            sent_per_s = rate(self.frames_sent),
            gated_per_s = rate(self.frames_gated),
            superseded_per_s = rate(self.frames_superseded),
            packets_per_s = rate(self.packets),
            kbit_per_s = rate(self.bytes * 8 / 1000),
            gpu_ms_per_s = rate(self.gpu_us / 1000),
            trace_ms_p50 = trace.quantile_ms(0.5),
            trace_ms_p99 = trace.quantile_ms(0.99),
            encode_ms_p50 = encode.quantile_ms(0.5),
            encode_ms_p99 = encode.quantile_ms(0.99),
            send_ms_p50 = send.quantile_ms(0.5),
            send_ms_p99 = send.quantile_ms(0.99),
            pose_to_sent_ms_p50 = pose_to_sent.quantile_ms(0.5),
            pose_to_sent_ms_p99 = pose_to_sent.quantile_ms(0.99),
            "rates"
        );
    }

    pub(crate) fn log_end(&self, client: &PeerText, lasted: Duration, reason: &str) {
        tracing::info!(
            %client,
            seconds = lasted.as_secs_f64(),
            messages = self.messages,
            poses = self.poses,
            acknowledgements = self.acknowledgements,
            poses_bad = self.poses_bad,
            poses_stale = self.poses_stale,
            poses_over_rate = self.poses_over_rate,
            poses_unread = self.poses_unread,
            frames_traced = self.frames_traced,
            frames_sent = self.frames_sent,
            frames_cut = self.frames_cut,
            frames_superseded = self.frames_superseded,
            frames_gated = self.frames_gated,
            frames_unsendable = self.frames_unsendable,
            frames_abandoned = self.frames_abandoned,
            packets = self.packets,
            packets_unsent = self.packets_unsent,
            bytes = self.bytes,
            gpu_ms = as_f64(self.gpu_us) / 1e3,
            udp_received = self.udp_received,
            udp_sent = self.udp_sent,
            quic_lost = self.quic_lost,
            reason,
            "session ended"
        );
    }
}

#[expect(clippy::cast_precision_loss, reason = "rates and means for logs")]
pub(crate) fn as_f64(count: u64) -> f64 {
    count as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn since_returns_the_difference() {
        let ledger = Ledger::default();
        ledger.poses.add(3);
        let earlier = ledger.totals();
        ledger.poses.one();
        ledger.gpu_us.add_us(Duration::from_millis(2));
        let expected = Totals { poses: 1, gpu_us: 2000, ..Totals::default() };
        assert_eq!(ledger.totals().since(&earlier), expected);
    }

    #[test]
    fn the_last_second_is_measured() {
        let ledger = Ledger::default();
        assert_eq!(ledger.latest(), Latest::default());
        let counted = Totals { poses: 90, frames_sent: 60, bytes: 3000, gpu_us: 1500, ..Totals::default() };
        ledger.set_latest(&counted, 1.5);
        let expected = Latest { poses_per_s: 60.0, frames_per_s: 40.0, bytes_per_s: 2000.0, device_ms_per_s: 1.0 };
        assert_eq!(ledger.latest(), expected);
    }

    #[test]
    fn there_is_no_newest_request_at_first() {
        let ledger = Ledger::default();
        assert_eq!(ledger.newest_requested(), None);
        for frame in [0, 7, u32::MAX] {
            ledger.set_newest_requested(FrameNumber(frame));
            assert_eq!(ledger.newest_requested(), Some(FrameNumber(frame)));
        }
    }
}
