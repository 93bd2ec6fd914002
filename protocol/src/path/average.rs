//! A moving average of durations.

use std::time::Duration;

/// Gives the new sample a weight of 1/8, as TCP does for its smoothed round trip (RFC 6298, section 2.3).
#[must_use]
pub fn smoothed(average: Duration, sample: Duration) -> Duration {
    (average * 7 + sample) / 8
}
