//! Histograms of durations with exponential buckets, for quantiles in logs and for Prometheus.
//!
//! With four buckets per octave, a quantile is off by at most an eighth of its value. Recording is one atomic addition
//! per counter.

use std::{
    sync::atomic::{AtomicU64, Ordering},
    time::Duration,
};

/// Buckets per octave.
const PER_OCTAVE: usize = 4;

/// Upper edge of the first bucket, in microseconds.
const FIRST_EDGE_US: u64 = 16;

/// Octaves above the first bucket. The last bucket ends at 67 s and also holds all longer times.
const OCTAVES: usize = 22;

const BUCKETS: usize = 1 + OCTAVES * PER_OCTAVE;

#[derive(Debug)]
pub(crate) struct Times {
    buckets: [AtomicU64; BUCKETS],
    sum_us: AtomicU64,
}

impl Default for Times {
    fn default() -> Self {
        Self { buckets: [const { AtomicU64::new(0) }; BUCKETS], sum_us: AtomicU64::new(0) }
    }
}

impl Times {
    pub(crate) fn record(&self, time: Duration) {
        let us = u64::try_from(time.as_micros()).unwrap_or(u64::MAX);
        self.buckets[bucket_of(us)].fetch_add(1, Ordering::Relaxed);
        self.sum_us.fetch_add(us, Ordering::Relaxed);
    }

    /// Counts NaN and negative times as 0.
    pub(crate) fn record_ms(&self, ms: f64) {
        self.record(Duration::try_from_secs_f64(ms * 1e-3).unwrap_or_default());
    }

    pub(crate) fn counts(&self) -> Counts {
        let buckets = std::array::from_fn(|index| self.buckets[index].load(Ordering::Relaxed));
        Counts { buckets, sum_us: self.sum_us.load(Ordering::Relaxed) }
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Counts {
    buckets: [u64; BUCKETS],
    pub(crate) sum_us: u64,
}

impl Default for Counts {
    fn default() -> Self {
        Self { buckets: [0; BUCKETS], sum_us: 0 }
    }
}

impl Counts {
    pub(crate) fn count(&self) -> u64 {
        self.buckets.iter().sum()
    }

    /// Returns the difference to an earlier reading.
    pub(crate) fn since(&self, earlier: &Self) -> Self {
        let buckets = std::array::from_fn(|index| self.buckets[index].saturating_sub(earlier.buckets[index]));
        Self { buckets, sum_us: self.sum_us.saturating_sub(earlier.sum_us) }
    }

    pub(crate) fn add(&mut self, other: &Self) {
        for (mine, others) in self.buckets.iter_mut().zip(&other.buckets) {
            *mine += others;
        }
        self.sum_us += other.sum_us;
    }

    /// The quantile `share` in milliseconds, interpolated within its bucket. 0 without counts.
    #[expect(clippy::cast_precision_loss, reason = "counts and microseconds of one second")]
    pub(crate) fn quantile_ms(&self, share: f64) -> f64 {
        let rank = self.count() as f64 * share;
        let mut below = 0.0;
        for (index, &count) in self.buckets.iter().enumerate().filter(|(_, count)| **count > 0) {
            if below + count as f64 >= rank {
                let (from, to) = (lower_edge_us(index) as f64, upper_edge_us(index) as f64);
                let within = ((rank - below) / count as f64).clamp(0.0, 1.0);
                return ((to - from).mul_add(within, from)).round() / 1e3;
            }
            below += count as f64;
        }
        0.0
    }

    /// Upper edges in seconds, one per octave, with each bucket's count. The last edge is `f64::MAX`, for infinity.
    #[expect(clippy::cast_precision_loss, reason = "microseconds below a minute")]
    pub(crate) fn histogram(&self) -> Vec<(f64, u64)> {
        let first = (FIRST_EDGE_US as f64 * 1e-6, self.buckets[0]);
        let octaves = self.buckets[1..].chunks(PER_OCTAVE).enumerate().map(|(octave, counts)| {
            let last = octave + 1 == OCTAVES;
            let edge = if last { f64::MAX } else { upper_edge_us((octave + 1) * PER_OCTAVE) as f64 * 1e-6 };
            (edge, counts.iter().sum())
        });
        std::iter::once(first).chain(octaves).collect()
    }
}

fn bucket_of(us: u64) -> usize {
    if us < FIRST_EDGE_US {
        return 0;
    }
    let octave = (us.ilog2() - FIRST_EDGE_US.ilog2()) as usize;
    let quarter = (us >> (octave + 2)) & 3;
    (1 + octave * PER_OCTAVE + usize::try_from(quarter).unwrap_or(0)).min(BUCKETS - 1)
}

/// Exclusive.
fn upper_edge_us(bucket: usize) -> u64 {
    match bucket.checked_sub(1) {
        None => FIRST_EDGE_US,
        Some(above) => (5 + (above % PER_OCTAVE) as u64) << (above / PER_OCTAVE + 2),
    }
}

fn lower_edge_us(bucket: usize) -> u64 {
    bucket.checked_sub(1).map_or(0, upper_edge_us)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_time_lies_within_its_bucket() {
        for us in (0..2000).chain((0..26).map(|bit| (1 << bit) - 1)).chain((0..26).map(|bit| 3 << bit)) {
            let bucket = bucket_of(us);
            let last = bucket == BUCKETS - 1;
            assert!(lower_edge_us(bucket) <= us && (us < upper_edge_us(bucket) || last), "{us} in {bucket}");
        }
        assert_eq!(bucket_of(u64::MAX), BUCKETS - 1);
        assert_eq!(upper_edge_us(BUCKETS - 1), 16 << OCTAVES);
    }

    #[test]
    fn quantiles_are_within_an_eighth() {
        let times = Times::default();
        for us in 1..=10_000 {
            times.record(Duration::from_micros(us));
        }
        let counts = times.counts();
        for (share, exact_ms) in [(0.5, 5.0), (0.9, 9.0), (0.99, 9.9)] {
            let found = counts.quantile_ms(share);
            assert!((found / exact_ms - 1.0_f64).abs() < 0.125, "{share}: {found} for {exact_ms}");
        }
        assert_eq!((counts.count(), counts.sum_us), (10_000, 50_005_000));
        assert!(Counts::default().quantile_ms(0.99).abs() < f64::EPSILON);
    }

    #[test]
    fn since_and_add_are_inverse() {
        let times = Times::default();
        times.record_ms(3.0);
        let earlier = times.counts();
        times.record_ms(40.0);
        times.record_ms(f64::NAN);
        let mut between = times.counts().since(&earlier);
        assert_eq!((between.count(), between.sum_us), (2, 40_000));
        between.add(&earlier);
        assert_eq!(between, times.counts());
        let histogram = between.histogram();
        assert_eq!(histogram.iter().map(|(_, count)| count).sum::<u64>(), 3);
        assert!(histogram.is_sorted_by(|a, b| a.0 < b.0), "{histogram:?}");
        assert!((histogram[1].0 - 32e-6).abs() < 1e-12, "{histogram:?}");
    }
}
