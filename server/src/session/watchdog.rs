//! Once a second: logs a session's rates, and ends a session whose client is silent, noisy or never starts.

use std::time::Instant;

use super::end::End;
use crate::{
    limits,
    metrics::ledger::{Ledger, StageCounts, Totals},
};

pub(super) struct Watchdog {
    opened_at: Instant,
    last_active_at: Instant,
    checked_at: Instant,
    totals: Totals,
    /// Seconds in a row in which it sent too many datagrams.
    seconds_over_rate: u32,
    stages: Box<StageCounts>,
}

impl Watchdog {
    pub(super) fn new(ledger: &Ledger) -> Self {
        let now = Instant::now();
        Self {
            opened_at: now,
            last_active_at: now,
            checked_at: now,
            totals: ledger.totals(),
            seconds_over_rate: 0,
            stages: Box::new(ledger.stages.counts()),
        }
    }

    /// `started`: the client has sent Start.
    pub(super) fn check(&mut self, ledger: &Ledger, started: bool) -> Result<(), End> {
        let (now, totals) = (Instant::now(), ledger.totals());
        let seconds = now.duration_since(self.checked_at).as_secs_f64();
        let latest = totals.since(&self.totals);
        (self.checked_at, self.totals) = (now, totals);
        ledger.set_latest(&latest, seconds);
        if started {
            let stages = ledger.stages.counts();
            latest.log_rates(&stages.since(&self.stages), seconds);
            *self.stages = stages;
        } else if now.duration_since(self.opened_at) > limits::SETUP_TIMEOUT {
            return Err(End::Violation(format!("no Start in {} s", limits::SETUP_TIMEOUT.as_secs())));
        }
        if latest.messages + latest.poses > 0 {
            self.last_active_at = now;
        } else if started && now.duration_since(self.last_active_at) > limits::SILENCE_TIMEOUT {
            return Err(End::Lost(format!("no pose and no message in {} s", limits::SILENCE_TIMEOUT.as_secs())));
        }
        self.check_violations(&latest, seconds)
    }
}

impl Watchdog {
    /// `latest` is what happened in these `seconds`.
    fn check_violations(&mut self, latest: &Totals, seconds: f64) -> Result<(), End> {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few seconds")]
        let whole_seconds = seconds.ceil() as u64;
        for (count, per_second, what) in [
            (latest.messages, limits::MAX_MESSAGES_PER_SECOND, "control messages"),
            (latest.edits, limits::MAX_EDITS_PER_SECOND, "edits"),
            (latest.poses_bad, limits::MAX_BAD_POSES_PER_SECOND, "invalid datagrams"),
        ] {
            if count > per_second * whole_seconds {
                return Err(End::Violation(format!("{count} {what} in {seconds:.1} s")));
            }
        }
        self.seconds_over_rate = if latest.poses_over_rate > 0 { self.seconds_over_rate + 1 } else { 0 };
        if self.seconds_over_rate >= limits::MAX_SECONDS_OVER_RATE {
            let [most, seconds] = [limits::MAX_POSES_PER_SECOND, limits::MAX_SECONDS_OVER_RATE];
            return Err(End::Violation(format!("more than {most} datagrams a second for {seconds} s")));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn silence_noise_and_endless_setups_end_a_session() {
        let ledger = Ledger::default();
        let ago = |time: Duration| Instant::now().checked_sub(time).unwrap();
        let watchdog = |silent: Duration| Watchdog { last_active_at: ago(silent), ..Watchdog::new(&ledger) };
        assert!(watchdog(limits::SILENCE_TIMEOUT / 2).check(&ledger, true).is_ok());
        let silent = watchdog(limits::SILENCE_TIMEOUT + Duration::from_secs(1)).check(&ledger, true);
        assert!(matches!(silent, Err(End::Lost(_))));
        let mut late = Watchdog::new(&ledger);
        late.opened_at = ago(limits::SETUP_TIMEOUT + Duration::from_secs(1));
        assert!(late.check(&ledger, true).is_ok());
        assert!(matches!(late.check(&ledger, false), Err(End::Violation(_))));
        let mut noisy = Watchdog::new(&ledger);
        ledger.messages.add(limits::MAX_MESSAGES_PER_SECOND + 1);
        assert!(matches!(noisy.check(&ledger, true), Err(End::Violation(_))));
        let ledger = Ledger::default();
        let mut wrong = Watchdog::new(&ledger);
        ledger.poses_bad.add(limits::MAX_BAD_POSES_PER_SECOND);
        assert!(wrong.check(&ledger, true).is_ok());
        ledger.poses_bad.add(limits::MAX_BAD_POSES_PER_SECOND + 1);
        assert!(matches!(wrong.check(&ledger, true), Err(End::Violation(_))));
        // Datagrams that a network held up are too many in one second, not in several.
        let mut flood = Watchdog::new(&ledger);
        let mut second = |over: u64| {
            ledger.poses_over_rate.add(over);
            flood.check(&ledger, true)
        };
        for over in [1, 1, 0].into_iter().cycle().take(30) {
            assert!(second(over).is_ok());
        }
        let ends = (1..=limits::MAX_SECONDS_OVER_RATE).find(|_| second(1).is_err());
        assert_eq!(ends, Some(limits::MAX_SECONDS_OVER_RATE));
    }
}
