//! Which masks either end keeps as references, and for how long.
//!
//! The server keeps the masks that it sent until a later one is acknowledged. The client keeps those that it
//! acknowledged until the server codes against a later one. Both keep a limited number of masks and bytes. A mask that
//! does not fit is not kept, which only costs bytes on the wire.

use std::collections::VecDeque;

use crate::{
    acknowledgement::Acknowledgement,
    codec::{Decoder, Encoder, Reference, ReferenceName},
    ids::FrameNumber,
    limits::{MAX_REFERENCE_BYTES, MAX_REFERENCES},
};

/// Masks, oldest first, and the memory of dropped ones for reuse.
#[derive(Debug, Default)]
struct Ring {
    kept: VecDeque<Reference>,
    spare: Vec<Reference>,
}

impl Ring {
    fn memory_bytes(&self) -> usize {
        self.kept.iter().chain(&self.spare).map(Reference::memory_bytes).sum()
    }

    fn find(&self, name: ReferenceName) -> Option<&Reference> {
        self.kept.iter().find(|reference| reference.name() == name)
    }

    /// Adds the mask that `fill` writes, unless it returns false.
    fn keep(&mut self, fill: impl FnOnce(&mut Reference) -> bool) -> Option<&Reference> {
        let mut reference = self.spare.pop().unwrap_or_default();
        if fill(&mut reference) {
            self.kept.push_back(reference);
            self.kept.back()
        } else {
            self.spare.push(reference);
            None
        }
    }

    /// Returns true if there is no room for another mask as large as the newest.
    fn is_full(&self) -> bool {
        let bytes = self.kept.iter().map(Reference::memory_bytes).sum::<usize>();
        let next = self.kept.back().map_or(0, Reference::memory_bytes);
        self.kept.len() >= MAX_REFERENCES || bytes + next > MAX_REFERENCE_BYTES
    }

    /// Keeps the memory of up to two masks for later ones.
    fn reuse(&mut self, unused: Option<Reference>) {
        self.spare.extend(unused.filter(|_| self.spare.len() < 2));
    }

    fn drop_oldest(&mut self) {
        let oldest = self.kept.pop_front();
        self.reuse(oldest);
    }

    fn drop_before(&mut self, name: ReferenceName) {
        while self.kept.front().is_some_and(|reference| reference.name() != name) {
            self.drop_oldest();
        }
    }

    fn clear(&mut self) {
        while !self.kept.is_empty() {
            self.drop_oldest();
        }
    }
}

/// The server's side: the masks that it sent, and which of them the client has.
#[derive(Debug, Default)]
pub struct SentMasks {
    ring: Ring,
    newest: Option<Acknowledgement>,
    /// The client has the oldest mask of the ring.
    acknowledged: bool,
}

impl SentMasks {
    /// Applies an acknowledgement. Old ones, and those of masks that are no longer kept, have no effect.
    pub fn acknowledge(&mut self, heard: Acknowledgement) {
        if self.newest.is_some_and(|newest| !heard.is_after(&newest)) {
            return;
        }
        self.newest = Some(heard);
        match heard.mask {
            None => {
                // The client has kept none of the masks sent so far.
                self.acknowledged = false;
                self.ring.clear();
            }
            Some(name) if self.ring.find(name).is_some() => {
                self.ring.drop_before(name);
                self.acknowledged = true;
            }
            Some(_) => {}
        }
    }

    /// Returns the bytes of the kept masks and of the memory kept for reuse.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        self.ring.memory_bytes()
    }

    /// Returns the newest mask that the client has, to code against.
    #[must_use]
    pub fn reference(&self) -> Option<&Reference> {
        self.ring.kept.front().filter(|_| self.acknowledged)
    }

    /// Keeps the last encoded mask, which is sent as `frame`.
    pub fn keep(&mut self, encoder: &Encoder, frame: FrameNumber) {
        if self.ring.is_full() {
            self.thin_out();
        }
        if !self.ring.is_full() {
            self.ring.keep(|reference| encoder.keep(frame, reference));
        }
    }

    /// Drops every other mask that is not acknowledged, so that some remain however late acknowledgements are.
    fn thin_out(&mut self) {
        let in_use = usize::from(self.acknowledged);
        let mut place = in_use;
        while place < self.ring.kept.len() {
            let unused = self.ring.kept.remove(place);
            self.ring.reuse(unused);
            place += 1;
        }
    }
}

/// The client's side: the masks that it has and has acknowledged.
#[derive(Debug, Default)]
pub struct KeptMasks {
    ring: Ring,
    sequence: u32,
    /// Times in a row that there was no room.
    full: u32,
}

/// Times in a row without room until the client starts over. The server codes against newer masks long before that,
/// unless it dropped all those that the client has; then both ends would be stuck.
const MOST_FULL: u32 = 64;

impl KeptMasks {
    /// Returns the mask that a frame is coded against, if it is kept. Drops older ones, because the server never goes
    /// back to them.
    pub fn reference(&mut self, name: ReferenceName) -> Option<&Reference> {
        self.ring.find(name)?;
        self.ring.drop_before(name);
        self.ring.kept.front()
    }

    /// Keeps the last decoded mask as `frame`. Returns the acknowledgement to send, or `None` if parts are missing.
    /// Without room it acknowledges the newest kept mask; after 64 times in a row it drops all and says so.
    pub fn keep(&mut self, decoder: &Decoder, frame: FrameNumber) -> Option<Acknowledgement> {
        if self.ring.is_full() {
            self.full += 1;
            if self.full > MOST_FULL {
                self.full = 0;
                return Some(self.lose());
            }
            let newest = self.ring.kept.back()?.name();
            return Some(self.say(Some(newest)));
        }
        self.full = 0;
        let mask = Some(self.ring.keep(|reference| decoder.keep(frame, reference))?.name());
        Some(self.say(mask))
    }

    /// Drops all masks, because the server codes against one that is missing. Returns the acknowledgement that says so.
    pub fn lose(&mut self) -> Acknowledgement {
        self.ring.clear();
        self.say(None)
    }

    fn say(&mut self, mask: Option<ReferenceName>) -> Acknowledgement {
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        Acknowledgement { sequence, mask }
    }
}
