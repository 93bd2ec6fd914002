//! Masks out: takes the newest, encodes it, omits what the path cannot carry, packetizes the rest, and sends all of its
//! packets or none. The engine traces the next mask meanwhile, because its channel has room for it.

use std::{
    io,
    time::{Duration, Instant},
};

use gnomon_protocol::{
    average::smoothed,
    codec::EncodeError,
    header::HEADER_BYTES,
    ids::FrameNumber,
    mask::Mask,
    packetizer::Packetizer,
    refresh::{Refresh, Selection},
};
use thiserror::Error;
use tokio::sync::watch;
use tracing::Instrument as _;

use super::{
    budget::Budget,
    feedback::Feedback,
    frame_encoder::{EncodeJob, EncodeOutcome, FrameEncoder},
};
use crate::{
    admission::{coding::Coding, encoders::EncoderQueue},
    metrics::ledger::Ledger,
    net::link::DataSender,
    phase::Phase,
    visibility::{
        TracedMask,
        engine::{MaskReceiver, RequestSender},
    },
};

#[derive(Debug, Error)]
pub(super) enum DriveError {
    #[error("the tracing engine has stopped")]
    EngineStopped,
    #[error("encoding failed: {0}")]
    Encoding(String),
    #[error("link: {0}")]
    Link(#[from] io::Error),
}

/// Sends frames until the session stops, then those in flight.
///
/// # Errors
/// If the engine or the link is gone.
pub(super) async fn drive(
    mut masks: MaskReceiver,
    requests: &RequestSender,
    mut frames: FrameSender,
    ledger: &Ledger,
    mut phase: watch::Receiver<Phase>,
) -> Result<(), DriveError> {
    let mut last_traced = None;
    let mut budget = Budget::new();
    loop {
        let stopping = *phase.borrow_and_update() == Phase::Stopping;
        if stopping && last_traced == ledger.newest_requested() {
            return Ok(());
        }
        let mut traced = tokio::select! {
            traced = budget.within(ledger, masks.recv()) => traced.ok_or(DriveError::EngineStopped)?,
            changed = phase.changed(), if !stopping => match changed {
                Ok(()) => continue,
                // The server was dropped, so nothing can tell this session to stop.
                Err(_) => return Ok(()),
            },
        };
        ledger.traced(&traced.cost);
        while let Ok(newer) = masks.try_recv() {
            ledger.traced(&newer.cost);
            ledger.frames_superseded.one();
            requests.recycle(std::mem::replace(&mut traced, newer).mask);
        }
        last_traced = Some(traced.frame);
        let span = tracing::debug_span!("frame", number = traced.frame.0);
        let mask;
        (frames, mask) = frames.send(traced, ledger).instrument(span).await?;
        requests.recycle(mask);
    }
}

/// Encodes masks and sends their packets.
pub(super) struct FrameSender {
    sender: DataSender,
    packetizer: Packetizer,
    encoder: Box<FrameEncoder>,
    encoders: EncoderQueue,
    feedback: watch::Receiver<Feedback>,
    first_frame_at: Option<Instant>,
    pace: Pace,
}

#[derive(Debug)]
struct Pace {
    last: Option<Instant>,
    /// Smoothed.
    interval: Duration,
    /// Masks skipped since the last one that was sent.
    left_out: u32,
}

impl Pace {
    /// Longer gaps are pauses. A frame after a pause may occupy the path for this long.
    const LONGEST: Duration = Duration::from_millis(100);

    const fn new() -> Self {
        Self { last: None, interval: Duration::from_millis(16), left_out: 0 }
    }

    /// Records a mask. Returns the time budget of its frame on the path.
    fn step(&mut self, now: Instant) -> Duration {
        let gap = self.last.replace(now).map_or(self.interval, |last| now.saturating_duration_since(last));
        if gap > Self::LONGEST {
            return Self::LONGEST * (self.left_out + 1);
        }
        self.interval = smoothed(self.interval, gap);
        self.interval * (self.left_out + 1)
    }

    /// Records that the mask was skipped because its share of the path was too small.
    fn leave_out(&mut self) {
        // Even at the smallest congestion window, the largest frame takes no longer.
        self.left_out = (self.left_out + 1).min(600);
    }
}

impl FrameSender {
    /// `coding` sets how frames are encoded, `refresh` how they are cut. `encoders` limits parallel encoding.
    pub(super) fn new(
        sender: DataSender,
        coding: Coding,
        refresh: Refresh,
        encoders: EncoderQueue,
        feedback: watch::Receiver<Feedback>,
    ) -> Self {
        let packet_bytes = sender.max_packet_bytes();
        let packetizer = Packetizer::new(packet_bytes);
        let encoder = Box::new(FrameEncoder::new(coding, refresh, packet_bytes, packetizer.payload_bytes()));
        Self { packetizer, sender, encoder, encoders, feedback, first_frame_at: None, pace: Pace::new() }
    }

