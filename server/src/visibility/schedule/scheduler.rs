//! Chooses the session that works next: the one whose mask is due first, among those within their share.
//!
//! A session's share is counted in virtual time: milliseconds of device time that it has used. Of the waiting sessions,
//! those whose virtual time is at most [`LEAD_MS`] ahead of the least go in the order of their deadlines. So no waiting
//! session falls behind another by more than the lead and one piece of work: start-time fair queueing (Goyal, Vin and
//! Cheng 1996) with deadlines inside the window.
//!
//! A session loses its unused time, except for [`SAVED_MS`]. That is more than the lead, so a session that uses less
//! than its share goes before greedy ones, whatever their deadlines are.
//!
//! Background work is chosen only when no other work fits, so it takes the time that the rest leaves. It saves no time
//! for later. Deadlines and shares are kept among background sessions, too.
//!
//! Work is a frame, or a part of a long one (`parts.rs`). A frame is interrupted only between parts.

use std::{collections::VecDeque, time::Instant};

/// Most that a session may be ahead of waiting ones, in milliseconds of device time. More gives deadlines more weight.
pub const LEAD_MS: f64 = 4.0;

/// How far behind the others a session restarts after using less than its share, in milliseconds of device time.
pub const SAVED_MS: f64 = 8.0;

/// Weight of the newest frame in the expected cost of the next.
const NEWEST_SHARE: f64 = 0.25;

/// Turns of the sessions that share a back end. Pure: without clock or device.
#[derive(Debug)]
pub struct Scheduler {
    sessions: Vec<Turn>,
    per_session: usize,
    /// Least virtual time among the waiting sessions at the last choice. Never decreases.
    clock_ms: f64,
}

/// Identifies a session within its engine.
pub type SessionKey = u64;

/// The piece of work that a session waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Demand {
    /// When the mask is due.
    pub due: Instant,
    /// True if it continues a frame that has begun.
    pub resumes: bool,
    /// True if the device has room for it now.
    pub fits: bool,
    /// True if it may take only time that other sessions leave.
    pub background: bool,
}

#[derive(Debug)]
struct Turn {
    key: SessionKey,
    used_ms: f64,
    /// Expected cost of its next frame, in milliseconds.
    expected_ms: f64,
    /// Charge for each of its frames in flight, oldest first.
    in_flight: VecDeque<f64>,
    /// True if it waited or had frames in flight at the last choice.
    waited: bool,
}

impl Scheduler {
    /// Allows each session at most `per_session` frames in flight.
    #[must_use]
    pub fn new(per_session: usize) -> Self {
        Self { sessions: Vec::new(), per_session, clock_ms: 0.0 }
    }

    /// Adds a session whose frames are expected to cost `expected_ms`.
    pub fn insert(&mut self, key: SessionKey, expected_ms: f64) {
        let turn = Turn { key, used_ms: self.clock_ms, expected_ms, in_flight: VecDeque::new(), waited: false };
        self.sessions.push(turn);
    }

    pub fn remove(&mut self, key: SessionKey) {
        self.sessions.retain(|turn| turn.key != key);
    }

