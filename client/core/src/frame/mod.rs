//! Decides each frame's camera and masks; [`frame_loop`] is the entry point.

pub mod frame_loop;
pub mod guard;
pub mod mode;
pub mod stats;
