//! Whether what SIGHUP reads again could be read, for the metrics.

use std::{
    sync::atomic::{AtomicBool, AtomicI64, Ordering},
    time::UNIX_EPOCH,
};

use crate::clock;

/// How one file was read last.
#[derive(Debug)]
pub(crate) struct Outcome {
    failed: AtomicBool,
    /// In seconds since 1970; negative before the first success.
    succeeded_at_unix_s: AtomicI64,
}

/// A reading of an [`Outcome`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Reload {
    /// A metric label.
    pub(crate) what: &'static str,
    pub(crate) failed: bool,
    pub(crate) succeeded_at_unix_s: i64,
}

impl Outcome {
    pub(crate) const fn new() -> Self {
        Self { failed: AtomicBool::new(false), succeeded_at_unix_s: AtomicI64::new(-1) }
    }

    pub(crate) fn succeeded(&self) {
        let now = clock::wall().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
        self.succeeded_at_unix_s.store(i64::try_from(now).unwrap_or(i64::MAX), Ordering::Relaxed);
        self.failed.store(false, Ordering::Relaxed);
    }

    pub(crate) fn failed(&self) {
        self.failed.store(true, Ordering::Relaxed);
    }

    /// `None` if nothing of this kind is in use.
    pub(crate) fn get(&self, what: &'static str) -> Option<Reload> {
        let succeeded_at_unix_s = self.succeeded_at_unix_s.load(Ordering::Relaxed);
        let failed = self.failed.load(Ordering::Relaxed);
        (succeeded_at_unix_s >= 0).then_some(Reload { what, failed, succeeded_at_unix_s })
    }
}

impl Default for Outcome {
    fn default() -> Self {
        Self::new()
    }
}

/// The files that SIGHUP reads again, but for the log, which a process has only one of.
#[derive(Debug, Default)]
pub(crate) struct Reloads {
    pub(crate) tokens: Outcome,
    pub(crate) certificate: Outcome,
}

impl Reloads {
    /// A reading of each that is in use.
    pub(crate) fn all(&self) -> Vec<Reload> {
        [self.tokens.get("tokens"), self.certificate.get("certificate")].into_iter().flatten().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_lasts_until_the_next_success() {
        let reloads = Reloads::default();
        reloads.tokens.failed();
        assert_eq!(reloads.all(), [], "nothing was ever loaded");
        reloads.tokens.succeeded();
        let loaded = reloads.all();
        assert!(matches!(loaded.as_slice(), [Reload { what: "tokens", failed: false, succeeded_at_unix_s: 1.. }]));
        reloads.tokens.failed();
        assert_eq!(reloads.all(), [Reload { failed: true, ..loaded[0] }], "the time is that of the success");
        reloads.tokens.succeeded();
        assert!(!reloads.all()[0].failed);
    }
}
