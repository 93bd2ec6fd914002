//! Makes a frame's parity.

use reed_solomon_simd::ReedSolomonEncoder;

use super::{LENGTH_BYTES, MAX_PROTECTED_PACKETS, PARITY_HEAD_BYTES, PARITY_ROOM_BYTES, fill_shard};
use crate::{header::HEADER_BYTES, limits::MAX_PACKET_BYTES};

/// Makes parity packets; reuses its memory from frame to frame.
#[derive(Default)]
pub struct ParityEncoder {
    coder: Option<ReedSolomonEncoder>,
    shard: Vec<u8>,
    /// Data of the parity packets, concatenated.
    output: Vec<u8>,
}

impl std::fmt::Debug for ParityEncoder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ParityEncoder").field("output_bytes", &self.output.len()).finish_non_exhaustive()
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Parity<'a> {
    packet_bytes: usize,
    data: &'a [u8],
}

impl<'a> Parity<'a> {
    #[must_use]
    pub fn count(&self) -> usize {
        self.data.len() / self.packet_bytes.max(1)
    }

    /// Data of each packet. All have the same length.
    pub(crate) fn data(&self) -> impl Iterator<Item = &'a [u8]> + use<'a> {
        self.data.chunks(self.packet_bytes.max(1))
    }

    /// Bytes of data in all packets.
    #[must_use]
    pub const fn bytes(&self) -> usize {
        self.data.len()
    }
}

impl ParityEncoder {
    /// Returns the parity made last.
    #[must_use]
    pub fn last(&self) -> Parity<'_> {
        let packet_bytes = PARITY_HEAD_BYTES + self.shard.len();
        Parity { packet_bytes, data: &self.output }
    }

    /// Makes `parity` parity packets for packets with these payloads. Makes none if there are more than
    /// [`MAX_PROTECTED_PACKETS`], or if the payloads leave no room for the head of a parity packet.
    pub fn encode<'a>(&mut self, payloads: impl Iterator<Item = &'a [u8]> + Clone, parity: u8) -> Parity<'_> {
        self.output.clear();
        let (packets, longest) =
            payloads.clone().fold((0, 0), |(count, most), payload: &[u8]| (count + 1, payload.len().max(most)));
        if parity > 0
            && (1..=MAX_PROTECTED_PACKETS).contains(&packets)
            && longest + PARITY_ROOM_BYTES + HEADER_BYTES <= MAX_PACKET_BYTES
        {
            let shard_bytes = (LENGTH_BYTES + longest).next_multiple_of(2);
            self.shard.resize(shard_bytes, 0);
            if self.make(payloads, packets, parity, shard_bytes).is_err() {
                // Cannot happen: the checks above are the coder's only conditions.
                self.output.clear();
            }
        }
        self.last()
    }

    fn make<'a>(
        &mut self,
        payloads: impl Iterator<Item = &'a [u8]>,
        packets: usize,
        parity: u8,
        shard_bytes: usize,
    ) -> Result<(), reed_solomon_simd::Error> {
        let coder = match &mut self.coder {
            Some(coder) => {
                coder.reset(packets, parity.into(), shard_bytes)?;
                coder
            }
            none => none.insert(ReedSolomonEncoder::new(packets, parity.into(), shard_bytes)?),
        };
        for payload in payloads {
            fill_shard(&mut self.shard, payload);
            coder.add_original_shard(&self.shard)?;
        }
        let [n0, n1, ..] = packets.to_le_bytes();
        for (place, shard) in (0..parity).zip(coder.encode()?.recovery_iter()) {
            self.output.extend_from_slice(&[n0, n1, parity, place]);
            self.output.extend_from_slice(shard);
        }
        Ok(())
    }
}
