//! Visibility codecs: a mask to bytes and back.
//!
//! | codec | raw bytes of a slice | in the frame |
//! |---|---|---|
//! | `words` | a u32 a pixel, row by row (dissertation §3.1) | as they are |
//! | `words-lz4` | the same | LZ4 block (dissertation §3.5) |
//! | `planes-lz4` | for each light the slice's 8×8 tiles, a u64 each | LZ4 block |
//!
//! A compressed slice that would not be shorter than its raw bytes is sent as these. The decoder is strict: a slice
//! gives exactly its raw bytes; bits of words that stand for no light of the frame, and bits of tiles that lie outside
//! the picture, are 0 or the frame is refused. The encoder writes such bits as 0 whatever the mask has there.
//!
//! Encoder and decoder keep their memory: once they have seen the largest frame, they take none.

mod id;
mod lz4;
mod planes;
mod words;

use std::{fmt, num::NonZeroU16, ops::Range};

use lz4_flex::block::DecompressError;
use thiserror::Error;

pub use self::id::{CodecId, UnknownCodec};
use crate::{
    frame::{Frame, FrameError, FrameHead, slice_tile_rows},
    limits::MAX_FRAME_BYTES,
    mask::{Mask, MaskShape, TILE_PX},
    pose::Pose,
};

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
}

/// Encodes masks; keeps its memory from frame to frame.
pub struct Encoder {
    codec: CodecId,
    slices: NonZeroU16,
    raw: Vec<u8>,
    lz4: lz4::Compressor,
}

impl fmt::Debug for Encoder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Encoder").field("codec", &self.codec).field("slices", &self.slices).finish_non_exhaustive()
    }
}

impl Encoder {
    /// An encoder that makes frames of one slice.
    #[must_use]
    pub fn new(codec: CodecId) -> Self {
        Self::with_slices(codec, NonZeroU16::MIN)
    }

    /// An encoder that makes frames of `slices` slices, or as many as the mask has rows of tiles if these are fewer.
    #[must_use]
    pub fn with_slices(codec: CodecId, slices: NonZeroU16) -> Self {
        Self { codec, slices, raw: Vec::new(), lz4: lz4::Compressor::new() }
    }

    /// What the frames are encoded with.
    #[must_use]
    pub const fn codec(&self) -> CodecId {
        self.codec
    }

    /// Replaces what is in `body` by the mask's frame.
    ///
    /// # Errors
    /// When the frame would be longer than [`MAX_FRAME_BYTES`].
    pub fn encode(&mut self, mask: &Mask, body: &mut Vec<u8>) -> Result<(), EncodeError> {
        self.encode_for(None, mask, body)
    }

    /// As [`Self::encode`], of a mask that was traced for another pose than the client's own.
    ///
    /// # Errors
    /// As [`Self::encode`].
    pub fn encode_for(&mut self, traced_for: Option<Pose>, mask: &Mask, body: &mut Vec<u8>) -> Result<(), EncodeError> {
        body.clear();
        let shape = mask.shape();
        let head = FrameHead { codec: self.codec, shape, traced_for };
        let count = u16::try_from(head.max_slices()).unwrap_or(u16::MAX).min(self.slices.get());
        head.begin(count, body);
        for slice in 0..usize::from(count) {
            let start = body.len();
            self.append_slice(mask, &slice_tile_rows(shape, slice, count.into()), body);
            let too_long = EncodeError::TooLong(body.len());
            let bytes = u32::try_from(body.len() - start).map_err(|_| too_long)?;
            head.set_slice_length(body, slice, bytes);
        }
        if body.len() > MAX_FRAME_BYTES { Err(EncodeError::TooLong(body.len())) } else { Ok(()) }
    }

    fn append_slice(&mut self, mask: &Mask, rows: &Range<usize>, body: &mut Vec<u8>) {
        let (shape, words) = (mask.shape(), mask.words());
        match self.codec {
            CodecId::Words => {
                for row in rows.clone() {
                    let bytes = at_least(&mut self.raw, raw_bytes(self.codec, shape, &(row..row + 1)));
                    words::from_planes(shape, words, row, bytes);
                    body.extend_from_slice(bytes);
                }
            }
            CodecId::WordsLz4 => {
                let raw = at_least(&mut self.raw, raw_bytes(self.codec, shape, rows));
                let mut rest = &mut *raw;
                for row in rows.clone() {
                    let bytes = raw_bytes(self.codec, shape, &(row..row + 1));
                    let (head, tail) = rest.split_at_mut(bytes);
                    words::from_planes(shape, words, row, head);
                    rest = tail;
                }
                body.extend_from_slice(self.lz4.compress(raw));
            }
            CodecId::PlanesLz4 => {
                let raw = at_least(&mut self.raw, raw_bytes(self.codec, shape, rows));
                planes::write(shape, words, rows, raw);
                body.extend_from_slice(self.lz4.compress(raw));
            }
        }
    }
}

