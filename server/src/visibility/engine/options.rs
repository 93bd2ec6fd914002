//! An engine's options.

use std::num::NonZeroUsize;

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum BackendChoice {
    /// `ray-query` on a GPU with ray queries, `compute` on any other GPU, `cpu` without a GPU or with a software
    /// adapter only.
    Auto,
    /// Kernels on a graphics adapter that use its ray queries.
    RayQuery,
    /// Kernels on a graphics adapter.
    Compute,
    /// The processor.
    Cpu,
}

#[derive(Debug, Clone, PartialEq)]
pub struct EngineOptions {
    pub backend: BackendChoice,
    /// Part of the adapter's name, for `compute` and `ray-query`.
    pub adapter: Option<String>,
    /// Permits software adapters.
    pub allow_software: bool,
    /// Threads for `cpu`. `None`: one per core.
    pub threads: Option<NonZeroUsize>,
    /// Most sessions open at once.
    pub max_sessions: usize,
    /// Device time that the sessions of a device may need, in milliseconds per second.
    pub budget_ms: f64,
    /// Engines to start. `None`: one for each adapter of the best kind. More engines than adapters share adapters.
    pub devices: Option<NonZeroUsize>,
}

impl EngineOptions {
    /// Nearly all of a device's time. The rest is for unmeasured work.
    pub const DEFAULT_BUDGET_MS: f64 = 900.0;
}
