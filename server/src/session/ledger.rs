//! A session's books: everything that came in, went out or was dropped, by cause.

use std::{
    sync::atomic::{AtomicU64, Ordering},
    time::Duration,
};

use gnomon_protocol::ids::FrameNumber;

macro_rules! ledger {
    ($($(#[$doc:meta])* $name:ident,)*) => {
        /// Counters of one session, shared by its tasks.
        #[derive(Debug, Default)]
        pub(crate) struct Ledger {
            $($(#[$doc])* pub(crate) $name: Counter,)*
            newest_requested: AtomicU64,
        }

        /// The counters at one moment.
        #[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
        pub(crate) struct Totals {
            $($(#[$doc])* pub(crate) $name: u64,)*
        }

        impl Ledger {
            /// What has been counted until now.
            pub(crate) fn totals(&self) -> Totals {
                Totals { $($name: self.$name.get(),)* }
            }
        }

        impl Totals {
            /// What has been counted since `earlier`.
            pub(crate) fn since(&self, earlier: &Self) -> Self {
                Self { $($name: self.$name.saturating_sub(earlier.$name),)* }
            }
        }
    };
}

ledger! {
    /// Control messages received.
    messages,
    /// Poses taken.
    poses,
    /// Datagrams that are no pose, or not a valid one.
    poses_bad,
    /// Poses that are not newer than one that was taken.
    poses_stale,
    /// Masks that the engine traced.
    frames_traced,
    /// Frames sent whole.
    frames_sent,
    /// Frames dropped: a newer mask was there before they were encoded.
    frames_superseded,
    /// Frames dropped: earlier ones still waited for the network.
    frames_gated,
    /// Frames dropped: too long for the header, or not to be encoded.
    frames_unsendable,
    /// Packets sent.
    packets,
    /// Bytes sent in packets, headers included.
    bytes,
    /// Microseconds spent on encoding.
    encode_us,
    /// Microseconds from a pose's arrival until its frame was handed to the network, summed.
    latency_us,
}

/// A number that only grows.
#[derive(Debug, Default)]
pub(crate) struct Counter(AtomicU64);

impl Counter {
    /// Counts one more.
    pub(crate) fn one(&self) {
        self.add(1);
    }

    /// Counts `more`.
    pub(crate) fn add(&self, more: u64) {
        self.0.fetch_add(more, Ordering::Relaxed);
    }

    /// Counts a duration, in microseconds.
    pub(crate) fn add_us(&self, spent: Duration) {
        self.add(u64::try_from(spent.as_micros()).unwrap_or(u64::MAX));
    }

    fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

impl Ledger {
    /// Notes the frame that the engine has been asked for last.
    pub(crate) fn set_newest_requested(&self, frame: FrameNumber) {
        self.newest_requested.store(u64::from(frame.0) + 1, Ordering::Release);
    }

    /// The frame that the engine has been asked for last.
    pub(crate) fn newest_requested(&self) -> Option<FrameNumber> {
        let stored = self.newest_requested.load(Ordering::Acquire);
        stored.checked_sub(1).and_then(|frame| u32::try_from(frame).ok()).map(FrameNumber)
    }
}

impl Totals {
    /// The line of the last second.
    pub(crate) fn log_rates(&self, seconds: f64) {
        let rate = |count: u64| (as_f64(count) / seconds * 10.0).round() / 10.0;
        let mean_ms = |us: u64, count: u64| if count == 0 { 0.0 } else { (as_f64(us) / as_f64(count)).round() / 1e3 };
        tracing::info!(
            poses_per_s = rate(self.poses),
            traced_per_s = rate(self.frames_traced),
            sent_per_s = rate(self.frames_sent),
            gated_per_s = rate(self.frames_gated),
            superseded_per_s = rate(self.frames_superseded),
            packets_per_s = rate(self.packets),
            kbit_per_s = rate(self.bytes * 8 / 1000),
            encode_ms_mean = mean_ms(self.encode_us, self.frames_sent + self.frames_gated),
            pose_to_sent_ms_mean = mean_ms(self.latency_us, self.frames_sent),
            "rates"
        );
    }

    /// The line at the session's end.
    pub(crate) fn log_end(&self, client: &str, lasted: Duration, reason: &str) {
        tracing::info!(
            client,
            seconds = lasted.as_secs_f64(),
            messages = self.messages,
            poses = self.poses,
            poses_bad = self.poses_bad,
            poses_stale = self.poses_stale,
            frames_traced = self.frames_traced,
            frames_sent = self.frames_sent,
            frames_superseded = self.frames_superseded,
            frames_gated = self.frames_gated,
            frames_unsendable = self.frames_unsendable,
            packets = self.packets,
            bytes = self.bytes,
            reason,
            "session ended"
        );
    }
}

#[expect(clippy::cast_precision_loss, reason = "rates and means for people")]
fn as_f64(count: u64) -> f64 {
    count as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn totals_differ_by_what_was_counted_between_them() {
        let ledger = Ledger::default();
        ledger.poses.add(3);
        let earlier = ledger.totals();
        ledger.poses.one();
        ledger.encode_us.add_us(Duration::from_millis(2));
        let expected = Totals { poses: 1, encode_us: 2000, ..Totals::default() };
        assert_eq!(ledger.totals().since(&earlier), expected);
    }

    #[test]
    fn the_newest_request_starts_as_none() {
        let ledger = Ledger::default();
        assert_eq!(ledger.newest_requested(), None);
        for frame in [0, 7, u32::MAX] {
            ledger.set_newest_requested(FrameNumber(frame));
            assert_eq!(ledger.newest_requested(), Some(FrameNumber(frame)));
        }
    }
}
