//! A simulated session.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use anyhow::{Context, Result};
use bytes::Bytes;
use gnomon_client::link::receive_options::Packets;
use gnomon_protocol::{
    acknowledgement::Acknowledgement,
    codec::{CodecId, DecodeError, EncodedFrame, Encoder},
    coverage::Coverage,
    fec::{PARITY_ROOM_BYTES, ParityEncoder, parity_packets},
    ids::FrameNumber,
    limits::MAX_PACKET_BYTES,
    loss::{LossEstimate, LossFeedback},
    mask::{Mask, MaskShape},
    packetizer::Packetizer,
    reassembler::Policy,
    receive::{BadFrame, BadFrameReason, FrameReceiver, ReceiverConfig},
    references::SentMasks,
};

use super::options::{FPS, Outcome};
use crate::link::{
    Counts, Settings,
    impairment::{Delivery, Direction, Impairment},
};

/// Time between two packets of a frame.
const PACKET_GAP: Duration = Duration::from_micros(50);

struct Viewer {
    receiver: FrameReceiver,
    /// Start of the receiver's clock.
    begun: Instant,
    warm_up: u32,
    shown: Mask,
    coverage: Coverage,
    /// The frame that was delivered last, and its packets.
    counted: Option<(FrameNumber, u16)>,
    outcome: Outcome,
}

impl Viewer {
    fn new(packets: Packets, warm_up: u32, shape: MaskShape) -> Self {
        let receiver = FrameReceiver::new(ReceiverConfig {
            policy: if packets == Packets::WholeFrame { Policy::WholeFrame } else { Policy::Slices },
            largest: shape,
            keeps_references: true,
            reports_losses: packets == Packets::Parity,
        });
        Self {
            receiver,
            begun: Instant::now(),
            warm_up,
            shown: Mask::new(shape),
            coverage: Coverage::whole(shape),
            counted: None,
            outcome: Outcome::default(),
        }
    }

    fn wait_until(&mut self, now: Duration) -> Result<()> {
        self.receiver.handle_timeout(self.begun + now);
        self.show_frame()
    }

    fn receive(&mut self, delivery: &Delivery) -> Result<()> {
        self.wait_until(delivery.due)?;
        self.receiver.push(&delivery.bytes, self.begun + delivery.due)?;
        self.show_frame()
    }

    /// Shows the delivered frame, if any.
    fn show_frame(&mut self) -> Result<()> {
        let frame = match self.receiver.poll_frame(&mut self.shown, &mut self.coverage) {
            Ok(Some(frame)) => frame,
            Ok(None) | Err(BadFrame { reason: BadFrameReason::Decode(DecodeError::Reference(_)), .. }) => return Ok(()),
            Err(error) => return Err(error.into()),
        };
        if frame.frame.0 < self.warm_up {
            return Ok(());
        }
        self.outcome.frames_whole += u32::from(frame.missing == 0);
        // If the frame was delivered before, only its new packets count.
        let before = self.counted.filter(|(number, _)| *number == frame.frame).map_or(0, |(_, packets)| packets);
        self.outcome.packets_used += u64::from(frame.packets - before);
        self.counted = Some((frame.frame, frame.packets));
        Ok(())
    }

    /// Acknowledgements and loss feedback to send.
    fn feedback(&mut self) -> impl Iterator<Item = Bytes> {
        let acknowledgement = self.receiver.poll_acknowledgement().map(|word| Bytes::copy_from_slice(&word.encode()));
        let losses = self.receiver.poll_loss_feedback().map(|word| Bytes::copy_from_slice(&word.encode()));
        acknowledgement.into_iter().chain(losses)
    }

    fn compare(&mut self, truth: &Mask) {
        let differ = self.shown.words().iter().zip(truth.words()).map(|(a, b)| u64::from((a ^ b).count_ones()));
        self.outcome.wrong_bits += differ.sum::<u64>();
        self.outcome.bits += truth.shape().pixels() as u64 * u64::from(truth.shape().lights());
    }
}

/// The server and the link.
struct Sender {
    encoder: Encoder,
    packetizer: Packetizer,
    references: SentMasks,
    losses: LossEstimate,
    parity: ParityEncoder,
    begun: Instant,
    down: Impairment,
    up: Impairment,
    counts: Counts,
    body: EncodedFrame,
}

