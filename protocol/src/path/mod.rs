//! What either end measures of the network path.

pub mod average;
pub mod congestion;
pub mod loss;
