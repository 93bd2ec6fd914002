//! Visibility codecs: a mask to bytes and back.

use serde::{Deserialize, Serialize};

/// Names of the codecs, as they cross the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[repr(u8)]
pub enum CodecId {
    /// One u32 a pixel, bit k for light k, uncompressed: where the dissertation began (§1.3).
    Words = 0,
    /// The same words, LZ4: the dissertation's own format (§3.5).
    WordsLz4 = 1,
    /// Bit planes in 8×8 tiles, LZ4.
    PlanesLz4 = 2,
}