/// Decodes frames; keeps its memory from frame to frame.
#[derive(Debug, Default)]
pub struct Decoder {
    raw: Vec<u8>,
}

impl Decoder {
    /// A decoder for all codecs.
    #[must_use]
    pub const fn new() -> Self {
        Self { raw: Vec::new() }
    }

    /// Decodes a frame into `mask`, which takes the frame's shape: whoever expects a certain one looks at it after,
    /// or at [`Frame::parse`]'s head before. All sizes are checked before memory is taken, which is never more than
    /// the raw bytes of one slice and the mask.
    ///
    /// # Errors
    /// When the body is not exactly one frame. The mask is then one of some shape, with bits of no meaning.
    pub fn decode(&mut self, body: &[u8], mask: &mut Mask) -> Result<CodecId, DecodeError> {
        let frame = Frame::parse(body)?;
        let FrameHead { codec, shape, .. } = frame.head;
        for (slice, (rows, bytes)) in frame.slices().enumerate() {
            let (found, raw) = (bytes.len(), raw_bytes(codec, shape, &rows));
            let fits = match codec {
                CodecId::Words => found == raw,
                CodecId::WordsLz4 | CodecId::PlanesLz4 => lz4::can_be(found, raw),
            };
            if !fits {
                return Err(DecodeError::SliceLength { slice, found, raw });
            }
        }
        if mask.shape() != shape {
            mask.reset(shape);
        }
        for (slice, (rows, bytes)) in frame.slices().enumerate() {
            self.decode_slice(codec, slice, &rows, bytes, mask)?;
        }
        Ok(codec)
    }

    fn decode_slice(
        &mut self,
        codec: CodecId,
        slice: usize,
        rows: &Range<usize>,
        bytes: &[u8],
        mask: &mut Mask,
    ) -> Result<(), DecodeError> {
        let shape = mask.shape();
        let raw_len = raw_bytes(codec, shape, rows);
        let raw = match codec {
            CodecId::Words => bytes,
            CodecId::WordsLz4 | CodecId::PlanesLz4 => {
                lz4::decompress(bytes, raw_len, &mut self.raw).map_err(|failure| match failure {
                    lz4::Failure::Block(source) => DecodeError::Lz4 { slice, source },
                    lz4::Failure::Short(found) => DecodeError::Short { slice, found, raw: raw_len },
                })?
            }
        };
        match codec {
            CodecId::Words | CodecId::WordsLz4 => {
                let mut rest = raw;
                for row in rows.clone() {
                    let (head, tail) = rest.split_at(raw_bytes(codec, shape, &(row..row + 1)));
                    words::to_planes(shape, head, row, mask.words_mut()).map_err(|words::StrayLights(set)| {
                        DecodeError::StrayLights { slice, set, lights: shape.lights() }
                    })?;
                    rest = tail;
                }
                Ok(())
            }
            CodecId::PlanesLz4 => planes::read(shape, raw, rows, mask.words_mut())
                .map_err(|planes::StrayPixels { light, tile }| DecodeError::StrayPixels { light, tile }),
        }
    }
}

/// Bytes that the rows of tiles `rows` take before compression; there is at least one row.
fn raw_bytes(codec: CodecId, shape: MaskShape, rows: &Range<usize>) -> usize {
    match codec {
        CodecId::Words | CodecId::WordsLz4 => {
            let pixel_rows = (rows.end * TILE_PX as usize).min(shape.height() as usize) - rows.start * TILE_PX as usize;
            pixel_rows * shape.width() as usize * words::WORD_BYTES
        }
        CodecId::PlanesLz4 => rows.len() * shape.tiles_x() as usize * shape.lights() as usize * planes::TILE_BYTES,
    }
}

/// The first `len` bytes of a buffer that is only ever lengthened.
fn at_least(buffer: &mut Vec<u8>, len: usize) -> &mut [u8] {
    if buffer.len() < len {
        buffer.resize(len, 0);
    }
    &mut buffer[..len]
}
