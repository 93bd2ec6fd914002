//! Masks out: take the newest, encode it, leave out what the path does not bear, cut the rest into packets, and send
//! all of them or none. The engine traces the next mask in the meantime, because its channel has room for it.

use std::{
    io,
    sync::Arc,
    time::{Duration, Instant},
};

use gnomon_protocol::{
    average::smoothed,
    codec::{EncodeError, Encoder, Simplifier},
    fec::{MAX_PROTECTED_PACKETS, PARITY_ROOM_BYTES, ParityEncoder, parity_packets},
    frame::pieces,
    header::HEADER_BYTES,
    ids::FrameNumber,
    mask::Mask,
    packetizer::Packetizer,
    pose::Pose,
    references::SentMasks,
    refresh::{Choice, Refresh},
};
use thiserror::Error;
use tokio::sync::{Semaphore, watch};
use tracing::Instrument as _;

use super::{budget::Budget, feedback::Feedback};
use crate::{
    admission::handshake::Coding,
    metrics::ledger::Ledger,
    net::link::DataSender,
    phase::Phase,
    visibility::{
        TracedMask,
        engine::{MaskReceiver, RequestSender},
    },
};

/// Why frames stopped.
#[derive(Debug, Error)]
pub(super) enum DriveError {
    #[error("the tracing engine has stopped")]
    EngineStopped,
    #[error("encoding broke off: {0}")]
    Encoding(String),
    #[error("link: {0}")]
    Link(#[from] io::Error),
}

/// Sends frames until the session stops, and then those that are on their way.
///
/// # Errors
/// When the engine or the link is gone.
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
                // The server is gone, and with it everybody who could say when to stop.
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
        let mask = frames.send(traced, ledger).instrument(span).await?;
        requests.recycle(mask);
    }
}

/// Turns masks into packets. Its memory serves every frame of the session.
pub(super) struct FrameSender {
    sender: DataSender,
    packetizer: Packetizer,
    workspace: Option<Workspace>,
    encoders: Arc<Semaphore>,
    wrong_ppm: u16,
    /// The newest that the client has said about its masks and packets.
    heard: watch::Receiver<Feedback>,
    first_frame_at: Option<Instant>,
    pace: Pace,
}

/// How soon one frame follows the other.
#[derive(Debug)]
struct Pace {
    last: Option<Instant>,
    /// From one mask to the next, smoothed.
    interval: Duration,
    /// Masks since the last one of which something was sent.
    left_out: u32,
}

impl Pace {
    /// A longer pause is no pace. After one, a frame has the path for so long.
    const LONGEST: Duration = Duration::from_millis(100);

    const fn new() -> Self {
        Self { last: None, interval: Duration::from_millis(16), left_out: 0 }
    }

    /// Another mask is there: for how long its frame has the path.
    fn step(&mut self, now: Instant) -> Duration {
        let gap = self.last.replace(now).map_or(self.interval, |last| now.saturating_duration_since(last));
        if gap > Self::LONGEST {
            return Self::LONGEST * (self.left_out + 1);
        }
        self.interval = smoothed(self.interval, gap);
        self.interval * (self.left_out + 1)
    }

    /// Nothing of the mask's frame was sent, because its share of the path was too small.
    fn leave_out(&mut self) {
        // At the floor of the congestion window, a frame of the largest size takes no longer.
        self.left_out = (self.left_out + 1).min(600);
    }
}

struct Workspace {
    simplifier: Simplifier,
    encoder: Encoder,
    references: SentMasks,
    body: Vec<u8>,
    parity: ParityEncoder,
    refresh: Refresh,
    /// What is sent of the frame at hand.
    choice: Choice,
}

impl FrameSender {
    /// Of frames coded like this, cut by `refresh`; `encoders` bounds how many sessions encode at once.
    pub(super) fn new(
        sender: DataSender,
        Coding { codec, wrong_ppm }: Coding,
        refresh: Refresh,
        encoders: Arc<Semaphore>,
        heard: watch::Receiver<Feedback>,
    ) -> Self {
        let packet_bytes = sender.max_packet_bytes();
        // Parity of the packets has to fit one as well.
        let encoder = Encoder::new(codec).for_packets_of(packet_bytes.saturating_sub(PARITY_ROOM_BYTES));
        let references = SentMasks::default();
        Self {
            packetizer: Packetizer::new(packet_bytes),
            sender,
            workspace: Some(Workspace {
                simplifier: Simplifier::default(),
                encoder,
                references,
                body: Vec::new(),
                parity: ParityEncoder::default(),
                refresh,
                choice: Choice::Whole,
            }),
            encoders,
            wrong_ppm,
            heard,
            first_frame_at: None,
            pace: Pace::new(),
        }
    }

