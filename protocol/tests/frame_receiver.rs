//! The receiver, datagram by datagram: deadlines, repeated and unrequested frames, partial frames, and bad bodies.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers outside the test functions use these too")]

mod common;

use std::time::{Duration, Instant};

use bytes::Bytes;
use gnomon_protocol::{
    acknowledgement::Acknowledgement,
    codec::{CodecId, DecodeError, EncodedFrame, Encoder},
    coverage::{Coverage, PLACE_TILES},
    header::HEADER_BYTES,
    ids::FrameNumber,
    limits::MAX_PACKET_BYTES,
    loss::FEEDBACK_INTERVAL,
    mask::{Mask, MaskShape},
    packetizer::Packetizer,
    reassembler::{IgnoredCause, Policy, Progress},
    receive::{Arrival, BadFrameReason, FrameReceiver, ReceiverConfig, ReceiverCounters},
    references::SentMasks,
};
use proptest::prelude::*;

use crate::common::Random;

/// Discs of shadow that move with `step`.
fn disc(shape: MaskShape, step: u32) -> Mask {
    let mut mask = Mask::new(shape);
    for light in 0..shape.lights() {
        for (x, y) in (0..shape.height()).flat_map(|y| (0..shape.width()).map(move |x| (x, y))) {
            let from_centre = x.abs_diff(150 + step * 9).pow(2) + y.abs_diff(90 + light * 20).pow(2);
            mask.set(light, x, y, from_centre > 4900 + (x * 7 + y * 13) % 900);
        }
    }
    mask
}

struct Server {
    encoder: Encoder,
    references: SentMasks,
    packetizer: Packetizer,
}

impl Server {
    fn new(codec: CodecId) -> Self {
        Self {
            encoder: Encoder::new(codec).for_packets_of(150),
            references: SentMasks::default(),
            packetizer: Packetizer::new(MAX_PACKET_BYTES),
        }
    }

    fn send(&mut self, frame: u32, mask: &Mask) -> Vec<Bytes> {
        let mut body = EncodedFrame::default();
        self.encoder.encode_for(None, self.references.reference(), mask, &mut body).unwrap();
        self.references.keep(&self.encoder, FrameNumber(frame));
        self.packetizer.packets(FrameNumber(frame), frame, &body).unwrap().collect()
    }
}

/// A delivered frame without its body.
#[derive(Debug, PartialEq, Eq)]
struct Delivered {
    frame: u32,
    packets: usize,
    missing: usize,
    is_whole: bool,
}

/// The client's side. Its clock starts at 0 ms.
struct Client {
    receiver: FrameReceiver,
    begun: Instant,
    mask: Mask,
    coverage: Coverage,
}

impl Client {
    /// A client that has requested the frames below `frames`.
    fn new(policy: Policy, shape: MaskShape, frames: u32) -> Self {
        let config = ReceiverConfig { policy, largest: shape, keeps_references: true, reports_losses: true };
        let mut receiver = FrameReceiver::new(config);
        if let Some(newest) = frames.checked_sub(1) {
            receiver.request(FrameNumber(newest));
        }
        Self { receiver, begun: Instant::now(), mask: Mask::new(shape), coverage: Coverage::whole(shape) }
    }

    fn at(&self, ms: u64) -> Instant {
        self.begun + Duration::from_millis(ms)
    }

    fn push(&mut self, ms: u64, packet: &[u8]) -> Arrival {
        self.receiver.push(packet, self.at(ms)).unwrap()
    }

    fn poll(&mut self) -> Option<Delivered> {
        let frame = self.receiver.poll_frame(&mut self.mask, &mut self.coverage).unwrap()?;
        let packets = frame.packets.into();
        let missing = frame.missing.into();
        Some(Delivered { frame: frame.frame.0, packets, missing, is_whole: frame.is_whole })
    }

