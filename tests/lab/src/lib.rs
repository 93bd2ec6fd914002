//! Support for Gnomon's end-to-end tests and reports: the f64 referee, scenes, metrics, a network emulator, and a rig
//! that runs the real programs.

pub mod backends;
pub mod cloister;
pub mod hard_cases;
pub mod link;
pub mod metrics;
pub mod movers;
pub mod reference;
pub mod report;
pub mod rig;
pub mod scenes;
