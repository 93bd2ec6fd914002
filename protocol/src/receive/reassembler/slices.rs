//! The `Slices` policy: every packet carries a part of its frame that can be read alone, so what comes is kept.
//!
//! A frame begins with whichever of its packets comes first, and takes the others in any order. It ends when all have
//! come or when a packet of a newer frame comes; then it comes out with what is there, unless that has come out
//! already, because whoever waits for it had waited long enough. It is settled after that, and so are all older ones.

use super::{
    IgnoredCause,
    whole_frame::{FramePacket, Verdict},
};
use crate::ids::FrameNumber;

/// The frame at hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Current {
    /// The packet that came first, whichever it was; where only parity has come, what that says of the frame's first
    /// one.
    pub(super) begun_by: FramePacket,
    /// Packets taken, those put together from parity among them.
    pub(super) taken: u16,
    pub(super) restored: u16,
    /// Their data.
    bytes: usize,
    /// Places of the outermost packets that came, and of the frame's first once it has, counted from the one that came
    /// first.
    lowest: i64,
    highest: i64,
    first: Option<i64>,
    /// Packets that have come out, and their data.
    given: u16,
    pub(super) given_bytes: usize,
}

/// Whether two packets say the same of their frame.
fn is_alike(one: &FramePacket, other: &FramePacket) -> bool {
    one.packets == other.packets && one.timestamp_ms == other.timestamp_ms
}

impl Current {
    /// A frame of which `taken` packets have come: this one or none.
    fn begun_by(packet: &FramePacket, taken: u16) -> Self {
        Self {
            begun_by: *packet,
            taken,
            restored: 0,
            bytes: packet.data_bytes,
            lowest: 0,
            highest: 0,
            first: packet.first.then_some(0),
            given: 0,
            given_bytes: 0,
        }
    }

    /// Packets that have not come.
    pub(super) fn missing(&self) -> u16 {
        self.begun_by.packets.get() - self.taken
    }

    /// Where a packet lies, from the one that came first.
    fn place(&self, packet: &FramePacket) -> i64 {
        // Wrapping: a session lives longer than 2³² packets.
        i64::from(packet.sequence.wrapping_sub(self.begun_by.sequence).cast_signed())
    }

    /// Takes a packet into the frame's extent; nothing when the frame would be contradicted by it.
    fn extended(&self, packet: &FramePacket, place: i64) -> Option<Self> {
        let first = if packet.first { Some(place) } else { self.first };
        let (lowest, highest) = (self.lowest.min(place), self.highest.max(place));
        let packets = i64::from(self.begun_by.packets.get());
        let agrees = is_alike(&self.begun_by, packet)
            && packet.first == (first == Some(place))
            && highest - first.unwrap_or(lowest) < packets
            && first.is_none_or(|first| first <= lowest);
        agrees.then_some(Self { lowest, highest, first, ..*self })
    }
}

/// The policy's state.
#[derive(Debug)]
pub(super) struct Slices {
    max_frame_bytes: usize,
    pub(super) current: Option<Current>,
    /// A bit for each place that a packet of the frame at hand can have, from the one that came first: as many below it
    /// as above.
    seen: Vec<u64>,
    /// Newest settled frame.
    settled: Option<FrameNumber>,
    pub(super) frames_complete: u64,
    pub(super) frames_partial: u64,
    pub(super) frames_incomplete: u64,
}

impl Slices {
    pub(super) const fn new(max_frame_bytes: usize) -> Self {
        Self {
            max_frame_bytes,
            current: None,
            seen: Vec::new(),
            settled: None,
            frames_complete: 0,
            frames_partial: 0,
            frames_incomplete: 0,
        }
    }

    /// Whether all packets of the frame at hand have come.
    pub(super) fn complete(&self) -> Option<Current> {
        self.current.filter(|current| current.missing() == 0)
    }

    /// Delivers the current frame if packets of it have arrived since its last delivery.
    pub(super) fn deliver_partial(&mut self) -> Option<Current> {
        let current = self.current.as_mut().filter(|current| current.taken > current.given)?;
        let out = *current;
        (current.given, current.given_bytes) = (current.taken, current.bytes);
        Some(out)
    }