    /// Pushes all packets at one moment, and polls after each.
    fn deliver<'a>(&mut self, ms: u64, packets: impl IntoIterator<Item = &'a Bytes>) -> Vec<Delivered> {
        packets
            .into_iter()
            .filter_map(|packet| {
                self.push(ms, packet);
                self.poll()
            })
            .collect()
    }

    /// Lets the deadline pass.
    fn time_out(&mut self) -> Option<Delivered> {
        let due = self.receiver.deadline().unwrap();
        self.receiver.handle_timeout(due);
        self.poll()
    }

    /// Asserts that every arrived place equals that of `sent`.
    fn assert_covered(&self, sent: &Mask) {
        let shape = sent.shape();
        assert_eq!((self.mask.shape(), self.coverage.shape()), (shape, shape));
        let [across, _] = Coverage::places(shape);
        for (index, (ours, theirs)) in self.mask.words().iter().zip(sent.words()).enumerate() {
            let (light, tile) = (index / shape.tiles(), index % shape.tiles());
            let (x, y) = (tile % shape.tiles_x() as usize, tile / shape.tiles_x() as usize);
            let place = y * across as usize + x / PLACE_TILES as usize;
            assert!(ours == theirs || self.coverage.words()[place] >> light & 1 == 0, "light {light}, tile {x}, {y}");
        }
    }
}

fn shape() -> MaskShape {
    MaskShape::new(500, 300, 3).unwrap()
}

#[test]
fn a_partial_frame_is_delivered_at_its_deadline_and_again_when_it_is_whole() {
    let (mut server, mut client) = (Server::new(CodecId::TilesSmall), Client::new(Policy::Slices, shape(), 2));
    let sent = disc(shape(), 0);
    let packets = server.send(0, &sent);
    let count = packets.len();
    assert!(count > 2);
    assert_eq!(client.receiver.deadline(), None);
    assert_eq!(client.deliver(0, &packets[2..]), []);
    let due = client.receiver.deadline().unwrap();
    client.receiver.handle_timeout(due - Duration::from_millis(1));
    assert_eq!(client.poll(), None);
    client.receiver.handle_timeout(due);
    assert_eq!(client.poll(), Some(Delivered { frame: 0, packets: count - 2, missing: 2, is_whole: false }));
    assert_eq!((client.poll(), client.receiver.deadline()), (None, None), "it is delivered once");
    client.assert_covered(&sent);
    assert!(!client.coverage.is_whole() && client.mask != sent);
    assert_eq!(client.receiver.poll_acknowledgement(), None);
    let counters = client.receiver.counters();
    assert_eq!(counters, ReceiverCounters { partial: 1, ..ReceiverCounters::default() });

    // A late packet is delivered at its own deadline; the last one completes the frame.
    assert_eq!(client.deliver(100, &packets[..1]), []);
    assert_eq!(client.time_out().unwrap().missing, 1);
    let whole = Delivered { frame: 0, packets: count, missing: 0, is_whole: true };
    assert_eq!(client.deliver(110, &packets[1..2]), [whole]);
    assert!(client.coverage.is_whole() && client.mask == sent);
    let counters = client.receiver.counters();
    let payload_bytes = packets.iter().map(|packet| (packet.len() - HEADER_BYTES) as u64).sum();
    let expected = ReceiverCounters { frames: 1, packets: count as u64, payload_bytes, ..ReceiverCounters::default() };
    assert_eq!(counters, expected);
    let acknowledged = client.receiver.poll_acknowledgement().unwrap();
    assert_eq!(acknowledged.mask.unwrap().frame, FrameNumber(0));

    // A newer frame ends a partial one, and is coded against the acknowledged one.
    server.references.acknowledge(acknowledged);
    let [next, sent] = [disc(shape(), 1), disc(shape(), 2)];
    let packets = server.send(1, &next);
    assert_eq!(client.deliver(200, &packets[..1]), []);
    client.receiver.request(FrameNumber(2));
    let newer = server.send(2, &sent);
    let delivered = client.deliver(210, &newer);
    assert_eq!((delivered[0].frame, delivered[0].packets, delivered[0].is_whole), (1, 1, false));
    assert_eq!((delivered[1].frame, delivered[1].is_whole, delivered.len()), (2, true, 2));
    assert!(client.mask == sent);
}

