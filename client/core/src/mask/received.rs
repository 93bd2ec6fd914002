//! A received mask.

use gnomon_protocol::{
    coverage::Coverage,
    ids::FrameNumber,
    mask::{Mask, MaskShape},
    pose::Pose,
};
use web_time::Instant;

#[derive(Debug, Clone)]
pub struct ReceivedMask {
    /// The frame whose pose requested it.
    pub frame: FrameNumber,
    pub mask: Mask,
    /// Which of its tiles have arrived.
    pub coverage: Coverage,
    /// The pose that it was traced for, if the server looked ahead; `None` means the frame's own pose.
    pub traced_for: Option<Pose>,
    /// Size of the encoded frame, without packet headers.
    pub payload_bytes: usize,
    pub packets: u16,
    /// When its last packet arrived.
    pub received_at: Instant,
}

impl ReceivedMask {
    /// An all-zero mask of `shape`, as a buffer.
    #[must_use]
    pub fn blank(shape: MaskShape, now: Instant) -> Self {
        Self {
            frame: FrameNumber(0),
            mask: Mask::new(shape),
            coverage: Coverage::whole(shape),
            traced_for: None,
            payload_bytes: 0,
            packets: 0,
            received_at: now,
        }
    }
}
