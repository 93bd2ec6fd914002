//! The frames that the client has requested, once or twice.

use crate::{header::PacketHeader, ids::FrameNumber};

/// The newest requested frame, and the one requested again.
///
/// Packets of frames beyond the newest are dropped: the reassembler would take all earlier frames for old ones.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Requests {
    newest: Option<FrameNumber>,
    again: Option<Again>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Again {
    frame: FrameNumber,
    /// The mask had arrived, but the client could not use it.
    refused: bool,
}

impl Requests {
    /// Records that the pose of `frame` is about to be sent.
    pub fn request(&mut self, frame: FrameNumber) {
        self.newest = self.newest.max(Some(frame));
    }

    /// Records that the pose of `frame` is about to be sent again, because no mask arrived or, if `refused`, because
    /// the client could not use it.
    pub fn request_again(&mut self, frame: FrameNumber, refused: bool) {
        self.again = Some(Again { frame, refused });
        self.request(frame);
    }

    /// Returns whether the packet belongs to a frame that was not requested yet.
    pub(super) fn is_ahead(&self, header: &PacketHeader) -> bool {
        header.frame.is_some() && header.frame > self.newest
    }

    /// Returns whether the packet is the first of a second attempt. False if the first attempt has arrived whole in the
    /// meantime. `decoded` is the newest decoded frame.
    pub(super) fn is_second_attempt(&self, header: &PacketHeader, decoded: Option<FrameNumber>) -> bool {
        self.again.is_some_and(|Again { frame, refused }| {
            header.first
                && header.frame == Some(frame)
                && (decoded < header.frame || refused && decoded == header.frame)
        })
    }
}
