//! Congestion control: limits the bytes in flight by delay, and ignores a little loss.
//!
//! Quinn's own controllers take every loss for congestion; at 1 % of random loss they deliver 8 % of a stream of
//! frames. Here, frames lose value with age and lost packets are never sent again, so what counts is the queue in the
//! path. The rules, applied to the feedback of quinn's `congestion::Controller`:
//!
//! 1. *Base.* The path's own round trip is the smallest one seen in the last 5 to 10 s (two periods of 5 s, the older
//!    one forgotten), so that a longer route is learnt within 10 s.
//! 2. *Delay.* Queueing delay is the *standing* round trip above the base, and standing is the smallest one of the last
//!    20 to 40 ms, or of half to one base round trip if that is longer. The smallest, because jitter, late
//!    acknowledgements and a frame's own burst pass in that time, and an overlong queue does not. Above
//!    [`TARGET_DELAY`] (12 ms) the window shrinks to 0.85 of itself, at most once a round trip.
//! 3. *Loss.* Loss is judged in rounds of at least 200 datagrams and one round trip. A round that lost more than
//!    [`MAX_LOSS_PERCENT`] (10 %) shrinks the window to 0.85; less loss changes nothing.
//! 4. *Marks.* A congestion mark (ECN, reported as a loss of 0 bytes) counts as too much delay.
//! 5. *Growth.* While the sender could use more than the window, and the delay is below the target, acknowledged bytes
//!    open the window: by half of them until it first shrinks or the delay passes half the target, after that by up to
//!    8 datagrams a round trip, fewer the nearer the delay is to the target.
//! 6. *Drain.* A full window keeps a standing queue below the target, which rule 1 would in time take for the path
//!    itself. So after a period in which no round trip came within 3 ms of the base, the window is three quarters of
//!    what fills the path without a queue (window × base / standing), for two round trips and at least 50 ms; then it
//!    returns to its former size.
//! 7. *Outage.* When all packets were lost for longer than quinn's persistent-congestion period, the window falls to
//!    the floor and grows as at the start.
//!
//! The caller sets the initial window (quinn paces by window over round trip). It stays between [`FLOOR_DATAGRAMS`]
//! datagrams and [`MAX_WINDOW_BYTES`]. Not known: how it shares a path with other kinds of traffic. A queue that
//! overflows below 12 ms is only noticed when it loses more than 10 %.
//!
//! In quinn's adapter: `on_ack` passes `now − sent` as the round trip, not `RttEstimator::get`, which is smoothed and
//! so hides the smallest ones; `on_congestion_event` is [`DelayController::on_loss`], `on_mtu_update`
//! [`DelayController::on_datagram_bytes`].

use std::time::Duration;

use web_time::Instant;

/// Queueing delay above which the window shrinks.
pub const TARGET_DELAY: Duration = Duration::from_millis(12);

/// Share of lost bytes above which the window shrinks, in per cent.
pub const MAX_LOSS_PERCENT: u64 = 10;

/// Smallest window, in datagrams.
pub const FLOOR_DATAGRAMS: u64 = 10;

/// Largest window: 2.5 Gbit/s at 200 ms.
pub const MAX_WINDOW_BYTES: u64 = 64 << 20;

const BASE_PERIOD: Duration = Duration::from_secs(5);
const NEAR_BASE: Duration = Duration::from_millis(3);
/// More than a frame takes at 60 Hz.
const MIN_STANDING: Duration = Duration::from_millis(20);
const MIN_DRAIN: Duration = Duration::from_millis(50);
const LOSS_ROUND_DATAGRAMS: u64 = 200;
const GROWTH_DATAGRAMS: u64 = 8;

/// The controller: a state machine without clock or socket. `now` must not go back.
#[derive(Debug, Clone)]
pub struct DelayController {
    initial_window_bytes: u64,
    window_bytes: u64,
    datagram_bytes: u64,
    /// True until the window first shrinks.
    starting: bool,
    base: Lowest,
    standing: Lowest,
    shrunk_at: Option<Instant>,
    drain: Option<Drain>,
    round: LossRound,
    /// Growth of less than a byte, in bytes × window bytes.
    growth_credit: u64,
}

/// A period with a smaller window, in which the queue drains.
#[derive(Debug, Clone, Copy)]
struct Drain {
    until: Instant,
    window_bytes: u64,
}

/// The smallest round trip of the current period and of the one before.
#[derive(Debug, Clone, Copy, Default)]
struct Lowest {
    period_start: Option<Instant>,
    this: Option<Duration>,
    last: Option<Duration>,
}

