//! When to deliver a frame although some of its packets are missing.
//!
//! Waiting for lost packets delays the others, and not waiting shows gaps that would have closed. So the time from a
//! frame's first packet to its last is measured, and a frame may take the smoothed time plus four mean deviations (the
//! retransmission rule of RFC 6298, §2). Packets that arrive even later are delivered one mean deviation after the
//! first of them.

use std::time::Duration;

use web_time::Instant;

use crate::ids::FrameNumber;

/// Timers have a resolution of one millisecond.
const LEAST: Duration = Duration::from_millis(1);

/// The longest wait, and the wait before the first measurement. Longer than a frame at 60 Hz.
const MOST: Duration = Duration::from_millis(25);

/// The deadline of the current frame, from the times of those before it. Times must not go back.
#[derive(Debug, Clone, Default)]
pub(super) struct Deadline {
    spread: Spread,
    current: Option<Current>,
}

#[derive(Debug, Clone, Copy)]
struct Current {
    number: FrameNumber,
    first: Instant,
    last: Instant,
    packets: u32,
    due: Option<Instant>,
}

/// Mean and mean deviation of the time from a frame's first packet to its last.
#[derive(Debug, Clone, Copy, Default)]
struct Spread(Option<(Duration, Duration)>);

impl Spread {
    /// Smooths as RFC 6298: 1/8 for the mean, 1/4 for the deviation.
    fn update(&mut self, sample: Duration) {
        let sample = sample.min(MOST);
        self.0 = Some(match self.0 {
            None => (sample, sample / 2),
            Some((mean, deviation)) => ((mean * 7 + sample) / 8, (deviation * 3 + mean.abs_diff(sample)) / 4),
        });
    }

    fn timeout(self) -> Duration {
        self.0.map_or(MOST, |(mean, deviation)| (mean + deviation * 4).clamp(LEAST, MOST))
    }

    /// From a late packet to its delivery.
    fn late_timeout(self) -> Duration {
        self.0.map_or(MOST, |(_, deviation)| deviation.clamp(LEAST, MOST))
    }
}

impl Deadline {
    /// Returns when to deliver what has arrived of the current frame.
    pub(super) fn due(&self) -> Option<Instant> {
        self.current?.due
    }

    /// Records that a packet of frame `number` was stored at `now`.
    pub(super) fn packet_stored(&mut self, now: Instant, number: FrameNumber, completes: bool) {
        let current = match self.current.take() {
            Some(Current { number: same, first, packets, due, .. }) if same == number => {
                let due = due.or(Some(now + self.spread.late_timeout()));
                Current { number, first, last: now, packets: packets + 1, due }
            }
            before => {
                if let Some(before) = before {
                    before.measure(&mut self.spread);
                }
                Current { number, first: now, last: now, packets: 1, due: Some(now + self.spread.timeout()) }
            }
        };
        if completes {
            current.measure(&mut self.spread);
        } else {
            self.current = Some(current);
        }
    }

    /// Records that what has arrived was delivered.
    pub(super) fn delivered(&mut self) {
        if let Some(current) = &mut self.current {
            current.due = None;
        }
    }
}

impl Current {
    /// A frame with one arrived packet measures nothing.
    fn measure(&self, spread: &mut Spread) {
        if self.packets > 1 {
            spread.update(self.last.saturating_duration_since(self.first));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    /// Frames 16 ms apart, of four packets `gap` apart.
    fn frames(deadline: &mut Deadline, begin: Instant, numbers: std::ops::Range<u32>, gap: Duration) {
        for number in numbers {
            for packet in 0..4 {
                let now = begin + ms(16) * number + gap * packet;
                deadline.packet_stored(now, FrameNumber(number), packet == 3);
            }
        }
    }

    #[test]
    fn the_timeout_follows_the_measured_spread() {
        let (mut deadline, begin) = (Deadline::default(), Instant::now());
        assert_eq!((deadline.spread.timeout(), deadline.due()), (MOST, None));
        frames(&mut deadline, begin, 0..50, ms(1));
        assert_eq!(deadline.due(), None);
        assert!((ms(3)..ms(4)).contains(&deadline.spread.timeout()), "{:?}", deadline.spread.timeout());
        frames(&mut deadline, begin, 50..100, Duration::from_micros(50));
        assert_eq!(deadline.spread.timeout(), LEAST);
        frames(&mut deadline, begin, 100..103, ms(3));
        assert!(
            deadline.spread.timeout() > ms(9),
            "a burst of delay lengthens it at once: {:?}",
            deadline.spread.timeout()
        );
    }

    #[test]
    fn a_partial_frame_is_due_and_late_packets_are_due_again() {
        let (mut deadline, begin) = (Deadline::default(), Instant::now());
        frames(&mut deadline, begin, 0..50, ms(1));
        let (timeout, at) = (deadline.spread.timeout(), begin + ms(1000));
        deadline.packet_stored(at, FrameNumber(60), false);
        deadline.packet_stored(at + ms(1), FrameNumber(60), false);
        assert_eq!(deadline.due(), Some(at + timeout));
        deadline.delivered();
        assert_eq!(deadline.due(), None);
        deadline.packet_stored(at + ms(8), FrameNumber(60), false);
        assert_eq!(deadline.due(), Some(at + ms(8) + LEAST));
        // A newer frame replaces it and measures it.
        deadline.packet_stored(at + ms(16), FrameNumber(61), false);
        assert_eq!(deadline.due(), Some(at + ms(16) + deadline.spread.timeout()));
        assert!(deadline.spread.timeout() > timeout);
    }

    #[test]
    fn no_timeout_exceeds_the_longest() {
        let (mut deadline, begin) = (Deadline::default(), Instant::now());
        frames(&mut deadline, begin, 0..50, ms(300));
        assert_eq!(deadline.spread.timeout(), MOST);
    }
}
