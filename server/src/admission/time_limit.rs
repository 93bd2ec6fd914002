//! How long a handshake may take. A network that loses a third of its packets makes one take seconds, since every loss doubles the
//! time until the next try; a flood makes every one that is under way cost somebody else's place. So the limit is as long as places are
//! plenty, and short when they are not.

use std::{pin::pin, time::Duration};

use tokio::{
    sync::OwnedSemaphorePermit,
    time::{Instant, sleep_until},
};

use crate::limits::{MAX_HANDSHAKES, MAX_UNHURRIED_HANDSHAKES, UNHURRIED_LIMITS};

/// Does `work`, for `limit` at least: while few handshakes are under way for [`UNHURRIED_LIMITS`] times as long. `place` is one of the
/// places for handshakes. `None` when the time is up.
pub(crate) async fn within<T>(
    limit: Duration,
    place: &OwnedSemaphorePermit,
    work: impl Future<Output = T>,
) -> Option<T> {
    let begun = Instant::now();
    let mut work = pin!(work);
    let mut look = begun + limit;
    loop {
        tokio::select! {
            biased;
            done = &mut work => return Some(done),
            () = sleep_until(look) => {}
        }
        let under_way = MAX_HANDSHAKES.saturating_sub(place.semaphore().available_permits());
        if !goes_on(begun.elapsed(), limit, under_way) {
            return None;
        }
        // A flood that begins later ends it as well.
        look += limit / 8;
    }
}

/// Whether a handshake that has taken so long may go on beside so many, itself among them.
fn goes_on(taken: Duration, limit: Duration, under_way: usize) -> bool {
    taken < limit || (taken < limit * UNHURRIED_LIMITS && under_way <= MAX_UNHURRIED_HANDSHAKES)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use tokio::sync::Semaphore;

    use super::*;

    const LIMIT: Duration = Duration::from_millis(20);

    #[test]
    fn a_few_handshakes_have_time_and_many_do_not() {
        assert!(goes_on(LIMIT / 2, LIMIT, MAX_HANDSHAKES));
        assert!(!goes_on(LIMIT, LIMIT, MAX_UNHURRIED_HANDSHAKES + 1));
        assert!(goes_on(LIMIT * (UNHURRIED_LIMITS - 1), LIMIT, MAX_UNHURRIED_HANDSHAKES));
        assert!(!goes_on(LIMIT * UNHURRIED_LIMITS, LIMIT, 1));
    }

    #[tokio::test]
    async fn a_handshake_ends_when_its_time_is_up() {
        let places = Arc::new(Semaphore::new(MAX_HANDSHAKES));
        let mine = Arc::clone(&places).try_acquire_owned().unwrap();
        assert_eq!(within(LIMIT, &mine, async { 5 }).await, Some(5));
        let begun = Instant::now();
        assert_eq!(within(LIMIT, &mine, std::future::pending::<()>()).await, None);
        assert!(begun.elapsed() >= LIMIT * UNHURRIED_LIMITS);
        // Among many others it is not given that.
        let _flood = Arc::clone(&places).acquire_many_owned(u32::try_from(MAX_HANDSHAKES - 1).unwrap()).await.unwrap();
        let begun = Instant::now();
        assert_eq!(within(LIMIT * 50, &mine, std::future::pending::<()>()).await, None);
        assert!(begun.elapsed() < LIMIT * 50 * UNHURRIED_LIMITS);
    }
}