/// Bytes acknowledged and lost since the round began.
#[derive(Debug, Clone, Copy, Default)]
struct LossRound {
    start: Option<Instant>,
    acked_bytes: u64,
    lost_bytes: u64,
}

impl DelayController {
    /// Returns a controller with this initial window, for datagrams of about `datagram_bytes`.
    #[must_use]
    pub fn new(initial_window_bytes: u64, datagram_bytes: u16) -> Self {
        let datagram_bytes = u64::from(datagram_bytes.max(1));
        let window_bytes = initial_window_bytes.clamp(FLOOR_DATAGRAMS * datagram_bytes, MAX_WINDOW_BYTES);
        Self {
            initial_window_bytes: window_bytes,
            window_bytes,
            datagram_bytes,
            starting: true,
            base: Lowest::default(),
            standing: Lowest::default(),
            shrunk_at: None,
            drain: None,
            round: LossRound::default(),
            growth_credit: 0,
        }
    }

    /// Returns the bytes that may be in flight now.
    #[must_use]
    pub fn window_bytes(&self) -> u64 {
        self.drain.map_or(self.window_bytes, |drain| drain.window_bytes.min(self.window_bytes))
    }

    #[must_use]
    pub const fn initial_window_bytes(&self) -> u64 {
        self.initial_window_bytes
    }

    /// Returns the queueing delay: the standing round trip above the base.
    #[must_use]
    pub fn queueing_delay(&self) -> Duration {
        self.base.min().map_or(Duration::ZERO, |base| self.round_trip().saturating_sub(base))
    }

    /// Records `bytes` acknowledged. `app_limited`: the sender had nothing more to send. `rtt` is the unsmoothed time
    /// since these bytes were sent.
    pub fn on_ack(&mut self, now: Instant, bytes: u64, app_limited: bool, rtt: Duration) {
        let base_before = self.base.last;
        let ended = self.base.sample(now, rtt, BASE_PERIOD);
        let base = self.base.min().unwrap_or(rtt);
        self.standing.sample(now, rtt, MIN_STANDING.max(base / 2));
        self.drain = self.drain.filter(|drain| now < drain.until);
        if let (Some(ended), Some(before)) = (ended, base_before)
            && ended > before + NEAR_BASE
        {
            self.drain = Some(self.drain_to(now, before));
        }
        self.round.acked_bytes += bytes;
        self.judge_loss(now);
        let delay = self.queueing_delay();
        if delay > TARGET_DELAY {
            self.shrink(now);
        } else if !app_limited && self.drain.is_none() {
            self.grow(bytes, delay);
        }
    }

    fn drain_to(&self, now: Instant, base: Duration) -> Drain {
        let round_trip = self.round_trip();
        let (base_us, standing_us) = (micros(base), micros(round_trip).max(1));
        let window_bytes = (self.window_bytes.saturating_mul(base_us) / standing_us * 3 / 4).max(self.floor());
        Drain { until: now + MIN_DRAIN.max(round_trip * 2), window_bytes }
    }

    fn round_trip(&self) -> Duration {
        self.standing.min().unwrap_or(Duration::ZERO)
    }

    /// Records `lost_bytes` lost; 0 means a congestion mark. `persistent`: everything was lost for a long time.
    pub fn on_loss(&mut self, now: Instant, lost_bytes: u64, persistent: bool) {
        if persistent {
            self.window_bytes = self.floor();
            self.starting = true;
            self.round = LossRound::default();
            self.drain = None;
        } else if lost_bytes == 0 {
            self.shrink(now);
        } else {
            self.round.lost_bytes += lost_bytes;
            self.judge_loss(now);
        }
    }

    /// Sets the size of the path's datagrams.
    pub fn on_datagram_bytes(&mut self, datagram_bytes: u16) {
        self.datagram_bytes = u64::from(datagram_bytes.max(1));
        self.window_bytes = self.window_bytes.clamp(self.floor(), MAX_WINDOW_BYTES);
    }

    fn floor(&self) -> u64 {
        FLOOR_DATAGRAMS * self.datagram_bytes
    }

    fn judge_loss(&mut self, now: Instant) {
        let round_trip = self.round_trip();
        let round = &mut self.round;
        let start = *round.start.get_or_insert(now);
        let total = round.acked_bytes + round.lost_bytes;
        if total < LOSS_ROUND_DATAGRAMS * self.datagram_bytes || now.duration_since(start) < round_trip {
            return;
        }
        let too_much = round.lost_bytes.saturating_mul(100) > total.saturating_mul(MAX_LOSS_PERCENT);
        *round = LossRound { start: Some(now), ..LossRound::default() };
        if too_much {
            self.shrink(now);
        }
    }

