//! Errors of the encoder and the decoder.

use lz4_flex::block::DecompressError;
use thiserror::Error;

use super::tiles;
use crate::{frame::FrameError, ids::ReferenceName, limits::MAX_FRAME_BYTES};

#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum EncodeError {
    /// Only noise in 32 lights at more than 8.2 million pixels takes so many bytes.
    #[error("the frame takes {0} bytes, at most {MAX_FRAME_BYTES} are allowed")]
    TooLong(usize),
}

#[derive(Debug, Error)]
pub enum DecodeError {
    #[error(transparent)]
    Frame(#[from] FrameError),
    #[error("slice {slice} has {found} bytes, which cannot hold {raw} raw bytes")]
    SliceLength { slice: usize, found: usize, raw: usize },
    #[error("slice {slice}: {source}")]
    Lz4 { slice: usize, source: DecompressError },
    #[error("slice {slice} has {found} raw bytes, not {raw}")]
    Short { slice: usize, found: usize, raw: usize },
    /// `set` holds all bits that are set in some word.
    #[error("words of slice {slice} have bits of {set:#x} set, the frame has {lights} lights")]
    StrayLights { slice: usize, set: u32, lights: u32 },
    /// `tile` is an index in the plane.
    #[error("tile {tile} of light {light} has bits outside the picture")]
    StrayPixels { light: usize, tile: usize },
    /// The reference that the frame is coded against is missing.
    #[error("reference frame {frame} with digest {digest:#010x} is missing", frame = .0.frame, digest = .0.digest)]
    Reference(ReferenceName),
    /// The frame is not sliced, or does not have the target mask's shape.
    #[error("the frame is not sliced or has another shape than the mask")]
    NoParts,
    /// The slices do not cover the picture's blocks in order. `slice` is the number of slices if blocks are missing at
    /// the end.
    #[error("slice {slice} has no blocks, or not the next ones")]
    Blocks { slice: usize },
    #[error("slice {slice} has fewer or more bits than its blocks")]
    Bits { slice: usize },
}

impl DecodeError {
    pub(super) const fn of_tiles(slice: usize, failure: tiles::Failure) -> Self {
        match failure {
            tiles::Failure::Blocks => Self::Blocks { slice },
            tiles::Failure::Bits => Self::Bits { slice },
        }
    }
}
