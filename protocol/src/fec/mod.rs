//! Forward error correction over a frame's packets. Any parity packet can replace any lost packet.
//!
//! Nothing is retransmitted: it would arrive too late. Instead, a frame of n packets gets m parity packets, and any n
//! of the n + m restore the frame (Reed and Solomon's code, by `reed-solomon-simd`). m follows from the loss that the
//! client measured ([`parity_packets`]); without loss it is 0.
//!
//! A parity packet has the frame number and timestamp of its frame and no first-packet flag. Its number of packets is
//! the placeholder, which marks it as parity. Its sequence number is the first packet's, plus n, plus its index among
//! the m. Its data:
//!
//! | bytes | field |
//! |---|---|
//! | 0–1 | packets of the frame that it protects, n |
//! | 2 | parity packets of the frame, m |
//! | 3 | its index among them, from 0 |
//! | to the end | the shard, an even number of bytes |
//!
//! All little-endian. The code works on n shards: the data of each packet, after its length (u16), padded with zeros to
//! the same length.
//!
//! A packet restored from wrong parity is wrong, and its tiles may decode as others. So parity must be as trustworthy
//! as the packets. It never changes data that has arrived.

mod encoder;
mod recovery;
mod share;

use std::num::NonZeroU16;

pub(crate) use self::recovery::{Recovered, Recovery};
pub use self::{
    encoder::{Parity, ParityEncoder},
    share::{LossModel, parity_packets},
};
use crate::{header::PacketHeader, ids::FrameNumber, limits::MAX_PACKET_BYTES};

/// Bytes before a parity packet's shard.
pub(crate) const PARITY_HEAD_BYTES: usize = 4;

/// Bytes before a packet's data in its shard.
const LENGTH_BYTES: usize = 2;

/// Bytes that a frame's packets leave free, so that their parity fits a packet: head, length, and an odd byte.
pub const PARITY_ROOM_BYTES: usize = PARITY_HEAD_BYTES + LENGTH_BYTES + 1;

/// Most packets of a frame with parity: half a megabyte.
pub const MAX_PROTECTED_PACKETS: usize = 512;

/// A parity packet with all numbers in range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ParityPacket<'a> {
    pub(crate) frame: FrameNumber,
    pub(crate) timestamp_ms: u32,
    /// Sequence number of the frame's first packet.
    pub(crate) first_sequence: u32,
    pub(crate) packets: NonZeroU16,
    pub(crate) parity: u8,
    pub(crate) place: u8,
    pub(crate) shard: &'a [u8],
}

impl<'a> ParityPacket<'a> {
    /// Returns whether a packet with this header is parity.
    pub(crate) const fn is_one(header: &PacketHeader) -> bool {
        header.frame_packets.is_none() && header.frame.is_some() && header.timestamp_ms.is_some() && !header.first
    }

    /// Returns `None` if a number is out of range.
    pub(crate) fn parse(header: &PacketHeader, data: &'a [u8]) -> Option<Self> {
        let (&[n0, n1, parity, place], shard) = data.split_first_chunk()?;
        let packets = NonZeroU16::new(u16::from_le_bytes([n0, n1]))?;
        let fits = usize::from(packets.get()) <= MAX_PROTECTED_PACKETS
            && place < parity
            && shard.len() % 2 == 0
            && (LENGTH_BYTES + 1..=MAX_PACKET_BYTES).contains(&shard.len());
        fits.then_some(Self {
            frame: header.frame?,
            timestamp_ms: header.timestamp_ms?,
            first_sequence: header.sequence.wrapping_sub(u32::from(packets.get()) + u32::from(place)),
            packets,
            parity,
            place,
            shard,
        })
    }
}

/// Copies a packet's length and data into a shard.
fn fill_shard(shard: &mut [u8], data: &[u8]) {
    let (length, rest) = shard.split_at_mut(LENGTH_BYTES);
    // No packet is longer than 64 KiB.
    length.copy_from_slice(&u16::try_from(data.len()).unwrap_or(u16::MAX).to_le_bytes());
    rest[..data.len()].copy_from_slice(data);
    rest[data.len()..].fill(0);
}

/// Returns the data in a shard, if [`fill_shard`] could have made it.
fn shard_data(shard: &[u8]) -> Option<&[u8]> {
    let (length, rest) = shard.split_first_chunk::<LENGTH_BYTES>()?;
    let (data, zeros) = rest.split_at_checked(usize::from(u16::from_le_bytes(*length)))?;
    (!data.is_empty() && zeros.iter().all(|byte| *byte == 0)).then_some(data)
}
