//! Decides each datagram's fate in one direction of a link. Sans-IO: time is an argument.
//!
//! A datagram's chances depend only on the seed, the direction and its number; its jitter on seed, direction and time.
//! The same seed gives the same fates, whatever the timing of other datagrams. Two parts depend on more: the
//! bottleneck's queue on the other traffic, and a bursty channel on silence, in which it forgets its state. Otherwise a
//! sender that backs off after each loss would stay in one bad state for many seconds, which no radio does.

use std::{ops::AddAssign, time::Duration};

use bytes::Bytes;

use super::{
    settings::{Rate, Settings},
    trace::Moment,
};
use crate::cloister::rng::Rng;

/// Time from one random jitter value to the next, in seconds: about as fast as queues fill and drain.
const JITTER_STEP_S: f64 = 0.02;

/// Silence after which a bursty channel's state is drawn anew.
const FORGETTING: Duration = Duration::from_millis(100);

/// Headers of an IPv4 packet with a UDP datagram.
const IP_AND_UDP_BYTES: u64 = 28;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    Up,
    Down,
}

/// Fates of datagrams. `arrived` is the sum of delivered, lost and dropped ones.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct Counts {
    pub arrived: u64,
    /// Sent on, including late and corrupted ones, without duplicates.
    pub delivered: u64,
    pub lost: u64,
    /// Lost in the bad state of a bursty channel.
    pub burst_lost: u64,
    pub queue_dropped: u64,
    /// Larger than the path's MTU allows.
    pub too_large: u64,
    pub outage: u64,
    /// Delivered with a flipped bit.
    pub corrupted: u64,
    pub duplicated: u64,
    /// Delivered late, so that others overtake.
    pub reordered: u64,
    /// Dropped because the link's own memory was full: not part of the model, and 0 in a valid measurement.
    pub overrun: u64,
}

