//! Reports of the `lab`: tables that are measured by running the real programs.

pub mod accuracy;
pub mod load;
pub mod pareto;
pub mod pipeline;
pub mod plot;
pub mod scene_args;
pub mod table;
pub mod trace_error;
