//! How many bytes may be in flight: a controller that listens to delay and is deaf to a little loss.
//!
//! Quinn's own controllers take every loss for congestion; at 1 % of random loss they deliver 8 % of a stream of
//! frames. Frames are worth most when they are young, and a lost packet is never sent again, so what counts is the
//! queue in the path. The rules, each on the feedback that quinn's `congestion::Controller` gives:
//!
//! 1. *Base.* The path's own round trip is the smallest one seen in the last 5 to 10 s (two periods of 5 s, the older
//!    one forgotten), so that a longer route is learnt within 10 s.
//! 2. *Delay.* Queueing delay is the round trip above the base. Above [`TARGET_DELAY`] (25 ms) the window shrinks to
//!    0.85 of itself, at most once a round trip.
//! 3. *Loss.* Loss is judged in rounds of at least 200 datagrams and one round trip. A round that lost more than
//!    [`MAX_LOSS_PERCENT`] (10 %) shrinks the window to 0.85; less loss changes nothing.
//! 4. *Marks.* A congestion mark (ECN, reported as a loss of 0 bytes) counts as too much delay.
//! 5. *Growth.* While the sender could use more than the window, and the delay is below the target, acknowledged bytes
//!    open the window: byte for byte until it first shrinks or the delay passes half the target, after that by up to 8
//!    datagrams a round trip, less the nearer the delay is to the target.
//! 6. *Drain.* A full window keeps a queue below the target standing, which rule 1 would in time take for the path
//!    itself. So a period in which no round trip came within 3 ms of the base ends with half the window for two round
//!    trips (at least 50 ms); the window then takes its former size.
//! 7. *Outage.* When all packets were lost for longer than quinn's persistent-congestion period, the window falls to
//!    the floor and grows as at the start.
//!
//! The window starts at what the caller says (four frames at least: quinn paces by window over round trip) and stays
//! between [`FLOOR_DATAGRAMS`] datagrams and [`MAX_WINDOW_BYTES`]. Not known: how it shares a path with other kinds
//! of traffic. A queue that overflows below 25 ms is only noticed when it loses more than 10 %.

use std::time::{Duration, Instant};

/// Queueing delay above which the window shrinks.
pub const TARGET_DELAY: Duration = Duration::from_millis(25);

/// Share of lost bytes above which the window shrinks, in per cent.
pub const MAX_LOSS_PERCENT: u64 = 10;

/// Smallest window, in datagrams.
pub const FLOOR_DATAGRAMS: u64 = 10;

/// Largest window: 2.5 Gbit/s at 200 ms.
pub const MAX_WINDOW_BYTES: u64 = 64 << 20;

const BASE_PERIOD: Duration = Duration::from_secs(5);
const NEAR_BASE: Duration = Duration::from_millis(3);
const MIN_DRAIN: Duration = Duration::from_millis(50);
const LOSS_ROUND_DATAGRAMS: u64 = 200;
const GROWTH_DATAGRAMS: u64 = 8;

/// The controller: a state machine without clock or socket. `now` may not go back.
#[derive(Debug, Clone)]
pub struct DelayController {
    initial_window_bytes: u64,
    window_bytes: u64,
    datagram_bytes: u64,
    /// Whether the window has not shrunk yet.
    starting: bool,
    base: BaseRtt,
    latest_rtt: Duration,
    shrunk_at: Option<Instant>,
    drain_until: Option<Instant>,
    round: LossRound,
    /// Growth that is no whole byte yet, in bytes × window bytes.
    growth_credit: u64,
}

/// The smallest round trip of this period and of the one before.
#[derive(Debug, Clone, Copy, Default)]
struct BaseRtt {
    period_start: Option<Instant>,
    this: Option<Duration>,
    last: Option<Duration>,
}

/// What was acknowledged and lost since the round began.
#[derive(Debug, Clone, Copy, Default)]
struct LossRound {
    start: Option<Instant>,
    acked_bytes: u64,
    lost_bytes: u64,
}

