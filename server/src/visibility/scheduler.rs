//! Whose newest pose is traced next: the one whose mask is due first, among those that have not had more than their share.
//!
//! A session's share is counted in virtual time: milliseconds of the device that it has used. Of the sessions that wait, those whose
//! virtual time is at most [`LEAD_MS`] ahead of the one that is farthest behind may go, in the order of their deadlines. So nobody who
//! waits falls behind another by more than the lead and one frame, and nobody saves up time while it does not wait (the idea of
//! start-time fair queueing, Goyal, Vin and Cheng 1996, with deadlines inside the window). A frame that has begun is not interrupted.

use std::{collections::VecDeque, time::Instant};

/// How far ahead of others who wait a session may be, in milliseconds of the device. More of it is more room for deadlines.
pub const LEAD_MS: f64 = 8.0;

/// A session whose frames take longer than this, in milliseconds, has only one of them in flight while there are other sessions: what
/// is in flight cannot be overtaken.
const LONG_FRAME_MS: f64 = 2.0;

/// How much the newest frame counts in what the next one is expected to cost.
const NEWEST_SHARE: f64 = 0.25;

/// Turns of the sessions that share a back end. Pure: it knows neither clock nor device.
#[derive(Debug)]
pub struct Scheduler {
    sessions: Vec<Turn>,
    per_session: usize,
    /// Virtual time of who was farthest behind when somebody was chosen last: never turns back.
    clock_ms: f64,
}

/// A session's name within the engine.
pub type SessionKey = u64;

#[derive(Debug)]
struct Turn {
    key: SessionKey,
    /// Virtual time.
    used_ms: f64,
    /// What its next frame is expected to cost.
    expected_ms: f64,
    /// What was charged for each of its frames in flight, oldest first.
    in_flight: VecDeque<f64>,
    /// Whether it waited, or had frames in flight, when it was looked at last.
    waited: bool,
}

impl Turn {
    fn may_start(&self, per_session: usize, alone: bool) -> bool {
        let most = if alone || self.expected_ms <= LONG_FRAME_MS { per_session } else { 1 };
        self.in_flight.len() < most
    }
}

impl Scheduler {
    /// A scheduler that lets each session have at most `per_session` frames in flight.
    #[must_use]
    pub fn new(per_session: usize) -> Self {
        Self { sessions: Vec::new(), per_session, clock_ms: 0.0 }
    }

    /// A session has come whose frames are expected to cost so much.
    pub fn insert(&mut self, key: SessionKey, expected_ms: f64) {
        let turn = Turn { key, used_ms: self.clock_ms, expected_ms, in_flight: VecDeque::new(), waited: false };
        self.sessions.push(turn);
    }

    /// A session has gone.
    pub fn remove(&mut self, key: SessionKey) {
        self.sessions.retain(|turn| turn.key != key);
    }

    /// The session that goes next, among those for which `due` gives the deadline of something to trace.
    pub fn next(&mut self, mut due: impl FnMut(SessionKey) -> Option<Instant>) -> Option<SessionKey> {
        let (alone, per_session) = (self.sessions.len() <= 1, self.per_session);
        let mut waiting: Vec<(usize, Instant)> = Vec::new();
        for (index, turn) in self.sessions.iter_mut().enumerate() {
            let deadline = due(turn.key);
            if deadline.is_some() && !turn.waited {
                // Time that it did not ask for is not owed to it.
                turn.used_ms = turn.used_ms.max(self.clock_ms);
            }
            turn.waited = deadline.is_some() || !turn.in_flight.is_empty();
            if let Some(deadline) = deadline.filter(|_| turn.may_start(per_session, alone)) {
                waiting.push((index, deadline));
            }
        }
        let used = |index: usize| self.sessions[index].used_ms;
        let behind = waiting.iter().map(|(index, _)| used(*index)).min_by(f64::total_cmp)?;
        let chosen = waiting
            .into_iter()
            .filter(|(index, _)| used(*index) <= behind + LEAD_MS)
            .min_by(|(a, due_a), (b, due_b)| due_a.cmp(due_b).then(used(*a).total_cmp(&used(*b))))?;
        self.clock_ms = self.clock_ms.max(behind);
        Some(self.sessions[chosen.0].key)
    }

