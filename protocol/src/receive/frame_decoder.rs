//! Decodes reassembled frames, in whole or in part, and keeps the masks that later frames may be coded against.

use thiserror::Error;

use super::reassembler::{CompleteFrame, Policy};
use crate::{
    acknowledgement::Acknowledgement,
    codec::{DecodeError, Decoder},
    coverage::Coverage,
    frame::{Frame, FrameError, FrameHead},
    ids::FrameNumber,
    mask::{Mask, MaskShape},
    pose::Pose,
    references::KeptMasks,
};

/// A reassembled frame that is not a mask.
#[derive(Debug, Error)]
#[error("frame {frame}: {reason}")]
pub struct BadFrame {
    pub frame: FrameNumber,
    pub reason: BadFrameReason,
}

#[derive(Debug, Error)]
pub enum BadFrameReason {
    #[error(transparent)]
    Frame(#[from] FrameError),
    #[error("its shape is {found:?}, {largest:?} is the largest agreed on")]
    Shape { found: MaskShape, largest: MaskShape },
    #[error(transparent)]
    Decode(#[from] DecodeError),
}

#[derive(Debug)]
pub(super) struct FrameDecoder {
    decoder: Decoder,
    largest: MaskShape,
    /// Under [`Policy::Slices`], the newest value of each tile.
    newest: Option<Mask>,
    /// `None` if the server is to code every frame on its own.
    kept: Option<KeptMasks>,
}

impl FrameDecoder {
    pub(super) fn new(policy: Policy, largest: MaskShape, keeps_references: bool) -> Self {
        Self {
            decoder: Decoder::new(),
            largest,
            newest: (policy == Policy::Slices).then(|| Mask::new(largest)),
            kept: keeps_references.then(KeptMasks::default),
        }
    }

    /// Decodes a frame into `mask` and its arrived tiles into `coverage`. Returns the traced pose if the head has one.
    /// Writes what to tell the server into `acknowledgement`.
    pub(super) fn decode(
        &mut self,
        frame: &CompleteFrame<'_>,
        mask: &mut Mask,
        coverage: &mut Coverage,
        acknowledgement: &mut Option<Acknowledgement>,
    ) -> Result<Option<Pose>, BadFrameReason> {
        let head = Frame::parse(frame.body)?.head;
        // Checked before memory for the mask is taken.
        if !is_within(self.largest, head.shape) {
            return Err(BadFrameReason::Shape { found: head.shape, largest: self.largest });
        }
        let decoded = self.decode_body(frame, &head, mask);
        self.decoder.coverage(head.shape, coverage);
        let reply = self.kept.as_mut().and_then(|kept| match decoded {
            Ok(()) => kept.keep(&self.decoder, frame.frame),
            Err(DecodeError::Reference(_)) => Some(kept.lose()),
            Err(_) => None,
        });
        *acknowledgement = reply.or(*acknowledgement);
        Ok(decoded.map(|()| head.traced_for)?)
    }

    fn decode_body(&mut self, frame: &CompleteFrame<'_>, head: &FrameHead, mask: &mut Mask) -> Result<(), DecodeError> {
        let reference = head.reference.zip(self.kept.as_mut()).and_then(|(name, kept)| kept.reference(name));
        let Some(newest) = &mut self.newest else {
            return self.decoder.decode_against(reference, frame.body, mask).map(drop);
        };
        if newest.shape() != head.shape {
            newest.reset(head.shape);
        }
        if frame.known_bytes == 0 {
            self.decoder.decode_onto(reference, frame.body, newest)?;
        } else {
            self.decoder.decode_more(reference, &frame.body[frame.known_bytes..], newest)?;
        }
        if mask.shape() != head.shape {
            mask.reset(head.shape);
        }
        mask.words_mut().copy_from_slice(newest.words());
        Ok(())
    }
}

/// Returns whether a mask of this shape was agreed on. The exact shape requested is only known where poses are.
fn is_within(largest: MaskShape, shape: MaskShape) -> bool {
    shape.lights() == largest.lights() && shape.width() <= largest.width() && shape.height() <= largest.height()
}
