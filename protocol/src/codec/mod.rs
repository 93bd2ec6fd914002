//! Visibility codecs: a mask to bytes and back.
//!
//! | codec | raw bytes of a slice | in the frame |
//! |---|---|---|
//! | `words` | a u32 a pixel, row by row (dissertation §3.1) | as they are |
//! | `words-lz4` | the same | LZ4 block (dissertation §3.5) |
//! | `planes-lz4` | for each light the slice's 8×8 tiles, a u64 each | LZ4 block |
//! | `tiles-small`, `tiles-fast` | – | [`tiles`], in as many slices as datagrams are needed |
//!
//! A compressed slice that would not be shorter than its raw bytes is sent as these. The decoder is strict: a slice
//! gives exactly its raw bytes; bits of words that stand for no light of the frame, and bits of tiles that lie outside
//! the picture, are 0 or the frame is refused. The encoder writes such bits as 0 whatever the mask has there.
//!
//! All codecs give every other bit back. Who wants fewer bytes for some wrong bits puts a [`Simplifier`] before them.
//!
//! Encoder and decoder keep their memory: once they have seen the largest frame, they take none.

mod baseline;
mod simplify;
mod tiles;
mod transpose;

use std::{fmt, num::NonZeroU16, ops::Range};

use lz4_flex::block::DecompressError;
use thiserror::Error;

pub use self::simplify::Simplifier;
#[doc(hidden)]
pub use self::tiles::train as train_tiles;
pub use self::tiles::{Reference, ReferenceName};
pub use crate::wire::{CodecId, UnknownCodec};
use crate::{
    coverage::Coverage,
    frame::{Frame, FrameError, FrameHead, slice_tile_rows},
    header::HEADER_BYTES,
    ids::FrameNumber,
    limits::{MAX_FRAME_BYTES, MAX_PACKET_BYTES},
    mask::{Mask, MaskShape},
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
    const fn of_tiles(slice: usize, failure: tiles::Failure) -> Self {
        match failure {
            tiles::Failure::Blocks => Self::Blocks { slice },
            tiles::Failure::Bits => Self::Bits { slice },
        }
    }
}

/// Encodes masks; keeps its memory from frame to frame.
pub struct Encoder {
    codec: CodecId,
    slices: NonZeroU16,
    packet_bytes: usize,
    rows: baseline::Writer,
    tiles: tiles::Workspace,
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
    /// Codecs whose frames are sliced ([`CodecId::is_sliced`]) take as many as are needed instead.
    #[must_use]
    pub fn with_slices(codec: CodecId, slices: NonZeroU16) -> Self {
        Self {
            codec,
            slices,
            packet_bytes: MAX_PACKET_BYTES,
            rows: baseline::Writer::new(),
            tiles: tiles::Workspace::new(),
        }
    }

    /// Each of the slices fits a packet of `max_packet_bytes` bytes with the packet's header and the frame's head, where
    /// the frames are sliced.
    #[must_use]
    pub fn for_packets_of(mut self, max_packet_bytes: usize) -> Self {
        self.packet_bytes = max_packet_bytes;
        self
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
        self.encode_for(None, None, mask, body)
    }

    /// As [`Self::encode`], of a mask that was traced for another pose than the client's own, and against a reference that the
    /// client has. The codecs that know none do without, and so does a mask of another shape.
    ///
    /// # Errors
    /// As [`Self::encode`].
    pub fn encode_for(
        &mut self,
        traced_for: Option<Pose>,
        reference: Option<&Reference>,
        mask: &Mask,
        body: &mut Vec<u8>,
    ) -> Result<(), EncodeError> {
        body.clear();
        self.tiles.begin(None);
        let shape = mask.shape();
        let reference = reference.filter(|known| self.codec.has_references() && known.shape() == Some(shape));
        let head = FrameHead { codec: self.codec, shape, traced_for, reference: reference.map(Reference::name) };
        let form = match Form::of(self.codec) {
            Form::Rows(form) => form,
            Form::Tiles(profile) => return self.encode_sliced(&head, profile, reference, mask, body),
        };
        let count = u16::try_from(head.max_slices()).unwrap_or(u16::MAX).min(self.slices.get());
        head.begin(count, body);
        for slice in 0..usize::from(count) {
            let start = body.len();
            self.rows.append(form, mask, &slice_tile_rows(shape, slice, count.into()), body);
            let too_long = EncodeError::TooLong(body.len());
            let bytes = u32::try_from(body.len() - start).map_err(|_| too_long)?;
            head.set_slice_length(body, slice, bytes);
        }
        if body.len() > MAX_FRAME_BYTES { Err(EncodeError::TooLong(body.len())) } else { Ok(()) }
    }

