//! The receive task: packets → reassembler → decoder → back buffer → swap.

use std::{
    convert::Infallible,
    path::PathBuf,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Instant,
};

use gnomon_protocol::{
    codec::Decoder,
    frame::Frame,
    header::PacketHeader,
    ids::FrameNumber,
    limits::MAX_FRAME_BYTES,
    mask::MaskShape,
    reassembler::{IgnoredCause, PacketError, Policy, Progress, Reassembler},
};

use super::link::{DataReceiver, root_cause};
use crate::mask_buffer::MaskWriter;

/// What has come in so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Received {
    /// Whole frames that decoded.
    pub(crate) frames: u64,
    /// Frames of which something came, but not all.
    pub(crate) incomplete: u64,
    /// Whole frames that did not decode, or have another shape than was agreed on.
    pub(crate) bad: u64,
    /// Bytes of the whole frames, packet headers not counted.
    pub(crate) payload_bytes: u64,
    /// Packets of the whole frames.
    pub(crate) packets: u64,
}

/// Counters that the receive task writes and anybody reads.
pub(crate) type Counters = Arc<Mutex<Received>>;

/// Frames that are asked for a second time, because they did not come.
///
/// The reassembler lets frames out in growing order only and ignores what it has given up. A frame that is sent anew
/// therefore needs a fresh one, as soon as the first packet of the second attempt is there; but not when the first
/// attempt was only late, and has come whole in the meantime.
#[derive(Debug, Clone, Default)]
pub(crate) struct Again(Arc<AtomicU64>);

impl Again {
    /// Says that `frame` has been asked for again.
    pub(crate) fn ask(&self, frame: FrameNumber) {
        self.0.store(u64::from(frame.0) + 1, Ordering::Release);
    }

    /// The frame that this packet begins, if it was asked for again.
    fn begun_by(&self, packet: &[u8]) -> Option<FrameNumber> {
        let asked = self.0.load(Ordering::Acquire);
        let (header, _) = PacketHeader::decode(packet).ok().filter(|(header, _)| header.first && asked != 0)?;
        header.frame.filter(|frame| u64::from(frame.0) + 1 == asked)
    }
}

/// What the task works with.
pub(crate) struct ReceiveTask {
    pub(crate) receiver: DataReceiver,
    pub(crate) writer: MaskWriter,
    /// The largest shape that a mask may have.
    pub(crate) shape: MaskShape,
    pub(crate) counters: Counters,
    pub(crate) again: Again,
    /// Folder that every frame's body is written to.
    pub(crate) save_masks: Option<PathBuf>,
}

impl ReceiveTask {
    /// Receives until the link is gone. Gives the reason back, and the renderer's end open: there may be a better reason.
    pub(crate) async fn run(mut self) -> (String, MaskWriter) {
        match self.receive().await {
            Ok(never) => match never {},
            Err(reason) => (reason, self.writer),
        }
    }

    async fn receive(&mut self) -> Result<Infallible, String> {
        let limit = max_frame_bytes(self.shape);
        let fresh = || Reassembler::with_max_frame_bytes(Policy::WholeFrame, limit);
        let mut reassembler = fresh();
        let mut decoder = Decoder::new();
        // Of the reassemblers before this one.
        let mut incomplete_before = 0;
        // Whether a frame is begun, which the reassembler counts as incomplete only when it gives it up.
        let mut begun = false;
        // The newest mask.
        let mut whole = None;
        loop {
            let packet =
                self.receiver.receive().await.map_err(|error| format!("connection lost: {}", root_cause(&error)))?;
            if self.again.begun_by(packet).is_some_and(|frame| whole != Some(frame)) {
                incomplete_before += reassembler.stats().frames_incomplete + u64::from(begun);
                reassembler = fresh();
            }
            let progress = reassembler.push(packet);
            let incomplete = incomplete_before + reassembler.stats().frames_incomplete;
            match progress {
                Ok(Progress::Complete) => {
                    begun = false;
                    whole = self.take_frame(&reassembler, &mut decoder, incomplete)?.or(whole);
                }
                Ok(Progress::Stored) => begun = true,
                Ok(Progress::Ignored(cause)) => {
                    begun &= !matches!(cause, IgnoredCause::OutOfOrder | IgnoredCause::Newer);
                    tracing::trace!(?cause, "packet ignored");
                    let mut counters = self.counters.lock().unwrap_or_else(PoisonError::into_inner);
                    if std::mem::replace(&mut counters.incomplete, incomplete) < incomplete {
                        self.writer.lose();
                    }
                }
                Err(error) => {
                    begun &= !matches!(error, PacketError::Contradiction { .. } | PacketError::TooLong { .. });
                    tracing::debug!(%error, "bad packet");
                }
            }
        }
    }

    /// Hands a whole frame to the renderer, and says which it was, unless it is no mask.
    fn take_frame(
        &mut self,
        reassembler: &Reassembler,
        decoder: &mut Decoder,
        incomplete: u64,
    ) -> Result<Option<FrameNumber>, String> {
        let Some(complete) = reassembler.frame() else { return Ok(None) };
        let received_at = Instant::now();
        let largest = self.shape;
        let back = self.writer.back();
        // The shape is looked at before memory for it is taken.
        let decoded = match Frame::parse(complete.body).map(|frame| frame.head) {
            Ok(head) if is_within(head.shape, largest) => {
                back.traced_for = head.traced_for;
                decoder.decode(complete.body, &mut back.mask).map(drop).map_err(|error| error.to_string())
            }
            Ok(head) => Err(format!("its shape is {:?}, {largest:?} is the largest agreed on", head.shape)),
            Err(error) => Err(error.to_string()),
        };
        let mut counters = self.counters.lock().unwrap_or_else(PoisonError::into_inner);
        counters.incomplete = incomplete;
        if let Err(reason) = decoded {
            counters.bad += 1;
            tracing::warn!(frame = complete.frame.0, %reason, "a frame is no mask");
            return Ok(None);
        }
        counters.frames += 1;
        counters.payload_bytes += complete.body.len() as u64;
        counters.packets += u64::from(complete.packets);
        drop(counters);
        if let Some(folder) = &self.save_masks {
            let file = folder.join(format!("frame_{:06}.body", complete.frame.0));
            std::fs::write(&file, complete.body)
                .map_err(|error| format!("cannot write {}: {error}", file.display()))?;
        }
        back.frame = complete.frame;
        back.payload_bytes = complete.body.len();
        back.packets = complete.packets;
        back.received_at = received_at;
        self.writer.publish();
        Ok(Some(complete.frame))
    }
}

/// Whether masks of this shape may come at all; which one was asked for is known where poses are.
fn is_within(shape: MaskShape, largest: MaskShape) -> bool {
    shape.lights() == largest.lights() && shape.width() <= largest.width() && shape.height() <= largest.height()
}

/// The longest that a frame of this shape can be: its words uncompressed, what LZ4 adds to noise (one byte in 255),
/// and the head with its table of slices.
fn max_frame_bytes(shape: MaskShape) -> usize {
    let words = shape.pixels() * 4;
    (words + words / 255 + 64 * 1024).min(MAX_FRAME_BYTES)
}
