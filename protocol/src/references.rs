//! Which masks either end keeps as references, and when it lets go of them.
//!
//! The server keeps what it has sent until a later one is acknowledged; the client keeps what it has acknowledged until
//! the server codes against a later one. Both keep a few masks and a few bytes at most: what does not fit is not kept,
//! and costs bytes on the wire and nothing else.

use std::collections::VecDeque;

use crate::{
    acknowledgement::Acknowledgement,
    codec::{Decoder, Encoder, Reference, ReferenceName},
    ids::FrameNumber,
    limits::{MAX_REFERENCE_BYTES, MAX_REFERENCES},
};

/// Some masks in the order of their coming, and the memory of those that are not kept any more.
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

    /// Takes a mask in, if `fill` makes one.
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

    /// Whether another mask as large as the newest would be one too many.
    fn is_full(&self) -> bool {
        let bytes = self.kept.iter().map(Reference::memory_bytes).sum::<usize>();
        let next = self.kept.back().map_or(0, Reference::memory_bytes);
        self.kept.len() >= MAX_REFERENCES || bytes + next > MAX_REFERENCE_BYTES
    }

    /// Keeps memory for the masks to come.
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

/// The server's side: what it has sent, and what of it the client has.
#[derive(Debug, Default)]
pub struct SentMasks {
    ring: Ring,
    newest: Option<Acknowledgement>,
    /// Whether the oldest mask of the ring is one that the client has.
    acknowledged: bool,
}

impl SentMasks {
    /// Hears what the client says. Old acknowledgements, and those of masks that are not kept, change nothing.
    pub fn acknowledge(&mut self, heard: Acknowledgement) {
        if self.newest.is_some_and(|newest| !heard.is_after(&newest)) {
            return;
        }
        self.newest = Some(heard);
        match heard.mask {
            None => {
                // What was sent before is of no use: the client has not kept it.
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

    /// Bytes of memory that the masks are kept in, and those that come next will be.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        self.ring.memory_bytes()
    }

    /// The newest mask that the client has, to code against.
    #[must_use]
    pub fn reference(&self) -> Option<&Reference> {
        self.ring.kept.front().filter(|_| self.acknowledged)
    }

    /// Keeps what was encoded last, which is sent as `frame`.
    pub fn keep(&mut self, encoder: &Encoder, frame: FrameNumber) {
        if self.ring.is_full() {
            self.thin_out();
        }
        if !self.ring.is_full() {
            self.ring.keep(|reference| encoder.keep(frame, reference));
        }
    }

    /// Lets go of every other mask that is not acknowledged: so some remain, however long acknowledgements are under
    /// way.
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

/// The client's side: what it has and has said so.
#[derive(Debug, Default)]
pub struct KeptMasks {
    ring: Ring,
    sequence: u32,
    /// Times in a row that there was no room.
    full: u32,
}

/// Times in a row that the client finds no room before it begins anew. The server goes to newer masks long before that,
/// unless it has let go of all those that the client has: then neither end would move again.
const MOST_FULL: u32 = 64;

impl KeptMasks {
    /// The mask that a frame is coded against, if it is kept. Older ones are not needed any more: the server does not
    /// go back.
    pub fn reference(&mut self, name: ReferenceName) -> Option<&Reference> {
        self.ring.find(name)?;
        self.ring.drop_before(name);
        self.ring.kept.front()
    }

    /// Keeps what was decoded last, as `frame`, and says what to tell the server: nothing when not all of the frame had
    /// come. When as much is kept as may be, that the newest of it is there, or, when that goes on, that nothing is.
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

    /// Says that a mask is not at hand that the server thinks is, and forgets the others.
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
