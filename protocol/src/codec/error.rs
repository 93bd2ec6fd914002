//! Why a mask cannot be encoded or a body decoded.

use lz4_flex::block::DecompressError;
use thiserror::Error;

use super::tiles;
use crate::{frame::FrameError, ids::ReferenceName, limits::MAX_FRAME_BYTES};

/// Why a mask cannot be encoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum EncodeError {
    /// The frame would be longer than allowed. Only noise in 32 lights at more than 8.2 million pixels comes to this.
    #[error("the frame takes {0} bytes, at most {MAX_FRAME_BYTES} are allowed")]
    TooLong(usize),
}

/// Why a body cannot be decoded.
#[derive(Debug, Error)]
pub enum DecodeError {
    /// The body is no frame.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// A slice is too short or too long for what it stands for.
    #[error("slice {slice} has {found} bytes, which cannot stand for {raw} bytes")]
    SliceLength {
        /// The slice's place.
        slice: usize,
        /// Its length.
        found: usize,
        /// Raw bytes that it stands for.
        raw: usize,
    },
    /// A slice is no LZ4 block.
    #[error("slice {slice}: {source}")]
    Lz4 {
        /// The slice's place.
        slice: usize,
        /// What LZ4 says.
        source: DecompressError,
    },
    /// A slice decompresses to fewer bytes than it stands for.
    #[error("slice {slice} has {found} raw bytes, not {raw}")]
    Short {
        /// The slice's place.
        slice: usize,
        /// Raw bytes that it has.
        found: usize,
        /// Raw bytes that it stands for.
        raw: usize,
    },
    /// A word has bits that stand for no light.
    #[error("words of slice {slice} have bits of {set:#x} set, the frame has {lights} lights")]
    StrayLights {
        /// The slice's place.
        slice: usize,
        /// All bits that are set in some word.
        set: u32,
        /// Lights of the frame.
        lights: u32,
    },
    /// A tile has bits outside the picture.
    #[error("tile {tile} of light {light} has bits outside the picture")]
    StrayPixels {
        /// The light.
        light: usize,
        /// The tile's place in its plane.
        tile: usize,
    },
    /// The frame is coded against a mask that is not at hand.
    #[error("frame {frame} with digest {digest:#010x} is needed, and not at hand", frame = .0.frame, digest = .0.digest)]
    Reference(ReferenceName),
    /// The frame is not sliced, or has another shape than the mask that it is to be put into.
    #[error("the frame has no parts, or another shape")]
    NoParts,
    /// The slices do not cover the picture's blocks one after the other.
    #[error("slice {slice} has no blocks, or not those that follow the ones before")]
    Blocks {
        /// The slice's place, or the number of slices when blocks are missing at the end.
        slice: usize,
    },
    /// A slice has fewer or more bits than its blocks take.
    #[error("slice {slice} has fewer or more bits than its blocks")]
    Bits {
        /// The slice's place.
        slice: usize,
    },
}

impl DecodeError {
    pub(super) const fn of_tiles(slice: usize, failure: tiles::Failure) -> Self {
        match failure {
            tiles::Failure::Blocks => Self::Blocks { slice },
            tiles::Failure::Bits => Self::Bits { slice },
        }
    }
}
