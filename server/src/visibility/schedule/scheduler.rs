//! Whose work is done next: of the sessions that have not had more than their share the one whose mask is due first.
//!
//! A session's share is counted in virtual time: milliseconds of the device that it has used. Of the sessions that wait, those whose
//! virtual time is at most [`LEAD_MS`] ahead of the one that is farthest behind may go, in the order of their deadlines. Nobody who waits
//! falls behind another by more than the lead and one piece of work (the idea of start-time fair queueing, Goyal, Vin and Cheng 1996,
//! with deadlines inside the window).
//!
//! Time that a session does not ask for is lost to it, but for [`SAVED_MS`]. That is more than the lead: so whoever asks for less than its
//! share goes before those who take all that they can get, whatever their deadlines are.
//!
//! Work is a frame, or a part of a long one (`parts.rs`): what has begun is interrupted between two parts only.

use std::{collections::VecDeque, time::Instant};

/// How far ahead of others who wait a session may be, in milliseconds of the device. More of it is more room for deadlines.
pub const LEAD_MS: f64 = 4.0;

/// How far behind others a session is that comes back after it did not ask for its share, in milliseconds of the device.
pub const SAVED_MS: f64 = 8.0;

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

/// What a session waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Wish {
    /// When its mask is due.
    pub due: Instant,
    /// Whether it is for the rest of a frame that has begun.
    pub rest: bool,
    /// Whether the device has room for it now.
    pub fits: bool,
}

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

    /// The session that goes next, among those for which `wish` gives something to trace that fits.
    pub fn next(&mut self, mut wish: impl FnMut(SessionKey) -> Option<Wish>) -> Option<SessionKey> {
        let (per_session, clock_ms) = (self.per_session, self.clock_ms);
        let mut waiting: Vec<(usize, Instant)> = Vec::new();
        for (index, turn) in self.sessions.iter_mut().enumerate() {
            let wish = wish(turn.key);
            if wish.is_none() || !turn.waited {
                // Time that it did not ask for is not owed to it.
                turn.used_ms = turn.used_ms.max(clock_ms - SAVED_MS);
            }
            turn.waited = wish.is_some() || !turn.in_flight.is_empty();
            if let Some(wish) = wish.filter(|wish| wish.fits && (wish.rest || turn.in_flight.len() < per_session)) {
                waiting.push((index, wish.due));
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

    /// A frame of the session has begun.
    pub fn started(&mut self, key: SessionKey) {
        if let Some(turn) = self.turn(key) {
            turn.in_flight.push_back(0.0);
        }
    }

    /// This share of the session's newest frame is on the device now, and is charged for as expected.
    pub fn charge(&mut self, key: SessionKey, share: f64) {
        if let Some(turn) = self.turn(key)
            && let Some(charged_ms) = turn.in_flight.back_mut()
        {
            *charged_ms += turn.expected_ms * share;
            turn.used_ms += turn.expected_ms * share;
        }
    }

    /// The session's oldest frame in flight has landed, and has cost so much; sessions that have gone meanwhile are ignored.
    pub fn finished(&mut self, key: SessionKey, cost_ms: f64) {
        if let Some(turn) = self.turn(key)
            && let Some(charged_ms) = turn.in_flight.pop_front()
        {
            turn.used_ms += cost_ms - charged_ms;
            turn.expected_ms += (cost_ms - turn.expected_ms) * NEWEST_SHARE;
        }
    }

    /// The session's newest frame is not traced to its end, and costs it nothing.
    pub fn abandoned(&mut self, key: SessionKey) {
        if let Some(turn) = self.turn(key) {
            turn.used_ms -= turn.in_flight.pop_back().unwrap_or_default();
        }
    }

    /// All frames in flight are lost; they cost their sessions nothing.
    pub fn lost_all(&mut self) {
        for turn in &mut self.sessions {
            turn.used_ms -= turn.in_flight.drain(..).sum::<f64>();
        }
    }

    fn turn(&mut self, key: SessionKey) -> Option<&mut Turn> {
        self.sessions.iter_mut().find(|turn| turn.key == key)
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

    fn start(scheduler: &mut Scheduler, key: SessionKey) {
        scheduler.started(key);
        scheduler.charge(key, 1.0);
    }

    fn run(scheduler: &mut Scheduler, key: SessionKey, cost_ms: f64) {
        start(scheduler, key);
        scheduler.finished(key, cost_ms);
    }

    /// A frame that is due then, and fits.
    fn frame(due: Instant) -> Wish {
        Wish { due, rest: false, fits: true }
    }

    fn used(scheduler: &Scheduler, key: SessionKey) -> f64 {
        scheduler.sessions.iter().find(|turn| turn.key == key).unwrap().used_ms
    }

    #[test]
    fn of_those_within_their_share_the_earliest_deadline_goes_first() {
        let start = Instant::now();
        let mut scheduler = scheduler(&[1, 2, 3]);
        let due = |key: SessionKey| {
            Some(frame(start + Duration::from_millis([50, 10, 30][usize::try_from(key).unwrap() - 1])))
        };
        assert_eq!(scheduler.next(due), Some(2));
        run(&mut scheduler, 2, 3.0);
        assert_eq!(scheduler.next(due), Some(2), "it is within the lead");
        run(&mut scheduler, 2, 3.0);
        assert_eq!(scheduler.next(due), Some(3), "it is not any more");
        assert_eq!(scheduler.next(|key| due(key).filter(|_| key == 2)), Some(2), "unless nobody else waits");
    }

    #[test]
    fn time_that_was_not_asked_for_is_not_owed() {
        let now = Instant::now();
        let mut scheduler = scheduler(&[1, 2]);
        for _ in 0..100 {
            assert_eq!(scheduler.next(|key| (key == 1).then_some(frame(now))), Some(1));
            run(&mut scheduler, 1, 10.0);
        }
        let mut turns = [0, 0];
        for _ in 0..40 {
            // Whoever is chosen gets the later deadline.
            let later = |key: SessionKey| now + Duration::from_millis(turns[usize::try_from(key).unwrap() - 1]);
            let key = scheduler.next(|key| Some(frame(later(key)))).unwrap();
            turns[usize::try_from(key).unwrap() - 1] += 1;
            run(&mut scheduler, key, 10.0);
        }
        assert!(turns.iter().all(|turns| (19..=21).contains(turns)), "{turns:?}");
    }

    #[test]
    fn nobody_has_more_in_flight_than_allowed_and_what_has_begun_goes_on() {
        let now = Instant::now();
        let mut scheduler = scheduler(&[1, 2]);
        for expected in [Some(1), Some(1), None] {
            assert_eq!(scheduler.next(|key| (key == 1).then_some(frame(now))), expected);
            start(&mut scheduler, 1);
        }
        let rest = Wish { rest: true, ..frame(now) };
        assert_eq!(scheduler.next(|key| (key == 1).then_some(rest)), Some(1));
        assert_eq!(scheduler.next(|key| (key == 1).then_some(Wish { fits: false, ..rest })), None, "there is no room");
    }

    #[test]
    fn whoever_asks_for_less_than_its_share_goes_first_whatever_is_due() {
        let now = Instant::now();
        let mut scheduler = scheduler(&[1, 2]);
        for round in 0..500 {
            // The greedy one is always late; the modest one comes every 33 parts and has time.
            let modest = (round > 60 && round % 33 == 0).then_some(frame(now + Duration::from_secs(1)));
            let greedy = Wish { rest: true, ..frame(now) };
            let key = scheduler.next(|key| if key == 1 { Some(greedy) } else { modest }).unwrap();
            assert_eq!(key, if modest.is_some() { 2 } else { 1 }, "round {round}");
            run(&mut scheduler, key, 0.15);
        }
    }

    #[test]
    fn a_frame_is_paid_for_part_by_part_and_in_the_end_as_it_was() {
        let mut scheduler = scheduler(&[1]);
        scheduler.started(1);
        scheduler.charge(1, 0.25);
        scheduler.charge(1, 0.25);
        assert_eq!(used(&scheduler, 1), 0.5);
        scheduler.started(1);
        scheduler.charge(1, 0.5);
        scheduler.abandoned(1);
        assert_eq!(used(&scheduler, 1), 0.5);
        scheduler.finished(1, 3.0);
        assert_eq!(used(&scheduler, 1), 3.0);
    }

    #[test]
    fn who_has_gone_is_never_chosen_and_lost_frames_are_not_paid_for() {
        let now = Instant::now();
        let mut scheduler = scheduler(&[1, 2]);
        start(&mut scheduler, 1);
        start(&mut scheduler, 2);
        scheduler.remove(1);
        scheduler.finished(1, 3.0);
        scheduler.lost_all();
        assert_eq!(used(&scheduler, 2), 0.0);
        assert_eq!(scheduler.next(|_| Some(frame(now))), Some(2));
        scheduler.remove(2);
        assert_eq!(scheduler.next(|_| Some(frame(now))), None);
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
                let due = |key: SessionKey| Some(frame(start + Duration::from_millis((deadline * (key + 1) * 37) % 200)));
                let key = scheduler.next(due).unwrap();
                run(&mut scheduler, key, costs_ms[usize::try_from(key).unwrap()]);
                let all: Vec<f64> = (0..).zip(&costs_ms).map(|(key, _)| used(&scheduler, key)).collect();
                let (low, high) = (all.iter().copied().fold(f64::MAX, f64::min), all.iter().copied().fold(0.0, f64::max));
                prop_assert!(high - low <= LEAD_MS + most + 1e-6, "turn {turn}: {all:?}");
            }
        }

        /// Whoever waits goes before the others have used what they may have saved, the lead and a frame each, even when its deadline is
        /// the last of all.
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
            let (mut waited_ms, bound_ms) = (0.0, costs_ms.iter().map(|cost| SAVED_MS + LEAD_MS + 1.0 + cost).sum::<f64>());
            for round in ready {
                let due = |key: SessionKey| match round.get(usize::try_from(key).unwrap()) {
                    Some(ready) => ready.then_some(frame(start)),
                    None => Some(frame(start + Duration::from_secs(9))),
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