    /// Makes a reference of the mask that was encoded last, as `frame`. Says no, and leaves `reference` as it is, where its codec
    /// has no references.
    pub fn keep(&self, frame: FrameNumber, reference: &mut Reference) -> bool {
        self.tiles.keep(frame, reference)
    }

    /// A part for each slice.
    fn encode_sliced(
        &mut self,
        head: &FrameHead,
        profile: tiles::Profile,
        reference: Option<&Reference>,
        mask: &Mask,
        body: &mut Vec<u8>,
    ) -> Result<(), EncodeError> {
        let slice_bytes = self.packet_bytes.saturating_sub(HEADER_BYTES + head.part_bytes());
        let open = |body: &mut Vec<u8>| head.begin(1, body);
        // No slice is longer than its blocks' bits at 12 bits each.
        let close = |part: &mut [u8], bytes| head.set_slice_length(part, 0, u32::try_from(bytes).unwrap_or(u32::MAX));
        self.tiles.encode(tiles::Way::new(profile, reference), mask, slice_bytes, body, open, close);
        if body.len() > MAX_FRAME_BYTES { Err(EncodeError::TooLong(body.len())) } else { Ok(()) }
    }
}

/// How a codec's slices come about.
#[derive(Debug, Clone, Copy)]
enum Form {
    Rows(baseline::Form),
    Tiles(tiles::Profile),
}

impl Form {
    const fn of(codec: CodecId) -> Self {
        match codec {
            CodecId::Words => Self::Rows(baseline::Form::Words),
            CodecId::WordsLz4 => Self::Rows(baseline::Form::WordsLz4),
            CodecId::PlanesLz4 => Self::Rows(baseline::Form::PlanesLz4),
            CodecId::TilesSmall => Self::Tiles(tiles::Profile::Small),
            CodecId::TilesFast => Self::Tiles(tiles::Profile::Fast),
        }
    }
}

/// Decodes frames; keeps its memory from frame to frame.
pub struct Decoder {
    raw: Vec<u8>,
    tiles: tiles::Workspace,
}