impl Sender {
    fn new(codec: CodecId, settings: &Settings, seed: u64) -> Self {
        Self {
            encoder: Encoder::new(codec).for_packets_of(MAX_PACKET_BYTES - PARITY_ROOM_BYTES),
            packetizer: Packetizer::new(MAX_PACKET_BYTES),
            references: SentMasks::default(),
            losses: LossEstimate::default(),
            parity: ParityEncoder::default(),
            begun: Instant::now(),
            down: Impairment::new(settings.clone(), seed, Direction::Down),
            up: Impairment::new(settings.clone(), seed, Direction::Up),
            counts: Counts::default(),
            body: EncodedFrame::default(),
        }
    }

    fn receive_feedback(&mut self, delivery: &Delivery) -> Result<()> {
        if let Ok(feedback) = LossFeedback::decode(&delivery.bytes) {
            self.losses.hear(self.begun + delivery.due, feedback);
        } else {
            self.references.acknowledge(Acknowledgement::decode(&delivery.bytes)?);
        }
        Ok(())
    }

    /// Cuts a mask into packets, adds parity, and sends them through the link.
    fn send(&mut self, number: u32, mut now: Duration, mask: &Mask, outcome: &mut Outcome) -> Result<Vec<Delivery>> {
        self.encoder.encode_for(None, self.references.reference(), mask, &mut self.body)?;
        self.references.keep(&self.encoder, FrameNumber(number));
        let mut deliveries = Vec::new();
        let mut packets: Vec<Bytes> = self.packetizer.packets(FrameNumber(number), number, &self.body)?.collect();
        outcome.frames += 1;
        outcome.packets += packets.len() as u64;
        let parity = parity_packets(self.losses.model(), packets.len());
        let parity = self.parity.encode(self.body.payloads(self.packetizer.payload_bytes()), parity);
        packets.extend(self.packetizer.parity_packets(FrameNumber(number), number, parity));
        for packet in packets {
            outcome.bytes += packet.len() as u64;
            deliveries.extend(self.down.push(now, packet, &mut self.counts).into_iter().flatten());
            now += PACKET_GAP;
        }
        Ok(deliveries)
    }
}

/// Time at which a frame's pose is sent and the newest mask is shown.
fn moment(frame: u32) -> Duration {
    Duration::from_secs_f64(f64::from(frame) / FPS)
}

/// Runs a session with these masks; the first `warm_up` do not count.
pub(super) fn run(
    masks: &[Mask],
    (codec, packets, warm_up): (CodecId, Packets, u32),
    link: (&Settings, u64),
    rtt: Duration,
) -> Result<Outcome> {
    let first = masks.first().context("no frames")?;
    let (mut viewer, mut sender) = (Viewer::new(packets, warm_up, first.shape()), Sender::new(codec, link.0, link.1));
    let (mut deliveries, mut feedback) = (VecDeque::<Delivery>::new(), VecDeque::<Delivery>::new());
    // Nothing is compared until masks arrive.
    let begins = rtt + moment(3);
    // A frame is shown and requested; its mask is sent half a round trip later.
    let shown = (0..).zip(masks).map(|(frame, mask)| (moment(frame), frame, mask, false));
    let sent = (0..).zip(masks).map(|(frame, mask)| (moment(frame) + rtt / 2, frame, mask, true));
    let mut events: Vec<_> = shown.chain(sent).collect();
    events.sort_by_key(|(time, ..)| *time);
    for (now, frame, mask, is_sent) in events {
        while let Some(delivery) = deliveries.pop_front_if(|delivery| delivery.due <= now) {
            viewer.receive(&delivery)?;
            for word in viewer.feedback() {
                feedback.extend(sender.up.push(delivery.due, word, &mut sender.counts).into_iter().flatten());
            }
        }
        viewer.wait_until(now)?;
        if is_sent {
            while let Some(delivery) = feedback.pop_front_if(|delivery| delivery.due <= now) {
                sender.receive_feedback(&delivery)?;
            }
            let mut before = Outcome::default();
            let outcome = if frame < warm_up { &mut before } else { &mut viewer.outcome };
            deliveries.extend(sender.send(frame, now, mask, outcome)?);
        } else {
            viewer.receiver.request(FrameNumber(frame));
            if now >= begins && frame >= warm_up {
                viewer.compare(mask);
            }
        }
    }
    for delivery in deliveries {
        viewer.receive(&delivery)?;
    }
    viewer.wait_until(moment(masks.len().try_into()?) + rtt * 2)?;
    Ok(viewer.outcome)
}
