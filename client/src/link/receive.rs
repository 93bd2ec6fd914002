//! The receive task: packets → reassembler → decoder → back buffer → swap.
//!
//! Where each packet of a frame stands alone, a frame comes out in part when what is missing of it takes longer than packets take
//! of late, or a newer one begins, and once more when more of it has come. The mask says which of its tiles have come
//! ([`gnomon_protocol::coverage`]); the others keep the value that they had.

use std::{
    convert::Infallible,
    fs::File,
    io::Write as _,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Instant,
};

use gnomon_protocol::{
    acknowledgement::Acknowledgement,
    codec::{DecodeError, Decoder},
    frame::{Frame, FrameHead},
    header::PacketHeader,
    ids::FrameNumber,
    limits::MAX_FRAME_BYTES,
    loss::{FEEDBACK_INTERVAL, LossFeedback, LossMeter},
    mask::{Mask, MaskShape},
    reassembler::{CompleteFrame, Deadline, IgnoredCause, PacketError, Policy, Progress, Reassembler},
    references::KeptMasks,
};
use gnomon_transport::root_cause;
use tokio::sync::watch;

use super::{connection::DataReceiver, receive_options::Reception};
use crate::mask_buffer::MaskWriter;

/// What has come in so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Received {
    /// Whole frames that decoded.
    pub(crate) frames: u64,
    /// Frames that the server had left parts out of, and of which the others decoded.
    pub(crate) cut: u64,
    /// Frames that were shown although something of them was missing.
    pub(crate) partial: u64,
    /// Frames of which something came, but not all, and which were not shown.
    pub(crate) incomplete: u64,
    /// Frames whose pose had not been sent when their first packet came.
    pub(crate) future: u64,
    /// Frames that did not decode, are coded against a mask that is not here, or have another shape than was agreed on.
    pub(crate) bad: u64,
    /// Bytes of the whole frames and of those that were cut, packet headers not counted.
    pub(crate) payload_bytes: u64,
    /// Their packets.
    pub(crate) packets: u64,
}

/// Counters that the receive task writes and anybody reads.
pub(crate) type Counters = Arc<Mutex<Received>>;

/// What has been asked for: the newest frame, and the one that is asked for a second time, because it did not come or was of no
/// use.
///
/// A packet of a frame beyond the newest answers nothing. Were it pushed, the reassembler would take every frame before it for an
/// old one.
///
/// The reassembler lets frames out in growing order only and ignores what it has given up. A frame that is sent anew
/// therefore needs a fresh one, as soon as the first packet of the second attempt is there; but not when the first
/// attempt was only late, and has come whole in the meantime.
#[derive(Debug, Clone, Default)]
pub(crate) struct Requested {
    /// One more than the newest frame's number.
    newest: Arc<AtomicU64>,
    /// Twice one more than the number of the frame that is asked for again, plus 1 when it has come but is of no use.
    again: Arc<AtomicU64>,
}

impl Requested {
    /// Says that the pose of `frame` is about to leave.
    pub(crate) fn ask(&self, frame: FrameNumber) {
        self.newest.fetch_max(u64::from(frame.0) + 1, Ordering::AcqRel);
    }

    /// Says that `frame` is about to be asked for again; `refused` when its mask has come and is of no use.
    pub(crate) fn ask_again(&self, frame: FrameNumber, refused: bool) {
        self.again.store((u64::from(frame.0) + 1) * 2 + u64::from(refused), Ordering::Release);
    }

    /// Whether no pose of this packet's frame has been sent yet.
    fn is_ahead(&self, header: &PacketHeader) -> bool {
        header.frame.is_some_and(|frame| u64::from(frame.0) >= self.newest.load(Ordering::Acquire))
    }

    /// Whether this packet begins the second attempt at a frame, when `whole` is the newest frame that has come.
    fn is_begun_anew(&self, header: &PacketHeader, whole: Option<FrameNumber>) -> bool {
        let again = self.again.load(Ordering::Acquire);
        let refused = again % 2 == 1;
        header.first
            && header.frame.is_some_and(|frame| u64::from(frame.0) + 1 == again / 2)
            && (whole < header.frame || refused && whole == header.frame)
    }
}

