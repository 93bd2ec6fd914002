//! Parity: any n of a frame's n + m packets restore it, wrong parity never changes what arrived, and memory is bounded.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers outside the test functions use these too")]

mod common;

use bytes::Bytes;
use gnomon_protocol::{
    codec::EncodedFrame,
    fec::{MAX_PROTECTED_PACKETS, PARITY_ROOM_BYTES, ParityEncoder},
    header::{HEADER_BYTES, PacketHeader},
    ids::FrameNumber,
    limits::MAX_PACKET_BYTES,
    packetizer::Packetizer,
    reassembler::{CompleteFrame, IgnoredCause, PacketError, Policy, Progress, Reassembler},
};
use proptest::prelude::*;

use crate::common::Random;

/// A frame's payloads, and all its packets: n packets, then their parity.
struct Sent {
    number: u32,
    payloads: Vec<Vec<u8>>,
    packets: Vec<Bytes>,
}

impl Sent {
    fn data(&self) -> usize {
        self.payloads.len()
    }
}

/// Frames of noise, of up to `most` packets, with up to eight parity packets each.
fn stream(frames: u32, most: usize, random: &mut Random) -> Vec<Sent> {
    let (mut packetizer, mut encoder) = (Packetizer::new(40), ParityEncoder::default());
    let frame = |number: u32| {
        let body: Vec<u8> = (0..1 + random.index(24 * most)).map(|_| random.byte()).collect();
        let body = EncodedFrame::from(body);
        let payloads: Vec<Vec<u8>> = body.payloads(packetizer.payload_bytes()).map(<[u8]>::to_vec).collect();
        let mut packets: Vec<Bytes> = packetizer.packets(FrameNumber(number), number, &body).unwrap().collect();
        let parity = encoder.encode(body.payloads(packetizer.payload_bytes()), random.below(9).to_le_bytes()[0]);
        packets.extend(packetizer.parity_packets(FrameNumber(number), number, parity));
        Sent { number, payloads, packets }
    };
    (0..frames).map(frame).collect()
}

/// A frame's number, its packets arrived or restored, restored, and missing, and its body.
fn owned(frame: CompleteFrame<'_>) -> (u32, u16, u16, u16, Vec<u8>) {
    (frame.frame.0, frame.packets, frame.restored, frame.missing, frame.body.to_vec())
}

/// Indices of a frame's packets that arrive, in random order, some twice.
fn arrivals(sent: &Sent, loss: u64, random: &mut Random) -> Vec<usize> {
    let mut arrived: Vec<usize> = (0..sent.packets.len()).filter(|_| !random.one_in(loss)).collect();
    for place in 0..arrived.len() {
        let other = random.index(arrived.len());
        arrived.swap(place, other);
        if random.one_in(9) {
            arrived.push(arrived[place]);
        }
    }
    arrived
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_n_packets_restore_a_frame(
        frames in 1u32..8, most in 1usize..14, loss in 2u64..12, seed in any::<u64>()
    ) {
        let mut random = Random(seed);
        let mut reassembler = Reassembler::new(Policy::Slices);
        let mut restored = 0;
        for sent in stream(frames, most, &mut random) {
            let arrived = arrivals(&sent, loss, &mut random);
            let (mut came, mut distinct) = (Vec::new(), Vec::new());
            let mut out = None;
            for place in arrived {
                let progress = reassembler.push(&sent.packets[place]).unwrap();
                if distinct.len() == sent.data() {
                    prop_assert_eq!(progress, Progress::Ignored(IgnoredCause::Old));
                    continue;
                }
                if distinct.contains(&place) {
                    prop_assert_eq!(progress, Progress::Ignored(IgnoredCause::Duplicate));
                    continue;
                }
                distinct.push(place);
                came.extend((place < sent.data()).then_some(place));
                prop_assert_eq!(progress == Progress::Complete, distinct.len() == sent.data());
                if progress == Progress::Complete {
                    out = reassembler.frame().map(owned);
                }
            }
            let whole = distinct.len() == sent.data();
            if !whole && reassembler.deliver_partial() {
                out = reassembler.frame().map(owned);
            }
            prop_assert_eq!(out.is_some(), whole || !came.is_empty());
            let Some((number, packets, put_together, missing, body)) = out else { continue };
            let lost = (0..sent.data()).filter(|place| !came.contains(place)).collect::<Vec<_>>();
            let known = came.iter().chain(lost.iter().filter(|_| whole));
            prop_assert_eq!(body, known.flat_map(|place| sent.payloads[*place].clone()).collect::<Vec<u8>>());
            let count = |places: &[usize]| u16::try_from(places.len()).unwrap();
            prop_assert_eq!((number, put_together), (sent.number, if whole { count(&lost) } else { 0 }));
            prop_assert_eq!((packets, missing), (count(&came) + put_together, count(&lost) - put_together));
            restored += u64::from(put_together);
        }
        let stats = reassembler.stats();
        prop_assert_eq!((stats.restored, stats.parity_contradicted, stats.malformed), (restored, 0, 0));
        prop_assert_eq!(stats.stored + stats.ignored() + stats.malformed, stats.packets);
    }

    #[test]
    fn wrong_parity_changes_no_arrived_packet(
        frames in 1u32..8, most in 1usize..14, loss in 2u64..12, seed in any::<u64>()
    ) {
        let mut random = Random(seed);
        let mut reassembler = Reassembler::new(Policy::Slices);
        for sent in stream(frames, most, &mut random) {
            let mut came = Vec::new();
            for place in arrivals(&sent, loss, &mut random) {
                let mut packet = sent.packets[place].to_vec();
                let parity = place >= sent.data();
                if parity {
                    // Changes sequence number, timestamp, or data, but not the frame number.
                    for _ in 0..=random.index(3) {
                        let data_bytes = packet.len() - HEADER_BYTES;
                        let places = [random.index(4), 12 + random.index(4), HEADER_BYTES + random.index(data_bytes)];
                        packet[places[random.index(3)]] ^= 1 << random.below(8);
                    }
                }
                let progress = reassembler.push(&packet);
                prop_assert!(parity || progress.is_ok(), "{:?}", progress);
                if !parity && matches!(progress, Ok(Progress::Stored | Progress::Complete)) {
                    came.extend_from_slice(&sent.payloads[place]);
                }
                if matches!(progress, Ok(Progress::Complete)) {
                    break;
                }
            }
            reassembler.deliver_partial();
            if let Some(frame) = reassembler.frame().filter(|frame| frame.frame.0 == sent.number) {
                prop_assert!(frame.body.starts_with(&came));
                prop_assert!(frame.restored > 0 || frame.body.len() == came.len());
            }
            prop_assert!(reassembler.parity_bytes() <= 2 * 255 * MAX_PACKET_BYTES);
        }
    }
}

