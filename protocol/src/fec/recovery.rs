//! Puts together what is missing of a frame, from its parity and what has come.

use reed_solomon_simd::ReedSolomonDecoder;

use super::{LENGTH_BYTES, ParityPacket, fill_shard, shard_data};

/// What is known of the frame at hand beside its data. Its memory is bounded by the bounds of [`ParityPacket`] and the
/// number of a frame's packets, and serves every frame.
#[derive(Default)]
pub(crate) struct Recovery {
    coder: Option<ReedSolomonDecoder>,
    /// Where in the body the data of each packet lies that has come.
    came: Vec<Piece>,
    kind: Option<Kind>,
    /// Places of the parity packets that have come, and their shards one after the other.
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

/// What all parity packets of a frame say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Kind {
    first_sequence: u32,
    packets: usize,
    parity: u8,
    shard_bytes: usize,
}

/// What was put together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Recovered {
    /// There is not enough for it, or nothing to do.
    Nothing,
    /// All that was missing: so many packets.
    All(u16),
    /// What has come does not fit together. The parity is forgotten.
    Contradiction,
}

impl std::fmt::Debug for Recovery {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Recovery").field("kind", &self.kind).field("places", &self.places).finish_non_exhaustive()
    }
}

impl Recovery {
    /// Another frame begins.
    pub(crate) fn begin(&mut self) {
        self.came.clear();
        self.forget_parity();
    }

    fn forget_parity(&mut self) {
        self.kind = None;
        self.places.clear();
        self.shards.clear();
    }

    /// A packet of the frame has come; its data lies in the body from `start` on.
    pub(crate) fn came(&mut self, sequence: u32, start: usize, bytes: usize) {
        self.came.push(Piece { sequence, start, bytes });
    }

    /// A parity packet of the frame has come. Says whether it was kept: not when it was there already. Nothing when it
    /// contradicts the others.
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

    /// Bytes of memory that parity is kept in.
    pub(crate) const fn memory_bytes(&self) -> usize {
        self.shards.capacity()
    }

    /// Appends the data of all packets that are missing to `body`, in their order, if there is enough to know it and
    /// the body has room for it.
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
