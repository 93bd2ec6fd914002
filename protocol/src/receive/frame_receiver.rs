//! The receiving end of a session: datagrams and time in; masks, feedback and the next deadline out.
//!
//! Where each packet of a frame can be decoded alone, a frame is delivered in part when its missing packets are overdue
//! ([`super::deadline`]) or a newer frame begins, and again when more of it has arrived. [`Coverage`] says which tiles
//! have arrived; the others keep the value that they had.

use std::ops::Add;

use web_time::Instant;

use super::{
    deadline::Deadline,
    frame_decoder::{BadFrame, FrameDecoder},
    reassembler::{IgnoredCause, PacketError, Policy, Progress, Reassembler},
    requests::Requests,
};
use crate::{
    acknowledgement::Acknowledgement,
    coverage::Coverage,
    header::PacketHeader,
    ids::FrameNumber,
    limits::MAX_FRAME_BYTES,
    loss::{LossFeedback, LossReporter},
    mask::{Mask, MaskShape},
    pose::Pose,
};

/// How a session receives frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReceiverConfig {
    pub policy: Policy,
    /// Largest mask agreed on. Masks have exactly its number of lights.
    pub largest: MaskShape,
    /// Acknowledge masks, so that the server codes later ones against them.
    pub keeps_references: bool,
    pub reports_losses: bool,
}

/// Counts since the receiver was made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ReceiverCounters {
    /// Whole frames that decoded.
    pub frames: u64,
    /// Decoded frames that the server had left parts out of.
    pub cut: u64,
    /// Frames that were delivered with packets missing.
    pub partial: u64,
    /// Frames that arrived in part and were not delivered.
    pub incomplete: u64,
    /// Frames whose first packet arrived before they were requested.
    pub future: u64,
    /// Frames that did not decode, lack their reference, or exceed the agreed shape.
    pub bad: u64,
    /// Bytes of `frames` and `cut`, without packet headers.
    pub payload_bytes: u64,
    /// Packets of `frames` and `cut`.
    pub packets: u64,
}

/// What happened to a datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrival {
    /// Passed to the reassembler.
    Packet(Progress),
    /// Dropped: its frame was not requested yet.
    Unrequested(FrameNumber),
}

/// A frame that decoded.
#[derive(Debug, Clone, Copy)]
pub struct ReceivedFrame<'a> {
    pub frame: FrameNumber,
    /// The pose it was traced for, if the server looked ahead; otherwise the request's.
    pub traced_for: Option<Pose>,
    /// Its encoded bytes, as in [`CompleteFrame::body`](super::reassembler::CompleteFrame::body).
    pub body: &'a [u8],
    /// Packets that arrived or were restored from parity.
    pub packets: u16,
    pub restored: u16,
    pub missing: u16,
    pub is_whole: bool,
    /// Time of the datagram or deadline that delivered it.
    pub received_at: Instant,
}

/// Turns the datagrams of one session into masks. After each [`Self::push`] and [`Self::handle_timeout`], poll for a
/// frame and for feedback.
#[derive(Debug)]
pub struct FrameReceiver {
    config: ReceiverConfig,
    requests: Requests,
    reassembler: Reassembler,
    deadline: Deadline,
    decoder: FrameDecoder,
    losses: LossReporter,
    counters: ReceiverCounters,
    /// Incomplete frames of earlier reassemblers.
    incomplete_before: u64,
    /// A frame has arrived in part. The reassembler only counts it as incomplete when it abandons it.
    in_progress: bool,
    newest_decoded: Option<FrameNumber>,
    /// The frame delivered last, if packets of it were missing.
    delivered_in_part: Option<FrameNumber>,
    /// The reassembler has a frame that has not been polled.
    is_ready: bool,
    has_lost: bool,
    last_event: Option<Instant>,
    acknowledgement: Option<Acknowledgement>,
    loss_feedback: Option<LossFeedback>,
}

impl FrameReceiver {
    #[must_use]
    pub fn new(config: ReceiverConfig) -> Self {
        let ReceiverConfig { policy, largest, keeps_references, .. } = config;
        Self {
            config,
            requests: Requests::default(),
            reassembler: new_reassembler(config),
            deadline: Deadline::default(),
            decoder: FrameDecoder::new(policy, largest, keeps_references),
            losses: LossReporter::default(),
            counters: ReceiverCounters::default(),
            incomplete_before: 0,
            in_progress: false,
            newest_decoded: None,
            delivered_in_part: None,
            is_ready: false,
            has_lost: false,
            last_event: None,
            acknowledgement: None,
            loss_feedback: None,
        }
    }

    /// See [`Requests::request`].
    pub fn request(&mut self, frame: FrameNumber) {
        self.requests.request(frame);
    }

    /// See [`Requests::request_again`].
    pub fn request_again(&mut self, frame: FrameNumber, refused: bool) {
        self.requests.request_again(frame, refused);
    }

    /// Replaces all requests, for a client that records them on another thread.
    pub fn set_requests(&mut self, requests: Requests) {
        self.requests = requests;
    }

