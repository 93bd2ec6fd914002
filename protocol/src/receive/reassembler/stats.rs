//! Counts of a reassembler's packets and frames, by cause.

/// Counts since the reassembler was made. Every packet is in exactly one of `stored`, the `ignored_…` and `malformed`,
/// which add up to `packets`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ReassemblerStats {
    /// Packets pushed, of any kind.
    pub packets: u64,
    /// Their bytes, headers included.
    pub bytes: u64,
    /// Packets whose data was stored, parity included. Their frame may have been dropped later.
    pub stored: u64,
    /// Frames delivered whole.
    pub frames_complete: u64,
    /// Frames that ended in part, under [`Policy::Slices`](super::Policy::Slices). Includes those ended by a whole
    /// newer frame, although only the newer one is delivered.
    pub frames_partial: u64,
    /// Frames that arrived in part and were not delivered: dropped, abandoned, or never begun for lack of their first
    /// packet. Frames that never arrived, or only after a newer frame had begun, are not counted. Exact if packets are
    /// only lost; with packets duplicated or reordered across frames, a frame may count twice.
    pub frames_incomplete: u64,
    /// Packets other than first packets, while no frame had begun.
    pub ignored_not_first: u64,
    /// Packets of frames that had been delivered, dropped, or overtaken by a newer frame.
    pub ignored_old: u64,
    /// Packets stored before.
    pub ignored_duplicate: u64,
    /// Packets that arrived out of order within the frame, which was dropped.
    pub ignored_out_of_order: u64,
    /// Packets of a newer frame, other than its first, that made the reassembler abandon the current frame.
    pub ignored_newer: u64,
    /// Packets that were not frame packets or contradicted their frame.
    pub malformed: u64,
    /// Packets restored from parity.
    pub restored: u64,
    /// Times that parity contradicted the packets and was discarded.
    pub parity_contradicted: u64,
}

impl ReassemblerStats {
    /// Returns the number of packets that were neither stored nor malformed.
    #[must_use]
    pub const fn ignored(&self) -> u64 {
        self.ignored_not_first
            + self.ignored_old
            + self.ignored_duplicate
            + self.ignored_out_of_order
            + self.ignored_newer
    }
}