/// A frame with one packet, which is lost; a large frame; odd and even lengths.
#[test]
fn the_smallest_and_the_largest_frames_have_parity() {
    for (packets, parity, last) in [(1, 1, 1), (1, 1, 2), (1, 5, 1000), (MAX_PROTECTED_PACKETS, 255, 7)] {
        let payload_bytes = MAX_PACKET_BYTES - HEADER_BYTES - PARITY_ROOM_BYTES;
        let mut packetizer = Packetizer::new(HEADER_BYTES + payload_bytes);
        let body: Vec<u8> = (1..=255).cycle().take((packets - 1) * payload_bytes + last).collect();
        let body = EncodedFrame::from(body);
        let honest: Vec<Bytes> = packetizer.packets(FrameNumber(3), 9, &body).unwrap().collect();
        let mut encoder = ParityEncoder::default();
        let made = encoder.encode(body.payloads(packetizer.payload_bytes()), parity);
        assert_eq!(made.count(), usize::from(parity));
        let parity_packets: Vec<Bytes> = packetizer.parity_packets(FrameNumber(3), 9, made).collect();
        assert!(parity_packets.iter().all(|packet| packet.len() <= MAX_PACKET_BYTES));
        let mut reassembler = Reassembler::new(Policy::Slices);
        let lost = packets.min(usize::from(parity));
        let arriving = honest[lost..].iter().chain(&parity_packets[..lost]);
        let progress: Vec<_> = arriving.map(|packet| reassembler.push(packet).unwrap()).collect();
        assert_eq!(progress.last(), Some(&Progress::Complete));
        let frame = reassembler.frame().unwrap();
        assert_eq!((usize::from(frame.restored), frame.missing, frame.body.len()), (lost, 0, body.len()));
        let (came, restored) =
            frame.body.split_at(body.len() - honest[..lost].iter().map(|one| one.len() - 16).sum::<usize>());
        assert!([restored, came].concat() == body.body());
    }
    // Beyond the limit there is no parity.
    let body = EncodedFrame::from(vec![1; (MAX_PROTECTED_PACKETS + 1) * 8]);
    assert_eq!(ParityEncoder::default().encode(body.payloads(8), 5).count(), 0);
}

#[test]
fn malformed_parity_is_refused() {
    let mut packetizer = Packetizer::new(40);
    let body = EncodedFrame::from(vec![7; 60]);
    let honest: Vec<Bytes> = packetizer.packets(FrameNumber(3), 9, &body).unwrap().collect();
    let mut encoder = ParityEncoder::default();
    let parity = encoder.encode(body.payloads(packetizer.payload_bytes()), 2);
    let parity: Vec<Bytes> = packetizer.parity_packets(FrameNumber(3), 9, parity).collect();
    let with = |place: usize, byte: u8| {
        let mut bad = parity[0].to_vec();
        bad[place] = byte;
        bad
    };
    let mut odd = parity[0][..parity[0].len() - 1].to_vec();
    odd[8] -= 1;
    let mut reassembler = Reassembler::new(Policy::Slices);
    assert_eq!(reassembler.push(&honest[0]), Ok(Progress::Stored));
    // No packets, too many, a place beyond the last one, an odd shard, another timestamp, another number of packets.
    for bad in [with(16, 0), with(17, 3), with(19, 2), odd, with(12, 8), with(16, 4)] {
        assert!(matches!(reassembler.push(&bad), Err(PacketError::Parity(_))));
    }
    assert_eq!(reassembler.push(&parity[1]), Ok(Progress::Stored));
    assert_eq!(reassembler.push(&honest[2]), Ok(Progress::Complete));
    // Under the other policy it is not a frame packet.
    let mut whole = Reassembler::new(Policy::WholeFrame);
    assert!(matches!(whole.push(&parity[0]), Err(PacketError::Placeholder { .. })));
    let header = PacketHeader::decode(&parity[1]).unwrap().0;
    assert_eq!((header.frame_packets, header.first, header.sequence), (None, false, 4));
}