    /// Takes a datagram that arrived at `now`. Drops a frame that has not been polled.
    ///
    /// # Errors
    /// As [`Reassembler::push`]. The receiver stays usable.
    pub fn push(&mut self, datagram: &[u8], now: Instant) -> Result<Arrival, PacketError> {
        self.is_ready = false;
        let header = PacketHeader::decode(datagram).ok().map(|(header, _)| header);
        if let Some(header) = header {
            if let Some(frame) = header.frame.filter(|_| self.requests.is_ahead(&header)) {
                self.counters.future += u64::from(header.first);
                return Ok(Arrival::Unrequested(frame));
            }
            // A reassembler delivers frames in increasing order, so a second attempt needs a new one.
            if self.requests.is_second_attempt(&header, self.newest_decoded) {
                self.incomplete_before = self.incomplete() + u64::from(self.in_progress);
                self.reassembler = new_reassembler(self.config);
            }
            if self.config.reports_losses {
                self.loss_feedback = self.losses.packet(header.sequence, now).or(self.loss_feedback);
            }
        }
        let progress = self.reassembler.push(datagram);
        match &progress {
            Ok(Progress::Stored | Progress::Partial | Progress::Complete) => {
                self.in_progress = progress != Ok(Progress::Complete);
                if let Some(frame) =
                    header.and_then(|header| header.frame).filter(|_| self.config.policy == Policy::Slices)
                {
                    self.deadline.packet_stored(now, frame, !self.in_progress);
                }
            }
            Ok(Progress::Ignored(cause)) => {
                self.in_progress &= !matches!(cause, IgnoredCause::OutOfOrder | IgnoredCause::Newer);
                let incomplete = self.incomplete();
                self.has_lost |= self.counters.incomplete < incomplete;
                self.counters.incomplete = incomplete;
            }
            Err(PacketError::Contradiction { .. } | PacketError::TooLong { .. }) => self.in_progress = false,
            Err(_) => {}
        }
        self.ready(now);
        progress.map(Arrival::Packet)
    }

    /// Returns when to call [`Self::handle_timeout`], unless a datagram arrives first.
    #[must_use]
    pub fn deadline(&self) -> Option<Instant> {
        self.deadline.due()
    }

    /// Delivers what has arrived of an overdue frame. Does nothing before the [deadline](Self::deadline).
    pub fn handle_timeout(&mut self, now: Instant) {
        if self.deadline().is_some_and(|due| due <= now) {
            self.deadline.delivered();
            self.reassembler.deliver_partial();
            self.ready(now);
        }
    }

    fn ready(&mut self, now: Instant) {
        self.is_ready = self.reassembler.frame().is_some();
        self.last_event = Some(now);
    }

    /// Decodes the delivered frame, if there is one, into `mask` and `coverage`.
    ///
    /// # Errors
    /// Errors if it is not a mask, lacks its reference, or is too large. `mask` and `coverage` are then undefined.
    pub fn poll_frame(
        &mut self,
        mask: &mut Mask,
        coverage: &mut Coverage,
    ) -> Result<Option<ReceivedFrame<'_>>, BadFrame> {
        let incomplete = self.incomplete();
        let is_ready = std::mem::take(&mut self.is_ready);
        let Some((complete, received_at)) = self.reassembler.frame().zip(self.last_event).filter(|_| is_ready) else {
            return Ok(None);
        };
        self.counters.incomplete = incomplete;
        let frame = complete.frame;
        let decoded = self.decoder.decode(&complete, mask, coverage, &mut self.acknowledgement);
        let traced_for = decoded.map_err(|reason| {
            self.counters.bad += 1;
            BadFrame { frame, reason }
        })?;
        self.newest_decoded = Some(frame);
        let in_part = complete.missing > 0;
        let was_counted = std::mem::replace(&mut self.delivered_in_part, in_part.then_some(frame)) == Some(frame);
        let is_whole = !in_part && coverage.is_whole();
        if in_part {
            self.counters.partial += u64::from(!was_counted);
        } else {
            self.counters.frames += u64::from(is_whole);
            self.counters.cut += u64::from(!is_whole);
            self.counters.partial -= u64::from(was_counted);
            self.counters.payload_bytes += complete.body.len() as u64;
            self.counters.packets += u64::from(complete.packets);
        }
        Ok(Some(ReceivedFrame {
            frame,
            traced_for,
            body: complete.body,
            packets: complete.packets,
            restored: complete.restored,
            missing: complete.missing,
            is_whole,
            received_at,
        }))
    }

    /// Returns whether a frame was lost since the last call.
    pub fn poll_loss(&mut self) -> bool {
        std::mem::take(&mut self.has_lost)
    }

    /// Returns the acknowledgement to send, if there is a new one.
    pub fn poll_acknowledgement(&mut self) -> Option<Acknowledgement> {
        self.acknowledgement.take()
    }

    /// Returns the loss feedback to send, if it is due.
    pub fn poll_loss_feedback(&mut self) -> Option<LossFeedback> {
        self.loss_feedback.take()
    }

    #[must_use]
    pub const fn counters(&self) -> ReceiverCounters {
        self.counters
    }

    fn incomplete(&self) -> u64 {
        self.incomplete_before + self.reassembler.stats().frames_incomplete
    }
}

impl Add for ReceiverCounters {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            frames: self.frames + other.frames,
            cut: self.cut + other.cut,
            partial: self.partial + other.partial,
            incomplete: self.incomplete + other.incomplete,
            future: self.future + other.future,
            bad: self.bad + other.bad,
            payload_bytes: self.payload_bytes + other.payload_bytes,
            packets: self.packets + other.packets,
        }
    }
}

/// Returns a reassembler for the longest frame of the largest shape: its words uncompressed, LZ4's overhead on noise
/// (one byte in 255), and the heads of a frame and its parts.
fn new_reassembler(config: ReceiverConfig) -> Reassembler {
    let words = config.largest.pixels() * 4;
    Reassembler::with_max_frame_bytes(config.policy, (words + words / 255 + 64 * 1024).min(MAX_FRAME_BYTES))
}
