//! What a reassembler has seen, counted by cause.

/// Counts since the reassembler was made. Every packet pushed is in exactly one of `stored`, the `ignored_…` and
/// `malformed`, so these add up to `packets`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ReassemblerStats {
    /// Packets pushed, of whatever kind.
    pub packets: u64,
    /// Their bytes, headers included.
    pub bytes: u64,
    /// Packets whose data was stored, parity among them. The frame may still have been dropped later.
    pub stored: u64,
    /// Frames that came out whole.
    pub frames_complete: u64,
    /// Frames that came out in part, under [`Policy::Slices`](super::Policy::Slices). One that a whole newer frame
    /// ended is counted, although only the newer one is given out.
    pub frames_partial: u64,
    /// Frames of which something arrived and which did not come out: dropped, abandoned, or never begun because the
    /// first packet was not there. A frame of which nothing arrived is unknown here, and so is one that only arrived
    /// after a newer frame had begun. Exact where packets are only lost; where they are reordered across frames or
    /// duplicated as well, a frame may be counted twice.
    pub frames_incomplete: u64,
    /// Packets ignored because no frame was begun and they were no first packet.
    pub ignored_not_first: u64,
    /// Packets of frames that had already come out, been dropped, or been overtaken by a newer frame.
    pub ignored_old: u64,
    /// Packets that had been stored already.
    pub ignored_duplicate: u64,
    /// Packets that came out of order inside the frame and dropped it.
    pub ignored_out_of_order: u64,
    /// Packets of a newer frame, not its first, that made the reassembler abandon the frame that it was at.
    pub ignored_newer: u64,
    /// Packets that were no frame packet, or contradicted their frame.
    pub malformed: u64,
    /// Packets that never came and were put together from parity.
    pub restored: u64,
    /// Times that parity did not fit what had come, and was forgotten.
    pub parity_contradicted: u64,
}

impl ReassemblerStats {
    /// All packets that were neither stored nor malformed.
    #[must_use]
    pub const fn ignored(&self) -> u64 {
        self.ignored_not_first
            + self.ignored_old
            + self.ignored_duplicate
            + self.ignored_out_of_order
            + self.ignored_newer
    }
}
