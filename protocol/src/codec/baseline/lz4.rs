//! LZ4's block format. A slice that does not compress holds its raw bytes: its length tells.

use lz4_flex::block::{
    CompressTable, DecompressError, compress_into_with_table, decompress_into, get_maximum_output_size,
};

/// Most raw bytes per compressed byte: each further byte of a match's length adds 255.
const MAX_RATIO: usize = 255;

pub(super) struct Compressor {
    table: CompressTable,
    output: Vec<u8>,
}

impl Compressor {
    pub(super) fn new() -> Self {
        // Large from the start: it fits any length, and a small one would be replaced at the first long slice.
        Self { table: CompressTable::large(), output: Vec::new() }
    }

    /// Returns the compressed bytes, or `raw` itself if they would not be fewer.
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

/// Returns whether a slice can hold `raw_bytes` raw bytes. Check before allocating them.
pub(super) const fn can_be(slice_bytes: usize, raw_bytes: usize) -> bool {
    slice_bytes <= raw_bytes && raw_bytes <= slice_bytes.saturating_mul(MAX_RATIO)
}

#[derive(Debug)]
pub(super) enum Failure {
    Block(DecompressError),
    /// The block is well-formed but has only this many bytes.
    Short(usize),
}

/// Returns the slice's `raw_bytes` raw bytes, in `scratch` or in the slice itself.
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