impl AddAssign for Counts {
    fn add_assign(&mut self, other: Self) {
        self.arrived += other.arrived;
        self.delivered += other.delivered;
        self.lost += other.lost;
        self.burst_lost += other.burst_lost;
        self.queue_dropped += other.queue_dropped;
        self.too_large += other.too_large;
        self.outage += other.outage;
        self.corrupted += other.corrupted;
        self.duplicated += other.duplicated;
        self.reordered += other.reordered;
        self.overrun += other.overrun;
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Delivery {
    /// On the clock of [`Impairment::push`].
    pub due: Duration,
    pub bytes: Bytes,
}

/// Random draws for a datagram, in this order.
struct Chances {
    loss: f64,
    state: f64,
    reorder: f64,
    duplicate: f64,
    corrupt: f64,
    bit: u64,
}

#[derive(Debug, Clone)]
pub struct Impairment {
    settings: Settings,
    seed: u64,
    index: u64,
    /// True while the bursty channel is in its bad state.
    bad: bool,
    last_push: Duration,
    /// When the bottleneck's queue is empty.
    idle_at: Duration,
    /// Arrival of the latest datagram that was not held back.
    last_due: Duration,
}

impl Impairment {
    pub fn new(settings: Settings, seed: u64, direction: Direction) -> Self {
        let mut seed = Rng::new(seed);
        let seed = match direction {
            Direction::Up => seed.bits(),
            Direction::Down => {
                seed.bits();
                seed.bits()
            }
        };
        let zero = Duration::ZERO;
        Self { settings, seed, index: 0, bad: false, last_push: zero, idle_at: zero, last_due: zero }
    }

    /// Takes a datagram at `now`, the time since the link's first one, and returns its deliveries: none, one or two.
    /// `now` must not decrease.
    pub fn push(&mut self, now: Duration, datagram: Bytes, counts: &mut Counts) -> [Option<Delivery>; 2] {
        let silence = now.saturating_sub(self.last_push);
        self.last_push = now;
        let chances = self.chances(silence);
        counts.arrived += 1;
        let moment = self.moment(now);
        if self.settings.outages.iter().any(|&(start, length)| (start..start + length).contains(&now)) {
            counts.outage += 1;
            return [None, None];
        }
        if self.settings.mtu.is_some_and(|mtu| datagram.len() as u64 + IP_AND_UDP_BYTES > mtu) {
            counts.too_large += 1;
            return [None, None];
        }
        let in_burst = self.settings.burst.filter(|_| self.bad);
        if chances.loss < in_burst.map_or(moment.loss, |burst| burst.loss) {
            *(if in_burst.is_some() { &mut counts.burst_lost } else { &mut counts.lost }) += 1;
            return [None, None];
        }
        let Some(sent) = self.pass_bottleneck(now, datagram.len()) else {
            counts.queue_dropped += 1;
            return [None, None];
        };
        counts.delivered += 1;
        let on_its_way = moment.delay.as_secs_f64() + self.settings.jitter.as_secs_f64() * self.jitter_at(now);
        let mut due = (sent + Duration::from_secs_f64(on_its_way.max(0.0))).max(self.last_due);
        if chances.reorder < self.settings.reorder {
            counts.reordered += 1;
            due += self.settings.reorder_by;
        } else {
            self.last_due = due;
        }
        let mut bytes = datagram;
        if chances.corrupt < self.settings.corrupt && !bytes.is_empty() {
            counts.corrupted += 1;
            let mut flipped = bytes.to_vec();
            let bit = usize::try_from(chances.bit % (8 * flipped.len() as u64)).unwrap_or(0);
            flipped[bit / 8] ^= 1 << (bit % 8);
            bytes = flipped.into();
        }
        let twice = chances.duplicate < self.settings.duplicate;
        counts.duplicated += u64::from(twice);
        let delivery = Delivery { due, bytes };
        [twice.then(|| delivery.clone()), Some(delivery)]
    }

    /// Draws for the next datagram, which arrives after `silence`, and advances the bursty channel.
    fn chances(&mut self, silence: Duration) -> Chances {
        // Streams of nearby seeds overlap: hence the extra step.
        let mut rng = Rng::new(Rng::new(self.seed ^ self.index).bits());
        self.index += 1;
        let chances = Chances {
            loss: rng.unit(),
            state: rng.unit(),
            reorder: rng.unit(),
            duplicate: rng.unit(),
            corrupt: rng.unit(),
            bit: rng.bits(),
        };
        if let Some(burst) = self.settings.burst {
            self.bad = match (silence > FORGETTING, self.bad) {
                (true, _) => chances.state < burst.share,
                (false, true) => chances.state >= burst.leave(),
                (false, false) => chances.state < burst.enter(),
            };
        }
        chances
    }

    /// Returns the trace's delay and loss at a time, or the constant ones.
    fn moment(&self, now: Duration) -> Moment {
        let Settings { delay, loss, trace, .. } = &self.settings;
        trace.as_ref().map_or(Moment { time: now, delay: *delay, loss: *loss }, |(_, trace)| trace.at(now))
    }

    /// Returns when a datagram leaves the bottleneck; `None` if the queue is full.
    fn pass_bottleneck(&mut self, now: Duration, bytes: usize) -> Option<Duration> {
        let Some(Rate { bits_per_s, queue_bytes }) = self.settings.rate else { return Some(now) };
        let waiting = self.idle_at.saturating_sub(now);
        let waiting_bytes = waiting.as_nanos() * u128::from(bits_per_s) / 8_000_000_000;
        if waiting_bytes + bytes as u128 > u128::from(queue_bytes) {
            return None;
        }
        // Rounded up, so that the rate is never exceeded.
        let nanos = (bytes as u64 * 8_000_000_000).div_ceil(bits_per_s);
        self.idle_at = now.max(self.idle_at) + Duration::from_nanos(nanos);
        Some(self.idle_at)
    }

    /// Value noise from −1 to 1: random values at even times, joined by cosines.
    fn jitter_at(&self, now: Duration) -> f64 {
        let place = now.as_secs_f64() / JITTER_STEP_S;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "not negative, and far below 2^53")]
        let step = place as u64;
        let value = |step: u64| 2.0 * Rng::new(Rng::new(!self.seed ^ step).bits()).unit() - 1.0;
        let ease = 0.5 - 0.5 * (std::f64::consts::PI * place.fract()).cos();
        value(step) * (1.0 - ease) + value(step + 1) * ease
    }
}