/// What the task works with.
pub(crate) struct ReceiveTask {
    pub(crate) receiver: DataReceiver,
    pub(crate) writer: MaskWriter,
    /// The largest shape that a mask may have.
    pub(crate) shape: MaskShape,
    pub(crate) reception: Reception,
    /// Where it says which masks later ones can be coded against.
    pub(crate) acknowledge: watch::Sender<Option<Acknowledgement>>,
    /// Where it tells how many packets are missing.
    pub(crate) tell_losses: watch::Sender<Option<LossFeedback>>,
    pub(crate) counters: Counters,
    pub(crate) requested: Requested,
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
        let Reception { policy, tells_losses, .. } = self.reception;
        let fresh = || Reassembler::with_max_frame_bytes(policy, limit);
        let mut reassembler = fresh();
        // Masks that are written down stand alone.
        let mut decoder = FrameDecoder::new(policy, self.shape, self.reception.save_masks.is_none());
        // When the frame at hand comes out as it is.
        let mut deadline = Deadline::default();
        let mut losses = Losses::default();
        // Of the reassemblers before this one.
        let mut incomplete_before = 0;
        // Whether a frame is begun, which the reassembler counts as incomplete only when it gives it up.
        let mut begun = false;
        // The newest mask.
        let mut whole = None;
        loop {
            let Ok(packet) = within(deadline.due(), self.receiver.receive()).await else {
                deadline.given();
                reassembler.so_far();
                let incomplete = incomplete_before + reassembler.stats().frames_incomplete;
                whole = self.take_frame(&reassembler, &mut decoder, incomplete)?.or(whole);
                continue;
            };
            let packet = &packet.map_err(|error| format!("connection lost: {}", root_cause(&error)))?[..];
            let header = PacketHeader::decode(packet).ok().map(|(header, _)| header);
            if let Some(header) = header.filter(|header| self.requested.is_ahead(header)) {
                tracing::debug!(frame = ?header.frame, "a packet of a frame that was not asked for yet");
                let mut counters = self.counters.lock().unwrap_or_else(PoisonError::into_inner);
                counters.future += u64::from(header.first);
                continue;
            }
            if header.is_some_and(|header| self.requested.is_begun_anew(&header, whole)) {
                incomplete_before += reassembler.stats().frames_incomplete + u64::from(begun);
                reassembler = fresh();
            }
            let now = Instant::now();
            if let Some(header) = header.filter(|_| tells_losses) {
                self.tell_losses.send_if_modified(|told| losses.take(&header, now, told));
            }
            let progress = reassembler.push(packet);
            let incomplete = incomplete_before + reassembler.stats().frames_incomplete;
            match progress {
                Ok(progress @ (Progress::Stored | Progress::Partial | Progress::Complete)) => {
                    begun = progress != Progress::Complete;
                    if let Some(frame) = header.and_then(|header| header.frame).filter(|_| policy == Policy::Slices) {
                        deadline.stored(now, frame, !begun);
                    }
                }
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
            whole = self.take_frame(&reassembler, &mut decoder, incomplete)?.or(whole);
        }
    }

    /// Hands the frame that has come out to the renderer, and says which it was, unless there is none or it is no mask.
    fn take_frame(
        &mut self,
        reassembler: &Reassembler,
        decoder: &mut FrameDecoder,
        incomplete: u64,
    ) -> Result<Option<FrameNumber>, String> {
        let Some(complete) = reassembler.frame() else { return Ok(None) };
        let received_at = Instant::now();
        let back = self.writer.back();
        // The shape is looked at before memory for it is taken.
        let decoded = match Frame::parse(complete.body).map(|frame| frame.head) {
            Ok(head) if is_within(self.shape, head.shape) => {
                back.traced_for = head.traced_for;
                let (decoded, said) = decoder.decode(&complete, &head, &mut back.mask);
                decoder.decoder.coverage(head.shape, &mut back.coverage);
                if said.is_some() {
                    self.acknowledge.send_replace(said);
                }
                decoded.map_err(|error| error.to_string())
            }
            Ok(head) => Err(format!("its shape is {:?}, {:?} is the largest agreed on", head.shape, self.shape)),
            Err(error) => Err(error.to_string()),
        };
        let mut counters = self.counters.lock().unwrap_or_else(PoisonError::into_inner);
        counters.incomplete = incomplete;
        if let Err(reason) = decoded {
            counters.bad += 1;
            tracing::warn!(frame = complete.frame.0, %reason, "a frame is no mask");
            return Ok(None);
        }
        // What comes out once more has been counted.
        let in_part = (complete.missing > 0).then_some(complete.frame);
        let again = std::mem::replace(&mut decoder.in_part, in_part) == Some(complete.frame);
        let whole = complete.missing == 0 && back.coverage.is_whole();
        if complete.missing == 0 {
            counters.frames += u64::from(whole);
            counters.cut += u64::from(!whole);
            counters.partial -= u64::from(again);
            counters.payload_bytes += complete.body.len() as u64;
            counters.packets += u64::from(complete.packets);
        } else {
            counters.partial += u64::from(!again);
        }
        drop(counters);
        if let Some(folder) = self.reception.save_masks.as_ref().filter(|_| whole) {
            let file = folder.join(format!("frame_{:06}.body", complete.frame.0));
            std::fs::write(&file, complete.body)
                .map_err(|error| format!("cannot write {}: {error}", file.display()))?;
        }
        if let Some(file) = &self.reception.came {
            let CompleteFrame { frame: FrameNumber(number), packets, restored, missing, .. } = complete;
            File::options()
                .append(true)
                .open(file)
                .and_then(|mut file| writeln!(file, "{number} {packets} {restored} {missing}"))
                .map_err(|error| format!("cannot write to {}: {error}", file.display()))?;
        }
        back.frame = complete.frame;
        back.payload_bytes = complete.body.len();
        back.packets = complete.packets;
        back.received_at = received_at;
        self.writer.publish();
        Ok(Some(complete.frame))
    }
}

