//! Admission: the handshake, tokens, limits per address, session permits, and the capacity of cores, network and
//! memory.

pub(crate) mod addresses;
pub(crate) mod capacity;
pub(crate) mod coding;
pub(crate) mod encoders;
pub(crate) mod end_reason;
pub(crate) mod failed_tokens;
pub(crate) mod handshake;
pub(crate) mod memory;
pub(crate) mod permit;
mod scene_pace;
pub(crate) mod services;
pub(crate) mod time_limit;
pub mod tokens;
