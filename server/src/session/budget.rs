//! What one client may cost: device time and bytes a second. Who has spent more waits for its next mask; nothing queues meanwhile,
//! because the engine traces nothing for a session that takes no masks.

use std::time::{Duration, Instant};

use crate::{
    limits::{MAX_CLIENT_BYTES_PER_SECOND, MAX_CLIENT_GPU_PER_SECOND},
    metrics::ledger::Ledger,
};

/// A session's spending.
#[derive(Debug)]
pub(super) struct Budget {
    gpu_s: Account,
    bytes: Account,
    at: Instant,
}

/// Fills at a constant rate up to a second's worth; may be overdrawn by what cost more than was known before.
#[derive(Debug)]
struct Account {
    per_second: f64,
    level: f64,
    /// What had been spent when it was last looked at.
    spent: f64,
}

impl Account {
    const fn new(per_second: f64) -> Self {
        Self { per_second, level: per_second, spent: 0.0 }
    }

    /// Books what has been spent by now, and says how long its owner has to wait.
    fn settle(&mut self, spent: f64, passed: Duration) -> Duration {
        let filled = self.per_second.mul_add(passed.as_secs_f64(), self.level).min(self.per_second);
        self.level = filled - (spent - self.spent);
        self.spent = spent;
        Duration::try_from_secs_f64(-self.level / self.per_second).unwrap_or_default()
    }
}

impl Budget {
    pub(super) fn new() -> Self {
        #[expect(clippy::cast_precision_loss, reason = "far below 2^53")]
        let bytes = Account::new(MAX_CLIENT_BYTES_PER_SECOND as f64);
        Self { gpu_s: Account::new(MAX_CLIENT_GPU_PER_SECOND.as_secs_f64()), bytes, at: Instant::now() }
    }

    /// Waits for `work` once the session's spending allows it. Cancelling it loses nothing if cancelling `work` does not.
    pub(super) async fn within<T>(&mut self, ledger: &Ledger, work: impl Future<Output = T>) -> T {
        let wait = self.settle(ledger, Instant::now());
        if !wait.is_zero() {
            tokio::time::sleep(wait).await;
        }
        work.await
    }

    #[expect(clippy::cast_precision_loss, reason = "far below 2^53")]
    fn settle(&mut self, ledger: &Ledger, now: Instant) -> Duration {
        let passed = now.saturating_duration_since(self.at);
        self.at = now;
        let totals = ledger.totals();
        let gpu = self.gpu_s.settle(totals.gpu_us as f64 * 1e-6, passed);
        gpu.max(self.bytes.settle(totals.bytes as f64, passed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_account_allows_its_rate_and_a_second_of_savings() {
        let mut account = Account::new(100.0);
        assert_eq!(account.settle(100.0, Duration::ZERO), Duration::ZERO, "the first second is there at once");
        assert_eq!(account.settle(150.0, Duration::ZERO), Duration::from_millis(500));
        assert_eq!(account.settle(150.0, Duration::from_millis(500)), Duration::ZERO);
        assert_eq!(account.settle(150.0, Duration::from_secs(3600)), Duration::ZERO, "savings end at a second");
        assert_eq!(account.settle(300.0, Duration::ZERO), Duration::from_millis(500));
    }

    #[test]
    fn both_the_device_and_bytes_are_counted() {
        let ledger = Ledger::default();
        let mut budget = Budget::new();
        let start = budget.at;
        assert_eq!(budget.settle(&ledger, start), Duration::ZERO);
        ledger.bytes.add(MAX_CLIENT_BYTES_PER_SECOND * 3 / 2);
        assert_eq!(budget.settle(&ledger, start), Duration::from_millis(500));
        ledger.gpu_us.add_us(MAX_CLIENT_GPU_PER_SECOND * 3);
        assert_eq!(budget.settle(&ledger, start), Duration::from_secs(2));
        assert_eq!(budget.settle(&ledger, start + Duration::from_secs(2)), Duration::ZERO);
    }
}
