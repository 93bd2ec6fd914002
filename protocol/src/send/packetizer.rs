//! Cuts encoded frames into packets.

use std::num::NonZeroU16;

use bytes::{Bytes, BytesMut};
use thiserror::Error;

use crate::{
    codec::EncodedFrame,
    fec::Parity,
    header::{HEADER_BYTES, PacketHeader},
    ids::FrameNumber,
    limits::{MAX_FRAME_BYTES, MAX_FRAME_PACKETS, MAX_LAB_PACKET_BYTES},
};

/// Why a frame cannot be sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum PacketizeError {
    #[error("frame {0} is empty")]
    Empty(FrameNumber),
    #[error("frame {frame} has {bytes} bytes, at most {MAX_FRAME_BYTES} are allowed")]
    TooLong { frame: FrameNumber, bytes: usize },
    /// More packets than the header can count.
    #[error("frame {frame} takes {packets} packets, at most {MAX_FRAME_PACKETS} are allowed")]
    TooManyPackets { frame: FrameNumber, packets: usize },
    /// The number is the header's placeholder.
    #[error("frame number {0} is reserved")]
    FrameNumber(FrameNumber),
}

/// Cuts frames into packets and numbers them; one for each direction of a session.
///
/// Packets share one buffer, which is allocated anew only while packets of earlier frames are still held.
#[derive(Debug)]
pub struct Packetizer {
    payload_bytes: usize,
    next_sequence: u32,
    buffer: BytesMut,
}

impl Packetizer {
    /// Makes packets of at most `max_packet_bytes` bytes, header included, clamped to 17 to [`MAX_LAB_PACKET_BYTES`].
    /// Sequence numbers start at 0 (§3.1).
    #[must_use]
    pub fn new(max_packet_bytes: usize) -> Self {
        let packet_bytes = max_packet_bytes.clamp(HEADER_BYTES + 1, MAX_LAB_PACKET_BYTES);
        Self { payload_bytes: packet_bytes - HEADER_BYTES, next_sequence: 0, buffer: BytesMut::new() }
    }

    /// Returns the number of packets that a frame takes.
    #[must_use]
    pub fn packet_count(&self, encoded: &EncodedFrame) -> usize {
        encoded.payload_count(self.payload_bytes)
    }

    /// Returns the bytes of a frame on the wire, headers included.
    #[must_use]
    pub fn wire_bytes(&self, encoded: &EncodedFrame) -> usize {
        encoded.body().len() + self.packet_count(encoded) * HEADER_BYTES
    }

    /// Returns the most bytes that a packet carries, header excluded.
    #[must_use]
    pub const fn payload_bytes(&self) -> usize {
        self.payload_bytes
    }

    #[must_use]
    pub const fn next_sequence(&self) -> u32 {
        self.next_sequence
    }