    async fn send(&mut self, traced: TracedMask, ledger: &Ledger) -> Result<Mask, DriveError> {
        let TracedMask { frame, mask, ahead, received_at, cost } = traced;
        let started = Instant::now();
        // Who takes frames in part gets them cut down to what the path bears.
        let in_part = self.heard.borrow().losses.is_told();
        let budget = self.sender.frame_budget(self.pace.step(started)).filter(|_| in_part);
        let (mask, encoded) = self.encode(mask, ahead, budget, ledger).await?;
        let encoding = started.elapsed();
        ledger.stages.encode.record(encoding);
        let choice = self.workspace.as_ref().map_or(Choice::Whole, |workspace| workspace.choice);
        self.sender.hold_back(choice != Choice::Whole);
        let (body, parity) = match (encoded, &self.workspace) {
            (Ok(()), _) if choice == Choice::Nothing => {
                self.pace.leave_out();
                ledger.frames_gated.one();
                tracing::debug!("skipped: the path bears too little of it");
                return Ok(mask);
            }
            (Ok(()), Some(workspace)) => (&workspace.body, workspace.parity.last()),
            (Err(error), _) => {
                ledger.frames_unsendable.one();
                tracing::warn!(%error, "a mask cannot be encoded");
                return Ok(mask);
            }
            (Ok(()), None) => return Err(DriveError::Encoding("its memory is gone".to_owned())),
        };
        let sending = Instant::now();
        let packets = self.packetizer.packet_count(body) + parity.count();
        let bytes = body.len() + parity.bytes() + packets * HEADER_BYTES;
        if !self.sender.has_room(packets, bytes) {
            ledger.frames_gated.one();
            tracing::debug!(bytes, packets, "skipped: earlier frames still wait");
            return Ok(mask);
        }
        let since_first = sending.duration_since(*self.first_frame_at.get_or_insert(sending));
        // It wraps after 49 days, as the header says.
        #[expect(clippy::cast_possible_truncation, reason = "milliseconds modulo 2³²")]
        let timestamp_ms = since_first.as_millis() as u32;
        match self.packetizer.packets(frame, timestamp_ms, body) {
            Ok(cut) => {
                for packet in cut {
                    self.sender.send(packet).await?;
                }
            }
            Err(error) => {
                ledger.frames_unsendable.one();
                tracing::warn!(%error, "a frame cannot be cut into packets");
                return Ok(mask);
            }
        }
        for packet in self.packetizer.parity_packets(frame, timestamp_ms, parity) {
            self.sender.send(packet).await?;
        }
        self.sender.flush().await?;
        let counts = [packets - parity.count(), parity.count()];
        self.pace.left_out = 0;
        if let Some(Workspace { encoder, references, refresh, .. }) = &mut self.workspace {
            // What the client has not whole is no reference.
            if choice == Choice::Whole {
                references.keep(encoder, frame);
            } else {
                ledger.frames_cut.one();
            }
            refresh.sent(&mask);
        }
        ledger.frames_sent.one();
        ledger.packets.add(packets as u64);
        ledger.bytes.add(bytes as u64);
        ledger.stages.send.record(sending.elapsed());
        ledger.stages.pose_to_sent.record(received_at.elapsed());
        log_frame(frame, bytes, counts, encoding.as_secs_f64() * 1e3, &cost);
        Ok(mask)
    }

    /// Encodes on a thread where it disturbs no other session's packets.
    async fn encode(
        &mut self,
        mut mask: Mask,
        ahead: Option<Pose>,
        budget: Option<usize>,
        ledger: &Ledger,
    ) -> Result<(Mask, Result<(), EncodeError>), DriveError> {
        let broken = |reason: &str| DriveError::Encoding(reason.to_owned());
        let mut workspace = self.workspace.take().ok_or_else(|| broken("its memory is gone"))?;
        let permit = Arc::clone(&self.encoders).acquire_owned().await.map_err(|_| broken("the server has stopped"))?;
        let Feedback { acknowledged, losses } = *self.heard.borrow_and_update();
        let (wrong_ppm, payload_bytes) = (self.wrong_ppm, self.packetizer.payload_bytes());
        let job = tokio::task::spawn_blocking(move || {
            let (_permit, begun) = (permit, Instant::now());
            let Workspace { simplifier, encoder, references, body, parity, refresh, choice } = &mut workspace;
            if let Some(acknowledged) = acknowledged {
                references.acknowledge(acknowledged);
            }
            simplifier.simplify(&mut mask, wrong_ppm);
            let result = encoder.encode_for(ahead, references.reference(), &mask, body);
            let sliced = encoder.codec().is_sliced();
            let packets_of = |body: &[u8]| pieces(body, payload_bytes).count();
            let parity_of = |packets: usize| {
                let protected = sliced && packets <= MAX_PROTECTED_PACKETS;
                if protected { parity_packets(losses.model(), packets) } else { 0 }
            };
            *choice = budget.filter(|_| result.is_ok()).map_or(Choice::Whole, |budget| {
                // Parity takes its share.
                let fit = packets_of(body).min(budget / payload_bytes.max(1)).max(1);
                let budget = budget.saturating_mul(fit) / (fit + usize::from(parity_of(fit)));
                refresh.choose(&mask, body, budget, losses.model().loss > 0.0)
            });
            parity.encode(pieces(body, payload_bytes), parity_of(packets_of(body)));
            (workspace, mask, result, begun.elapsed())
        });
        let (workspace, mask, result, took) = job.await.map_err(|error| broken(&error.to_string()))?;
        ledger.frames_encoded.one();
        ledger.encode_us.add_us(took);
        self.workspace = Some(workspace);
        Ok((mask, result))
    }
}

/// `counts` are the packets that carry the frame, and those of parity.
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
        "sent"
    );
}
