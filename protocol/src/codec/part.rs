//! A part of an encoded frame.

use std::ops::Range;

/// A part of a sliced frame: it fits a packet and can be decoded alone.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Part {
    pub bytes: usize,
    pub(super) blocks: Range<usize>,
}
