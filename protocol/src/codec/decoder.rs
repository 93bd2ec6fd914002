//! Decodes frame bodies into masks.

use std::fmt;

use super::{
    baseline,
    error::DecodeError,
    form::Form,
    tiles::{self, Mode, Reference},
};
use crate::{
    coverage::Coverage,
    frame::{Frame, FrameHead},
    ids::FrameNumber,
    mask::{Mask, MaskShape},
    wire::CodecId,
};

/// Decodes frames. Reuses its memory from frame to frame.
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
    #[must_use]
    pub fn new() -> Self {
        Self { raw: Vec::new(), tiles: tiles::Workspace::new() }
    }

    /// Decodes a whole frame into `mask`, which takes the frame's shape. To require a shape, check [`Frame::parse`]'s
    /// head first. Sizes are checked before memory is allocated: at most the mask and the raw bytes of one slice, or a
    /// few times the mask for sliced frames.
    ///
    /// # Errors
    /// If the body is not exactly one frame, or is coded against a reference. The mask's content is then unspecified.
    pub fn decode(&mut self, body: &[u8], mask: &mut Mask) -> Result<CodecId, DecodeError> {
        self.decode_against(None, body, mask)
    }

    /// As [`Self::decode`], for a frame that may be coded against `reference`.
    ///
    /// # Errors
    /// As [`Self::decode`], or if the frame is coded against another reference.
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

    /// Decodes the parts of a sliced frame that have arrived, in any order. Other tiles of `mask` keep their bits.
    ///
    /// # Errors
    /// If the body does not consist of parts of one frame with the mask's shape, or is coded against another reference.
    /// Some tiles of `mask` may have changed; none if the reference is missing.
    pub fn decode_onto(
        &mut self,
        reference: Option<&Reference>,
        body: &[u8],
        mask: &mut Mask,
    ) -> Result<CodecId, DecodeError> {
        self.tiles.begin(None);
        self.decode_more(reference, body, mask)
    }

    /// As [`Self::decode_onto`], for more parts of the last decoded frame. Once all have arrived, the mask can be
    /// [kept](Self::keep).
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
        let mode = Mode::new(profile, reference);
        self.tiles.resume(mode, mask.shape());
        Frame::parts(body).try_for_each(|part| part.map(drop))?;
        let slices = || {
            let parts = Frame::parts(body).map_while(Result::ok).enumerate();
            parts.flat_map(|(slice, part)| part.slices().map(move |(_, bytes)| (slice, bytes)))
        };
        let decoded = self.tiles.decode(mode, slices, mask);
        decoded.map_err(|(slice, failure)| DecodeError::of_tiles(slice, failure))
    }

    /// Writes which tiles of the last decoded frame, of shape `shape`, arrived.
    pub fn coverage(&self, shape: MaskShape, coverage: &mut Coverage) {
        self.tiles.coverage(shape, coverage);
    }

    /// Makes `reference` the last decoded mask, named `frame`. Returns false, and leaves `reference` unchanged, if
    /// parts are missing or the codec has no references.
    pub fn keep(&self, frame: FrameNumber, reference: &mut Reference) -> bool {
        self.tiles.keep(frame, reference)
    }
}

/// Returns the reference that a frame names, if any. Errors unless it is `reference`.
fn named<'a>(head: &FrameHead, reference: Option<&'a Reference>) -> Result<Option<&'a Reference>, DecodeError> {
    let Some(name) = head.reference else { return Ok(None) };
    let known = reference.filter(|known| known.name() == name && known.shape() == Some(head.shape));
    known.map(Some).ok_or(DecodeError::Reference(name))
}

/// Errors unless the parts hold all blocks of the picture, in order.
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
