//! The `Slices` policy: every packet carries a part of its frame that can be decoded alone, so every packet is kept.
//!
//! A frame begins with its first packet to arrive, and takes the others in any order. It ends when all have arrived, or
//! when a packet of a newer frame arrives. Then everything not yet delivered is delivered. After that, the frame and
//! all older ones are settled.

use super::{
    IgnoredCause,
    baseline::{FramePacket, Verdict},
};
use crate::ids::FrameNumber;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Current {
    /// The packet that arrived first. If only parity has arrived: the frame's first packet, as the parity describes it.
    pub(super) begun_by: FramePacket,
    /// Packets taken, restored ones included.
    pub(super) taken: u16,
    pub(super) restored: u16,
    /// Bytes of data in the packets taken.
    bytes: usize,
    /// Lowest and highest index of the packets that arrived, and the index of the frame's first packet if it did, all
    /// relative to the packet that arrived first.
    lowest: i64,
    highest: i64,
    first: Option<i64>,
    /// Packets delivered, and the bytes of their data.
    given: u16,
    pub(super) given_bytes: usize,
}

/// Returns whether two packets agree about their frame.
fn is_alike(one: &FramePacket, other: &FramePacket) -> bool {
    one.packets == other.packets && one.timestamp_ms == other.timestamp_ms
}

impl Current {
    /// Returns a frame begun by a packet. `taken` is 1, or 0 for parity.
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

    pub(super) fn missing(&self) -> u16 {
        self.begun_by.packets.get() - self.taken
    }

    /// Returns a packet's index relative to the one that arrived first.
    fn place(&self, packet: &FramePacket) -> i64 {
        // Wrapping: a session lives longer than 2³² packets.
        i64::from(packet.sequence.wrapping_sub(self.begun_by.sequence).cast_signed())
    }

    /// Returns the frame extended by a packet, or `None` if they contradict each other.
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

#[derive(Debug)]
pub(super) struct Slices {
    max_frame_bytes: usize,
    pub(super) current: Option<Current>,
    /// One bit for each index that a packet of the current frame can have, relative to the one that arrived first: as
    /// many below it as above.
    seen: Vec<u64>,
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

    /// Returns the current frame if all its packets have arrived.
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

    /// Ends the current frame in part. Returns it if some of it was not delivered.
    pub(super) fn end(&mut self) -> Option<Current> {
        let ended = self.current.take()?;
        *(if ended.taken > 0 { &mut self.frames_partial } else { &mut self.frames_incomplete }) += 1;
        Some(ended).filter(|ended| ended.taken > ended.given)
    }

    /// Drops the current frame if it is complete.
    pub(super) fn leave_complete(&mut self) {
        self.current = self.current.filter(|current| current.missing() > 0);
    }

    /// Returns whether a packet of `frame` ends the current, older frame.
    pub(super) fn is_newer(&self, frame: FrameNumber) -> bool {
        self.current.is_some_and(|current| frame > current.begun_by.frame)
    }

    /// Decides about parity of a frame not newer than the current one. `first` is the first packet that it describes.
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

    /// Records that all missing packets were restored.
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

    /// Decides about a packet of a frame not newer than the current one.
    pub(super) fn packet(&mut self, packet: &FramePacket) -> Verdict {
        let Some(current) = self.current.filter(|current| current.begun_by.frame == packet.frame) else {
            return self.begin(packet);
        };
        if current.taken == 0 {
            // So far only parity has arrived, and packets outrank parity.
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

    /// Marks an index and returns whether it is new. It lies less than `packets` away from 0.
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