    /// A frame of the session is in flight now, and is charged for as expected.
    pub fn started(&mut self, key: SessionKey) {
        if let Some(turn) = self.sessions.iter_mut().find(|turn| turn.key == key) {
            turn.used_ms += turn.expected_ms;
            turn.in_flight.push_back(turn.expected_ms);
        }
    }

    /// The session's oldest frame in flight has landed, and has cost so much; sessions that have gone meanwhile are ignored.
    pub fn finished(&mut self, key: SessionKey, cost_ms: f64) {
        if let Some(turn) = self.sessions.iter_mut().find(|turn| turn.key == key)
            && let Some(charged_ms) = turn.in_flight.pop_front()
        {
            turn.used_ms += cost_ms - charged_ms;
            turn.expected_ms += (cost_ms - turn.expected_ms) * NEWEST_SHARE;
        }
    }

    /// All frames in flight are lost; they cost their sessions nothing.
    pub fn lost_all(&mut self) {
        for turn in &mut self.sessions {
            turn.used_ms -= turn.in_flight.drain(..).sum::<f64>();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use proptest::prelude::*;

    use super::*;

    fn scheduler(keys: &[SessionKey]) -> Scheduler {
        let mut scheduler = Scheduler::new(2);
        for &key in keys {
            scheduler.insert(key, 1.0);
        }
        scheduler
    }

    fn run(scheduler: &mut Scheduler, key: SessionKey, cost_ms: f64) {
        scheduler.started(key);
        scheduler.finished(key, cost_ms);
    }

    fn used(scheduler: &Scheduler, key: SessionKey) -> f64 {
        scheduler.sessions.iter().find(|turn| turn.key == key).unwrap().used_ms
    }

    #[test]
    fn of_those_within_their_share_the_earliest_deadline_goes_first() {
        let start = Instant::now();
        let mut scheduler = scheduler(&[1, 2, 3]);
        let due =
            |key: SessionKey| Some(start + Duration::from_millis([50, 10, 30][usize::try_from(key).unwrap() - 1]));
        assert_eq!(scheduler.next(due), Some(2));
        run(&mut scheduler, 2, 5.0);
        assert_eq!(scheduler.next(due), Some(2), "it is within the lead");
        run(&mut scheduler, 2, 5.0);
        assert_eq!(scheduler.next(due), Some(3), "it is not any more");
        assert_eq!(scheduler.next(|key| due(key).filter(|_| key == 2)), Some(2), "unless nobody else waits");
    }

    #[test]
    fn time_that_was_not_asked_for_is_not_owed() {
        let now = Instant::now();
        let mut scheduler = scheduler(&[1, 2]);
        for _ in 0..100 {
            assert_eq!(scheduler.next(|key| (key == 1).then_some(now)), Some(1));
            run(&mut scheduler, 1, 10.0);
        }
        let mut turns = [0, 0];
        for _ in 0..40 {
            // Whoever is chosen gets the later deadline.
            let key = scheduler.next(|key| Some(now + Duration::from_millis(turns[usize::try_from(key).unwrap() - 1])));
            let key = key.unwrap();
            turns[usize::try_from(key).unwrap() - 1] += 1;
            run(&mut scheduler, key, 10.0);
        }
        assert!(turns.iter().all(|turns| (19..=21).contains(turns)), "{turns:?}");
    }

    #[test]
    fn long_frames_have_one_in_flight_beside_others_and_nobody_more_than_allowed() {
        let now = Instant::now();
        let mut alone = scheduler(&[1]);
        for expected in [Some(1), Some(1), None] {
            assert_eq!(alone.next(|_| Some(now)), expected);
            alone.started(1);
        }
        let mut shared = scheduler(&[1, 2]);
        for _ in 0..20 {
            run(&mut shared, 1, 50.0);
        }
        shared.started(1);
        assert_eq!(shared.next(|key| (key == 1).then_some(now)), None, "long");
        shared.started(2);
        assert_eq!(shared.next(|key| (key == 2).then_some(now)), Some(2), "short");
    }

    #[test]
    fn who_has_gone_is_never_chosen_and_lost_frames_are_not_paid_for() {
        let now = Instant::now();
        let mut scheduler = scheduler(&[1, 2]);
        scheduler.started(1);
        scheduler.started(2);
        scheduler.remove(1);
        scheduler.finished(1, 3.0);
        scheduler.lost_all();
        assert_eq!(used(&scheduler, 2), 0.0);
        assert_eq!(scheduler.next(|_| Some(now)), Some(2));
        scheduler.remove(2);
        assert_eq!(scheduler.next(|_| Some(now)), None);
    }

    proptest! {
        /// However costs and deadlines are, sessions that always wait have used the same, up to the lead and one frame; each frame
        /// costs what was expected here, so that nothing is corrected afterwards.
        #[test]
        fn whoever_waits_gets_its_share(
            costs_ms in prop::collection::vec(0.05_f64..40.0, 2..8),
            deadlines_ms in prop::collection::vec(0_u64..200, 400),
        ) {
            let start = Instant::now();
            let mut scheduler = Scheduler::new(2);
            for (key, cost) in (0..).zip(&costs_ms) {
                scheduler.insert(key, *cost);
            }
            let most = costs_ms.iter().copied().fold(0.0, f64::max);
            for (turn, deadline) in deadlines_ms.iter().enumerate() {
                let due = |key: SessionKey| Some(start + Duration::from_millis((deadline * (key + 1) * 37) % 200));
                let key = scheduler.next(due).unwrap();
                run(&mut scheduler, key, costs_ms[usize::try_from(key).unwrap()]);
                let all: Vec<f64> = (0..).zip(&costs_ms).map(|(key, _)| used(&scheduler, key)).collect();
                let (low, high) = (all.iter().copied().fold(f64::MAX, f64::min), all.iter().copied().fold(0.0, f64::max));
                prop_assert!(high - low <= LEAD_MS + most + 1e-6, "turn {turn}: {all:?}");
            }
        }

        /// Whoever waits goes before the others have used the lead and a frame each, even when its deadline is the last of all.
        #[test]
        fn nobody_starves(
            costs_ms in prop::collection::vec(0.05_f64..40.0, 6),
            ready in prop::collection::vec(prop::collection::vec(any::<bool>(), 6), 1..300),
        ) {
            let start = Instant::now();
            let mut scheduler = Scheduler::new(2);
            for (key, cost) in (0..).zip(&costs_ms) {
                scheduler.insert(key, *cost);
            }
            scheduler.insert(6, 1.0);
            let (mut waited_ms, bound_ms) = (0.0, costs_ms.iter().map(|cost| LEAD_MS + 1.0 + cost).sum::<f64>());
            for round in ready {
                let due = |key: SessionKey| match round.get(usize::try_from(key).unwrap()) {
                    Some(ready) => ready.then_some(start),
                    None => Some(start + Duration::from_secs(9)),
                };
                let key = scheduler.next(due).unwrap();
                let cost = costs_ms.get(usize::try_from(key).unwrap()).copied().unwrap_or(1.0);
                run(&mut scheduler, key, cost);
                waited_ms = if key == 6 { 0.0 } else { waited_ms + cost };
                prop_assert!(waited_ms <= bound_ms + 1e-6, "{waited_ms} ms of others, {bound_ms} are the bound");
            }
        }
    }
}
