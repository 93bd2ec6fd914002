//! Core time, network bandwidth and memory: measures or bounds what sessions use, and decides whether one more fits.
//! Device time has its own budget (`visibility/schedule/capacity.rs`).

use std::{
    fmt,
    sync::Arc,
    time::{Duration, Instant},
};

use gnomon_protocol::mask::MaskShape;
use parking_lot::Mutex;

use super::{
    coding::Coding,
    memory::{default_budget_bytes, device_bytes, session_bytes},
    scene_pace::{SCENE_SHARE, ScenePace},
};
use crate::{
    config::ServerConfig,
    metrics::ledger::{Ledger, as_f64},
    visibility::schedule::{capacity::LEAST_HZ, measured_rate::MeasuredRate},
};

/// Default budget for encoding, in ms per second and core. The rest is for packets and the system.
const CORE_BUDGET_MS: f64 = 800.0;

/// How long a look at the bandwidth that sessions leave is good for.
const LEFT_LASTS: Duration = Duration::from_millis(250);

const MB: u64 = 1_000_000;

/// Number of frames after which a session's own mean cost is used.
const MIN_MEASURED_FRAMES: u64 = 8;

/// Limits per second.
#[derive(Debug, Clone, Copy)]
struct Budget {
    core_ms: f64,
    mbit: f64,
    /// Not per second.
    memory_bytes: u64,
}

/// What a client asks for.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Demand {
    /// Its largest masks.
    pub(crate) shape: MaskShape,
    pub(crate) coding: Coding,
    /// Declared masks per second.
    pub(crate) rate_hz: Option<f64>,
}

/// Cost of one frame, or of a second of frames.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Cost {
    core_ms: f64,
    mbit: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum OverCapacity {
    Cores {
        needed_ms: f64,
        left_ms: f64,
    },
    Network {
        needed_mbit: f64,
        left_mbit: f64,
    },
    Memory {
        needed_bytes: u64,
        left_bytes: u64,
    },
    /// It does not even fit alone, so there is no use in asking again.
    TooLarge {
        needed_bytes: u64,
        budget_bytes: u64,
    },
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
            Self::Memory { needed_bytes, left_bytes } => {
                let [needed, left] = [needed_bytes.div_ceil(MB), left_bytes / MB];
                write!(formatter, "it may need {needed} MB of memory, and {left} are left")
            }
            Self::TooLarge { needed_bytes, budget_bytes } => {
                let [needed, budget] = [needed_bytes.div_ceil(MB), budget_bytes / MB];
                write!(
                    formatter,
                    "it may need {needed} MB of memory, and all sessions have {budget}: ask for smaller masks"
                )
            }
        }
    }
}

#[derive(Debug)]
pub(crate) struct HostCapacity {
    budget: Budget,
    scene_bytes: u64,
    /// Devices with buffers of their own.
    devices: u32,
    reserved: Arc<Mutex<Reserved>>,
    scene: Mutex<SceneRate>,
}

/// The pace of all scene fetches.
#[derive(Debug, Default)]
struct SceneRate {
    pace: ScenePace,
    /// What sessions left, and when that was looked up.
    left: Option<(Instant, f64)>,
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
    shape: MaskShape,
    memory_bytes: u64,
    declared_hz: Option<f64>,
    measured: MeasuredRate,
    ledger: Arc<Ledger>,
}

/// One session's reservation, released on drop, and its ledger.
#[derive(Debug)]
pub(crate) struct Reservation {
    reserved: Arc<Mutex<Reserved>>,
    share: Arc<Share>,
}

impl HostCapacity {
    /// `devices` is the number of devices with buffers of their own.
    pub(crate) fn new(config: &ServerConfig, cores: usize, scene_bytes: u64, devices: u32) -> Self {
        let cores = u32::try_from(cores).unwrap_or(u32::MAX);
        let core_ms = config.cores_budget_ms.map_or(CORE_BUDGET_MS * f64::from(cores), f64::from);
        let mbit = config.network_budget_mbit.map_or(f64::INFINITY, f64::from);
        let chosen_bytes = config.memory_budget_mb.map(|mb| u64::from(mb) * MB);
        let memory_bytes = chosen_bytes.or_else(default_budget_bytes).unwrap_or(u64::MAX);
        let budget = Budget { core_ms, mbit, memory_bytes };
        Self { budget, scene_bytes, devices, reserved: Arc::default(), scene: Mutex::default() }
    }

