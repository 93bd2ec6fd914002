//! From an encoded frame to packets.

pub mod packetizer;
pub mod refresh;
