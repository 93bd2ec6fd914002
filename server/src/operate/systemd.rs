//! Tells systemd how the server is, for units of `Type=notify`: READY, RELOADING, STOPPING and the watchdog
//! (sd_notify(3)). Does nothing elsewhere.

#[cfg(target_os = "linux")]
mod notify {
    use std::time::Duration;

    use sd_notify::NotifyState;
    use tokio::time::{MissedTickBehavior, timeout};

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

    /// Feeds systemd's watchdog, if the unit has one, while the runtime runs this and `lives` says yes. Dropping the
    /// task ends that.
    #[must_use]
    pub fn watchdog(lives: impl Fn() -> bool + Send + 'static) -> Option<impl Drop> {
        let period = sd_notify::watchdog_enabled()?;
        Some(Task::spawn(feed(period, lives, || tell(vec![NotifyState::Watchdog]))))
    }

    /// Calls `tell` three times a `period`.
    pub(super) async fn feed<F: Future<Output = ()>>(period: Duration, lives: impl Fn() -> bool, tell: impl Fn() -> F) {
        let mut tick = tokio::time::interval((period / 3).max(Duration::from_millis(1)));
        tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut lived = true;
        loop {
            tick.tick().await;
            let lives = lives();
            if lives {
                tell().await;
            } else if lived {
                tracing::error!("a tracing thread does not answer: systemd's watchdog is not fed");
            }
            lived = lives;
        }
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
    use crate::task::Task;

    pub async fn ready() {}

    pub async fn reloading() {}

    pub async fn stopping() {}

    #[must_use]
    pub fn watchdog(_: impl Fn() -> bool + Send + 'static) -> Option<impl Drop> {
        None::<Task>
    }
}

pub use self::notify::{ready, reloading, stopping, watchdog};

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use std::{
        sync::{
            Arc,
            atomic::{AtomicBool, AtomicU32, Ordering},
        },
        time::Duration,
    };

    use super::notify::feed;

    #[tokio::test]
    async fn a_server_that_does_not_answer_is_not_reported_alive() {
        let (lives, fed) = (Arc::new(AtomicBool::new(true)), Arc::new(AtomicU32::new(0)));
        let (check, count) = (Arc::clone(&lives), Arc::clone(&fed));
        let task = tokio::spawn(feed(
            Duration::from_millis(30),
            move || check.load(Ordering::Relaxed),
            move || {
                count.fetch_add(1, Ordering::Relaxed);
                std::future::ready(())
            },
        ));
        let pause = || tokio::time::sleep(Duration::from_millis(20));
        for _ in 0..3 {
            fed.store(0, Ordering::Relaxed);
            while fed.load(Ordering::Relaxed) < 3 {
                pause().await;
            }
            lives.store(false, Ordering::Relaxed);
            // One runtime thread: no call is under way.
            fed.store(0, Ordering::Relaxed);
            for _ in 0..10 {
                pause().await;
            }
            assert_eq!(fed.load(Ordering::Relaxed), 0);
            lives.store(true, Ordering::Relaxed);
        }
        task.abort();
    }
}