    fn shrink(&mut self, now: Instant) {
        self.starting = false;
        if self.shrunk_at.is_some_and(|at| now.duration_since(at) < self.round_trip()) {
            return;
        }
        self.shrunk_at = Some(now);
        self.window_bytes = (self.window_bytes / 20 * 17).max(self.floor());
    }

    fn grow(&mut self, acked_bytes: u64, delay: Duration) {
        if delay > TARGET_DELAY / 2 {
            self.starting = false;
        }
        let growth = if self.starting {
            acked_bytes / 2
        } else {
            let target_us = micros(TARGET_DELAY);
            let headroom_us = target_us.saturating_sub(micros(delay));
            let per_round_trip = GROWTH_DATAGRAMS * self.datagram_bytes * headroom_us / target_us;
            self.growth_credit = self.growth_credit.saturating_add(per_round_trip.saturating_mul(acked_bytes));
            let whole = self.growth_credit / self.window_bytes;
            self.growth_credit %= self.window_bytes;
            whole
        };
        self.window_bytes = self.window_bytes.saturating_add(growth).min(MAX_WINDOW_BYTES);
    }
}

fn micros(duration: Duration) -> u64 {
    u64::try_from(duration.as_micros()).unwrap_or(u64::MAX)
}

impl Lowest {
    fn min(&self) -> Option<Duration> {
        self.this.into_iter().chain(self.last).min()
    }

