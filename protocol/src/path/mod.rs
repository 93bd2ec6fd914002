//! Measurements of the network path, at either end.

pub mod average;
pub mod congestion;
pub mod loss;
