//! The time limit of handshakes. It is long while few are under way: on a network that loses a third of its packets,
//! each loss doubles the time until the next try. It is short during a flood, when slow ones would block others.

use std::{pin::pin, time::Duration};

use tokio::{
    sync::OwnedSemaphorePermit,
    time::{Instant, sleep_until},
};

use crate::limits::{MAX_HANDSHAKES, MAX_UNHURRIED_HANDSHAKES, UNHURRIED_LIMITS};

/// Runs `work` for up to `limit`, or up to [`UNHURRIED_LIMITS`] times that while few handshakes are under way. Returns
/// `None` after the time limit. `permit` is one of [`MAX_HANDSHAKES`].
pub(crate) async fn within<T>(
    limit: Duration,
    permit: &OwnedSemaphorePermit,
    work: impl Future<Output = T>,
) -> Option<T> {
    let started_at = Instant::now();
    let mut work = pin!(work);
    let mut next_check = started_at + limit;
    loop {
        tokio::select! {
            biased;
            done = &mut work => return Some(done),
            () = sleep_until(next_check) => {}
        }
        let under_way = MAX_HANDSHAKES.saturating_sub(permit.semaphore().available_permits());
        if !may_continue(started_at.elapsed(), limit, under_way) {
            return None;
        }
        // Checked again, in case a flood begins later.
        next_check += limit / 8;
    }
}

/// `under_way` includes this handshake.
fn may_continue(elapsed: Duration, limit: Duration, under_way: usize) -> bool {
    elapsed < limit || (elapsed < limit * UNHURRIED_LIMITS && under_way <= MAX_UNHURRIED_HANDSHAKES)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use tokio::sync::Semaphore;

    use super::*;

    const LIMIT: Duration = Duration::from_millis(20);

    #[test]
    fn a_few_handshakes_have_time_and_many_do_not() {
        assert!(may_continue(LIMIT / 2, LIMIT, MAX_HANDSHAKES));
        assert!(!may_continue(LIMIT, LIMIT, MAX_UNHURRIED_HANDSHAKES + 1));
        assert!(may_continue(LIMIT * (UNHURRIED_LIMITS - 1), LIMIT, MAX_UNHURRIED_HANDSHAKES));
        assert!(!may_continue(LIMIT * UNHURRIED_LIMITS, LIMIT, 1));
    }

    #[tokio::test]
    async fn a_handshake_ends_when_its_time_is_up() {
        let permits = Arc::new(Semaphore::new(MAX_HANDSHAKES));
        let mine = Arc::clone(&permits).try_acquire_owned().unwrap();
        assert_eq!(within(LIMIT, &mine, async { 5 }).await, Some(5));
        let started_at = Instant::now();
        assert_eq!(within(LIMIT, &mine, std::future::pending::<()>()).await, None);
        assert!(started_at.elapsed() >= LIMIT * UNHURRIED_LIMITS);
        // During a flood it gets no extra time.
        let _flood = Arc::clone(&permits).acquire_many_owned(u32::try_from(MAX_HANDSHAKES - 1).unwrap()).await.unwrap();
        let started_at = Instant::now();
        assert_eq!(within(LIMIT * 50, &mine, std::future::pending::<()>()).await, None);
        assert!(started_at.elapsed() < LIMIT * 50 * UNHURRIED_LIMITS);
    }
}
