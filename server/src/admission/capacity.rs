//! Core time and network bandwidth: measures what sessions use, and decides whether one more fits. Device time has its
//! own budget (`visibility/schedule/capacity.rs`).

use std::{
    fmt,
    sync::Arc,
    time::{Duration, Instant},
};

use gnomon_protocol::mask::MaskShape;
use parking_lot::Mutex;

use crate::{
    config::ServerConfig,
    metrics::ledger::{Ledger, as_f64},
    visibility::schedule::capacity::{IDLE_SHARE, LEAST_HZ},
};

/// Default budget for encoding, in ms per second and core. The rest is for packets and the system.
const CORE_BUDGET_MS: f64 = 800.0;

/// A new session counts with its requested rate; after this time, with its measured rate, updated this often.
const WINDOW: Duration = Duration::from_secs(10);

/// Number of frames after which a session's own mean cost is used.
const MIN_MEASURED_FRAMES: u64 = 8;

/// Limits per second.
#[derive(Debug, Clone, Copy)]
struct Budget {
    core_ms: f64,
    mbit: f64,
}

/// Cost of one frame, or of a second of frames.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Cost {
    core_ms: f64,
    mbit: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum OverCapacity {
    Cores { needed_ms: f64, left_ms: f64 },
    Network { needed_mbit: f64, left_mbit: f64 },
}

impl fmt::Display for OverCapacity {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cores { needed_ms, left_ms } => {
                write!(formatter, "it would need {needed_ms:.1} ms of the cores a second, and {left_ms:.1} are left")
            }
            Self::Network { needed_mbit, left_mbit } => {
                write!(formatter, "it would need {needed_mbit:.1} Mbit/s, and {left_mbit:.1} are left")
            }
        }
    }
}

#[derive(Debug)]
pub(crate) struct HostCapacity {
    budget: Budget,
    reserved: Arc<Mutex<Reserved>>,
}

#[derive(Debug, Default)]
struct Reserved {
    sessions: Vec<Arc<Share>>,
    /// Mean cost per bit of a raw mask, over the sessions that have sent frames.
    per_bit: Cost,
}

/// What one session takes of the host.
#[derive(Debug)]
pub(crate) struct Share {
    bits: f64,
    requested_hz: f64,
    ledger: Arc<Ledger>,
    latest: Mutex<Latest>,
}

/// Frame rate in the last [`WINDOW`].
#[derive(Debug)]
struct Latest {
    since: Instant,
    frames: u64,
    rate_hz: f64,
}

/// One session's reservation, released on drop, and its ledger.
#[derive(Debug)]
pub(crate) struct Reservation {
    reserved: Arc<Mutex<Reserved>>,
    share: Arc<Share>,
}

impl HostCapacity {
    pub(crate) fn new(config: &ServerConfig, cores: usize) -> Self {
        let cores = u32::try_from(cores).unwrap_or(u32::MAX);
        let core_ms = config.cores_budget_ms.map_or(CORE_BUDGET_MS * f64::from(cores), f64::from);
        let mbit = config.network_budget_mbit.map_or(f64::INFINITY, f64::from);
        Self { budget: Budget { core_ms, mbit }, reserved: Arc::default() }
    }

    /// Reserves room for a session of up to `rate_hz` masks a second. The first session always fits: it can disturb no
    /// other. `replaced` is the session that it resumes, which does not count. Errors if the cores or the network lack
    /// capacity.
    pub(crate) fn reserve(
        &self,
        shape: MaskShape,
        rate_hz: Option<f64>,
        replaced: Option<&Arc<Share>>,
    ) -> Result<Reservation, OverCapacity> {
        let requested_hz = rate_hz.unwrap_or(LEAST_HZ);
        let latest = Latest { since: Instant::now(), frames: 0, rate_hz: requested_hz };
        let bits = as_f64(shape.pixels() as u64) * f64::from(shape.lights());
        let share = Arc::new(Share { bits, requested_hz, ledger: Arc::default(), latest: Mutex::new(latest) });
        let mut reserved = self.reserved.lock();
        reserved.update_cost();
        let per_bit = reserved.per_bit;
        let mut others =
            reserved.sessions.iter().filter(|other| replaced.is_none_or(|old| !Arc::ptr_eq(old, other))).peekable();
        let needed = share.cost_per_second(per_bit);
        if others.peek().is_some() {
            let used = others.map(|other| other.cost_per_second(per_bit)).fold(Cost::default(), Cost::plus);
            let left_ms = (self.budget.core_ms - used.core_ms).max(0.0);
            if needed.core_ms > left_ms {
                return Err(OverCapacity::Cores { needed_ms: needed.core_ms, left_ms });
            }
            let left_mbit = (self.budget.mbit - used.mbit).max(0.0);
            if needed.mbit > left_mbit {
                return Err(OverCapacity::Network { needed_mbit: needed.mbit, left_mbit });
            }
        }
        reserved.sessions.push(Arc::clone(&share));
        drop(reserved);
        Ok(Reservation { reserved: Arc::clone(&self.reserved), share })
    }
}

impl Reserved {
    /// Updates `per_bit` from the current sessions. Keeps its value if no session is measured.
    fn update_cost(&mut self) {
        let measured = self.sessions.iter().filter_map(|entry| entry.frame_cost().map(|cost| (cost, entry.bits)));
        let (sum, bits) =
            measured.fold((Cost::default(), 0.0), |(sum, bits), (cost, more)| (sum.plus(cost), bits + more));
        if bits > 0.0 {
            self.per_bit = sum.times(1.0 / bits);
        }
    }
}

