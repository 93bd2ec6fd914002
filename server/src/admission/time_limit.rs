//! The time limit of handshakes. It is long while few are under way: on a network that loses a third of its packets,
//! each loss doubles the time until the next try. It is short during a flood, when slow ones would block others.

use std::{pin::pin, time::Duration};

use tokio::time::{Instant, sleep_until};

use crate::limits::{MAX_UNHURRIED_HANDSHAKES, UNHURRIED_LIMITS};

/// Runs `work` for up to `limit`, or up to [`UNHURRIED_LIMITS`] times that while few handshakes are `under_way`, this
/// one included. Returns `None` after the time limit.
pub(crate) async fn within<T>(
    limit: Duration,
    under_way: impl Fn() -> usize,
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
        if !may_continue(started_at.elapsed(), limit, under_way()) {
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
    use super::*;
    use crate::limits::MAX_HANDSHAKES;

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
        assert_eq!(within(LIMIT, || 1, async { 5 }).await, Some(5));
        let started_at = Instant::now();
        assert_eq!(within(LIMIT, || 1, std::future::pending::<()>()).await, None);
        assert!(started_at.elapsed() >= LIMIT * UNHURRIED_LIMITS);
        // During a flood it gets no extra time.
        let started_at = Instant::now();
        assert_eq!(within(LIMIT * 50, || MAX_HANDSHAKES, std::future::pending::<()>()).await, None);
        assert!(started_at.elapsed() < LIMIT * 50 * UNHURRIED_LIMITS);
    }
}
