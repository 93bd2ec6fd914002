//! When a frame whose packets stand alone comes out although some are missing.
//!
//! Waiting for what is lost makes the rest late; not waiting shows gaps that would have closed. So the time from a frame's first
//! packet to its last is measured, and the rest of a frame may take what it usually takes and four mean deviations (the rule for
//! retransmission of RFC 6298, §2). What comes later still is given out with the next such step.

use std::time::{Duration, Instant};

use crate::ids::FrameNumber;

/// Timers tick in milliseconds; nothing shorter can be waited for.
const LEAST: Duration = Duration::from_millis(1);

/// The longest that a frame waits, also while nothing is known: longer than a frame lasts at 60 a second.
const MOST: Duration = Duration::from_millis(25);

/// The frame at hand, and what has been learnt from those before it. Times may not go back.
#[derive(Debug, Clone, Default)]
pub struct Deadline {
    spread: Spread,
    frame: Option<AtHand>,
}

#[derive(Debug, Clone, Copy)]
struct AtHand {
    number: FrameNumber,
    first: Instant,
    last: Instant,
    packets: u32,
    due: Option<Instant>,
}

/// From a frame's first packet to its last, and how much that varies.
#[derive(Debug, Clone, Copy, Default)]
struct Spread(Option<(Duration, Duration)>);

impl Spread {
    /// A new sample counts for an eighth, its distance from what was expected for a quarter, as in RFC 6298.
    fn take(&mut self, sample: Duration) {
        let sample = sample.min(MOST);
        self.0 = Some(match self.0 {
            None => (sample, sample / 2),
            Some((mean, deviation)) => ((mean * 7 + sample) / 8, (deviation * 3 + mean.abs_diff(sample)) / 4),
        });
    }

    fn patience(self) -> Duration {
        self.0.map_or(MOST, |(mean, deviation)| (mean + deviation * 4).clamp(LEAST, MOST))
    }

    /// Between giving out what is there and giving out what came late.
    fn step(self) -> Duration {
        self.0.map_or(MOST, |(_, deviation)| deviation.clamp(LEAST, MOST))
    }
}

impl Deadline {
    /// When what has come of the frame at hand is to come out.
    #[must_use]
    pub fn due(&self) -> Option<Instant> {
        self.frame?.due
    }

    /// How long a frame's packets may take now.
    #[must_use]
    pub fn patience(&self) -> Duration {
        self.spread.patience()
    }

    /// A packet of a frame has been stored, and `completes` it or not.
    pub fn stored(&mut self, now: Instant, number: FrameNumber, completes: bool) {
        let at_hand = match self.frame.take() {
            Some(AtHand { number: same, first, packets, due, .. }) if same == number => {
                let due = due.or(Some(now + self.spread.step()));
                AtHand { number, first, last: now, packets: packets + 1, due }
            }
            before => {
                if let Some(before) = before {
                    before.teach(&mut self.spread);
                }
                AtHand { number, first: now, last: now, packets: 1, due: Some(now + self.spread.patience()) }
            }
        };
        if completes {
            at_hand.teach(&mut self.spread);
        } else {
            self.frame = Some(at_hand);
        }
    }

    /// What has come has come out: there is nothing to wait for until more comes.
    pub fn given(&mut self) {
        if let Some(at_hand) = &mut self.frame {
            at_hand.due = None;
        }
    }
}

impl AtHand {
    /// A frame of which one packet came says nothing, unless it has no more.
    fn teach(&self, spread: &mut Spread) {
        if self.packets > 1 {
            spread.take(self.last.saturating_duration_since(self.first));
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
                deadline.stored(now, FrameNumber(number), packet == 3);
            }
        }
    }

    #[test]
    fn patience_is_what_frames_take_and_some_more() {
        let (mut deadline, begin) = (Deadline::default(), Instant::now());
        assert_eq!((deadline.patience(), deadline.due()), (MOST, None));
        frames(&mut deadline, begin, 0..50, ms(1));
        assert_eq!(deadline.due(), None);
        assert!((ms(3)..ms(4)).contains(&deadline.patience()), "{:?}", deadline.patience());
        frames(&mut deadline, begin, 50..100, Duration::from_micros(50));
        assert_eq!(deadline.patience(), LEAST);
        frames(&mut deadline, begin, 100..103, ms(3));
        assert!(deadline.patience() > ms(9), "a burst of delay makes it wait at once: {:?}", deadline.patience());
    }

    #[test]
    fn a_frame_in_part_is_due_and_what_comes_late_is_due_again() {
        let (mut deadline, begin) = (Deadline::default(), Instant::now());
        frames(&mut deadline, begin, 0..50, ms(1));
        let (patience, at) = (deadline.patience(), begin + ms(1000));
        deadline.stored(at, FrameNumber(60), false);
        deadline.stored(at + ms(1), FrameNumber(60), false);
        assert_eq!(deadline.due(), Some(at + patience));
        deadline.given();
        assert_eq!(deadline.due(), None);
        deadline.stored(at + ms(8), FrameNumber(60), false);
        assert_eq!(deadline.due(), Some(at + ms(8) + LEAST));
        // A newer frame takes its place, and has learnt from it.
        deadline.stored(at + ms(16), FrameNumber(61), false);
        assert_eq!(deadline.due(), Some(at + ms(16) + deadline.patience()));
        assert!(deadline.patience() > patience);
    }

    #[test]
    fn no_frame_waits_longer_than_the_longest_time() {
        let (mut deadline, begin) = (Deadline::default(), Instant::now());
        frames(&mut deadline, begin, 0..50, ms(300));
        assert_eq!(deadline.patience(), MOST);
    }
}