    /// The frame at hand ends here, in part. It comes out if something of it has not yet.
    pub(super) fn end(&mut self) -> Option<Current> {
        let ended = self.current.take()?;
        *(if ended.taken > 0 { &mut self.frames_partial } else { &mut self.frames_incomplete }) += 1;
        Some(ended).filter(|ended| ended.taken > ended.given)
    }

    /// Makes room for what follows: a frame that is complete is at hand no more.
    pub(super) fn leave_complete(&mut self) {
        self.current = self.current.filter(|current| current.missing() > 0);
    }

    /// Whether a packet of this frame ends the one at hand, because that is older.
    pub(super) fn is_newer(&self, frame: FrameNumber) -> bool {
        self.current.is_some_and(|current| frame > current.begun_by.frame)
    }

    /// Decides about parity of a frame that is not newer than the one at hand, by what it says of the frame's first
    /// packet.
    pub(super) fn parity(&mut self, first: &FramePacket) -> Verdict {
        match self.current.filter(|current| current.begun_by.frame == first.frame) {
            Some(Current { begun_by, .. }) if is_alike(&begun_by, first) => Verdict::Append,
            Some(_) => Verdict::Contradiction,
            None if self.is_settled(first.frame) => Verdict::Ignore(IgnoredCause::Old),
            None => {
                self.settled = Some(first.frame);
                self.current = Some(Current::begun_by(first, 0));
                Verdict::Begin
            }
        }
    }

    /// So many packets have been put together, all that were missing.
    pub(super) fn restored(&mut self, packets: u16, bytes: usize) {
        if let Some(current) = &mut self.current {
            current.taken += packets;
            current.restored += packets;
            current.bytes += bytes;
        }
        self.count_if_complete();
    }

    fn is_settled(&self, frame: FrameNumber) -> bool {
        self.settled.is_some_and(|settled| frame <= settled)
    }

    /// Decides about a packet that is not newer than the frame at hand.
    pub(super) fn packet(&mut self, packet: &FramePacket) -> Verdict {
        let Some(current) = self.current.filter(|current| current.begun_by.frame == packet.frame) else {
            return self.begin(packet);
        };
        if current.taken == 0 {
            // So far there was parity only, which counts for less than what it stands in for.
            let alike = is_alike(&current.begun_by, packet);
            let verdict = self.start(packet);
            return if alike && verdict == Verdict::Begin { Verdict::Append } else { verdict };
        }
        let place = current.place(packet);
        let Some(extended) = current.extended(packet, place) else {
            self.drop_current();
            return Verdict::Contradiction;
        };
        if !self.see(place, extended.begun_by.packets.get()) {
            return Verdict::Ignore(IgnoredCause::Duplicate);
        }
        if packet.data_bytes > self.max_frame_bytes - current.bytes {
            self.drop_current();
            return Verdict::TooLong;
        }
        let bytes = current.bytes + packet.data_bytes;
        self.current = Some(Current { taken: current.taken + 1, bytes, ..extended });
        self.count_if_complete();
        Verdict::Append
    }

    fn begin(&mut self, packet: &FramePacket) -> Verdict {
        if self.is_settled(packet.frame) { Verdict::Ignore(IgnoredCause::Old) } else { self.start(packet) }
    }

    fn start(&mut self, packet: &FramePacket) -> Verdict {
        self.settled = Some(packet.frame);
        if packet.data_bytes > self.max_frame_bytes {
            self.drop_current();
            return Verdict::TooLong;
        }
        self.current = Some(Current::begun_by(packet, 1));
        self.seen.clear();
        self.seen.resize((usize::from(packet.packets.get()) * 2).div_ceil(64), 0);
        self.see(0, packet.packets.get());
        self.count_if_complete();
        Verdict::Begin
    }

    /// Whether the place has not been seen before. It is less than `packets` away from the first that came.
    fn see(&mut self, place: i64, packets: u16) -> bool {
        let bit = usize::try_from(place + i64::from(packets)).unwrap_or(0);
        let Some(word) = self.seen.get_mut(bit / 64) else { return false };
        let before = *word;
        *word |= 1 << (bit % 64);
        before != *word
    }

    fn drop_current(&mut self) {
        self.current = None;
        self.frames_incomplete += 1;
    }

    fn count_if_complete(&mut self) {
        self.frames_complete += u64::from(self.complete().is_some());
    }
}
