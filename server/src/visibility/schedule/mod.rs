//! Shares one device among sessions: whose turn it is, what masks cost, and whether one more session fits.

pub mod capacity;
pub mod costs;
pub mod parts;
pub mod scheduler;
