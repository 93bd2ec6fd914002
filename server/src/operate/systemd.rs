//! Tells systemd how the server is, for units of `Type=notify`: READY, RELOADING, STOPPING and the watchdog
//! (sd_notify(3)). Does nothing elsewhere.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use crate::{admission::services::Services, visibility::engine::Engine};

/// How often the engines are looked at while one has not moved yet.
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// Shows whether the server lives.
pub struct Pulse(Arc<Services>);

impl Pulse {
    pub(crate) const fn new(services: Arc<Services>) -> Self {
        Self(services)
    }

    /// Waits up to `limit` until each engine's thread has made a round. Returns whether they have. An engine without
    /// its device does not count: it reopens the device, or ends the server.
    pub async fn beats(&self, limit: Duration) -> bool {
        let round = |engine: &Engine| engine.is_well().then(|| engine.nudge());
        advance(limit, || self.0.engine.engines().iter().map(round).collect()).await
    }
}

/// Waits until every number that is there has grown, or is there no longer.
async fn advance(limit: Duration, mut rounds: impl FnMut() -> Vec<Option<u64>>) -> bool {
    let (started_at, first) = (Instant::now(), rounds());
    loop {
        let stuck = first.iter().zip(rounds()).any(|(first, now)| now.is_some() && *first == now);
        if !stuck || started_at.elapsed() >= limit {
            return !stuck;
        }
        tokio::time::sleep(LOOK_EVERY).await;
    }
}

#[cfg(target_os = "linux")]
mod notify {
    use std::time::Duration;

    use sd_notify::NotifyState;
    use tokio::time::{MissedTickBehavior, timeout};

    use super::Pulse;
    use crate::task::Task;

    /// systemd reads at once, so nothing waits longer for it.
    const TIMEOUT: Duration = Duration::from_secs(2);

    /// Start-up or a reload is done.
    pub async fn ready() {
        tell(vec![NotifyState::Ready]).await;
    }

    pub async fn reloading() {
        let now = NotifyState::monotonic_usec_now();
        tell([Ok(NotifyState::Reloading), now].into_iter().flatten().collect()).await;
    }

    pub async fn stopping() {
        tell(vec![NotifyState::Stopping]).await;
    }

    /// Feeds systemd's watchdog, if the unit has one, while the runtime runs this and the engines' threads make rounds.
    /// Dropping the task ends that.
    #[must_use]
    pub fn watchdog(pulse: Pulse) -> Option<impl Drop> {
        let period = sd_notify::watchdog_enabled()? / 3;
        Some(Task::spawn(async move {
            let mut tick = tokio::time::interval(period.max(super::LOOK_EVERY));
            tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
            loop {
                tick.tick().await;
                if pulse.beats(period).await {
                    tell(vec![NotifyState::Watchdog]).await;
                } else {
                    tracing::error!(
                        ms = period.as_secs_f64() * 1e3,
                        "an engine is stuck: systemd's watchdog is not fed"
                    );
                }
            }
        }))
    }

    async fn tell(states: Vec<NotifyState<'static>>) {
        let told = tokio::task::spawn_blocking(move || sd_notify::notify(&states));
        let reason = match timeout(TIMEOUT, told).await {
            Ok(Ok(Ok(()))) => return,
            Ok(Ok(Err(error))) => error.to_string(),
            Ok(Err(error)) => error.to_string(),
            Err(_) => format!("no answer in {} s", TIMEOUT.as_secs()),
        };
        tracing::warn!(reason, "cannot notify systemd");
    }
}

#[cfg(not(target_os = "linux"))]
mod notify {
    use super::Pulse;
    use crate::task::Task;

    pub async fn ready() {}

    pub async fn reloading() {}

    pub async fn stopping() {}

    #[must_use]
    pub fn watchdog(_: Pulse) -> Option<impl Drop> {
        None::<Task>
    }
}

pub use self::notify::{ready, reloading, stopping, watchdog};

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn an_engine_that_makes_no_round_is_stuck() {
        let limit = Duration::from_millis(50);
        let mut calls = 0;
        let mut moving = || {
            calls += 1;
            vec![Some(calls / 4), None]
        };
        assert!(advance(Duration::from_secs(60), &mut moving).await);
        assert!(!advance(limit, || vec![Some(7)]).await, "it makes no round");
        assert!(!advance(limit, || vec![Some(7), None]).await);
        assert!(advance(limit, || vec![None, None]).await, "devices are being reopened");
        let mut lost = [Some(7), Some(7), None].into_iter();
        assert!(advance(Duration::from_secs(60), || vec![lost.next().flatten()]).await, "the device is lost meanwhile");
    }
}
