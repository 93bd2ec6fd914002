//! Limits how many lines one place in the code logs, since peers can make the server log.
//!
//! Each place has a token bucket. Lines beyond it are counted, and the count is logged by [`super::sink`]. Lines at
//! level debug and below are logged only on demand, and have no limit.

use std::{
    collections::HashMap,
    sync::atomic::{AtomicU64, Ordering},
    time::{Duration, Instant},
};

use parking_lot::Mutex;
use tracing::{Event, Level, Metadata, Subscriber, callsite::Identifier, subscriber::Interest};
use tracing_subscriber::layer::{Context, Filter};

use crate::{
    limits::{LOG_BURST, LOG_LINES_PER_SECOND},
    metrics::ledger::TIMED,
};

/// How often [`SiteLimit::report`] is called.
pub(super) const REPORT_EVERY: Duration = Duration::from_secs(10);

/// Static, since a process has one log.
static SUPPRESSED: AtomicU64 = AtomicU64::new(0);

/// Lines left out since the start, because their place logged too many.
pub(crate) fn lines_suppressed() -> u64 {
    SUPPRESSED.load(Ordering::Relaxed)
}

/// The buckets, at most one for each place in the code that logs.
#[derive(Default)]
pub(super) struct SiteLimit(Mutex<HashMap<Identifier, Site>>);

struct Site {
    about: &'static Metadata<'static>,
    lines: f64,
    refilled_at: Instant,
    suppressed: u64,
}

impl SiteLimit {
    /// Returns whether the place may log a line now.
    fn admits(&self, about: &'static Metadata<'static>, now: Instant) -> bool {
        let mut sites = self.0.lock();
        let site =
            sites.entry(about.callsite()).or_insert(Site { about, lines: LOG_BURST, refilled_at: now, suppressed: 0 });
        let passed = now.saturating_duration_since(site.refilled_at);
        site.lines = (site.lines + passed.as_secs_f64() * LOG_LINES_PER_SECOND).min(LOG_BURST);
        site.refilled_at = now;
        let admitted = site.lines >= 1.0;
        if admitted {
            site.lines -= 1.0;
        } else {
            site.suppressed += 1;
            SUPPRESSED.fetch_add(1, Ordering::Relaxed);
        }
        admitted
    }

    /// Logs how many lines each place has left out since the last call.
    pub(super) fn report(&self) {
        let left_out: Vec<_> = (self.0.lock().values_mut())
            .filter(|site| site.suppressed > 0)
            .map(|site| (site.about, std::mem::take(&mut site.suppressed)))
            .collect();
        for (about, lines) in left_out {
            let place = format!("{}:{}", about.file().unwrap_or(about.target()), about.line().unwrap_or_default());
            tracing::warn!(lines, place, "log lines were suppressed");
        }
    }
}

impl<S: Subscriber> Filter<S> for &'static SiteLimit {
    fn enabled(&self, _: &Metadata<'_>, _: &Context<'_, S>) -> bool {
        true
    }

    fn callsite_enabled(&self, _: &'static Metadata<'static>) -> Interest {
        Interest::always()
    }

    fn event_enabled(&self, event: &Event<'_>, _: &Context<'_, S>) -> bool {
        let about = event.metadata();
        *about.level() > Level::INFO || about.target() == TIMED || self.admits(about, Instant::now())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex as StdMutex};

    use tracing_subscriber::{Layer as _, fmt, layer::SubscriberExt as _, registry};

    use super::*;

    #[derive(Clone, Default)]
    struct Lines(Arc<StdMutex<Vec<u8>>>);

    impl std::io::Write for Lines {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_place_that_logs_too_much_is_suppressed_and_the_count_is_logged() {
        let (lines, limit) = (Lines::default(), &*Box::leak(Box::<SiteLimit>::default()));
        let writer = lines.clone();
        let layer = fmt::layer().with_ansi(false).with_writer(move || writer.clone()).with_filter(limit);
        let before = lines_suppressed();
        tracing::subscriber::with_default(registry().with(layer), || {
            for number in 0..5000 {
                tracing::warn!(number, "a flood");
                tracing::debug!(number, "on demand");
                tracing::info!(target: TIMED, number, "rates");
            }
            tracing::warn!("another place");
            limit.report();
            limit.report();
        });
        let text = String::from_utf8(lines.0.lock().unwrap().clone()).unwrap();
        let count = |what: &str| text.lines().filter(|line| line.contains(what)).count();
        let flood = count("a flood");
        // A slow machine refills a little meanwhile.
        assert!((200..2500).contains(&flood), "{flood}");
        assert_eq!((count("on demand"), count("rates"), count("another place")), (5000, 5000, 1));
        let told: Vec<_> = text.lines().filter(|line| line.contains("log lines were suppressed")).collect();
        assert!(matches!(told.as_slice(), [one] if one.contains(&format!("lines={}", 5000 - flood))), "{told:?}");
        assert!(told[0].contains("site_limit.rs:"), "{told:?}");
        assert!(lines_suppressed() - before >= 5000 - flood as u64);
    }

    #[test]
    fn a_bucket_fills_again() {
        let limit = SiteLimit::default();
        let about = {
            struct Here;
            static META: Metadata<'static> = tracing::metadata! {
                name: "here", target: "here", level: Level::INFO, fields: &[], callsite: &Here,
                kind: tracing::metadata::Kind::EVENT,
            };
            impl tracing::Callsite for Here {
                fn set_interest(&self, _: Interest) {}
                fn metadata(&self) -> &Metadata<'_> {
                    &META
                }
            }
            &META
        };
        let now = Instant::now();
        let admitted = |at: Instant| (0..1000).filter(|_| limit.admits(about, at)).count();
        assert_eq!([admitted(now), admitted(now), admitted(now + Duration::from_secs(3))], [200, 0, 30]);
        assert_eq!(admitted(now + Duration::from_secs(3600)), 200);
    }
}