    /// Encodes a mask, then sends it, or drops it if the path cannot take it. Returns the mask's memory.
    async fn send(mut self, traced: TracedMask, ledger: &Ledger) -> Result<(Self, Mask), DriveError> {
        let TracedMask { frame, mask, ahead, received_at, cost } = traced;
        let started = Instant::now();
        let budget = self.sender.frame_budget(self.pace.step(started));
        let permit = self.encoders.acquire().await;
        let permit = permit.ok_or_else(|| DriveError::Encoding("the server has stopped".to_owned()))?;
        let feedback = *self.feedback.borrow_and_update();
        // Only clients that report losses accept partial frames.
        let budget_bytes = budget.filter(|_| feedback.losses.is_told());
        let job = EncodeJob { mask, traced_for: ahead, budget_bytes, feedback };
        let encoded = self.encoder.run(job, permit).await.map_err(|error| DriveError::Encoding(error.to_string()))?;
        let EncodeOutcome { encoder, mask, selection, took } = encoded;
        self.encoder = encoder;
        ledger.frames_encoded.one();
        ledger.encode_us.add_us(took);
        let encoding = started.elapsed();
        ledger.stages.encode.record(encoding);
        let sending = Instant::now();
        let Some(Sent { packets, parity, bytes }) = self.transmit(frame, selection, sending, ledger).await? else {
            return Ok((self, mask));
        };
        self.pace.left_out = 0;
        self.encoder.sent(frame, &mask);
        ledger.frames_sent.one();
        ledger.packets.add((packets + parity) as u64);
        ledger.bytes.add(bytes as u64);
        ledger.stages.send.record(sending.elapsed());
        ledger.stages.pose_to_sent.record(received_at.elapsed());
        log_frame(frame, bytes, [packets, parity], encoding.as_secs_f64() * 1e3, &cost);
        Ok((self, mask))
    }

    /// Sends all packets of the encoded frame, or returns `None` if it is dropped.
    async fn transmit(
        &mut self,
        frame: FrameNumber,
        selection: Result<Selection, EncodeError>,
        now: Instant,
        ledger: &Ledger,
    ) -> Result<Option<Sent>, DriveError> {
        self.sender.hold_back(matches!(selection, Ok(Selection::Parts | Selection::Nothing)));
        match &selection {
            Ok(Selection::Whole | Selection::Parts) => {}
            Ok(Selection::Nothing) => {
                self.pace.leave_out();
                ledger.frames_gated.one();
                tracing::debug!("skipped: the path cannot carry enough of it");
                return Ok(None);
            }
            Err(error) => {
                ledger.frames_unsendable.one();
                tracing::warn!(%error, "a mask cannot be encoded");
                return Ok(None);
            }
        }
        let (encoded, parity) = (self.encoder.frame(), self.encoder.parity());
        let sent = Sent {
            packets: self.encoder.packets(),
            parity: parity.count(),
            bytes: encoded.body().len() + parity.bytes() + (self.encoder.packets() + parity.count()) * HEADER_BYTES,
        };
        if !self.sender.has_room(sent.packets + sent.parity, sent.bytes) {
            ledger.frames_gated.one();
            tracing::debug!(
                bytes = sent.bytes,
                packets = sent.packets + sent.parity,
                "skipped: earlier frames are still queued"
            );
            return Ok(None);
        }
        let since_first = now.duration_since(*self.first_frame_at.get_or_insert(now));
        #[expect(clippy::cast_possible_truncation, reason = "milliseconds modulo 2³²: wraps after 49 days")]
        let timestamp_ms = since_first.as_millis() as u32;
        match self.packetizer.packets(frame, timestamp_ms, encoded) {
            Ok(packets) => {
                for packet in packets {
                    self.sender.send(packet).await?;
                }
            }
            Err(error) => {
                ledger.frames_unsendable.one();
                tracing::warn!(%error, "a frame cannot be cut into packets");
                return Ok(None);
            }
        }
        for packet in self.packetizer.parity_packets(frame, timestamp_ms, parity) {
            self.sender.send(packet).await?;
        }
        self.sender.flush().await?;
        ledger.frames_cut.add(u64::from(selection == Ok(Selection::Parts)));
        Ok(Some(sent))
    }
}

/// What was sent for one frame.
struct Sent {
    packets: usize,
    parity: usize,
    /// On the wire, headers included.
    bytes: usize,
}

/// `packets` carry the frame, `parity` repairs it.
fn log_frame(
    frame: FrameNumber,
    bytes: usize,
    [packets, parity]: [usize; 2],
    encode_ms: f64,
    cost: &crate::visibility::TraceCost,
) {
    tracing::debug!(
        %frame,
        bytes,
        packets,
        parity,
        encode_ms,
        primary_ms = cost.primary_ms,
        shadow_ms = cost.shadow_ms,
        readback_ms = cost.readback_ms,
        primary_rays = cost.primary_rays,
        shadow_rays = cost.shadow_rays,
        rays_traced = cost.shares.traced,
        "sent"
    );
}