impl Share {
    /// Mean cost of a frame, once enough frames were sent.
    fn frame_cost(&self) -> Option<Cost> {
        let (encoded, sent) = (self.ledger.frames_encoded.get(), self.ledger.frames_sent.get());
        (sent >= MIN_MEASURED_FRAMES && encoded > 0).then(|| Cost {
            core_ms: as_f64(self.ledger.encode_us.get()) * 1e-3 / as_f64(encoded),
            mbit: as_f64(self.ledger.bytes.get()) * 8e-6 / as_f64(sent),
        })
    }

    /// Expected cost per second.
    fn cost_per_second(&self, per_bit: Cost) -> Cost {
        let frames = self.ledger.frames_encoded.get();
        let mut latest = self.latest.lock();
        let elapsed = latest.since.elapsed();
        if elapsed >= WINDOW {
            let rate_hz = as_f64(frames.saturating_sub(latest.frames)) / elapsed.as_secs_f64();
            let rate_hz = rate_hz.clamp(self.requested_hz * IDLE_SHARE, self.requested_hz);
            *latest = Latest { since: Instant::now(), frames, rate_hz };
        }
        self.frame_cost().unwrap_or_else(|| per_bit.times(self.bits)).times(latest.rate_hz)
    }
}

impl Cost {
    fn plus(self, other: Self) -> Self {
        Self { core_ms: self.core_ms + other.core_ms, mbit: self.mbit + other.mbit }
    }

    fn times(self, factor: f64) -> Self {
        Self { core_ms: self.core_ms * factor, mbit: self.mbit * factor }
    }
}

impl Reservation {
    pub(crate) fn ledger(&self) -> Arc<Ledger> {
        Arc::clone(&self.share.ledger)
    }

    pub(crate) fn share(&self) -> Arc<Share> {
        Arc::clone(&self.share)
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        let mut reserved = self.reserved.lock();
        // Its measured cost remains after it ends.
        reserved.update_cost();
        reserved.sessions.retain(|entry| !Arc::ptr_eq(entry, &self.share));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn capacity(cores_budget_ms: u32, network_budget_mbit: Option<u32>) -> HostCapacity {
        let config =
            ServerConfig { cores_budget_ms: Some(cores_budget_ms), network_budget_mbit, ..ServerConfig::default() };
        HostCapacity::new(&config, 1)
    }

    fn shape() -> MaskShape {
        MaskShape::new(640, 360, 4).unwrap()
    }

    /// Ten frames, 2 ms and 25 kB each.
    fn work(reservation: &Reservation) {
        let ledger = reservation.ledger();
        ledger.frames_encoded.add(10);
        ledger.frames_sent.add(10);
        ledger.encode_us.add(20_000);
        ledger.bytes.add(250_000);
    }

    #[test]
    fn sessions_fit_until_the_cores_are_spent_and_again_when_one_ends() {
        let capacity = capacity(500, None);
        // Costs are unknown until the first session has sent frames.
        let mut sessions = vec![capacity.reserve(shape(), Some(60.0), None).unwrap()];
        work(&sessions[0]);
        let refused = loop {
            match capacity.reserve(shape(), Some(60.0), None) {
                Ok(reservation) => sessions.push(reservation),
                Err(refused) => break refused,
            }
        };
        // 120 ms per second each.
        assert_eq!(sessions.len(), 4);
        let text = refused.to_string();
        assert!(text.contains("need 120.0 ms of the cores") && text.contains("20.0 are left"), "{text}");
        // A smaller mask fits, and so does a session without a rate.
        let small = capacity.reserve(MaskShape::new(64, 36, 4).unwrap(), Some(60.0), None).unwrap();
        let greedy = capacity.reserve(shape(), None, None).unwrap();
        drop((small, greedy, sessions.pop()));
        sessions.push(capacity.reserve(shape(), Some(60.0), None).unwrap());
        // The measured cost remains after all sessions end.
        sessions.clear();
        let _first = capacity.reserve(shape(), Some(240.0), None).unwrap();
        assert!(capacity.reserve(shape(), Some(60.0), None).is_err());
    }

    #[test]
    fn the_network_is_a_budget_of_its_own() {
        let capacity = capacity(1_000_000, Some(30));
        let first = capacity.reserve(shape(), Some(60.0), None).unwrap();
        work(&first);
        // 12 Mbit/s each.
        let _second = capacity.reserve(shape(), Some(60.0), None).unwrap();
        let refused = capacity.reserve(shape(), Some(60.0), None).unwrap_err();
        assert!(refused.to_string().contains("need 12.0 Mbit/s, and 6.0 are left"), "{refused}");
    }

    #[test]
    fn an_idle_session_counts_with_a_tenth_of_its_rate() {
        let capacity = capacity(200, None);
        let idle = capacity.reserve(shape(), Some(60.0), None).unwrap();
        work(&idle);
        assert!(capacity.reserve(shape(), Some(60.0), None).is_err());
        {
            let mut latest = idle.share.latest.lock();
            latest.since = Instant::now().checked_sub(WINDOW * 2).unwrap();
            latest.frames = 10;
        }
        assert!(capacity.reserve(shape(), Some(60.0), None).is_ok());
    }
}
