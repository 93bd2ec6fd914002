//! Gnomon's end-to-end tests and what they need: the f64 referee, scenes, metrics, a network to test on, and a rig that boots real programs.

pub mod backends;
pub mod cloister;
pub mod hard_cases;
pub mod link;
pub mod metrics;
pub mod reference;
pub mod report;
pub mod rig;
pub mod scenes;