    /// Returns the session to go next, among those whose `demand` fits.
    pub fn next(&mut self, mut demand: impl FnMut(SessionKey) -> Option<Demand>) -> Option<SessionKey> {
        let (per_session, clock_ms) = (self.per_session, self.clock_ms);
        let mut waiting: Vec<(usize, Instant)> = Vec::new();
        let mut in_background = true;
        for (index, turn) in self.sessions.iter_mut().enumerate() {
            let demand = demand(turn.key);
            if demand.is_none_or(|demand| demand.background) || !turn.waited {
                // Unused time is lost.
                turn.used_ms = turn.used_ms.max(clock_ms - SAVED_MS);
            }
            turn.waited = demand.is_some() || !turn.in_flight.is_empty();
            if let Some(demand) =
                demand.filter(|demand| demand.fits && (demand.resumes || turn.in_flight.len() < per_session))
            {
                if in_background && !demand.background {
                    waiting.clear();
                    in_background = false;
                }
                if demand.background == in_background {
                    waiting.push((index, demand.due));
                }
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

    /// Records that a frame of the session has begun.
    pub fn started(&mut self, key: SessionKey) {
        if let Some(turn) = self.turn(key) {
            turn.in_flight.push_back(0.0);
        }
    }

    /// Charges this share of the expected cost of the session's newest frame, which the device now works on.
    pub fn charge(&mut self, key: SessionKey, share: f64) {
        if let Some(turn) = self.turn(key)
            && let Some(charged_ms) = turn.in_flight.back_mut()
        {
            *charged_ms += turn.expected_ms * share;
            turn.used_ms += turn.expected_ms * share;
        }
    }

    /// Replaces the charge for the session's oldest frame in flight by its measured cost. Ignores removed sessions.
    pub fn finished(&mut self, key: SessionKey, cost_ms: f64) {
        if let Some(turn) = self.turn(key)
            && let Some(charged_ms) = turn.in_flight.pop_front()
        {
            turn.used_ms += cost_ms - charged_ms;
            turn.expected_ms += (cost_ms - turn.expected_ms) * NEWEST_SHARE;
        }
    }

    /// Reverts the charge for the session's newest frame, which is dropped.
    pub fn abandoned(&mut self, key: SessionKey) {
        if let Some(turn) = self.turn(key) {
            turn.used_ms -= turn.in_flight.pop_back().unwrap_or_default();
        }
    }

    /// Reverts the charges for all frames in flight, which are lost.
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

    /// A frame that is due at `due` and fits.
    fn frame(due: Instant) -> Demand {
        Demand { due, resumes: false, fits: true, background: false }
    }

    fn used(scheduler: &Scheduler, key: SessionKey) -> f64 {
        scheduler.sessions.iter().find(|turn| turn.key == key).unwrap().used_ms
    }

    #[test]
    fn the_earliest_deadline_within_the_lead_goes_first() {
        let start = Instant::now();
        let mut scheduler = scheduler(&[1, 2, 3]);
        let due = |key: SessionKey| {
            Some(frame(start + Duration::from_millis([50, 10, 30][usize::try_from(key).unwrap() - 1])))
        };
        assert_eq!(scheduler.next(due), Some(2));
        run(&mut scheduler, 2, 3.0);
        assert_eq!(scheduler.next(due), Some(2), "within the lead");
        run(&mut scheduler, 2, 3.0);
        assert_eq!(scheduler.next(due), Some(3), "beyond the lead");
        assert_eq!(scheduler.next(|key| due(key).filter(|_| key == 2)), Some(2), "no other session waits");
    }

    #[test]
    fn unused_time_is_lost() {
        let now = Instant::now();
        let mut scheduler = scheduler(&[1, 2]);
        for _ in 0..100 {
            assert_eq!(scheduler.next(|key| (key == 1).then_some(frame(now))), Some(1));
            run(&mut scheduler, 1, 10.0);
        }
        let mut turns = [0, 0];
        for _ in 0..40 {
            // The chosen session gets a later deadline.
            let later = |key: SessionKey| now + Duration::from_millis(turns[usize::try_from(key).unwrap() - 1]);
            let key = scheduler.next(|key| Some(frame(later(key)))).unwrap();
            turns[usize::try_from(key).unwrap() - 1] += 1;
            run(&mut scheduler, key, 10.0);
        }
        assert!(turns.iter().all(|turns| (19..=21).contains(turns)), "{turns:?}");
    }

    #[test]
    fn frames_in_flight_are_bounded_and_begun_frames_continue() {
        let now = Instant::now();
        let mut scheduler = scheduler(&[1, 2]);
        for expected in [Some(1), Some(1), None] {
            assert_eq!(scheduler.next(|key| (key == 1).then_some(frame(now))), expected);
            start(&mut scheduler, 1);
        }
        let rest = Demand { resumes: true, ..frame(now) };
        assert_eq!(scheduler.next(|key| (key == 1).then_some(rest)), Some(1));
        assert_eq!(
            scheduler.next(|key| (key == 1).then_some(Demand { fits: false, ..rest })),
            None,
            "there is no room"
        );
    }

    #[test]
    fn sessions_below_their_share_go_before_greedy_ones() {
        let now = Instant::now();
        let mut scheduler = scheduler(&[1, 2]);
        for round in 0..500 {
            // The greedy one is always late. The modest one comes every 33 parts and has time.
            let modest = (round > 60 && round % 33 == 0).then_some(frame(now + Duration::from_secs(1)));
            let greedy = Demand { resumes: true, ..frame(now) };
            let key = scheduler.next(|key| if key == 1 { Some(greedy) } else { modest }).unwrap();
            assert_eq!(key, if modest.is_some() { 2 } else { 1 }, "round {round}");
            run(&mut scheduler, key, 0.15);
        }
    }

    #[test]
    fn charges_for_parts_are_replaced_by_the_measured_cost() {
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
    fn removed_sessions_are_never_chosen_and_lost_frames_cost_nothing() {
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

    #[test]
    fn background_work_takes_what_is_left_and_saves_nothing() {
        let now = Instant::now();
        let mut scheduler = scheduler(&[1, 2, 3]);
        let background = Demand { background: true, ..frame(now) };
        let late = frame(now + Duration::from_secs(1));
        for _ in 0..100 {
            assert_eq!(scheduler.next(|key| Some(if key == 1 { late } else { background })), Some(1));
            run(&mut scheduler, 1, 10.0);
        }
        // The other cannot go now.
        let full = Demand { fits: false, ..late };
        let mut turns = [0, 0];
        for _ in 0..40 {
            let key = scheduler.next(|key| Some(if key == 1 { full } else { background })).unwrap();
            turns[usize::try_from(key).unwrap() - 2] += 1;
            run(&mut scheduler, key, 10.0);
        }
        assert_eq!(turns, [20, 20]);
        // What it had to wait gives it no right to more than its turn later.
        run(&mut scheduler, 1, 1000.0);
        for _ in 0..2 {
            assert_eq!(scheduler.next(|key| Some(if key == 1 { late } else { background })), Some(1));
        }
        assert!(used(&scheduler, 2) >= scheduler.clock_ms - SAVED_MS);
    }

    proptest! {
        /// Whatever has happened before, no background work goes before other work that fits.
        #[test]
        fn background_work_never_goes_first(
            steps in prop::collection::vec((prop::collection::vec((0_u8..4, any::<bool>()), 5), 0.05_f64..40.0), 100),
        ) {
            let now = Instant::now();
            let mut scheduler = scheduler(&[0, 1, 2, 3, 4]);
            for (sessions, cost_ms) in steps {
                let demand = |key: SessionKey| {
                    let (kind, fits) = sessions[usize::try_from(key).unwrap()];
                    (kind < 3).then_some(Demand { fits, background: kind == 0, ..frame(now) })
                };
                let chosen = scheduler.next(demand);
                let fitting: Vec<Demand> = (0..5).filter_map(demand).filter(|demand| demand.fits).collect();
                prop_assert_eq!(chosen.is_some(), !fitting.is_empty());
                if let Some(key) = chosen {
                    prop_assert!(!demand(key).unwrap().background || fitting.iter().all(|other| other.background));
                    run(&mut scheduler, key, cost_ms);
                }
            }
        }

        /// Whatever the costs and deadlines are, sessions that always wait have used the same time, up to the lead and
        /// one frame. Each frame costs what was expected, so no charge is corrected.
        #[test]
        fn waiting_sessions_get_equal_shares(
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
                let due_ms = |key: SessionKey| (deadline * (key + 1) * 37) % 200;
                let due = |key: SessionKey| Some(frame(start + Duration::from_millis(due_ms(key))));
                let key = scheduler.next(due).unwrap();
                run(&mut scheduler, key, costs_ms[usize::try_from(key).unwrap()]);
                let all: Vec<f64> = (0..).zip(&costs_ms).map(|(key, _)| used(&scheduler, key)).collect();
                let low = all.iter().copied().fold(f64::MAX, f64::min);
                let high = all.iter().copied().fold(0.0, f64::max);
                prop_assert!(high - low <= LEAD_MS + most + 1e-6, "turn {turn}: {all:?}");
            }
        }

        /// While a session waits, each other one uses at most its saved time, the lead and a frame, even if due first.
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
            let bound_ms: f64 = costs_ms.iter().map(|cost| SAVED_MS + LEAD_MS + 1.0 + cost).sum();
            let mut waited_ms = 0.0;
            for round in ready {
                let due = |key: SessionKey| match round.get(usize::try_from(key).unwrap()) {
                    Some(ready) => ready.then_some(frame(start)),
                    None => Some(frame(start + Duration::from_secs(9))),
                };
                let key = scheduler.next(due).unwrap();
                let cost = costs_ms.get(usize::try_from(key).unwrap()).copied().unwrap_or(1.0);
                run(&mut scheduler, key, cost);
                waited_ms = if key == 6 { 0.0 } else { waited_ms + cost };
                prop_assert!(waited_ms <= bound_ms + 1e-6, "others used {waited_ms} ms, at most {bound_ms} allowed");
            }
        }
    }
}