impl fmt::Debug for Decoder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Decoder").finish_non_exhaustive()
    }
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// A decoder for all codecs.
    #[must_use]
    pub fn new() -> Self {
        Self { raw: Vec::new(), tiles: tiles::Workspace::new() }
    }

    /// Decodes a frame into `mask`, which takes the frame's shape: whoever expects a certain one looks at it after,
    /// or at [`Frame::parse`]'s head before. All sizes are checked before memory is taken, which is never more than
    /// the mask and the raw bytes of one slice, or some times the mask where frames are sliced.
    ///
    /// # Errors
    /// When the body is not exactly one frame, or is coded against a reference. The mask is then one of some shape, with bits
    /// of no meaning.
    pub fn decode(&mut self, body: &[u8], mask: &mut Mask) -> Result<CodecId, DecodeError> {
        self.decode_against(None, body, mask)
    }

    /// As [`Self::decode`], of a frame that may be coded against this reference.
    ///
    /// # Errors
    /// As [`Self::decode`], or when the frame is coded against another reference.
    pub fn decode_against(
        &mut self,
        reference: Option<&Reference>,
        body: &[u8],
        mask: &mut Mask,
    ) -> Result<CodecId, DecodeError> {
        self.tiles.begin(None);
        let frame = Frame::parse(body)?;
        let FrameHead { codec, shape, .. } = frame.head;
        match Form::of(codec) {
            Form::Rows(form) => {
                for (slice, (rows, bytes)) in frame.slices().enumerate() {
                    baseline::check_length(form, shape, slice, &rows, bytes.len())?;
                }
                if mask.shape() != shape {
                    mask.reset(shape);
                }
                for (slice, (rows, bytes)) in frame.slices().enumerate() {
                    baseline::read(form, &mut self.raw, slice, &rows, bytes, mask)?;
                }
            }
            Form::Tiles(profile) => {
                check_cover(shape, body)?;
                let reference = named(&frame.head, reference)?;
                if mask.shape() != shape {
                    mask.reset(shape);
                }
                self.decode_parts(profile, reference, body, mask)?;
            }
        }
        Ok(codec)
    }

    /// Decodes those parts of a sliced frame that have come, in any order; the rest of `mask` stays as it is.
    ///
    /// # Errors
    /// When the body does not consist of parts of one frame with the mask's shape, or is coded against another reference. Some
    /// tiles of `mask` may have changed, but none where it is the reference that is missing.
    pub fn decode_onto(
        &mut self,
        reference: Option<&Reference>,
        body: &[u8],
        mask: &mut Mask,
    ) -> Result<CodecId, DecodeError> {
        self.tiles.begin(None);
        self.decode_more(reference, body, mask)
    }

    /// As [`Self::decode_onto`], of further parts of the frame of which others were decoded last: the mask can be
    /// [kept](Self::keep) when all have come, one after the other.
    ///
    /// # Errors
    /// As [`Self::decode_onto`].
    pub fn decode_more(
        &mut self,
        reference: Option<&Reference>,
        body: &[u8],
        mask: &mut Mask,
    ) -> Result<CodecId, DecodeError> {
        let head = Frame::parse(body)?.head;
        match Form::of(head.codec) {
            Form::Tiles(profile) if head.shape == mask.shape() => {
                let reference = named(&head, reference)?;
                self.decode_parts(profile, reference, body, mask).map(|()| head.codec)
            }
            Form::Tiles(_) | Form::Rows(_) => Err(DecodeError::NoParts),
        }
    }

    fn decode_parts(
        &mut self,
        profile: tiles::Profile,
        reference: Option<&Reference>,
        body: &[u8],
        mask: &mut Mask,
    ) -> Result<(), DecodeError> {
        let way = tiles::Way::new(profile, reference);
        self.tiles.go_on(way, mask.shape());
        Frame::parts(body).try_for_each(|part| part.map(drop))?;
        let slices = || {
            let parts = Frame::parts(body).map_while(Result::ok).enumerate();
            parts.flat_map(|(slice, part)| part.slices().map(move |(_, bytes)| (slice, bytes)))
        };
        let decoded = self.tiles.decode(way, slices, mask);
        decoded.map_err(|(slice, failure)| DecodeError::of_tiles(slice, failure))
    }

    /// Says what of the frame that was decoded last, which had this shape, has come.
    pub fn coverage(&self, shape: MaskShape, coverage: &mut Coverage) {
        self.tiles.coverage(shape, coverage);
    }

    /// Makes a reference of the mask that was decoded last, as `frame`. Says no, and leaves `reference` as it is, where not all
    /// of it had come, or its codec has no references.
    pub fn keep(&self, frame: FrameNumber, reference: &mut Reference) -> bool {
        self.tiles.keep(frame, reference)
    }
}

/// Places, in a mask's words, of the tiles that a part of a sliced frame holds; none of any other bytes.
pub fn part_words(shape: MaskShape, part: &[u8]) -> impl Iterator<Item = Range<usize>> + use<> {
    let blocks = Frame::parse(part)
        .ok()
        .filter(|frame| frame.head.codec.is_sliced() && frame.head.shape == shape)
        .and_then(|frame| tiles::blocks_of(shape, frame.slices().next()?.1));
    tiles::words_of(shape, blocks.unwrap_or(0..0))
}

/// The reference that a frame names, which must be the one at hand.
fn named<'a>(head: &FrameHead, reference: Option<&'a Reference>) -> Result<Option<&'a Reference>, DecodeError> {
    let Some(name) = head.reference else { return Ok(None) };
    let known = reference.filter(|known| known.name() == name && known.shape() == Some(head.shape));
    known.map(Some).ok_or(DecodeError::Reference(name))
}

/// Whether the parts hold the picture's blocks one after the other.
fn check_cover(shape: MaskShape, body: &[u8]) -> Result<(), DecodeError> {
    let (mut next, mut count) = (0, 0);
    for (slice, part) in Frame::parts(body).enumerate() {
        for (_, bytes) in part?.slices() {
            let blocks = tiles::blocks_of(shape, bytes).filter(|blocks| blocks.start == next);
            next = blocks.ok_or(DecodeError::Blocks { slice })?.end;
        }
        count = slice + 1;
    }
    if next == tiles::block_count(shape) { Ok(()) } else { Err(DecodeError::Blocks { slice: count }) }
}
