//! The engines of a server, one per device. A new session goes to the engine with the least measured load. An engine
//! that loses its device hands its sessions to the others.

use std::{num::NonZeroUsize, sync::Arc, time::Instant};

use gnomon_protocol::mask::MaskShape;
use gnomon_scene::Scene;
use gnomon_shaders::gpu::Gpu;

use super::{
    error::{EngineError, OpenError},
    handle::{Engine, STOP_PATIENCE},
    options::{BackendChoice, EngineOptions},
    port::SessionPort,
};
use crate::visibility::schedule::costs::SessionCosts;

/// Running engines, at least one. Dropping them waits for their threads, so don't drop them on an async worker.
#[derive(Debug)]
pub struct Fleet {
    engines: Vec<Engine>,
    description: String,
}

impl Fleet {
    /// Starts an engine on each device, in parallel.
    ///
    /// # Errors
    /// If an engine does not start.
    pub fn start(scene: &Arc<Scene>, options: &EngineOptions) -> Result<Self, EngineError> {
        let wanted = options.adapter.as_deref();
        let adapters = match options.backend {
            BackendChoice::Cpu => 1,
            // `count` does not count software adapters, but one device is always opened.
            BackendChoice::Auto | BackendChoice::Compute | BackendChoice::RayQuery => {
                pollster::block_on(Gpu::count(wanted)).max(1)
            }
        };
        let devices = options.devices.map_or(adapters, NonZeroUsize::get);
        let named = wanted.unwrap_or_default();
        let options_of = |device: usize| {
            let adapter = match devices {
                1 => options.adapter.clone(),
                _ => Some(format!("{named}#{}", device % adapters + 1)),
            };
            EngineOptions { adapter, ..options.clone() }
        };
        let started: Vec<Result<Engine, EngineError>> = std::thread::scope(|scope| {
            let starting: Vec<_> = (0..devices)
                .map(|device| scope.spawn(move || Engine::start(Arc::clone(scene), &options_of(device))))
                .collect();
            starting.into_iter().map(|started| started.join().unwrap_or(Err(EngineError::Died))).collect()
        });
        let engines = started.into_iter().collect::<Result<Vec<_>, _>>()?;
        Engine::connect_peers(&engines);
        let description = match engines.as_slice() {
            [only] => only.description().to_owned(),
            [first, ..] => format!("{devices} devices: {}, …", first.description()),
            [] => return Err(EngineError::Died),
        };
        Ok(Self { engines, description })
    }

    /// Back ends and adapters, in readable form.
    #[must_use]
    pub fn description(&self) -> &str {
        &self.description
    }

    #[must_use]
    pub fn engines(&self) -> &[Engine] {
        &self.engines
    }

    /// Number of engines with buffers on a device; 0 on the processor.
    pub(crate) fn devices(&self) -> u32 {
        u32::try_from(self.engines.iter().filter(|engine| engine.has_device()).count()).unwrap_or(u32::MAX)
    }

    #[must_use]
    pub fn sessions(&self) -> usize {
        self.engines.iter().map(Engine::sessions).sum()
    }

    /// Opens a session on the least loaded device that admits it, for up to `rate_hz` masks per second.
    ///
    /// # Errors
    /// If no device admits it: the error of the least loaded one.
    pub fn open(&self, shape: MaskShape, rate_hz: Option<f64>) -> Result<SessionPort, OpenError> {
        self.open_instead(shape, rate_hz, None)
    }

    /// As [`Self::open`], judged as if the session with the costs `replaced` were gone.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub(crate) fn open_instead(
        &self,
        shape: MaskShape,
        rate_hz: Option<f64>,
        replaced: Option<&Arc<SessionCosts>>,
    ) -> Result<SessionPort, OpenError> {
        let mut by_load: Vec<(bool, f64, usize, &Engine)> = (self.engines.iter())
            .map(|engine| (!engine.is_well(), engine.load_without_ms(replaced), engine.sessions(), engine))
            .collect();
        by_load.sort_by(|(a_ill, a, a_sessions, _), (b_ill, b, b_sessions, _)| {
            a_ill.cmp(b_ill).then(a.total_cmp(b)).then(a_sessions.cmp(b_sessions))
        });
        let mut first = None;
        for (.., engine) in by_load {
            match engine.open_instead(shape, rate_hz, replaced) {
                Ok(port) => return Ok(port),
                Err(error) => _ = first.get_or_insert(error),
            }
        }
        Err(first.unwrap_or(OpenError::Busy))
    }

    /// Returns false if an engine hangs: see [`Engine::answers`].
    #[must_use]
    pub fn answers(&self) -> bool {
        self.engines.iter().all(Engine::answers)
    }

    /// Waits until all engines have ended. Returns the last reason.
    pub async fn ended(&self) -> String {
        let mut reason = String::new();
        for engine in &self.engines {
            reason = engine.ended().await;
        }
        reason
    }

    /// Stops tracing, closes all sessions' ports, and waits for the threads to end.
    pub fn shutdown(&self) {
        let deadline = Instant::now() + STOP_PATIENCE;
        self.engines.iter().for_each(Engine::ask_to_stop);
        for engine in &self.engines {
            engine.shutdown_within(deadline.saturating_duration_since(Instant::now()));
        }
    }
}
