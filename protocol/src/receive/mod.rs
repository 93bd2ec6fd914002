//! From packets to frames.

pub mod reassembler;
