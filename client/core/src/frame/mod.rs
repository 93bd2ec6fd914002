//! What a frame is drawn from: pose, mode, guard band.

pub mod guard;
pub mod mode;
pub mod pose_history;
