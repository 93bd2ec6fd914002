//! The lab's reports: tables measured on the real programs.

pub mod accuracy;
pub mod chaos;
pub mod codec;
pub mod edges;
pub mod hostile;
pub mod lag;
pub mod link;
pub mod living;
pub mod load;
pub mod loss;
pub mod moving_times;
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
mod statistics;
pub mod table;
pub mod trace_error;
pub mod video;
