//! An encoded mask: bytes, and where they may be split into packets.

use std::ops::Deref;

use super::part::Part;

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct EncodedFrame {
    pub(super) body: Vec<u8>,
    /// The parts of a sliced frame, in the body's order; empty for other frames.
    pub(super) parts: Vec<Part>,
}

impl EncodedFrame {
    #[must_use]
    pub fn with_capacity(bytes: usize) -> Self {
        Self { body: Vec::with_capacity(bytes), parts: Vec::new() }
    }

    #[must_use]
    pub fn body(&self) -> &[u8] {
        &self.body
    }

    #[must_use]
    pub fn into_body(self) -> Vec<u8> {
        self.body
    }

    /// Returns the parts of a sliced frame. Empty for codecs that are not [sliced](super::CodecId::is_sliced).
    #[must_use]
    pub fn parts(&self) -> &[Part] {
        &self.parts
    }

    /// Returns the payload of each packet: one part each if every part fits `most` bytes, otherwise `most` bytes in all
    /// but the last.
    pub fn payloads(&self, most: usize) -> impl Iterator<Item = &[u8]> + Clone {
        let body = &self.body;
        let (parts, rest) = if self.fits(most) { (&self.parts[..], &[][..]) } else { (&[][..], &body[..]) };
        let parts = parts.iter().scan(0, move |end, part| {
            let start = *end;
            *end += part.bytes;
            Some(&body[start..*end])
        });
        parts.chain(rest.chunks(most.max(1)))
    }

    /// Returns the number of [`Self::payloads`].
    #[must_use]
    pub fn payload_count(&self, most: usize) -> usize {
        if self.fits(most) { self.parts.len() } else { self.body.len().div_ceil(most.max(1)) }
    }

    fn fits(&self, most: usize) -> bool {
        !self.parts.is_empty() && self.parts.iter().all(|part| part.bytes <= most)
    }

    /// Removes the parts for which `keep`, given index and part, returns false.
    pub(crate) fn retain_parts(&mut self, mut keep: impl FnMut(usize, &Part) -> bool) {
        let Self { body, parts } = self;
        let (mut index, mut start, mut end) = (0, 0, 0);
        parts.retain(|part| {
            let kept = keep(index, part);
            if kept {
                body.copy_within(start..start + part.bytes, end);
                end += part.bytes;
            }
            (index, start) = (index + 1, start + part.bytes);
            kept
        });
        body.truncate(end);
    }
}

impl Deref for EncodedFrame {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.body
    }
}

impl From<Vec<u8>> for EncodedFrame {
    /// A body that may be split anywhere.
    fn from(body: Vec<u8>) -> Self {
        Self { body, parts: Vec::new() }
    }
}
