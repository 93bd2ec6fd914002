//! The packet header: six fields in 16 bytes, little-endian (dissertation §3.1, Figure 1).
//!
//! | bytes | field | placeholder |
//! |---|---|---|
//! | 0–3 | sequence number: +1 a packet, wraps | – |
//! | 4–7 | frame number | all ones |
//! | 8–9 | data size: bytes after the header | – |
//! | 10–11 | number of packets in the frame × 2 + first-packet flag | number = 0 |
//! | 12–15 | timestamp: ms since the sender's first frame | all ones |
//!
//! §3.1 takes 65,507 − 65,487 = 20 bytes for the header when it counts 127 packets a frame, but the six fields that it
//! lists (4 + 4 + 4 as "3 of which consist of 4-byte integers", 2, 15 bits and 1 bit) make 16. Ours has 16, so a lab
//! packet carries 65,491 bytes. The uncompressed 1080p frame takes 127 packets either way.

use std::num::NonZeroU16;

use thiserror::Error;

use crate::ids::FrameNumber;

pub const HEADER_BYTES: usize = 16;

/// Largest value of the 15-bit number of packets.
const MAX_COUNT: u16 = u16::MAX >> 1;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct PacketHeader {
    /// Number of the packet, +1 each; wraps after 2³² packets (11 days at 4,300 a second), so compare with wrapping
    /// arithmetic.
    pub sequence: u32,
    /// Frame of the packet; `None` is the placeholder `u32::MAX`, which is no frame number. At 120 frames a second a
    /// session reaches it after 414 days.
    pub frame: Option<FrameNumber>,
    /// Bytes after the header.
    pub data_bytes: u16,
    /// Packets in the frame, at most 32,767; `None` is the placeholder.
    pub frame_packets: Option<NonZeroU16>,
    pub first: bool,
    /// Time of the frame in ms since the sender's first frame; `None` is the placeholder `u32::MAX`, which the
    /// packetizer never sends as a time.
    pub timestamp_ms: Option<u32>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum HeaderError {
    #[error("a packet of {0} bytes is shorter than its {HEADER_BYTES}-byte header")]
    TooShort(usize),
    #[error("the header says {stated} bytes of data, {found} follow it")]
    DataSize { stated: u16, found: usize },
}

impl PacketHeader {
    /// A `frame_packets` above 32,767 does not fit its field and is written as 32,767.
    #[must_use]
    pub fn encode(&self) -> [u8; HEADER_BYTES] {
        let count = self.frame_packets.map_or(0, |count| count.get().min(MAX_COUNT));
        let frame = self.frame.map_or(u32::MAX, |frame| frame.0);
        let mut bytes = [0; HEADER_BYTES];
        bytes[..4].copy_from_slice(&self.sequence.to_le_bytes());
        bytes[4..8].copy_from_slice(&frame.to_le_bytes());
        bytes[8..10].copy_from_slice(&self.data_bytes.to_le_bytes());
        bytes[10..12].copy_from_slice(&(count << 1 | u16::from(self.first)).to_le_bytes());
        bytes[12..].copy_from_slice(&self.timestamp_ms.unwrap_or(u32::MAX).to_le_bytes());
        bytes
    }

    /// Returns a datagram's header and its payload, which is exactly `data_bytes` long.
    ///
    /// # Errors
    /// If the datagram is shorter than a header, or not as long as its header says.
    pub fn decode(datagram: &[u8]) -> Result<(Self, &[u8]), HeaderError> {
        let Some((head, payload)) = datagram.split_first_chunk::<HEADER_BYTES>() else {
            return Err(HeaderError::TooShort(datagram.len()));
        };
        let [s0, s1, s2, s3, f0, f1, f2, f3, d0, d1, c0, c1, t0, t1, t2, t3] = *head;
        let data_bytes = u16::from_le_bytes([d0, d1]);
        if usize::from(data_bytes) != payload.len() {
            return Err(HeaderError::DataSize { stated: data_bytes, found: payload.len() });
        }
        let count = u16::from_le_bytes([c0, c1]);
        let header = Self {
            sequence: u32::from_le_bytes([s0, s1, s2, s3]),
            frame: unless_placeholder(u32::from_le_bytes([f0, f1, f2, f3])).map(FrameNumber),
            data_bytes,
            frame_packets: NonZeroU16::new(count >> 1),
            first: count & 1 == 1,
            timestamp_ms: unless_placeholder(u32::from_le_bytes([t0, t1, t2, t3])),
        };
        Ok((header, payload))
    }
}

fn unless_placeholder(value: u32) -> Option<u32> {
    (value != u32::MAX).then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_datagram_is_exactly_header_and_data() {
        for length in 0..HEADER_BYTES {
            assert_eq!(PacketHeader::decode(&vec![0; length]), Err(HeaderError::TooShort(length)));
        }
        let mut datagram = [0; HEADER_BYTES + 5];
        datagram[8] = 5;
        datagram[16..].copy_from_slice(b"shade");
        assert_eq!(PacketHeader::decode(&datagram).unwrap().1, b"shade");
        assert_eq!(PacketHeader::decode(&datagram[..20]), Err(HeaderError::DataSize { stated: 5, found: 4 }));
        datagram[8] = 4;
        assert_eq!(PacketHeader::decode(&datagram), Err(HeaderError::DataSize { stated: 4, found: 5 }));
    }

    #[test]
    fn placeholders_are_all_ones_or_no_packets() {
        let datagram = [[0; 4], [0xFF; 4], [0, 0, 1, 0], [0xFF; 4]].concat();
        let (header, data) = PacketHeader::decode(&datagram).unwrap();
        assert_eq!((header.frame, header.frame_packets, header.timestamp_ms), (None, None, None));
        assert!(header.first && data.is_empty());
        assert_eq!(header.encode(), *datagram);
    }

    #[test]
    fn a_count_that_does_not_fit_leaves_the_flag_alone() {
        for first in [false, true] {
            let header = PacketHeader {
                sequence: 0,
                frame: None,
                data_bytes: 0,
                frame_packets: Some(NonZeroU16::MAX),
                first,
                timestamp_ms: None,
            };
            let (decoded, _) = PacketHeader::decode(&header.encode()).unwrap();
            assert_eq!(decoded.frame_packets, NonZeroU16::new(32_767));
            assert_eq!(decoded.first, first);
        }
    }
}