#[test]
fn a_frame_that_was_not_requested_is_dropped_and_disturbs_nothing() {
    let (mut server, mut client) = (Server::new(CodecId::TilesFast), Client::new(Policy::WholeFrame, shape(), 1));
    let packets = server.send(0, &disc(shape(), 0));
    let future = server.send(5, &disc(shape(), 5));
    assert_eq!(client.push(0, &packets[0]), Arrival::Packet(Progress::Stored));
    for packet in &future {
        assert_eq!(client.push(0, packet), Arrival::Unrequested(FrameNumber(5)));
        assert_eq!(client.poll(), None);
    }
    assert_eq!(client.deliver(0, &packets[1..]).len(), 1);
    let counters = client.receiver.counters();
    assert_eq!((counters.frames, counters.future, counters.incomplete), (1, 1, 0));
    client.receiver.request(FrameNumber(5));
    assert_eq!(client.deliver(0, &server.send(5, &disc(shape(), 5))).len(), 1);
}

#[test]
fn a_frame_that_is_requested_again_may_arrive_again() {
    let old = Arrival::Packet(Progress::Ignored(IgnoredCause::Old));
    for policy in [Policy::WholeFrame, Policy::Slices] {
        let (mut server, mut client) = (Server::new(CodecId::TilesFast), Client::new(policy, shape(), 5));
        let mask = disc(shape(), 3);
        // Frame 3 is lost, and 4 begins.
        let (lost, open) = (server.send(3, &mask), server.send(4, &mask));
        client.push(0, &lost[0]);
        assert_eq!(
            client.push(1, &open[0]),
            Arrival::Packet(if policy == Policy::Slices { Progress::Partial } else { Progress::Stored })
        );
        assert_eq!(client.push(2, &lost[0]), old, "{policy:?}");
        client.receiver.request_again(FrameNumber(3), false);
        let again = server.send(3, &mask);
        assert_eq!(client.push(3, &again[1]), old, "the second attempt begins with a first packet");
        let delivered = client.deliver(4, &again);
        assert_eq!((delivered.len(), delivered[0].frame, delivered[0].is_whole), (1, 3, true), "{policy:?}");
        // Both frames begun before count as incomplete.
        assert_eq!(client.receiver.counters().incomplete, if policy == Policy::Slices { 1 } else { 2 });

        // A first attempt that has arrived is kept, unless its mask was refused.
        client.receiver.request_again(FrameNumber(3), false);
        assert_eq!(client.push(5, &server.send(3, &mask)[0]), old);
        client.receiver.request_again(FrameNumber(3), true);
        assert_eq!(client.deliver(6, &server.send(3, &mask)).len(), 1);
    }
}

#[test]
fn losses_are_signalled_once() {
    let (mut server, mut client) = (Server::new(CodecId::TilesFast), Client::new(Policy::WholeFrame, shape(), 2));
    let packets = server.send(0, &disc(shape(), 0));
    client.push(0, &packets[0]);
    assert!(!client.receiver.poll_loss());
    assert_eq!(client.push(0, &packets[2]), Arrival::Packet(Progress::Ignored(IgnoredCause::OutOfOrder)));
    assert_eq!([client.receiver.poll_loss(), client.receiver.poll_loss()], [true, false]);
    assert_eq!(client.receiver.counters().incomplete, 1);
    client.push(0, &packets[1]);
    assert!(!client.receiver.poll_loss());
}