    /// Takes a sample. If it ends a period, returns that period's lowest.
    fn sample(&mut self, now: Instant, rtt: Duration, period: Duration) -> Option<Duration> {
        let start = *self.period_start.get_or_insert(now);
        let mut ended = None;
        if now.duration_since(start) >= period {
            ended = self.this;
            (self.period_start, self.last, self.this) = (Some(now), self.this, None);
        }
        self.this = Some(self.this.map_or(rtt, |least| least.min(rtt)));
        ended
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WINDOW: u64 = 400_000;
    const BASE_MS: u64 = 40;

    /// A controller, a clock, and a known base round trip of 40 ms.
    struct Bench {
        controller: DelayController,
        now: Instant,
    }

    impl Bench {
        fn new() -> Self {
            let mut bench = Self { controller: DelayController::new(WINDOW, 1200), now: Instant::now() };
            bench.acks(10, BASE_MS, true);
            assert_eq!(bench.window(), WINDOW);
            bench
        }

        /// One datagram acknowledged per ms.
        fn acks(&mut self, count: u64, rtt_ms: u64, app_limited: bool) {
            for _ in 0..count {
                self.now += Duration::from_millis(1);
                self.controller.on_ack(self.now, 1200, app_limited, Duration::from_millis(rtt_ms));
            }
        }

        /// One datagram per ms, one in `every` lost.
        fn loses(&mut self, count: u64, every: u64) {
            for place in 1..=count {
                self.now += Duration::from_millis(1);
                if place % every == 0 {
                    self.controller.on_loss(self.now, 1200, false);
                } else {
                    self.controller.on_ack(self.now, 1200, true, Duration::from_millis(BASE_MS));
                }
            }
        }

        fn window(&self) -> u64 {
            self.controller.window_bytes()
        }
    }

    #[test]
    fn the_initial_window_is_clamped_to_its_bounds() {
        for (told, window) in [(0, 12_000), (WINDOW, WINDOW), (u64::MAX, MAX_WINDOW_BYTES)] {
            let controller = DelayController::new(told, 1200);
            assert_eq!((controller.window_bytes(), controller.initial_window_bytes()), (window, window));
        }
    }

    #[test]
    fn delay_above_the_target_shrinks_once_a_round_trip() {
        let mut bench = Bench::new();
        // At the target, until it counts as standing.
        bench.acks(100, BASE_MS + 12, true);
        assert_eq!(bench.controller.queueing_delay(), TARGET_DELAY);
        assert_eq!(bench.window(), WINDOW);
        bench.acks(40, BASE_MS + 13, true);
        assert_eq!(bench.window(), WINDOW / 20 * 17);
        // Shrinks again 53 ms after the first time, when the last lower round trip has been forgotten.
        bench.acks(53, BASE_MS + 13, true);
        assert_eq!(bench.window(), WINDOW / 20 * 17 / 20 * 17);
    }

    #[test]
    fn delay_that_does_not_stand_is_ignored() {
        let mut bench = Bench::new();
        for _ in 0..50 {
            bench.acks(15, BASE_MS + 200, true);
            bench.acks(1, BASE_MS, true);
        }
        assert_eq!(bench.window(), WINDOW);
    }

    #[test]
    fn the_window_stays_above_its_floor() {
        let mut bench = Bench::new();
        bench.acks(9000, BASE_MS + 300, true);
        assert_eq!(bench.window(), FLOOR_DATAGRAMS * 1200);
    }

    #[test]
    fn loss_shrinks_above_a_tenth_only() {
        for (every, shrinks) in [(100, false), (20, false), (11, false), (10, false), (9, true), (2, true)] {
            let mut bench = Bench::new();
            bench.loses(1000, every);
            assert_eq!(bench.window() < WINDOW, shrinks, "one in {every}");
        }
    }

    #[test]
    fn a_burst_of_loss_in_a_long_round_is_little_loss() {
        let mut bench = Bench::new();
        bench.controller.on_loss(bench.now, 19 * 1200, false);
        bench.loses(180, u64::MAX);
        assert_eq!(bench.window(), WINDOW);
    }

    #[test]
    fn a_congestion_mark_shrinks_once_a_round_trip() {
        let mut bench = Bench::new();
        bench.controller.on_loss(bench.now, 0, false);
        bench.controller.on_loss(bench.now + Duration::from_millis(39), 0, false);
        assert_eq!(bench.window(), WINDOW / 20 * 17);
        bench.controller.on_loss(bench.now + Duration::from_millis(40), 0, false);
        assert_eq!(bench.window(), WINDOW / 20 * 17 / 20 * 17);
    }

    #[test]
    fn growth_is_by_bytes_at_first_and_by_datagrams_later() {
        let mut bench = Bench::new();
        bench.acks(100, BASE_MS, false);
        assert_eq!(bench.window(), WINDOW + 100 * 1200 / 2);
        bench.controller.on_loss(bench.now, 0, false);
        let shrunk = bench.window();
        // A window of acknowledgements takes one round trip.
        bench.acks(shrunk / 1200, BASE_MS, false);
        let grown = bench.window() - shrunk;
        assert!((7 * 1200..=8 * 1200).contains(&grown), "{grown}");
    }

    #[test]
    fn growth_ends_at_the_target() {
        let mut bench = Bench::new();
        bench.acks(200, BASE_MS + 7, false);
        let window = bench.window();
        assert!(!bench.controller.starting);
        bench.acks(200, BASE_MS + 12, false);
        // At the first of these the delay still stood at 7 ms.
        assert!(bench.window() - window < 1200, "{}", bench.window() - window);
    }

    #[test]
    fn the_window_of_an_idle_sender_does_not_grow() {
        let mut bench = Bench::new();
        bench.acks(1000, BASE_MS, true);
        assert_eq!(bench.window(), WINDOW);
    }

    #[test]
    fn an_outage_starts_anew_from_the_floor() {
        let mut bench = Bench::new();
        bench.controller.on_loss(bench.now, 0, false);
        bench.controller.on_loss(bench.now, 5000, true);
        assert_eq!(bench.window(), 12_000);
        bench.acks(10, BASE_MS, false);
        assert_eq!(bench.window(), 18_000);
    }

    #[test]
    fn a_period_without_the_base_ends_in_a_drain() {
        let mut bench = Bench::new();
        bench.acks(10_000, BASE_MS + 10, true);
        // Two periods have passed: the base has become 50 ms, and the drain tries 3/4 · 40/50 of the window.
        let drained = bench.window();
        assert!((WINDOW * 3 / 5 - 2..=WINDOW * 3 / 5).contains(&drained), "{drained}");
        bench.acks(200, BASE_MS, true);
        assert_eq!(bench.window(), WINDOW);
        assert_eq!(bench.controller.queueing_delay(), Duration::ZERO);
        // A path that returns to its base has no drain.
        let mut quiet = Bench::new();
        for _ in 0..12_000 {
            quiet.acks(1, BASE_MS + 3, true);
            assert_eq!(quiet.window(), WINDOW);
        }
    }

    #[test]
    fn larger_datagrams_raise_the_floor() {
        let mut controller = DelayController::new(12_000, 1200);
        controller.on_datagram_bytes(1452);
        assert_eq!(controller.window_bytes(), 14_520);
    }
}
