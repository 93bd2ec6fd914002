//! What an engine traces with, and for how many sessions.

use std::num::NonZeroUsize;

/// The back end to trace with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum BackendChoice {
    /// `ray-query` on a GPU with ray queries, `compute` on any other GPU, `cpu` when there is no GPU or only a software
    /// adapter.
    Auto,
    /// Kernels on a graphics adapter, with its own ray queries.
    RayQuery,
    /// Kernels on a graphics adapter.
    Compute,
    /// The processor.
    Cpu,
}

/// How to trace, and for how many sessions.
#[derive(Debug, Clone, PartialEq)]
pub struct EngineOptions {
    pub backend: BackendChoice,
    /// Part of the adapter's name, for `compute` and `ray-query`.
    pub adapter: Option<String>,
    /// Whether a software adapter may be used.
    pub allow_software: bool,
    /// Threads for `cpu`. `None`: one per core.
    pub threads: Option<NonZeroUsize>,
    /// Most sessions open at a time.
    pub max_sessions: usize,
    /// Milliseconds of each device that sessions may need per second.
    pub budget_ms: f64,
    /// Engines to start. `None`: one for each adapter of the best kind. More engines than adapters share adapters.
    pub devices: Option<NonZeroUsize>,
}

impl EngineOptions {
    /// Nearly all of a device's time. The rest is for work that is not measured.
    pub const DEFAULT_BUDGET_MS: f64 = 900.0;
}
