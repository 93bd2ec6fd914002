//! Admission: the handshake, tokens, limits per address, session permits, and the capacity of cores and network.

pub(crate) mod addresses;
pub(crate) mod capacity;
pub(crate) mod end_reason;
pub(crate) mod handshake;
pub(crate) mod permit;
pub(crate) mod services;
pub(crate) mod time_limit;
pub mod tokens;
