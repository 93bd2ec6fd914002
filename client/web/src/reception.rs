//! A session's datagrams: packets in, masks and feedback out.

use std::collections::VecDeque;

use gnomon_client_core::mask::{queue::MaskQueue, received::ReceivedMask};
use gnomon_protocol::{
    ids::FrameNumber,
    mask::MaskShape,
    pose::{Pose, encode_pose_packet},
    reassembler::Policy,
    receive::{FrameReceiver, ReceiverConfig, ReceiverCounters},
};
use web_time::Instant;

/// Datagrams that wait for the page to take them, which it does after each call: a pose, an acknowledgement and a loss
/// report. Older ones go.
const MAX_WAITING: usize = 8;

#[derive(Debug)]
pub struct Reception {
    receiver: FrameReceiver,
    back: ReceivedMask,
    outgoing: VecDeque<Vec<u8>>,
    sequence: u32,
}

impl Reception {
    /// For masks of at most this shape.
    #[must_use]
    pub fn new(largest: MaskShape, now: Instant) -> Self {
        let config = ReceiverConfig { policy: Policy::Slices, largest, keeps_references: true, reports_losses: true };
        Self {
            receiver: FrameReceiver::new(config),
            back: ReceivedMask::blank(largest, now),
            outgoing: VecDeque::new(),
            sequence: 0,
        }
    }

    pub fn send_pose(&mut self, frame: FrameNumber, pose: &Pose) {
        self.receiver.request(frame);
        self.send(encode_pose_packet(self.sequence, frame, pose).to_vec());
        self.sequence = self.sequence.wrapping_add(1);
    }

    /// Sends a pose once more, because its mask did not come.
    pub fn send_pose_again(&mut self, frame: FrameNumber, pose: &Pose) {
        self.receiver.request_again(frame, false);
        self.send_pose(frame, pose);
    }

    fn send(&mut self, datagram: Vec<u8>) {
        if self.outgoing.len() >= MAX_WAITING {
            self.outgoing.pop_front();
        }
        self.outgoing.push_back(datagram);
    }

    /// Takes a datagram. Masks go to `queue`.
    pub fn push(&mut self, datagram: &[u8], now: Instant, queue: &mut MaskQueue) {
        // What cannot be used is counted by the receiver.
        let _ = self.receiver.push(datagram, now);
        self.poll(queue);
    }

    /// Passes on what has arrived of an overdue frame.
    pub fn poll_deadline(&mut self, now: Instant, queue: &mut MaskQueue) {
        self.receiver.handle_timeout(now);
        self.poll(queue);
    }

    fn poll(&mut self, queue: &mut MaskQueue) {
        // A frame that does not decode is counted by the receiver.
        if let Ok(Some(frame)) = self.receiver.poll_frame(&mut self.back.mask, &mut self.back.coverage) {
            self.back.frame = frame.frame;
            self.back.traced_for = frame.traced_for;
            self.back.payload_bytes = frame.body.len();
            self.back.packets = frame.packets;
            self.back.received_at = frame.received_at;
            queue.publish(&mut self.back);
        }
        if let Some(acknowledgement) = self.receiver.poll_acknowledgement() {
            self.send(acknowledgement.encode().to_vec());
        }
        if let Some(feedback) = self.receiver.poll_loss_feedback() {
            self.send(feedback.encode().to_vec());
        }
    }

    /// Returns the next datagram to send.
    pub fn take_outgoing(&mut self) -> Option<Vec<u8>> {
        self.outgoing.pop_front()
    }

    #[must_use]
    pub fn counters(&self) -> ReceiverCounters {
        self.receiver.counters()
    }
}
