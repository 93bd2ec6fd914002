//! Tells the server which masks the client has, so that later ones can be coded against them.
//!
//! An acknowledgement is a packet of its own, so that it arrives before the next pose: a header with placeholders in
//! the fields of visibility packets, and 4 bytes, the digest of the mask of the header's frame. If the frame is a
//! placeholder too, the client has no mask, or lacks the one that a frame was coded against, and wants slices without a
//! reference.

use thiserror::Error;

use crate::{
    header::{HEADER_BYTES, HeaderError, PacketHeader},
    ids::ReferenceName,
};

const DIGEST_BYTES: usize = 4;

pub const ACKNOWLEDGEMENT_BYTES: usize = HEADER_BYTES + DIGEST_BYTES;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum AcknowledgementError {
    #[error(transparent)]
    Header(#[from] HeaderError),
    #[error("an acknowledgement has {DIGEST_BYTES} bytes of data, not {0}")]
    Length(usize),
    #[error("packet {0} is not an acknowledgement: its header has fields of a visibility frame")]
    Visibility(u32),
}

/// The newest mask that a client has whole; `None` if it has none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Acknowledgement {
    /// Number of the acknowledgement, +1 each; wraps.
    pub sequence: u32,
    pub mask: Option<ReferenceName>,
}

impl Acknowledgement {
    #[must_use]
    pub fn encode(&self) -> [u8; ACKNOWLEDGEMENT_BYTES] {
        let header = PacketHeader {
            sequence: self.sequence,
            frame: self.mask.map(|mask| mask.frame),
            #[expect(clippy::cast_possible_truncation, reason = "4")]
            data_bytes: DIGEST_BYTES as u16,
            frame_packets: None,
            first: false,
            timestamp_ms: None,
        };
        let mut packet = [0; ACKNOWLEDGEMENT_BYTES];
        packet[..HEADER_BYTES].copy_from_slice(&header.encode());
        packet[HEADER_BYTES..].copy_from_slice(&self.mask.map_or(0, |mask| mask.digest).to_le_bytes());
        packet
    }

    ///
    /// # Errors
    /// If they are no packet, a visibility packet, or have other data than a digest.
    pub fn decode(datagram: &[u8]) -> Result<Self, AcknowledgementError> {
        let (header, data) = PacketHeader::decode(datagram)?;
        let digest: [u8; DIGEST_BYTES] = data.try_into().map_err(|_| AcknowledgementError::Length(data.len()))?;
        if header.frame_packets.is_some() || header.timestamp_ms.is_some() || header.first {
            return Err(AcknowledgementError::Visibility(header.sequence));
        }
        let digest = u32::from_le_bytes(digest);
        Ok(Self { sequence: header.sequence, mask: header.frame.map(|frame| ReferenceName { frame, digest }) })
    }

    /// Returns true if this acknowledgement was made after `other`.
    #[must_use]
    pub const fn is_after(&self, other: &Self) -> bool {
        self.sequence.wrapping_sub(other.sequence).cast_signed() > 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::FrameNumber;

    #[test]
    fn acknowledgements_round_trip_and_other_packets_are_refused() {
        let mask = Some(ReferenceName { frame: FrameNumber(0x0102_0304), digest: 0xA0B0_C0D0 });
        let bytes = Acknowledgement { sequence: 7, mask }.encode();
        let golden = [7, 0, 0, 0, 4, 3, 2, 1, 4, 0, 0, 0, 0xFF, 0xFF, 0xFF, 0xFF, 0xD0, 0xC0, 0xB0, 0xA0];
        assert_eq!(bytes, golden);
        assert_eq!(Acknowledgement::decode(&bytes), Ok(Acknowledgement { sequence: 7, mask }));
        let none = Acknowledgement { sequence: u32::MAX, mask: None };
        assert_eq!(Acknowledgement::decode(&none.encode()), Ok(none));
        assert!(Acknowledgement { sequence: 0, mask }.is_after(&none) && !none.is_after(&none));
        let with = |place: usize, byte: u8| {
            let mut bad = bytes;
            bad[place] = byte;
            Acknowledgement::decode(&bad).unwrap_err()
        };
        assert_eq!(with(10, 2), AcknowledgementError::Visibility(7));
        assert_eq!(with(10, 1), AcknowledgementError::Visibility(7));
        assert_eq!(with(12, 0), AcknowledgementError::Visibility(7));
        assert_eq!(with(8, 3), AcknowledgementError::Header(HeaderError::DataSize { stated: 3, found: 4 }));
        let mut longer = [&bytes[..], &[0]].concat();
        longer[8] = 5;
        assert_eq!(Acknowledgement::decode(&longer), Err(AcknowledgementError::Length(5)));
    }
}
