//! Turns a mask into a frame that fits the path: simplify → encode → select → protect.

use std::time::{Duration, Instant};

use gnomon_protocol::{
    codec::{EncodeError, EncodedFrame, Encoder, Simplifier},
    fec::{MAX_PROTECTED_PACKETS, PARITY_ROOM_BYTES, Parity, ParityEncoder, parity_packets},
    ids::FrameNumber,
    mask::Mask,
    pose::Pose,
    references::SentMasks,
    refresh::{Refresh, Selection},
};
use tokio::task::JoinError;

use super::feedback::Feedback;
use crate::admission::{coding::Coding, encoders::EncoderPermit};

/// The session's encoder. It reuses its memory for every frame.
pub(super) struct FrameEncoder {
    wrong_ppm: u16,
    payload_bytes: usize,
    simplifier: Simplifier,
    encoder: Encoder,
    references: SentMasks,
    refresh: Refresh,
    parity: ParityEncoder,
    frame: EncodedFrame,
    selection: Selection,
}

pub(super) struct EncodeJob {
    pub(super) mask: Mask,
    /// The extrapolated pose that it was traced for, if any.
    pub(super) traced_for: Option<Pose>,
    /// Bytes that the path can carry, if the client accepts partial frames.
    pub(super) budget_bytes: Option<usize>,
    pub(super) feedback: Feedback,
}

pub(super) struct EncodeOutcome {
    pub(super) encoder: Box<FrameEncoder>,
    pub(super) mask: Mask,
    pub(super) selection: Result<Selection, EncodeError>,
    pub(super) took: Duration,
}

impl FrameEncoder {
    /// `payload_bytes` is the payload of a packet of `packet_bytes`.
    pub(super) fn new(
        Coding { codec, wrong_ppm }: Coding,
        refresh: Refresh,
        packet_bytes: usize,
        payload_bytes: usize,
    ) -> Self {
        Self {
            wrong_ppm,
            payload_bytes,
            simplifier: Simplifier::default(),
            // The parity of a packet must fit a packet, too.
            encoder: Encoder::new(codec).for_packets_of(packet_bytes.saturating_sub(PARITY_ROOM_BYTES)),
            references: SentMasks::default(),
            refresh,
            parity: ParityEncoder::default(),
            frame: EncodedFrame::default(),
            selection: Selection::Whole,
        }
    }

    /// Encodes on a thread of its own, so that other sessions' packets are not delayed, and holds `permit` meanwhile.
    ///
    /// # Errors
    /// If encoding panicked.
    pub(super) async fn run(
        mut self: Box<Self>,
        mut job: EncodeJob,
        permit: EncoderPermit,
    ) -> Result<EncodeOutcome, JoinError> {
        let work = tokio::task::spawn_blocking(move || {
            let (_permit, started) = (permit, Instant::now());
            let selection = self.encode(&mut job);
            EncodeOutcome { encoder: self, mask: job.mask, selection, took: started.elapsed() }
        });
        work.await
    }

    fn encode(&mut self, job: &mut EncodeJob) -> Result<Selection, EncodeError> {
        let EncodeJob { mask, traced_for, budget_bytes, feedback } = job;
        if let Some(acknowledged) = feedback.acknowledged {
            self.references.acknowledge(acknowledged);
        }
        self.simplifier.simplify(mask, self.wrong_ppm);
        self.encoder.encode_for(*traced_for, self.references.reference(), mask, &mut self.frame)?;
        self.selection = budget_bytes.map_or(Selection::Whole, |budget| self.select(mask, budget, feedback));
        let parity = self.parity_packets(self.packets(), feedback);
        self.parity.encode(self.frame.payloads(self.payload_bytes), parity);
        Ok(self.selection)
    }

    /// Keeps what fits the budget, less the share of parity.
    fn select(&mut self, mask: &Mask, budget_bytes: usize, feedback: &Feedback) -> Selection {
        let fitting = self.packets().min(budget_bytes / self.payload_bytes.max(1)).max(1);
        let parity = usize::from(self.parity_packets(fitting, feedback));
        let budget_bytes = budget_bytes.saturating_mul(fitting) / (fitting + parity);
        self.refresh.select(mask, &mut self.frame, budget_bytes, feedback.losses.model().loss > 0.0)
    }

    fn parity_packets(&self, packets: usize, feedback: &Feedback) -> u8 {
        let protected = self.encoder.codec().is_sliced() && packets <= MAX_PROTECTED_PACKETS;
        if protected { parity_packets(feedback.losses.model(), packets) } else { 0 }
    }

    /// Number of packets that carry the frame, without parity.
    pub(super) fn packets(&self) -> usize {
        self.frame.payload_count(self.payload_bytes)
    }

    pub(super) const fn frame(&self) -> &EncodedFrame {
        &self.frame
    }

    pub(super) fn parity(&self) -> Parity<'_> {
        self.parity.last()
    }

    /// Records that the selected parts of the mask were sent.
    pub(super) fn sent(&mut self, frame: FrameNumber, mask: &Mask) {
        // The client can refer only to masks that it has whole.
        if self.selection == Selection::Whole {
            self.references.keep(&self.encoder, frame);
        }
        self.refresh.sent(mask);
    }
}
