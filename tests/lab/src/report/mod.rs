//! Reports of the `lab`: tables that are measured by running the real programs.

pub mod accuracy;
pub mod chaos;
pub mod codec;
pub mod hostile;
pub mod lag;
mod lag_plots;
pub mod link;
pub mod load;
pub mod loss;
pub mod network;
pub mod pareto;
pub mod pipeline;
pub mod plot;
pub mod predict_cost;
mod predict_rig;
pub mod prediction_error;
mod recorded_error;
pub mod replay;
pub mod scene_args;
mod shown;
pub mod table;
pub mod trace_error;
pub mod video;
