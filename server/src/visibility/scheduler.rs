//! Whose newest pose is traced next: of the sessions that have one, the one that was served longest ago.

/// Turns of the sessions that share a back end. Pure: it knows neither clock nor device.
#[derive(Debug)]
pub struct Scheduler {
    sessions: Vec<Turn>,
    per_session: usize,
    turns: u64,
}

/// A session's name within the engine.
pub type SessionKey = u64;

#[derive(Debug)]
struct Turn {
    key: SessionKey,
    /// Number of the session's latest turn, or of the turn before it came.
    latest: u64,
    in_flight: usize,
}

impl Scheduler {
    /// A scheduler that lets each session have at most `per_session` frames in flight.
    #[must_use]
    pub fn new(per_session: usize) -> Self {
        Self { sessions: Vec::new(), per_session, turns: 0 }
    }

    /// A session has come. It stands behind those that wait already.
    pub fn insert(&mut self, key: SessionKey) {
        self.sessions.push(Turn { key, latest: self.turns, in_flight: 0 });
    }

    /// A session has gone.
    pub fn remove(&mut self, key: SessionKey) {
        self.sessions.retain(|turn| turn.key != key);
    }

    /// The session that goes next, among those that `is_ready` says have something to trace and can take it.
    pub fn next(&self, mut is_ready: impl FnMut(SessionKey) -> bool) -> Option<SessionKey> {
        let mut best: Option<&Turn> = None;
        for turn in &self.sessions {
            let earlier = best.is_none_or(|best| turn.latest < best.latest);
            if turn.in_flight < self.per_session && earlier && is_ready(turn.key) {
                best = Some(turn);
            }
        }
        best.map(|turn| turn.key)
    }

    /// A frame of the session is in flight now: its turn is used.
    pub fn started(&mut self, key: SessionKey) {
        self.turns += 1;
        if let Some(turn) = self.sessions.iter_mut().find(|turn| turn.key == key) {
            turn.latest = self.turns;
            turn.in_flight += 1;
        }
    }

    /// A frame of the session has landed; sessions that have gone meanwhile are ignored.
    pub fn finished(&mut self, key: SessionKey) {
        if let Some(turn) = self.sessions.iter_mut().find(|turn| turn.key == key) {
            turn.in_flight = turn.in_flight.saturating_sub(1);
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn scheduler(keys: &[SessionKey]) -> Scheduler {
        let mut scheduler = Scheduler::new(2);
        for &key in keys {
            scheduler.insert(key);
        }
        scheduler
    }

    #[test]
    fn busy_sessions_take_turns() {
        let mut scheduler = scheduler(&[1, 2, 3]);
        let mut order = Vec::new();
        for _ in 0..7 {
            let key = scheduler.next(|_| true).unwrap();
            order.push(key);
            scheduler.started(key);
            scheduler.finished(key);
        }
        assert_eq!(order, [1, 2, 3, 1, 2, 3, 1]);
    }

    #[test]
    fn a_session_that_was_idle_goes_first_but_saves_no_turns() {
        let mut scheduler = scheduler(&[1, 2]);
        for _ in 0..5 {
            assert_eq!(scheduler.next(|key| key == 1), Some(1));
            scheduler.started(1);
            scheduler.finished(1);
        }
        assert_eq!(scheduler.next(|_| true), Some(2));
        scheduler.started(2);
        assert_eq!(scheduler.next(|_| true), Some(1));
    }

    #[test]
    fn nobody_has_more_in_flight_than_allowed() {
        let mut scheduler = scheduler(&[1]);
        scheduler.started(1);
        scheduler.started(1);
        assert_eq!(scheduler.next(|_| true), None);
        scheduler.finished(1);
        assert_eq!(scheduler.next(|_| true), Some(1));
    }

    #[test]
    fn who_has_gone_is_never_chosen() {
        let mut scheduler = scheduler(&[1, 2]);
        scheduler.started(1);
        scheduler.remove(1);
        scheduler.finished(1);
        assert_eq!(scheduler.next(|_| true), Some(2));
        scheduler.remove(2);
        assert_eq!(scheduler.next(|_| true), None);
    }

    proptest! {
        /// Whoever is always ready waits for at most one turn of every other session.
        #[test]
        fn nobody_starves(ready in prop::collection::vec(prop::collection::vec(any::<bool>(), 6), 1..60)) {
            let mut scheduler = scheduler(&[0, 1, 2, 3, 4, 5, 6]);
            let mut waited = 0;
            for round in ready {
                // Session 6 is always ready, the others as they like.
                let key = scheduler.next(|key| key == 6 || round[usize::try_from(key).unwrap()]).unwrap();
                scheduler.started(key);
                scheduler.finished(key);
                waited = if key == 6 { 0 } else { waited + 1 };
                prop_assert!(waited <= 6);
            }
        }
    }
}
