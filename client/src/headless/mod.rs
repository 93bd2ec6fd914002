//! Runs without a window: pictures, statistics and a summary go into files.

pub mod pictures;
mod progress;
pub mod run;
pub mod stats;
