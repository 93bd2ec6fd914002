use std::{fmt, num::NonZeroU16};

use super::{
    baseline,
    encoded_frame::EncodedFrame,
    error::EncodeError,
    form::Form,
    tiles::{self, Mode, Reference},
};
use crate::{
    frame::{FrameHead, slice_tile_rows},
    header::HEADER_BYTES,
    ids::FrameNumber,
    limits::{MAX_FRAME_BYTES, MAX_PACKET_BYTES},
    mask::Mask,
    pose::Pose,
    wire::CodecId,
};

/// Encodes masks. Reuses its memory from frame to frame.
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
    /// Makes frames of one slice.
    #[must_use]
    pub fn new(codec: CodecId) -> Self {
        Self::with_slices(codec, NonZeroU16::MIN)
    }

    /// Makes frames of `slices` slices, at most one per row of tiles. [Sliced](CodecId::is_sliced) codecs ignore the
    /// number and make one slice per packet.
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

    /// Makes each part of a sliced frame fit a packet of `max_packet_bytes` bytes, header included.
    #[must_use]
    pub fn for_packets_of(mut self, max_packet_bytes: usize) -> Self {
        self.packet_bytes = max_packet_bytes;
        self
    }

    #[must_use]
    pub const fn codec(&self) -> CodecId {
        self.codec
    }

    /// Encodes a mask into `frame`, replacing its content.
    ///
    /// # Errors
    /// If the frame would be longer than [`MAX_FRAME_BYTES`].
    pub fn encode(&mut self, mask: &Mask, frame: &mut EncodedFrame) -> Result<(), EncodeError> {
        self.encode_for(None, None, mask, frame)
    }

    /// As [`Self::encode`], for a mask traced for another pose than the client's, and against a reference that the
    /// client has. The reference is ignored by codecs without references and for masks of another shape.
    ///
    /// # Errors
    /// As [`Self::encode`].
    pub fn encode_for(
        &mut self,
        traced_for: Option<Pose>,
        reference: Option<&Reference>,
        mask: &Mask,
        frame: &mut EncodedFrame,
    ) -> Result<(), EncodeError> {
        frame.body.clear();
        frame.parts.clear();
        self.tiles.begin(None);
        let shape = mask.shape();
        let reference = reference.filter(|known| self.codec.has_references() && known.shape() == Some(shape));
        let head = FrameHead { codec: self.codec, shape, traced_for, reference: reference.map(Reference::name) };
        let form = match Form::of(self.codec) {
            Form::Rows(form) => form,
            Form::Tiles(profile) => {
                let slice_bytes = self.packet_bytes.saturating_sub(HEADER_BYTES + head.part_bytes());
                self.tiles.encode(Mode::new(profile, reference), &head, mask, slice_bytes, frame);
                return checked_length(&frame.body);
            }
        };
        let body = &mut frame.body;
        let count = u16::try_from(head.max_slices()).unwrap_or(u16::MAX).min(self.slices.get());
        head.begin(count, body);
        for slice in 0..usize::from(count) {
            let start = body.len();
            self.rows.append(form, mask, &slice_tile_rows(shape, slice, count.into()), body);
            let too_long = EncodeError::TooLong(body.len());
            let bytes = u32::try_from(body.len() - start).map_err(|_| too_long)?;
            head.set_slice_length(body, slice, bytes);
        }
        checked_length(body)
    }

    /// Makes `reference` the last encoded mask, named `frame`. Returns false, and leaves `reference` unchanged, if the
    /// codec has no references.
    pub fn keep(&self, frame: FrameNumber, reference: &mut Reference) -> bool {
        self.tiles.keep(frame, reference)
    }
}

fn checked_length(body: &[u8]) -> Result<(), EncodeError> {
    if body.len() > MAX_FRAME_BYTES { Err(EncodeError::TooLong(body.len())) } else { Ok(()) }
}
