//! Cuts a frame's body into packets.

use std::num::NonZeroU16;

use bytes::{Bytes, BytesMut};
use thiserror::Error;

use crate::{
    header::{HEADER_BYTES, PacketHeader},
    ids::FrameNumber,
    limits::{MAX_FRAME_BYTES, MAX_FRAME_PACKETS, MAX_LAB_PACKET_BYTES},
};

/// Why a body cannot be sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum PacketizeError {
    /// There is nothing to send.
    #[error("frame {0} is empty")]
    Empty(FrameNumber),
    /// Longer than any frame may be.
    #[error("frame {frame} has {bytes} bytes, at most {MAX_FRAME_BYTES} are allowed")]
    TooLong {
        /// The frame.
        frame: FrameNumber,
        /// Its length.
        bytes: usize,
    },
    /// More packets than the header can count.
    #[error("frame {frame} takes {packets} packets, at most {MAX_FRAME_PACKETS} are allowed")]
    TooManyPackets {
        /// The frame.
        frame: FrameNumber,
        /// Packets that it would take.
        packets: usize,
    },
    /// The number is the header's placeholder.
    #[error("frame number {0} stands for no frame")]
    FrameNumber(FrameNumber),
}

/// Cuts bodies into packets and numbers these; one for each direction of a session.
///
/// The packets' memory is one buffer, taken anew only while packets of earlier frames are still held somewhere.
#[derive(Debug)]
pub struct Packetizer {
    payload_bytes: usize,
    next_sequence: u32,
    buffer: BytesMut,
}

impl Packetizer {
    /// Packets of at most `max_packet_bytes` bytes, header included; values outside 17 to [`MAX_LAB_PACKET_BYTES`]
    /// are brought to the nearer end. Sequence numbers start at 0 (§3.1).
    #[must_use]
    pub fn new(max_packet_bytes: usize) -> Self {
        let packet_bytes = max_packet_bytes.clamp(HEADER_BYTES + 1, MAX_LAB_PACKET_BYTES);
        Self { payload_bytes: packet_bytes - HEADER_BYTES, next_sequence: 0, buffer: BytesMut::new() }
    }

    /// Packets that a body takes.
    #[must_use]
    pub const fn packet_count(&self, body_bytes: usize) -> usize {
        body_bytes.div_ceil(self.payload_bytes)
    }

    /// Bytes that a body takes on the wire, headers included.
    #[must_use]
    pub const fn wire_bytes(&self, body_bytes: usize) -> usize {
        body_bytes + self.packet_count(body_bytes) * HEADER_BYTES
    }

    /// Sequence number of the next packet.
    #[must_use]
    pub const fn next_sequence(&self) -> u32 {
        self.next_sequence
    }

    /// The packets of one frame, in order; all but the last are full. Each takes its sequence number when it is
    /// made, so packets that are never taken from the iterator leave no gap.
    ///
    /// `timestamp_ms` wraps after 49.7 days; `u32::MAX`, which is the header's placeholder, is sent as the ms before.
    ///
    /// # Errors
    /// When the body is empty, too long, or takes too many packets, or when `frame` is the placeholder `u32::MAX`.
    pub fn packets<'a>(
        &'a mut self,
        frame: FrameNumber,
        timestamp_ms: u32,
        body: &'a [u8],
    ) -> Result<impl Iterator<Item = Bytes> + 'a, PacketizeError> {
        if frame.0 == u32::MAX {
            return Err(PacketizeError::FrameNumber(frame));
        }
        if body.len() > MAX_FRAME_BYTES {
            return Err(PacketizeError::TooLong { frame, bytes: body.len() });
        }
        let packets = self.packet_count(body.len());
        let counted = u16::try_from(packets).ok().filter(|_| packets <= MAX_FRAME_PACKETS);
        let counted = NonZeroU16::new(counted.ok_or(PacketizeError::TooManyPackets { frame, packets })?);
        let frame_packets = counted.ok_or(PacketizeError::Empty(frame))?;
        self.buffer.reserve(self.wire_bytes(body.len()));
        let Self { payload_bytes, next_sequence, buffer } = self;
        Ok(body.chunks(*payload_bytes).enumerate().map(move |(index, payload)| {
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
}
