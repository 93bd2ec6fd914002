//! Restores a frame's missing packets from its parity and the packets that arrived.

use reed_solomon_simd::ReedSolomonDecoder;

use super::{LENGTH_BYTES, ParityPacket, fill_shard, shard_data};

/// What is known of the current frame besides its data. Its memory is bounded by [`ParityPacket`]'s limits and the
/// number of a frame's packets, and is reused for every frame.
#[derive(Default)]
pub(crate) struct Recovery {
    coder: Option<ReedSolomonDecoder>,
    /// Where in the body the data of each arrived packet lies.
    came: Vec<Piece>,
    kind: Option<Kind>,
    /// Indices of the arrived parity packets, and their shards, concatenated.
    places: Vec<u8>,
    shards: Vec<u8>,
    shard: Vec<u8>,
    missing: Vec<bool>,
}

#[derive(Debug, Clone, Copy)]
struct Piece {
    sequence: u32,
    start: usize,
    bytes: usize,
}

/// What all parity packets of a frame have in common.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Kind {
    first_sequence: u32,
    packets: usize,
    parity: u8,
    shard_bytes: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Recovered {
    /// Too little has arrived, or nothing is missing.
    Nothing,
    /// Every missing packet was restored; their number.
    All(u16),
    /// The parity contradicts the packets. It is discarded.
    Contradiction,
}

impl std::fmt::Debug for Recovery {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Recovery").field("kind", &self.kind).field("places", &self.places).finish_non_exhaustive()
    }
}

impl Recovery {
    /// Starts another frame.
    pub(crate) fn begin(&mut self) {
        self.came.clear();
        self.forget_parity();
    }

    fn forget_parity(&mut self) {
        self.kind = None;
        self.places.clear();
        self.shards.clear();
    }

    /// Records a packet of the frame. Its data lies in the body from `start` on.
    pub(crate) fn came(&mut self, sequence: u32, start: usize, bytes: usize) {
        self.came.push(Piece { sequence, start, bytes });
    }

    /// Records a parity packet of the frame. Returns whether it was new, or `None` if it contradicts the others.
    pub(crate) fn parity(&mut self, packet: &ParityPacket<'_>) -> Option<bool> {
        let kind = Kind {
            first_sequence: packet.first_sequence,
            packets: packet.packets.get().into(),
            parity: packet.parity,
            shard_bytes: packet.shard.len(),
        };
        if *self.kind.get_or_insert(kind) != kind {
            return None;
        }
        let new = !self.places.contains(&packet.place);
        if new {
            self.places.push(packet.place);
            self.shards.extend_from_slice(packet.shard);
        }
        Some(new)
    }

    /// Bytes of memory that hold parity.
    pub(crate) const fn memory_bytes(&self) -> usize {
        self.shards.capacity()
    }

    /// Appends the data of all missing packets to `body`, in order, if enough has arrived and the body has room.
    pub(crate) fn recover(&mut self, body: &mut Vec<u8>, max_body_bytes: usize) -> Recovered {
        let Some(kind) = self.kind else { return Recovered::Nothing };
        if self.came.len() >= kind.packets || self.came.len() + self.places.len() < kind.packets {
            return Recovered::Nothing;
        }
        let before = body.len();
        if let Some(count) = self.put_together(kind, body, max_body_bytes) {
            Recovered::All(count)
        } else {
            body.truncate(before);
            self.forget_parity();
            Recovered::Contradiction
        }
    }

    fn put_together(&mut self, kind: Kind, body: &mut Vec<u8>, max_body_bytes: usize) -> Option<u16> {
        let Kind { first_sequence, packets, parity, shard_bytes } = kind;
        let coder = match &mut self.coder {
            Some(coder) => {
                coder.reset(packets, parity.into(), shard_bytes).ok()?;
                coder
            }
            none => none.insert(ReedSolomonDecoder::new(packets, parity.into(), shard_bytes).ok()?),
        };
        self.missing.clear();
        self.missing.resize(packets, true);
        self.shard.resize(shard_bytes, 0);
        for Piece { sequence, start, bytes } in &self.came {
            let place = usize::try_from(sequence.wrapping_sub(first_sequence)).ok()?;
            if !std::mem::replace(self.missing.get_mut(place)?, false) || LENGTH_BYTES + bytes > shard_bytes {
                return None;
            }
            fill_shard(&mut self.shard, &body[*start..start + bytes]);
            coder.add_original_shard(place, &self.shard).ok()?;
        }
        for (place, shard) in self.places.iter().zip(self.shards.chunks_exact(shard_bytes)) {
            coder.add_recovery_shard(usize::from(*place), shard).ok()?;
        }
        let restored = coder.decode().ok()?;
        let mut count = 0;
        for (place, _) in self.missing.iter().enumerate().filter(|(_, missing)| **missing) {
            let data = shard_data(restored.restored_original(place)?)?;
            if data.len() > max_body_bytes.saturating_sub(body.len()) {
                return None;
            }
            body.extend_from_slice(data);
            count += 1;
        }
        Some(count)
    }
}