    /// Reserves room for a session. The first session always fits if there is memory: it can disturb no other.
    /// `replaced` is the session that it resumes, which does not count. Errors if cores, network or memory lack
    /// capacity.
    pub(crate) fn reserve(
        &self,
        Demand { shape, coding, rate_hz }: Demand,
        replaced: Option<&Arc<Share>>,
    ) -> Result<Reservation, OverCapacity> {
        let memory_bytes = session_bytes(shape, coding, self.scene_bytes);
        let measured = MeasuredRate::new(rate_hz.unwrap_or(LEAST_HZ));
        let bits = as_f64(shape.pixels() as u64) * f64::from(shape.lights());
        let share =
            Arc::new(Share { bits, shape, memory_bytes, declared_hz: rate_hz, measured, ledger: Arc::default() });
        let mut reserved = self.reserved.lock();
        reserved.update_cost();
        let per_bit = reserved.per_bit;
        let others: Vec<&Arc<Share>> =
            reserved.sessions.iter().filter(|other| replaced.is_none_or(|old| !Arc::ptr_eq(old, other))).collect();
        self.check_memory(&others, &share)?;
        let needed = share.cost_per_second(per_bit);
        if !others.is_empty() {
            let mut used = others.iter().map(|other| other.cost_per_second(per_bit)).fold(Cost::default(), Cost::plus);
            if self.budget.mbit.is_finite() && self.scene.lock().pace.is_active(Instant::now()) {
                used.mbit += self.budget.mbit * SCENE_SHARE;
            }
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

    fn check_memory(&self, others: &[&Arc<Share>], new: &Share) -> Result<(), OverCapacity> {
        // All sessions share a device's buffers, which are made for the largest masks.
        let buffers = |shapes: &mut dyn Iterator<Item = MaskShape>| {
            shapes.map(device_bytes).max().unwrap_or(0) * u64::from(self.devices)
        };
        let budget_bytes = self.budget.memory_bytes;
        let alone = new.memory_bytes + buffers(&mut [new.shape].into_iter());
        if alone > budget_bytes {
            return Err(OverCapacity::TooLarge { needed_bytes: alone, budget_bytes });
        }
        let sessions: u64 = others.iter().map(|other| other.memory_bytes).sum();
        let used = sessions + buffers(&mut others.iter().map(|other| other.shape));
        let after = buffers(&mut others.iter().map(|other| other.shape).chain([new.shape]));
        let needed_bytes = (sessions + new.memory_bytes + after).saturating_sub(used);
        let left_bytes = budget_bytes.saturating_sub(used);
        if needed_bytes > left_bytes { Err(OverCapacity::Memory { needed_bytes, left_bytes }) } else { Ok(()) }
    }

    /// Takes time for a chunk of the scene that goes now. Returns when the same client's next one may go.
    pub(crate) fn scene_chunk(&self, bytes: usize, now: Instant) -> Instant {
        if self.budget.mbit.is_infinite() {
            return now;
        }
        let known = self.scene.lock().left.filter(|(at, _)| now.saturating_duration_since(*at) < LEFT_LASTS);
        let (at, left_mbit) = known.unwrap_or_else(|| (now, self.left_mbit()));
        let mut scene = self.scene.lock();
        scene.left = Some((at, left_mbit));
        scene.pace.take(bytes, left_mbit.max(self.budget.mbit * SCENE_SHARE), now)
    }

    /// Bandwidth that the sessions' masks leave.
    fn left_mbit(&self) -> f64 {
        let reserved = self.reserved.lock();
        let used: f64 = reserved.sessions.iter().map(|share| share.cost_per_second(reserved.per_bit).mbit).sum();
        self.budget.mbit - used
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

    /// Expected cost per second. A session without a rate yields its core time to others, but not its bandwidth.
    fn cost_per_second(&self, per_bit: Cost) -> Cost {
        let frames = self.ledger.frames_encoded.get();
        let planned_hz = self.measured.planned_hz(frames);
        let sent_hz = if self.declared_hz.is_some() { planned_hz } else { self.measured.update(frames) };
        let frame = self.frame_cost().unwrap_or_else(|| per_bit.times(self.bits));
        Cost { core_ms: frame.core_ms * planned_hz, mbit: frame.mbit * sent_hz }
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
    use gnomon_protocol::codec::CodecId;

    use super::*;

    fn capacity(cores_budget_ms: u32, network_budget_mbit: Option<u32>) -> HostCapacity {
        let config =
            ServerConfig { cores_budget_ms: Some(cores_budget_ms), network_budget_mbit, ..ServerConfig::default() };
        HostCapacity::new(&config, 1, 0, 0)
    }

    fn demand(shape: MaskShape, rate_hz: Option<f64>) -> Demand {
        Demand { shape, coding: Coding { codec: CodecId::PlanesLz4, wrong_ppm: 0 }, rate_hz }
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
        let mut sessions = vec![capacity.reserve(demand(shape(), Some(60.0)), None).unwrap()];
        work(&sessions[0]);
        let refused = loop {
            match capacity.reserve(demand(shape(), Some(60.0)), None) {
                Ok(reservation) => sessions.push(reservation),
                Err(refused) => break refused,
            }
        };
        // 120 ms per second each.
        assert_eq!(sessions.len(), 4);
        let text = refused.to_string();
        assert!(text.contains("need 120.0 ms of the cores") && text.contains("20.0 are left"), "{text}");
        // A smaller mask fits, and so does a session without a rate.
        let small = capacity.reserve(demand(MaskShape::new(64, 36, 4).unwrap(), Some(60.0)), None).unwrap();
        let greedy = capacity.reserve(demand(shape(), None), None).unwrap();
        drop((small, greedy, sessions.pop()));
        sessions.push(capacity.reserve(demand(shape(), Some(60.0)), None).unwrap());
        // The measured cost remains after all sessions end.
        sessions.clear();
        let _first = capacity.reserve(demand(shape(), Some(240.0)), None).unwrap();
        assert!(capacity.reserve(demand(shape(), Some(60.0)), None).is_err());
    }

    #[test]
    fn the_network_is_a_budget_of_its_own() {
        let capacity = capacity(1_000_000, Some(30));
        let first = capacity.reserve(demand(shape(), Some(60.0)), None).unwrap();
        work(&first);
        // 12 Mbit/s each.
        let _second = capacity.reserve(demand(shape(), Some(60.0)), None).unwrap();
        let refused = capacity.reserve(demand(shape(), Some(60.0)), None).unwrap_err();
        assert!(refused.to_string().contains("need 12.0 Mbit/s, and 6.0 are left"), "{refused}");
    }

    #[test]
    fn a_session_without_a_rate_counts_with_the_bandwidth_that_it_takes() {
        let capacity = capacity(1_000_000, Some(30));
        let greedy = capacity.reserve(demand(shape(), None), None).unwrap();
        work(&greedy);
        greedy.ledger().frames_encoded.add(1190);
        // 60 frames a second, of 0.2 Mbit each.
        greedy.share.measured.end_window(0);
        let refused = capacity.reserve(demand(shape(), Some(144.0)), None).unwrap_err();
        assert!(refused.to_string().contains("need 28.8 Mbit/s, and 18.0 are left"), "{refused}");
    }

    #[test]
    fn memory_is_a_budget_for_the_first_session_too() {
        let config = ServerConfig { memory_budget_mb: Some(400), ..ServerConfig::default() };
        let capacity = HostCapacity::new(&config, 1, 0, 0);
        let largest = demand(MaskShape::new(3840, 2160, 32).unwrap(), Some(1.0));
        let first = capacity.reserve(largest, None).unwrap();
        let refused = capacity.reserve(largest, None).unwrap_err().to_string();
        assert!(refused.contains("MB of memory, and 1") && refused.contains("are left"), "{refused}");
        let small = capacity.reserve(demand(shape(), Some(1.0)), None).unwrap();
        // A client that resumes a session is judged without it.
        let back = capacity.reserve(largest, Some(&first.share())).unwrap();
        drop((first, small, back));
        let config = ServerConfig { memory_budget_mb: Some(100), ..ServerConfig::default() };
        let refused = HostCapacity::new(&config, 1, 0, 0).reserve(largest, None).unwrap_err();
        assert!(matches!(refused, OverCapacity::TooLarge { .. }), "{refused}");
        // A device's buffers are made once, for the largest masks.
        let config = ServerConfig { memory_budget_mb: Some(900), ..ServerConfig::default() };
        let capacity = HostCapacity::new(&config, 1, 0, 1);
        let _first = capacity.reserve(largest, None).unwrap();
        assert!(capacity.reserve(largest, None).is_err());
        let _small = capacity.reserve(demand(shape(), None), None).unwrap();
    }

    #[test]
    fn the_scene_is_sent_with_what_masks_leave() {
        let capacity = capacity(1_000_000, Some(30));
        let now = Instant::now();
        // 1 Mbit at 30 Mbit/s.
        assert_eq!(capacity.scene_chunk(125_000, now) - now, Duration::from_secs_f64(1.0 / 30.0));
        let session = capacity.reserve(demand(shape(), Some(60.0)), None).unwrap();
        work(&session);
        let later = now + LEFT_LASTS;
        let took = capacity.scene_chunk(125_000, later) - later;
        assert!(took.abs_diff(Duration::from_secs_f64(1.0 / 18.0)) < Duration::from_millis(1), "{took:?}");
        // Sessions cannot reserve the share that fetches have at least.
        let refused = capacity.reserve(demand(shape(), Some(80.0)), None).unwrap_err();
        assert!(refused.to_string().contains("need 16.0 Mbit/s, and 15.0 are left"), "{refused}");
        let unlimited = HostCapacity::new(&ServerConfig::default(), 1, 0, 0);
        assert_eq!(unlimited.scene_chunk(usize::MAX, now), now);
    }

    #[test]
    fn an_idle_session_counts_with_a_tenth_of_its_rate() {
        let capacity = capacity(200, None);
        let idle = capacity.reserve(demand(shape(), Some(60.0)), None).unwrap();
        work(&idle);
        assert!(capacity.reserve(demand(shape(), Some(60.0)), None).is_err());
        idle.share.measured.end_window(10);
        assert!(capacity.reserve(demand(shape(), Some(60.0)), None).is_ok());
    }
}
