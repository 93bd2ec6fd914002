//! What sessions take of the cores and of the network, measured, and whether there is enough left for one more. Device time has its own
//! budget (`visibility/schedule/capacity.rs`).

use std::{
    fmt,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use gnomon_protocol::mask::MaskShape;

use crate::{
    config::ServerConfig,
    metrics::ledger::{Ledger, as_f64},
    visibility::schedule::capacity::{IDLE_SHARE, LEAST_HZ},
};

/// Time of each core that encoding may take in a second, in milliseconds, unless it is configured: the rest is for packets and the system.
const CORE_BUDGET_MS: f64 = 800.0;

/// How long a session is planned with what it asked for, and then with what it did in the last time of this length.
const WINDOW: Duration = Duration::from_secs(10);

/// Frames of a session after which its own cost is believed.
const KNOWN_FRAMES: u64 = 8;

/// What may be taken in a second.
#[derive(Debug, Clone, Copy)]
struct Budget {
    core_ms: f64,
    mbit: f64,
}

/// What frames cost.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Cost {
    core_ms: f64,
    mbit: f64,
}

/// Why a session more would be too much.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Scarce {
    Cores { needed_ms: f64, left_ms: f64 },
    Network { needed_mbit: f64, left_mbit: f64 },
}

impl fmt::Display for Scarce {
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

/// All sessions of a server.
#[derive(Debug)]
pub(crate) struct Plan {
    budget: Budget,
    planned: Arc<Mutex<Planned>>,
}

#[derive(Debug, Default)]
struct Planned {
    sessions: Vec<Arc<Entry>>,
    /// Of a bit of a mask, before its codec: what sessions have cost that sent frames.
    per_bit: Cost,
}

#[derive(Debug)]
struct Entry {
    bits: f64,
    asked_hz: f64,
    ledger: Arc<Ledger>,
    latest: Mutex<Latest>,
}

/// How fast a session has been of late.
#[derive(Debug)]
struct Latest {
    since: Instant,
    frames: u64,
    rate_hz: f64,
}

/// A session's place in the plan, and its books. Dropping it gives the place back.
#[derive(Debug)]
pub(crate) struct Share {
    planned: Arc<Mutex<Planned>>,
    entry: Arc<Entry>,
}

impl Plan {
    /// The configured budgets, for a machine with so many cores.
    pub(crate) fn new(config: &ServerConfig, cores: usize) -> Self {
        let cores = u32::try_from(cores).unwrap_or(u32::MAX);
        let core_ms = config.cores_budget_ms.map_or(CORE_BUDGET_MS * f64::from(cores), f64::from);
        let mbit = config.network_budget_mbit.map_or(f64::INFINITY, f64::from);
        Self { budget: Budget { core_ms, mbit }, planned: Arc::default() }
    }

    /// Takes a session up, with masks of this shape, so many a second at most. The first is always taken: there is nobody whose rate it
    /// could break.
    ///
    /// # Errors
    /// When cores or network do not bear it.
    pub(crate) fn take(&self, shape: MaskShape, rate_hz: Option<f64>) -> Result<Share, Scarce> {
        let asked_hz = rate_hz.unwrap_or(LEAST_HZ);
        let latest = Latest { since: Instant::now(), frames: 0, rate_hz: asked_hz };
        let bits = as_f64(shape.pixels() as u64) * f64::from(shape.lights());
        let entry = Arc::new(Entry { bits, asked_hz, ledger: Arc::default(), latest: Mutex::new(latest) });
        let mut planned = lock(&self.planned);
        planned.learn();
        let per_bit = planned.per_bit;
        let used = planned.sessions.iter().map(|other| other.need(per_bit)).fold(Cost::default(), Cost::plus);
        let needed = entry.need(per_bit);
        if !planned.sessions.is_empty() {
            let left_ms = (self.budget.core_ms - used.core_ms).max(0.0);
            if needed.core_ms > left_ms {
                return Err(Scarce::Cores { needed_ms: needed.core_ms, left_ms });
            }
            let left_mbit = (self.budget.mbit - used.mbit).max(0.0);
            if needed.mbit > left_mbit {
                return Err(Scarce::Network { needed_mbit: needed.mbit, left_mbit });
            }
        }
        planned.sessions.push(Arc::clone(&entry));
        drop(planned);
        Ok(Share { planned: Arc::clone(&self.planned), entry })
    }
}

impl Planned {
    /// Learns from the sessions that there are what a bit costs; without any it stays what it was.
    fn learn(&mut self) {
        let known = self.sessions.iter().filter_map(|entry| entry.a_frame().map(|cost| (cost, entry.bits)));
        let (sum, bits) = known.fold((Cost::default(), 0.0), |(sum, bits), (cost, more)| (sum.plus(cost), bits + more));
        if bits > 0.0 {
            self.per_bit = sum.times(1.0 / bits);
        }
    }
}

impl Entry {
    /// What one of its frames has cost, once that is known.
    fn a_frame(&self) -> Option<Cost> {
        let (encoded, sent) = (self.ledger.frames_encoded.get(), self.ledger.frames_sent.get());
        (sent >= KNOWN_FRAMES && encoded > 0).then(|| Cost {
            core_ms: as_f64(self.ledger.encode_us.get()) * 1e-3 / as_f64(encoded),
            mbit: as_f64(self.ledger.bytes.get()) * 8e-6 / as_f64(sent),
        })
    }