    /// Returns the packets of a frame, in order, as [`EncodedFrame::payloads`] cuts it. A packet gets its sequence
    /// number when the iterator yields it, so packets not taken leave no gap.
    ///
    /// `timestamp_ms` wraps after 49.7 days. `u32::MAX`, the header's placeholder, is sent as the millisecond before.
    ///
    /// # Errors
    /// If the body is empty, too long, or takes too many packets, or if `frame` is the placeholder `u32::MAX`.
    pub fn packets<'a>(
        &'a mut self,
        frame: FrameNumber,
        timestamp_ms: u32,
        encoded: &'a EncodedFrame,
    ) -> Result<impl Iterator<Item = Bytes> + 'a, PacketizeError> {
        if frame.0 == u32::MAX {
            return Err(PacketizeError::FrameNumber(frame));
        }
        let bytes = encoded.body().len();
        if bytes > MAX_FRAME_BYTES {
            return Err(PacketizeError::TooLong { frame, bytes });
        }
        let packets = self.packet_count(encoded);
        let counted = u16::try_from(packets).ok().filter(|_| packets <= MAX_FRAME_PACKETS);
        let counted = NonZeroU16::new(counted.ok_or(PacketizeError::TooManyPackets { frame, packets })?);
        let frame_packets = counted.ok_or(PacketizeError::Empty(frame))?;
        self.buffer.reserve(bytes + packets * HEADER_BYTES);
        let Self { payload_bytes, next_sequence, buffer } = self;
        Ok(encoded.payloads(*payload_bytes).enumerate().map(move |(index, payload)| {
            let header = PacketHeader {
                sequence: *next_sequence,
                frame: Some(frame),
                #[expect(clippy::cast_possible_truncation, reason = "a payload is at most 65,491 bytes: see `new`")]
                data_bytes: payload.len() as u16,
                frame_packets: Some(frame_packets),
                first: index == 0,
                timestamp_ms: Some(timestamp_ms.min(u32::MAX - 1)),
            };
            *next_sequence = next_sequence.wrapping_add(1);
            buffer.extend_from_slice(&header.encode());
            buffer.extend_from_slice(payload);
            buffer.split().freeze()
        }))
    }

    /// Returns the parity packets of the frame last passed to [`Self::packets`]. All of them must be taken.
    pub fn parity_packets<'a>(
        &'a mut self,
        frame: FrameNumber,
        timestamp_ms: u32,
        parity: Parity<'a>,
    ) -> impl Iterator<Item = Bytes> + 'a {
        self.buffer.reserve(parity.bytes() + parity.count() * HEADER_BYTES);
        let Self { next_sequence, buffer, .. } = self;
        parity.data().map(move |data| {
            let header = PacketHeader {
                sequence: *next_sequence,
                frame: Some(frame),
                // Parity fits a packet.
                data_bytes: u16::try_from(data.len()).unwrap_or(u16::MAX),
                frame_packets: None,
                first: false,
                timestamp_ms: Some(timestamp_ms.min(u32::MAX - 1)),
            };
            *next_sequence = next_sequence.wrapping_add(1);
            buffer.extend_from_slice(&header.encode());
            buffer.extend_from_slice(data);
            buffer.split().freeze()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packets(packetizer: &mut Packetizer, frame: u32, body: &[u8]) -> Vec<Bytes> {
        packetizer.packets(FrameNumber(frame), 9, &body.to_vec().into()).unwrap().collect()
    }

    #[test]
    fn all_packets_but_the_last_are_full_and_describe_the_same_frame() {
        let body: Vec<u8> = (0..=255).cycle().take(3000).collect();
        let mut packetizer = Packetizer::new(1161);
        for (frame, sequence) in [(4, 0), (7, 3)] {
            let packets = packets(&mut packetizer, frame, &body);
            let lengths: Vec<_> = packets.iter().map(Bytes::len).collect();
            assert_eq!(lengths, [1161, 1161, 16 + 3000 - 2 * 1145]);
            assert_eq!(packetizer.packet_count(&body.clone().into()), 3);
            assert_eq!(packetizer.wire_bytes(&body.clone().into()), 3048);
            let mut data = Vec::new();
            for (index, packet) in (0u32..).zip(&packets) {
                let (header, payload) = PacketHeader::decode(packet).unwrap();
                assert_eq!(header.sequence, sequence + index);
                assert_eq!(header.frame, Some(FrameNumber(frame)));
                assert_eq!(header.frame_packets, NonZeroU16::new(3));
                assert_eq!(header.first, index == 0);
                assert_eq!(header.timestamp_ms, Some(9));
                data.extend_from_slice(payload);
            }
            assert_eq!(data, body);
        }
        assert_eq!(packetizer.next_sequence(), 6);
    }

    /// §3.1 counts 127 packets for the uncompressed words of 1920×1080 pixels.
    #[test]
    fn the_dissertations_frame_takes_127_lab_packets() {
        assert_eq!(Packetizer::new(MAX_LAB_PACKET_BYTES).packet_count(&vec![0; 1920 * 1080 * 4].into()), 127);
    }

    #[test]
    fn any_allowed_frame_fits_the_count_at_the_datagram_size() {
        let packetizer = Packetizer::new(crate::limits::MAX_PACKET_BYTES);
        assert!(packetizer.packet_count(&vec![0; MAX_FRAME_BYTES].into()) <= MAX_FRAME_PACKETS);
    }

    #[test]
    fn sequence_numbers_wrap() {
        let mut packetizer = Packetizer::new(17);
        packetizer.next_sequence = u32::MAX;
        let sequences: Vec<_> = packets(&mut packetizer, 0, &[1, 2])
            .iter()
            .map(|packet| PacketHeader::decode(packet).unwrap().0.sequence)
            .collect();
        assert_eq!(sequences, [u32::MAX, 0]);
    }

    #[test]
    fn the_placeholder_timestamp_is_not_sent() {
        let mut packetizer = Packetizer::new(100);
        let packet = packetizer.packets(FrameNumber(0), u32::MAX, &vec![1].into()).unwrap().next().unwrap();
        assert_eq!(PacketHeader::decode(&packet).unwrap().0.timestamp_ms, Some(u32::MAX - 1));
    }

    #[test]
    fn unsendable_frames_are_refused_and_take_no_sequence_number() {
        // Sizes are clamped to the range: 1 byte of data a packet, and 65,507 bytes in all.
        let mut small = Packetizer::new(0);
        let frame = FrameNumber(3);
        let error = |packetizer: &mut Packetizer, frame, body: &[u8]| {
            packetizer.packets(frame, 0, &body.to_vec().into()).err().unwrap()
        };
        assert_eq!(error(&mut small, frame, &[]), PacketizeError::Empty(frame));
        let packets = 32_768;
        assert_eq!(error(&mut small, frame, &vec![0; packets]), PacketizeError::TooManyPackets { frame, packets });
        assert_eq!(small.packets(frame, 0, &vec![0; packets - 1].into()).unwrap().count(), packets - 1);
        let placeholder = FrameNumber(u32::MAX);
        assert_eq!(error(&mut small, placeholder, &[1]), PacketizeError::FrameNumber(placeholder));
        assert_eq!(small.next_sequence(), 32_767);
        let bytes = MAX_FRAME_BYTES + 1;
        let mut large = Packetizer::new(usize::MAX);
        assert_eq!(error(&mut large, frame, &vec![0; bytes]), PacketizeError::TooLong { frame, bytes });
        assert_eq!(large.packet_count(&vec![0; 65_491].into()), 1);
        assert_eq!(large.packet_count(&vec![0; 65_492].into()), 2);
    }
}
