//! What either end measures of the network path.

pub mod congestion;
pub mod loss;