/// Counts what is missing, and tells it now and then.
#[derive(Default)]
struct Losses {
    meter: LossMeter,
    told_at: Option<Instant>,
}

impl Losses {
    /// Counts a packet, and says whether it is time to tell `told`.
    fn take(&mut self, header: &PacketHeader, now: Instant, told: &mut Option<LossFeedback>) -> bool {
        self.meter.take(header.sequence);
        let due = self.told_at.is_none_or(|at| now.saturating_duration_since(at) >= FEEDBACK_INTERVAL);
        if due {
            self.told_at = Some(now);
            let sequence = told.map_or(0, |before| before.sequence.wrapping_add(1));
            *told = Some(LossFeedback { sequence, totals: self.meter.totals() });
        }
        due
    }
}

/// What `receive` gives, or nothing when the deadline comes before.
async fn within<T>(
    deadline: Option<Instant>,
    receive: impl Future<Output = T>,
) -> Result<T, tokio::time::error::Elapsed> {
    match deadline {
        Some(deadline) => tokio::time::timeout_at(deadline.into(), receive).await,
        None => Ok(receive.await),
    }
}

/// Decodes frames, knows the tiles that frames in part leave out, and keeps the masks that later ones may be coded against.
struct FrameDecoder {
    decoder: Decoder,
    /// The newest value of each tile, where frames come in part.
    newest: Option<Mask>,
    /// The frame that has come out last, if it was counted as one in part.
    in_part: Option<FrameNumber>,
    /// Nothing where frames are to stand alone.
    kept: Option<KeptMasks>,
}

impl FrameDecoder {
    fn new(policy: Policy, shape: MaskShape, with_references: bool) -> Self {
        Self {
            decoder: Decoder::new(),
            newest: (policy == Policy::Slices).then(|| Mask::new(shape)),
            in_part: None,
            kept: with_references.then(KeptMasks::default),
        }
    }

    /// Decodes a frame with this head, and says what the server is to hear of it.
    fn decode(
        &mut self,
        frame: &CompleteFrame<'_>,
        head: &FrameHead,
        mask: &mut Mask,
    ) -> (Result<(), DecodeError>, Option<Acknowledgement>) {
        let decoded = self.decode_into(frame, head, mask);
        let said = self.kept.as_mut().and_then(|kept| match decoded {
            Ok(()) => kept.keep(&self.decoder, frame.frame),
            Err(DecodeError::Reference(_)) => Some(kept.lose()),
            Err(_) => None,
        });
        (decoded, said)
    }

    fn decode_into(&mut self, frame: &CompleteFrame<'_>, head: &FrameHead, mask: &mut Mask) -> Result<(), DecodeError> {
        let reference = head.reference.zip(self.kept.as_mut()).and_then(|(name, kept)| kept.reference(name));
        let Some(newest) = &mut self.newest else {
            return self.decoder.decode_against(reference, frame.body, mask).map(drop);
        };
        if newest.shape() != head.shape {
            newest.reset(head.shape);
        }
        if frame.known_bytes == 0 {
            self.decoder.decode_onto(reference, frame.body, newest)?;
        } else {
            self.decoder.decode_more(reference, &frame.body[frame.known_bytes..], newest)?;
        }
        if mask.shape() != head.shape {
            mask.reset(head.shape);
        }
        mask.words_mut().copy_from_slice(newest.words());
        Ok(())
    }
}

/// Whether masks of this shape may come at all; which one was asked for is known where poses are.
fn is_within(largest: MaskShape, shape: MaskShape) -> bool {
    shape.lights() == largest.lights() && shape.width() <= largest.width() && shape.height() <= largest.height()
}

/// The longest that a frame of this shape can be: its words uncompressed, what LZ4 adds to noise (one byte in 255),
/// and the heads of a frame and its parts.
fn max_frame_bytes(shape: MaskShape) -> usize {
    let words = shape.pixels() * 4;
    (words + words / 255 + 64 * 1024).min(MAX_FRAME_BYTES)
}