    /// What it needs in a second.
    fn need(&self, per_bit: Cost) -> Cost {
        let frames = self.ledger.frames_encoded.get();
        let mut latest = self.latest.lock().unwrap_or_else(PoisonError::into_inner);
        let passed = latest.since.elapsed();
        if passed >= WINDOW {
            let rate_hz = as_f64(frames.saturating_sub(latest.frames)) / passed.as_secs_f64();
            let rate_hz = rate_hz.clamp(self.asked_hz * IDLE_SHARE, self.asked_hz);
            *latest = Latest { since: Instant::now(), frames, rate_hz };
        }
        self.a_frame().unwrap_or_else(|| per_bit.times(self.bits)).times(latest.rate_hz)
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

impl Share {
    /// The session's books.
    pub(crate) fn ledger(&self) -> Arc<Ledger> {
        Arc::clone(&self.entry.ledger)
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        let mut planned = lock(&self.planned);
        // What it has taught stays.
        planned.learn();
        planned.sessions.retain(|entry| !Arc::ptr_eq(entry, &self.entry));
    }
}

fn lock(planned: &Mutex<Planned>) -> MutexGuard<'_, Planned> {
    planned.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(cores_budget_ms: u32, network_budget_mbit: Option<u32>) -> Plan {
        let config =
            ServerConfig { cores_budget_ms: Some(cores_budget_ms), network_budget_mbit, ..ServerConfig::default() };
        Plan::new(&config, 1)
    }

    fn shape() -> MaskShape {
        MaskShape::new(640, 360, 4).unwrap()
    }

    /// Ten frames, 2 ms and 25 kB each.
    fn work(share: &Share) {
        let ledger = share.ledger();
        ledger.frames_encoded.add(10);
        ledger.frames_sent.add(10);
        ledger.encode_us.add(20_000);
        ledger.bytes.add(250_000);
    }

    #[test]
    fn sessions_are_borne_until_the_cores_are_spent_and_again_when_one_has_gone() {
        let plan = plan(500, None);
        // Nothing is known before the first one has sent frames.
        let mut sessions = vec![plan.take(shape(), Some(60.0)).unwrap()];
        work(&sessions[0]);
        let refused = loop {
            match plan.take(shape(), Some(60.0)) {
                Ok(share) => sessions.push(share),
                Err(refused) => break refused,
            }
        };
        // 120 ms a second each.
        assert_eq!(sessions.len(), 4);
        let text = refused.to_string();
        assert!(text.contains("need 120.0 ms of the cores") && text.contains("20.0 are left"), "{text}");
        // A smaller one has room, and who takes what is left needs little.
        let small = plan.take(MaskShape::new(64, 36, 4).unwrap(), Some(60.0)).unwrap();
        let greedy = plan.take(shape(), None).unwrap();
        drop((small, greedy, sessions.pop()));
        sessions.push(plan.take(shape(), Some(60.0)).unwrap());
        // What was learnt outlives everybody.
        sessions.clear();
        let _first = plan.take(shape(), Some(240.0)).unwrap();
        assert!(plan.take(shape(), Some(60.0)).is_err());
    }

    #[test]
    fn the_network_is_a_budget_of_its_own() {
        let plan = plan(1_000_000, Some(30));
        let first = plan.take(shape(), Some(60.0)).unwrap();
        work(&first);
        // 12 Mbit/s each.
        let _second = plan.take(shape(), Some(60.0)).unwrap();
        let refused = plan.take(shape(), Some(60.0)).unwrap_err();
        assert!(refused.to_string().contains("need 12.0 Mbit/s, and 6.0 are left"), "{refused}");
    }

    #[test]
    fn whoever_has_not_asked_of_late_is_planned_with_a_tenth() {
        let plan = plan(200, None);
        let idle = plan.take(shape(), Some(60.0)).unwrap();
        work(&idle);
        assert!(plan.take(shape(), Some(60.0)).is_err());
        {
            let mut latest = idle.entry.latest.lock().unwrap();
            latest.since = Instant::now().checked_sub(WINDOW * 2).unwrap();
            latest.frames = 10;
        }
        assert!(plan.take(shape(), Some(60.0)).is_ok());
    }
}