#[test]
fn a_bad_body_is_counted_and_the_receiver_goes_on() {
    let large = MaskShape::new(500, 308, 3).unwrap();
    let mut client = Client::new(Policy::WholeFrame, shape(), 9);
    let mut packetizer = Packetizer::new(MAX_PACKET_BYTES);
    let mut bodies = [(); 3].map(|()| EncodedFrame::default());
    // A shape that was not agreed on, no frame at all, and a truncated slice.
    Encoder::new(CodecId::TilesFast).encode(&disc(large, 0), &mut bodies[0]).unwrap();
    bodies[1] = vec![7; 40].into();
    Encoder::new(CodecId::PlanesLz4).encode(&disc(shape(), 0), &mut bodies[2]).unwrap();
    let mut cut = bodies[2].to_vec();
    *cut.last_mut().unwrap() ^= 0xFF;
    bodies[2] = cut.into();
    let mut reasons = Vec::new();
    for (frame, body) in (0..).zip(&bodies) {
        let packets: Vec<_> = packetizer.packets(FrameNumber(frame), frame, body).unwrap().collect();
        for packet in &packets {
            client.push(0, packet);
            match client.receiver.poll_frame(&mut client.mask, &mut client.coverage) {
                Ok(frame) => assert!(frame.is_none()),
                Err(error) => reasons.push((error.frame.0, error.reason)),
            }
        }
    }
    use BadFrameReason::{Decode, Frame, Shape};
    assert!(matches!(reasons[..], [(0, Shape { .. }), (1, Frame(_)), (2, Decode(_))]), "{reasons:?}");
    assert_eq!(client.receiver.counters(), ReceiverCounters { bad: 3, ..ReceiverCounters::default() });
    assert_eq!(client.receiver.poll_acknowledgement(), None);

    // A missing reference is reported to the server.
    let mut server = Server::new(CodecId::TilesSmall);
    for frame in [5, 6] {
        let packets = server.send(frame, &disc(shape(), frame));
        if frame == 5 {
            let mut other = Client::new(Policy::WholeFrame, shape(), 9);
            assert_eq!(other.deliver(0, &packets).len(), 1);
            server.references.acknowledge(other.receiver.poll_acknowledgement().unwrap());
            continue;
        }
        for packet in &packets {
            client.push(0, packet);
        }
        let error = client.receiver.poll_frame(&mut client.mask, &mut client.coverage).unwrap_err();
        assert!(matches!(error.reason, Decode(DecodeError::Reference(_))), "{error}");
        let none = Acknowledgement { sequence: 0, mask: None };
        assert_eq!(client.receiver.poll_acknowledgement(), Some(none));
    }
}

#[test]
fn lost_packets_are_reported_ten_times_a_second() {
    let (mut server, mut client) = (Server::new(CodecId::TilesFast), Client::new(Policy::Slices, shape(), 200));
    let mut reports = Vec::new();
    for frame in 0..60 {
        let packets = server.send(frame, &disc(shape(), frame % 4));
        for packet in &packets[1..] {
            client.push(u64::from(frame) * 10, packet);
            reports.extend(client.receiver.poll_loss_feedback());
        }
    }
    assert_eq!(reports.len(), 600 / usize::try_from(FEEDBACK_INTERVAL.as_millis()).unwrap());
    assert!(reports.iter().map(|report| report.sequence).eq(0..6));
    let last = reports.last().unwrap().totals;
    assert!(last.lost > 30 && last.lost == last.runs && last.expected > last.lost * 3, "{last:?}");
}

