//! Zstandard (RFC 8878). libzstd compresses; `ruzstd` decompresses on both ends, so that no byte of a peer reaches C.

use std::io::Read as _;

use ruzstd::decoding::{FrameDecoder, StreamingDecoder};

/// Higher levels take a server's start several times as long, for a few per cent.
#[cfg(not(target_family = "wasm"))]
const LEVEL: i32 = 9;

/// Largest window that is taken: libzstd's own bound on what decoders must bear is the same.
const MAX_WINDOW_BYTES: u64 = 1 << 27;

#[cfg(not(target_family = "wasm"))]
pub(super) fn compress(raw: &[u8]) -> Result<Vec<u8>, String> {
    zstd::bulk::compress(raw, LEVEL).map_err(|error| error.to_string())
}

/// Browsers unpack scenes only. What they pack is correct, and larger.
#[cfg(target_family = "wasm")]
#[expect(clippy::unnecessary_wraps, reason = "libzstd can fail")]
pub(super) fn compress(raw: &[u8]) -> Result<Vec<u8>, String> {
    Ok(ruzstd::encoding::compress_to_vec(raw, ruzstd::encoding::CompressionLevel::Fastest))
}

/// Decompresses one frame of exactly `size` bytes.
/// Errors with a sentence if it is broken, or has another size. Memory grows only as bytes come out.
pub(super) fn decompress(packed: &[u8], size: usize) -> Result<Vec<u8>, String> {
    let mut decoder = FrameDecoder::new();
    decoder.set_max_window_size(MAX_WINDOW_BYTES);
    let mut rest = packed;
    let reader = StreamingDecoder::new_with_decoder(&mut rest, decoder).map_err(|error| error.to_string())?;
    let mut raw = Vec::new();
    reader.take(size as u64 + 1).read_to_end(&mut raw).map_err(|error| error.to_string())?;
    match (raw.len() == size, rest.len()) {
        (true, 0) => Ok(raw),
        (true, left) => Err(format!("{left} bytes follow its end")),
        (false, _) => Err(format!("it does not unpack to {size} bytes")),
    }
}
