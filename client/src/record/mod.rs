//! Recordings of everything passed to the renderer in a run, with times and network events.
//!
//! A recording is a line with the format's version, then records: each its length (u32, little-endian) and its postcard
//! bytes. It contains masks as they were used, so [`replay`] draws the same pictures without a network. A recording
//! stops at [`format::MAX_BYTES`]. One that was cut off within a record is valid up to there.

pub mod format;
mod recorder;
pub mod replay;

pub use self::format::{Record, Start};
pub(crate) use self::recorder::Recorder;
