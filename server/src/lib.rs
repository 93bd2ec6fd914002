//! Gnomon's edge server: ray-traces visibility for many thin clients and streams it to them.
//!
//! A pose's way: `net` receives it → `session` keeps the newest → `visibility` traces it → `session` encodes and sends.

pub mod visibility;
