//! The Pareto front: the measurements that no other beats in time, bytes and error at once.

/// Relative difference below which two times are equal, within the clock's noise.
const CLOCK: f64 = 0.05;

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Trade {
    pub(super) ms: f64,
    pub(super) bytes: f64,
    pub(super) error: f64,
}

impl Trade {
    /// Returns whether this one is worse in nothing and clearly better in something.
    fn beats(&self, other: &Self) -> bool {
        let no_worse = self.ms <= other.ms && self.bytes <= other.bytes && self.error <= other.error;
        no_worse && (self.ms < other.ms * (1.0 - CLOCK) || self.bytes < other.bytes || self.error < other.error)
    }
}

/// Returns for each of `trades` whether it is on the front.
pub(super) fn on_front(trades: &[Trade]) -> Vec<bool> {
    trades.iter().map(|trade| !trades.iter().any(|other| other.beats(trade))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dominated_trades_are_off_the_front() {
        let trade = |ms, bytes, error| Trade { ms, bytes, error };
        let trades = [
            trade(10.0, 5.0, 0.0),
            trade(5.0, 5.0, 1.0),
            // Slower than the second, and no better.
            trade(6.0, 5.0, 1.0),
            // The first again, within the clock's noise.
            trade(10.3, 5.0, 0.0),
            // Slow and wrong, but small.
            trade(20.0, 1.0, 2.0),
            trade(20.0, 1.0, 3.0),
        ];
        assert_eq!(on_front(&trades), [true, true, false, true, true, false]);
    }
}