impl DelayController {
    /// A controller with its first window, for datagrams of about `datagram_bytes`.
    #[must_use]
    pub fn new(initial_window_bytes: u64, datagram_bytes: u16) -> Self {
        let datagram_bytes = u64::from(datagram_bytes.max(1));
        let window_bytes = initial_window_bytes.clamp(FLOOR_DATAGRAMS * datagram_bytes, MAX_WINDOW_BYTES);
        Self {
            initial_window_bytes: window_bytes,
            window_bytes,
            datagram_bytes,
            starting: true,
            base: BaseRtt::default(),
            latest_rtt: Duration::ZERO,
            shrunk_at: None,
            drain_until: None,
            round: LossRound::default(),
            growth_credit: 0,
        }
    }

    /// Bytes that may be in flight now.
    #[must_use]
    pub fn window_bytes(&self) -> u64 {
        if self.drain_until.is_some() { self.floor().max(self.window_bytes / 2) } else { self.window_bytes }
    }

    /// The window that the controller began with.
    #[must_use]
    pub const fn initial_window_bytes(&self) -> u64 {
        self.initial_window_bytes
    }

    /// The latest round trip above the base: what queues add.
    #[must_use]
    pub fn queueing_delay(&self) -> Duration {
        self.base.min().map_or(Duration::ZERO, |base| self.latest_rtt.saturating_sub(base))
    }

    /// `bytes` were acknowledged. `app_limited` says that the sender had nothing more to send; `rtt` is the smoothed
    /// round trip, the peer's acknowledgement delay taken off.
    pub fn on_ack(&mut self, now: Instant, bytes: u64, app_limited: bool, rtt: Duration) {
        self.latest_rtt = rtt;
        if self.base.sample(now, rtt) == Standing::Queue {
            self.drain_until = Some(now + MIN_DRAIN.max(rtt * 2));
        }
        self.drain_until = self.drain_until.filter(|until| now < *until);
        self.round.acked_bytes += bytes;
        self.judge_loss(now);
        let delay = self.queueing_delay();
        if delay > TARGET_DELAY {
            self.shrink(now);
        } else if !app_limited && self.drain_until.is_none() {
            self.grow(bytes, delay);
        }
    }

    /// `lost_bytes` were found lost; 0 stands for a congestion mark. `persistent` says that everything was lost for a
    /// long time.
    pub fn on_loss(&mut self, now: Instant, lost_bytes: u64, persistent: bool) {
        if persistent {
            self.window_bytes = self.floor();
            self.starting = true;
            self.round = LossRound::default();
            self.drain_until = None;
        } else if lost_bytes == 0 {
            self.shrink(now);
        } else {
            self.round.lost_bytes += lost_bytes;
            self.judge_loss(now);
        }
    }

    /// The path carries datagrams of another size.
    pub fn on_datagram_bytes(&mut self, datagram_bytes: u16) {
        self.datagram_bytes = u64::from(datagram_bytes.max(1));
        self.window_bytes = self.window_bytes.clamp(self.floor(), MAX_WINDOW_BYTES);
    }

    fn floor(&self) -> u64 {
        FLOOR_DATAGRAMS * self.datagram_bytes
    }

    fn judge_loss(&mut self, now: Instant) {
        let round = &mut self.round;
        let start = *round.start.get_or_insert(now);
        let total = round.acked_bytes + round.lost_bytes;
        if total < LOSS_ROUND_DATAGRAMS * self.datagram_bytes || now.duration_since(start) < self.latest_rtt {
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
        if self.shrunk_at.is_some_and(|at| now.duration_since(at) < self.latest_rtt) {
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
            acked_bytes
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

/// Whether a period that has just ended came near its base.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Standing {
    No,
    Queue,
}

impl BaseRtt {
    fn min(&self) -> Option<Duration> {
        self.this.into_iter().chain(self.last).min()
    }

    fn sample(&mut self, now: Instant, rtt: Duration) -> Standing {
        let start = *self.period_start.get_or_insert(now);
        let mut standing = Standing::No;
        if now.duration_since(start) >= BASE_PERIOD {
            if let (Some(this), Some(last)) = (self.this, self.last)
                && this > last + NEAR_BASE
            {
                standing = Standing::Queue;
            }
            (self.period_start, self.last, self.this) = (Some(now), self.this, None);
        }
        self.this = Some(self.this.map_or(rtt, |least| least.min(rtt)));
        standing
    }
}
