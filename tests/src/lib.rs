//! Gnomon's end-to-end tests and what they need: the f64 referee, scenes, metrics, and a rig that boots real programs.

pub mod backends;
pub mod cloister;
pub mod metrics;
pub mod reference;
pub mod report;
pub mod rig;
pub mod scenes;