/// Each frame loses a different packet: tiles that do not arrive keep their value, the others are right.
#[test]
fn tiles_that_do_not_arrive_keep_their_value() {
    let shape = shape();
    for codec in [CodecId::TilesSmall, CodecId::TilesFast] {
        let (mut server, mut client) = (Server::new(codec), Client::new(Policy::Slices, shape, 12));
        let mut before = Mask::new(shape);
        for step in 0..12 {
            let sent = disc(shape, step);
            let packets = server.send(step, &sent);
            assert!(packets.len() > 2, "{}", packets.len());
            let lost = step as usize % (packets.len() + 1);
            let arriving = packets.iter().enumerate().filter(|(index, _)| *index != lost).map(|(_, packet)| packet);
            let delivered = client.deliver(u64::from(step) * 100, arriving);
            if lost == packets.len() {
                assert!(delivered[0].is_whole && client.mask == sent, "it is delivered with its last packet");
                assert_eq!(client.receiver.deadline(), None);
                assert_eq!(client.receiver.poll_acknowledgement().is_some(), codec.has_references());
                before = sent;
                continue;
            }
            // The packet that ended the previous frame delivered only what its deadline had delivered already.
            assert_eq!(delivered, []);
            let partial = client.time_out().unwrap();
            assert_eq!((partial.frame, partial.missing, partial.is_whole), (step, 1, false));
            client.assert_covered(&sent);
            let words = || client.mask.words().iter().zip(before.words()).zip(sent.words());
            assert!(words().all(|((shown, before), sent)| shown == sent || shown == before));
            assert!(words().any(|((shown, _), sent)| shown != sent), "{codec}: nothing was missing in frame {step}");
            let right = words().filter(|((shown, _), sent)| shown == sent).count();
            assert!(right * 2 > shape.words(), "{right}");
            before = client.mask.clone();
            assert_eq!(client.receiver.poll_acknowledgement(), None);
            if step % 3 == 1 {
                // The late packet completes it.
                let completed = client.deliver(u64::from(step) * 100 + 50, [&packets[lost]]);
                assert_eq!((completed[0].frame, completed[0].missing), (step, 0));
                assert!(completed[0].is_whole && client.mask == sent);
                assert_eq!(client.receiver.poll_acknowledgement().is_some(), codec.has_references());
                before = client.mask.clone();
            }
        }
        let counters = client.receiver.counters();
        assert_eq!((counters.frames + counters.partial, counters.incomplete, counters.bad), (12, 0, 0));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// Every delivered place equals its frame's, with packets and feedback lost, packets repeated and reordered.
    #[test]
    fn every_delivered_place_is_right(
        seed in any::<u64>(),
        policy in prop_oneof![Just(Policy::WholeFrame), Just(Policy::Slices)],
        codec in prop_oneof![Just(CodecId::TilesSmall), Just(CodecId::TilesFast)],
        (lost, repeated, late) in (2u64..40, 2u64..40, 2u64..40),
    ) {
        let shape = MaskShape::new(200, 100, 2).unwrap();
        let frames = 12;
        let masks: Vec<_> = (0..frames).map(|frame| disc(shape, frame)).collect();
        let (mut server, mut client) = (Server::new(codec), Client::new(policy, shape, frames));
        let mut random = Random(seed);
        let (mut waiting, mut deliveries) = (Vec::new(), Vec::<Delivered>::new());
        for (frame, mask) in (0..).zip(&masks) {
            let now = u64::from(frame) * 16;
            for packet in server.send(frame, mask) {
                let copies = if random.one_in(lost) { 0 } else { 1 + usize::from(random.one_in(repeated)) };
                for _ in 0..copies {
                    let delay = if random.one_in(late) { random.below(30) } else { 0 };
                    waiting.push((now + delay, packet.clone()));
                }
            }
            waiting.sort_by_key(|(due, _)| *due);
            let later = waiting.partition_point(|(due, _)| *due < now + 16);
            for (ms, packet) in waiting.drain(..later) {
                let at = client.at(ms);
                client.receiver.handle_timeout(at);
                for is_timeout in [true, false] {
                    if !is_timeout {
                        client.push(ms, &packet);
                    }
                    let delivered = client.poll();
                    if let Some(delivered) = &delivered {
                        let sent = &masks[delivered.frame as usize];
                        client.assert_covered(sent);
                        prop_assert_eq!(delivered.is_whole, client.coverage.is_whole());
                        prop_assert!(!delivered.is_whole || client.mask == *sent);
                        prop_assert_eq!(delivered.is_whole, delivered.missing == 0);
                    }
                    deliveries.extend(delivered);
                }
                if let Some(acknowledgement) = client.receiver.poll_acknowledgement().filter(|_| !random.one_in(lost)) {
                    server.references.acknowledge(acknowledgement);
                }
            }
        }
        prop_assert!(deliveries.is_sorted_by(|one, next| {
            one.frame < next.frame || one.frame == next.frame && one.packets < next.packets
        }), "{deliveries:?}");
        let mut last: Vec<&Delivered> = Vec::new();
        for delivered in &deliveries {
            last.pop_if(|before| before.frame == delivered.frame);
            last.push(delivered);
        }
        let whole = last.iter().filter(|delivered| delivered.is_whole).count() as u64;
        let counters = client.receiver.counters();
        prop_assert_eq!((counters.frames, counters.cut, counters.bad), (whole, 0, 0));
        prop_assert_eq!(counters.partial, last.len() as u64 - whole);
    }
}
