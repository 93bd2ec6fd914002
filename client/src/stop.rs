//! The wish that a run ends early: a signal, or a closed window.
//!
//! The run's thread asks between frames. Its network tasks wait for the wish, so that the server is told at once even
//! while that thread draws.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use parking_lot::{Condvar, Mutex};
use thiserror::Error;
use tokio::sync::Notify;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("ended by {}", self.name())]
pub enum Cause {
    Interrupt,
    Terminate,
    /// The terminal is lost.
    HangUp,
    /// A person closed the window.
    Closed,
}

impl Cause {
    /// As in the summary.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Interrupt => "SIGINT",
            Self::Terminate => "SIGTERM",
            Self::HangUp => "SIGHUP",
            Self::Closed => "a closed window",
        }
    }

    /// As shells report a program that a signal ended: 128 and the signal's number.
    #[must_use]
    pub const fn exit_code(self) -> u8 {
        match self {
            Self::Closed => 0,
            Self::HangUp => 129,
            Self::Interrupt => 130,
            Self::Terminate => 143,
        }
    }
}

/// Shared by everything that a run does. Nothing takes the wish back.
#[derive(Debug, Clone, Default)]
pub struct Stop(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    cause: Mutex<Option<Cause>>,
    changed: Condvar,
    woken: Notify,
}

impl Stop {
    /// The first cause is kept.
    pub fn ask(&self, cause: Cause) {
        self.0.cause.lock().get_or_insert(cause);
        self.0.changed.notify_all();
        self.0.woken.notify_waiters();
    }

    #[must_use]
    pub fn asked(&self) -> Option<Cause> {
        *self.0.cause.lock()
    }

    /// # Errors
    /// Errors with the cause once the run is to end.
    pub fn check(&self) -> Result<(), Cause> {
        self.asked().map_or(Ok(()), Err)
    }

    /// Sleeps, but not longer than the run lasts.
    pub fn sleep(&self, time: Duration) {
        let until = Instant::now() + time;
        let mut cause = self.0.cause.lock();
        while cause.is_none() && !self.0.changed.wait_until(&mut cause, until).timed_out() {}
    }

    /// Waits until the run is to end.
    pub(crate) async fn wait(&self) -> Cause {
        loop {
            // Made before asking: it also sees a wish that comes between the two.
            let woken = self.0.woken.notified();
            if let Some(cause) = self.asked() {
                return cause;
            }
            woken.await;
        }
    }

    /// Does `work` unless the run is to end first, which drops it.
    pub(crate) async fn unless<T>(&self, work: impl Future<Output = T>) -> Result<T, Cause> {
        tokio::select! {
            biased;
            cause = self.wait() => Err(cause),
            done = work => Ok(done),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LONG: Duration = Duration::from_secs(3600);

    #[test]
    fn the_first_cause_is_kept_and_wakes_who_sleeps() {
        let stop = Stop::default();
        stop.sleep(Duration::from_millis(1));
        assert_eq!((stop.asked(), stop.check()), (None, Ok(())));
        let shared = stop.clone();
        let sleeping = std::thread::spawn(move || shared.sleep(LONG));
        stop.ask(Cause::Terminate);
        stop.ask(Cause::Interrupt);
        sleeping.join().unwrap();
        stop.sleep(LONG);
        assert_eq!((stop.asked(), stop.check()), (Some(Cause::Terminate), Err(Cause::Terminate)));
        assert_eq!(Cause::Terminate.to_string(), "ended by SIGTERM");
    }

    #[tokio::test]
    async fn work_is_done_unless_the_run_ends_first() {
        let stop = Stop::default();
        assert_eq!(stop.unless(async { 7 }).await, Ok(7));
        let shared = stop.clone();
        let endless = tokio::spawn(async move { shared.unless(std::future::pending::<()>()).await });
        tokio::task::yield_now().await;
        stop.ask(Cause::HangUp);
        assert_eq!(endless.await.unwrap(), Err(Cause::HangUp));
        assert_eq!(stop.unless(async { 7 }).await, Err(Cause::HangUp));
    }
}
