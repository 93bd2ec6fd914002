//! Pauses between attempts to reach a server: exponential backoff with jitter.

use std::time::Duration;

const FIRST: Duration = Duration::from_millis(250);

/// Longest pause. With a handshake it bounds the time to find a returning server: the target is 3 s.
const LONGEST: Duration = Duration::from_millis(1800);

/// Pauses that double up to [`LONGEST`], each shortened by up to a quarter.
#[derive(Debug)]
pub(crate) struct Backoff {
    next: Duration,
    state: u64,
}

impl Backoff {
    /// Different seeds keep clients that lost the same server from reconnecting in step.
    pub(crate) fn new(seed: u64) -> Self {
        Self { next: FIRST, state: seed }
    }

    pub(crate) fn next_pause(&mut self) -> Duration {
        // SplitMix64.
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = (self.state ^ (self.state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        let quarter_ns = u64::try_from(self.next.as_nanos() / 4).unwrap_or(u64::MAX).max(1);
        let pause = self.next - Duration::from_nanos((mixed ^ (mixed >> 31)) % quarter_ns);
        self.next = (self.next * 2).min(LONGEST);
        pause
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_to_their_bound_and_differ_between_clients() {
        let pauses = |seed| {
            let mut backoff = Backoff::new(seed);
            std::array::from_fn::<Duration, 8, _>(|_| backoff.next_pause())
        };
        let ours = pauses(1);
        for (index, pause) in ours.iter().enumerate() {
            let full = (FIRST * (1 << index)).min(LONGEST);
            assert!(*pause <= full && *pause >= full * 3 / 4, "{index}: {pause:?}");
        }
        assert_ne!(ours, pauses(2));
    }
}
