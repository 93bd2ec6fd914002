//! Limits one client's cost: device time and bytes per second. Over the limit its next mask waits. Nothing queues
//! meanwhile, since the engine traces nothing for a session that takes no masks.

use std::time::{Duration, Instant};

use crate::{
    limits::{MAX_CLIENT_BYTES_PER_SECOND, MAX_CLIENT_GPU_PER_SECOND},
    metrics::ledger::Ledger,
};

#[derive(Debug)]
pub(super) struct Budget {
    gpu_s: TokenBucket,
    bytes: TokenBucket,
    settled_at: Instant,
}

/// Holds up to one second's worth. May be overdrawn, since costs are known only afterwards.
#[derive(Debug)]
struct TokenBucket {
    per_second: f64,
    level: f64,
    /// Total spent at the last update.
    spent: f64,
}

impl TokenBucket {
    const fn new(per_second: f64) -> Self {
        Self { per_second, level: per_second, spent: 0.0 }
    }

    /// `spent` is the total so far. Returns the time to wait until the level is above zero.
    fn settle(&mut self, spent: f64, elapsed: Duration) -> Duration {
        let filled = self.per_second.mul_add(elapsed.as_secs_f64(), self.level).min(self.per_second);
        self.level = filled - (spent - self.spent);
        self.spent = spent;
        Duration::try_from_secs_f64(-self.level / self.per_second).unwrap_or_default()
    }
}

impl Budget {
    pub(super) fn new() -> Self {
        #[expect(clippy::cast_precision_loss, reason = "far below 2^53")]
        let bytes = TokenBucket::new(MAX_CLIENT_BYTES_PER_SECOND as f64);
        Self { gpu_s: TokenBucket::new(MAX_CLIENT_GPU_PER_SECOND.as_secs_f64()), bytes, settled_at: Instant::now() }
    }

    /// Waits until the budget permits more, then for `work`. Cancel-safe if `work` is.
    pub(super) async fn within<T>(&mut self, ledger: &Ledger, work: impl Future<Output = T>) -> T {
        let wait = self.settle(ledger, Instant::now());
        if !wait.is_zero() {
            tokio::time::sleep(wait).await;
        }
        work.await
    }

    #[expect(clippy::cast_precision_loss, reason = "far below 2^53")]
    fn settle(&mut self, ledger: &Ledger, now: Instant) -> Duration {
        let elapsed = now.saturating_duration_since(self.settled_at);
        self.settled_at = now;
        let totals = ledger.totals();
        let gpu = self.gpu_s.settle(totals.gpu_us as f64 * 1e-6, elapsed);
        gpu.max(self.bytes.settle(totals.bytes as f64, elapsed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bucket_allows_its_rate_and_a_burst_of_one_second() {
        let mut bucket = TokenBucket::new(100.0);
        assert_eq!(bucket.settle(100.0, Duration::ZERO), Duration::ZERO, "it starts full");
        assert_eq!(bucket.settle(150.0, Duration::ZERO), Duration::from_millis(500));
        assert_eq!(bucket.settle(150.0, Duration::from_millis(500)), Duration::ZERO);
        assert_eq!(bucket.settle(150.0, Duration::from_secs(3600)), Duration::ZERO, "it holds one second");
        assert_eq!(bucket.settle(300.0, Duration::ZERO), Duration::from_millis(500));
    }

    #[test]
    fn device_time_and_bytes_are_limited() {
        let ledger = Ledger::default();
        let mut budget = Budget::new();
        let start = budget.settled_at;
        assert_eq!(budget.settle(&ledger, start), Duration::ZERO);
        ledger.bytes.add(MAX_CLIENT_BYTES_PER_SECOND * 3 / 2);
        assert_eq!(budget.settle(&ledger, start), Duration::from_millis(500));
        ledger.gpu_us.add_us(MAX_CLIENT_GPU_PER_SECOND * 3);
        assert_eq!(budget.settle(&ledger, start), Duration::from_secs(2));
        assert_eq!(budget.settle(&ledger, start + Duration::from_secs(2)), Duration::ZERO);
    }
}
