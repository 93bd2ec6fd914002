//! Basis Universal pictures in KTX2 (KHR_texture_basisu): ETC1S and UASTC, one level alone.
//!
//! The crate `basisu` transcodes. It is pure Rust, but young, and indexes as the file says: so the container is checked
//! here first, and a panic in it becomes an error. Clients never see such a picture.

use std::panic::catch_unwind;

use basisu::{DecodeFlags, SourceFormat, TargetFormat, Transcoder};

/// Bytes before the index of levels.
const HEAD_BYTES: usize = 80;
const LEVEL_BYTES: usize = 24;
/// Most levels that are read; more are legal for larger pictures only.
const MAX_LEVELS: u32 = 16;
/// Bytes of a UASTC block of 4×4 texels.
const UASTC_BLOCK_BYTES: u64 = 16;
const NO_SUPERCOMPRESSION: u32 = 0;
const BASIS_LZ: u32 = 1;
const ZSTANDARD: u32 = 2;

/// Returns a picture's size.
/// Errors with a sentence if the container is cut, or is not of one flat picture in Basis Universal.
pub(super) fn size(encoded: &[u8]) -> Result<(u32, u32), String> {
    let cut = || "it is a cut KTX picture".to_owned();
    if encoded.len() < HEAD_BYTES {
        return Err(cut());
    }
    let [format, _, width, height, depth, layers, faces, levels, scheme, at, description_bytes] =
        std::array::from_fn(|word| u32_at(encoded, 12 + 4 * word));
    if format != 0 {
        return Err("it is a KTX picture in another format than Basis Universal".to_owned());
    }
    if depth != 0 || layers > 1 || faces != 1 {
        return Err("it is a KTX picture with depth, layers or faces".to_owned());
    }
    let (global, global_bytes) = (u64_at(encoded, 64), u64_at(encoded, 72));
    let inside = |start: u64, bytes: u64| start.checked_add(bytes).is_some_and(|end| end <= encoded.len() as u64);
    let index_bytes = u64::from(levels) * LEVEL_BYTES as u64;
    let parts = [(HEAD_BYTES as u64, index_bytes), (at.into(), description_bytes.into()), (global, global_bytes)];
    if levels == 0 || !parts.into_iter().all(|(start, bytes)| inside(start, bytes)) {
        return Err(cut());
    }
    if !matches!(scheme, NO_SUPERCOMPRESSION | BASIS_LZ | ZSTANDARD) {
        return Err(format!("it is a KTX picture with supercompression {scheme}, which is not supported"));
    }
    for level in 0..levels.min(MAX_LEVELS) {
        let at = HEAD_BYTES + level as usize * LEVEL_BYTES;
        let (start, bytes, raw_bytes) = (u64_at(encoded, at), u64_at(encoded, at + 8), u64_at(encoded, at + 16));
        if !inside(start, bytes) {
            return Err(cut());
        }
        // What is decompressed is exactly the blocks.
        let [width, height] = [width, height].map(|side| (side >> level).max(1));
        let blocks = u64::from(width.div_ceil(4)) * u64::from(height.div_ceil(4));
        if scheme == ZSTANDARD && raw_bytes != blocks.saturating_mul(UASTC_BLOCK_BYTES) {
            return Err(format!("its {width}×{height} pixels do not make {raw_bytes} bytes"));
        }
    }
    Ok((width, height))
}

/// Decodes one level of a picture, whose sides are halved so many times or less. Returns how often they are.
/// Call it only with what [`size`] has checked.
pub(super) fn decode(encoded: &[u8], width: u32, height: u32, halvings: u32) -> Result<(u32, Vec<u8>), String> {
    let level = halvings.min(u32_at(encoded, 40).saturating_sub(1)).min(MAX_LEVELS - 1);
    let decoded = catch_unwind(|| {
        let transcoder = Transcoder::new(encoded).map_err(|error| format!("{error:?}"))?;
        if !matches!(transcoder.source_format(), SourceFormat::Etc1s | SourceFormat::UastcLdr) {
            return Err(format!("{:?}", transcoder.source_format()));
        }
        transcoder.transcode(level, TargetFormat::Rgba32, DecodeFlags::NONE).map_err(|error| format!("{error:?}"))
    });
    let rgba = decoded.unwrap_or_else(|_| Err("the decoder failed".to_owned()));
    let rgba = rgba.map_err(|fault| format!("its Basis Universal data are broken or not supported: {fault}"))?;
    let [width, height] = [width, height].map(|side| (side >> level).max(1));
    if rgba.len() as u64 == super::area::area(width, height) * 4 {
        Ok((level, rgba))
    } else {
        Err(format!("its head says {width}×{height} pixels, its body has {} bytes", rgba.len()))
    }
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    bytes.get(at..).and_then(|bytes| bytes.first_chunk()).copied().map_or(0, u32::from_le_bytes)
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    bytes.get(at..).and_then(|bytes| bytes.first_chunk()).copied().map_or(0, u64::from_le_bytes)
}
