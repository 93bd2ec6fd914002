//! LZ4's block format, with a way out for what does not compress: a slice as long as its raw bytes is these bytes.

use lz4_flex::block::{
    CompressTable, DecompressError, compress_into_with_table, decompress_into, get_maximum_output_size,
};

/// The most that LZ4 can make of one byte: each further byte of a match's length adds 255.
const MAX_RATIO: usize = 255;

/// Compresses, keeping its memory from slice to slice.
pub(super) struct Compressor {
    table: CompressTable,
    output: Vec<u8>,
}

impl Compressor {
    pub(super) fn new() -> Self {
        // Large from the start: it fits any length, and a small one would be replaced at the first long slice.
        Self { table: CompressTable::large(), output: Vec::new() }
    }

    /// The compressed bytes, or `raw` itself where they would not be fewer.
    pub(super) fn compress<'a>(&'a mut self, raw: &'a [u8]) -> &'a [u8] {
        let room = get_maximum_output_size(raw.len());
        if self.output.len() < room {
            self.output.resize(room, 0);
        }
        match compress_into_with_table(raw, &mut self.output, &mut self.table) {
            Ok(bytes) if bytes < raw.len() => &self.output[..bytes],
            _ => raw,
        }
    }
}

/// Whether a slice can stand for `raw_bytes` bytes at all. To be asked before taking memory for these.
pub(super) const fn can_be(slice_bytes: usize, raw_bytes: usize) -> bool {
    slice_bytes <= raw_bytes && raw_bytes <= slice_bytes.saturating_mul(MAX_RATIO)
}

/// Why a slice does not decompress.
#[derive(Debug)]
pub(super) enum Failure {
    Block(DecompressError),
    /// It is well-formed, but has fewer bytes.
    Short(usize),
}

/// The `raw_bytes` bytes that a slice stands for, in `scratch` or in the slice itself.
pub(super) fn decompress<'a>(slice: &'a [u8], raw_bytes: usize, scratch: &'a mut Vec<u8>) -> Result<&'a [u8], Failure> {
    if slice.len() == raw_bytes {
        return Ok(slice);
    }
    if scratch.len() < raw_bytes {
        scratch.resize(raw_bytes, 0);
    }
    let raw = &mut scratch[..raw_bytes];
    match decompress_into(slice, raw).map_err(Failure::Block)? {
        found if found == raw_bytes => Ok(raw),
        found => Err(Failure::Short(found)),
    }
}
