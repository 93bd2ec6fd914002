//! The `WholeFrame` policy: the receiving algorithm of the dissertation (§3.2, Figures 2 and 3), headers only.
//!
//! Waiting (the initial state): the first packet of a frame newer than all that is settled begins that frame; other
//! packets are ignored. At a frame i:
//! - the packet that is next in sequence is taken, and the last one completes the frame;
//! - any other packet of i drops i, except a duplicate of one already taken: it says nothing about loss and the
//!   figures have no case for it, so it is ignored;
//! - packets of older frames are ignored;
//! - a packet of a newer frame j abandons i. Here we are greedier than Figure 2, which goes back to waiting and so
//!   loses j as well: if it is j's first packet, j begins at once; if not, j is lost and we wait for a newer one.
//!
//! A frame that was delivered, dropped or abandoned is settled, and so are all older ones: frames are delivered in
//! strictly increasing order. Frame numbers do not wrap (u32 at 120 Hz: 414 days); sequence numbers wrap after some
//! days, and are only compared with those of the same frame.

use std::num::NonZeroU16;

use crate::ids::FrameNumber;

/// The header of a packet that belongs to a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct FramePacket {
    pub(super) sequence: u32,
    pub(super) frame: FrameNumber,
    pub(super) packets: NonZeroU16,
    pub(super) first: bool,
    pub(super) timestamp_ms: u32,
    pub(super) data_bytes: usize,
}

/// Why a packet was ignored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum IgnoredCause {
    /// No frame has begun, and this is not a first packet.
    NotFirst,
    /// Its frame was delivered, dropped, or is older than the current one.
    Old,
    Duplicate,
    /// It is not the next packet of the current frame, which is dropped.
    OutOfOrder,
    /// It belongs to a newer frame but is not its first packet. Both frames are lost.
    Newer,
}

/// What to do with a packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Store the data at the start of the buffer. The frame needs more.
    Begin,
    /// Append the data to the buffer. The frame needs more, or is complete.
    Append,
    Ignore(IgnoredCause),
    /// It contradicts its frame, which is dropped.
    Contradiction,
    /// It makes its frame longer than allowed. The frame is dropped.
    TooLong,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Current {
    pub(super) first: FramePacket,
    /// Packets taken, at least one.
    pub(super) taken: u16,
    /// Bytes of data in the packets taken.
    bytes: usize,
}

impl Current {
    fn is_complete(&self) -> bool {
        self.taken == self.first.packets.get()
    }

    /// Returns whether the packet agrees with the first one in the fields that all packets of a frame share.
    fn agrees_with(&self, packet: &FramePacket) -> bool {
        packet.packets == self.first.packets && packet.timestamp_ms == self.first.timestamp_ms
    }
}

#[derive(Debug)]
pub(super) struct WholeFrame {
    max_frame_bytes: usize,
    current: Option<Current>,
    settled: Option<FrameNumber>,
    /// Newest frame counted as incomplete because packets of it arrived without the first.
    headless: Option<FrameNumber>,
    pub(super) frames_complete: u64,
    pub(super) frames_incomplete: u64,
}

impl WholeFrame {
    pub(super) const fn new(max_frame_bytes: usize) -> Self {
        Self { max_frame_bytes, current: None, settled: None, headless: None, frames_complete: 0, frames_incomplete: 0 }
    }

    /// Drops the current frame if it is complete.
    pub(super) fn leave_complete(&mut self) {
        self.current = self.current.filter(|current| !current.is_complete());
    }

    /// Returns the frame that the last packet completed. Call [`Self::leave_complete`] before the next packet.
    pub(super) fn complete(&self) -> Option<Current> {
        self.current.filter(Current::is_complete)
    }

    pub(super) fn packet(&mut self, packet: &FramePacket) -> Verdict {
        let Some(current) = &mut self.current else {
            return self.waiting(packet);
        };
        if packet.frame < current.first.frame {
            return Verdict::Ignore(IgnoredCause::Old);
        }
        if packet.frame > current.first.frame {
            self.drop_current();
            return match self.waiting(packet) {
                Verdict::Ignore(_) => {
                    self.settled = Some(packet.frame);
                    Verdict::Ignore(IgnoredCause::Newer)
                }
                begun => begun,
            };
        }
        // Wrapping: a session lives longer than 2³² packets.
        let index = packet.sequence.wrapping_sub(current.first.sequence);
        if !current.agrees_with(packet) || packet.first != (index == 0) {
            self.drop_current();
            return Verdict::Contradiction;
        }
        if index < u32::from(current.taken) {
            return Verdict::Ignore(IgnoredCause::Duplicate);
        }
        if index > u32::from(current.taken) {
            self.drop_current();
            return Verdict::Ignore(IgnoredCause::OutOfOrder);
        }
        if packet.data_bytes > self.max_frame_bytes - current.bytes {
            self.drop_current();
            return Verdict::TooLong;
        }
        current.taken += 1;
        current.bytes += packet.data_bytes;
        self.settle_if_complete();
        Verdict::Append
    }

    /// Drops the current frame, if any.
    fn drop_current(&mut self) {
        if let Some(Current { first, .. }) = self.current.take() {
            self.settled = Some(first.frame);
            self.count_incomplete(first.frame);
        }
    }

    fn waiting(&mut self, packet: &FramePacket) -> Verdict {
        if self.settled.is_some_and(|settled| packet.frame <= settled) {
            return Verdict::Ignore(IgnoredCause::Old);
        }
        if !packet.first {
            if self.headless < Some(packet.frame) {
                self.headless = Some(packet.frame);
                self.frames_incomplete += 1;
            }
            return Verdict::Ignore(IgnoredCause::NotFirst);
        }
        self.current = Some(Current { first: *packet, taken: 1, bytes: packet.data_bytes });
        if packet.data_bytes > self.max_frame_bytes {
            self.drop_current();
            return Verdict::TooLong;
        }
        self.settle_if_complete();
        Verdict::Begin
    }

    fn settle_if_complete(&mut self) {
        if let Some(Current { first, .. }) = self.complete() {
            self.settled = Some(first.frame);
            self.frames_complete += 1;
            if self.headless == Some(first.frame) {
                // Its second packet arrived before its first, and then again.
                self.frames_incomplete -= 1;
            }
        }
    }

    fn count_incomplete(&mut self, frame: FrameNumber) {
        if self.headless != Some(frame) {
            self.frames_incomplete += 1;
        }
    }
}
