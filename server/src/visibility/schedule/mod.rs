//! Shares one device among sessions: whose turn it is, how often, what masks cost, and whether one more
//! session fits.

pub mod capacity;
pub mod costs;
pub(crate) mod dearest;
pub(crate) mod measured_rate;
pub mod pace;
pub mod parts;
pub(crate) mod price;
pub mod scheduler;
