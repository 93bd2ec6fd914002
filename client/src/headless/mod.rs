//! Runs without a window, which write pictures, statistics and a summary to files.

mod edits;
pub mod pictures;
mod progress;
pub mod run;
pub mod stats;
