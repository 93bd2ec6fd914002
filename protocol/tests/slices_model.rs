//! The `Slices` policy, for any network and any time of delivery: everything that arrives before its frame ends is
//! delivered, and each packet's data is new once.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers outside the test functions use these too")]

mod common;

use bytes::Bytes;
use gnomon_protocol::{
    codec::EncodedFrame,
    header::PacketHeader,
    ids::FrameNumber,
    packetizer::Packetizer,
    reassembler::{IgnoredCause, PacketError, Policy, Progress, Reassembler},
};
use proptest::prelude::*;

use crate::common::Random;

/// A delivered frame: its number, sequence numbers in order of arrival, packets missing, and packets delivered before.
type Out = (u32, Vec<u32>, u16, usize);

fn header(packet: &[u8]) -> PacketHeader {
    PacketHeader::decode(packet).unwrap().0
}

/// The policy, as simply as possible. `None` delivers the current frame in part.
fn model(arrived: &[Option<Bytes>]) -> Vec<Out> {
    let (mut out, mut at_hand, mut settled) = (Vec::new(), None::<Out>, None);
    for packet in arrived {
        let Some(header) = packet.as_ref().map(|packet| header(packet)) else {
            if let Some((_, came, _, known)) = &mut at_hand
                && came.len() > *known
            {
                let given = came.len();
                out.extend(at_hand.clone());
                at_hand.as_mut().unwrap().3 = given;
            }
            continue;
        };
        let frame = header.frame.unwrap().0;
        let packets = header.frame_packets.unwrap().get();
        if settled >= Some(frame) {
            continue;
        }
        if at_hand.as_ref().is_some_and(|(older, ..)| *older < frame) {
            // A newer frame that is whole at once replaces the partial one.
            let ended = at_hand.take().unwrap();
            settled = Some(ended.0);
            if packets > 1 && ended.1.len() > ended.3 {
                out.push(ended);
            }
        }
        match &mut at_hand {
            Some((older, ..)) if frame < *older => continue,
            Some((_, came, missing, _)) => {
                if came.contains(&header.sequence) {
                    continue;
                }
                came.push(header.sequence);
                *missing -= 1;
            }
            None => at_hand = Some((frame, vec![header.sequence], packets - 1, 0)),
        }
        if at_hand.as_ref().is_some_and(|(_, _, missing, _)| *missing == 0) {
            settled = Some(frame);
            out.extend(at_hand.take());
        }
    }
    out
}

/// Frames of 1 to 6 packets of one byte each, their last sequence numbers beyond the wrap.
fn stream(frames: u32, random: &mut Random) -> Vec<Bytes> {
    let (mut packets, mut sequence) = (Vec::new(), u32::MAX - frames);
    for frame in 0..frames {
        let body = EncodedFrame::from(vec![frame.to_le_bytes()[0]; 1 + random.index(6)]);
        for packet in Packetizer::new(17).packets(FrameNumber(frame), frame, &body).unwrap() {
            let header = PacketHeader { sequence, ..header(&packet) };
            // The data identifies the packet.
            packets.push(Bytes::from([&header.encode()[..], &sequence.to_le_bytes()[..1]].concat()));
            sequence = sequence.wrapping_add(1);
        }
    }
    packets
}

/// Loses one in `n`, duplicates one in `n`, and delays one in `n` by some places.
fn network(packets: &[Bytes], n: u64, random: &mut Random) -> Vec<Bytes> {
    let mut arriving = Vec::new();
    for (place, packet) in packets.iter().enumerate() {
        let mut late = || if random.one_in(n) { random.index(24) } else { 0 };
        let times = [place * 2 + late(), place * 2 + late() + 1];
        let copies = if random.one_in(n) { 0 } else { 1 + usize::from(random.one_in(n)) };
        arriving.extend(times[..copies].iter().map(|time| (*time, packet.clone())));
    }
    arriving.sort_by_key(|(time, _)| *time);
    arriving.into_iter().map(|(_, packet)| packet).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_arrival_is_delivered(frames in 1u32..30, n in 2u64..30, looks in 1u64..20, seed in any::<u64>()) {
        let mut random = Random(seed);
        let packets = stream(frames, &mut random);
        let mut events = Vec::new();
        for packet in network(&packets, n, &mut random) {
            events.push(Some(packet));
            events.extend(random.one_in(looks).then_some(None));
        }
        let mut reassembler = Reassembler::new(Policy::Slices);
        let mut out = Vec::new();
        for event in &events {
            let given = match event {
                Some(packet) => matches!(reassembler.push(packet).unwrap(), Progress::Complete | Progress::Partial),
                None => reassembler.deliver_partial(),
            };
            let frame = reassembler.frame();
            prop_assert_eq!(frame.is_some(), given);
            out.extend(frame.map(|frame| (frame.frame.0, frame.body.to_vec(), frame.missing, frame.known_bytes)));
            prop_assert!(frame.is_none_or(|frame| frame.body.len() == usize::from(frame.packets)));
        }
        let byte = |sequence: &u32| sequence.to_le_bytes()[0];
        let expected: Vec<_> = model(&events)
            .into_iter()
            .map(|(frame, came, missing, known)| (frame, came.iter().map(byte).collect::<Vec<u8>>(), missing, known))
            .collect();
        prop_assert_eq!(out, expected);
        let stats = reassembler.stats();
        prop_assert_eq!(stats.stored + stats.ignored() + stats.malformed, stats.packets);
    }
}

#[test]
fn a_packet_that_contradicts_its_frame_drops_it() {
    let body = EncodedFrame::from(vec![1; 5]);
    let honest: Vec<_> = Packetizer::new(17).packets(FrameNumber(7), 9, &body).unwrap().collect();
    let bent = |index: usize, change: fn(&mut PacketHeader)| {
        let mut header = header(&honest[index]);
        change(&mut header);
        [&header.encode()[..], &[1]].concat()
    };
    let contradictions = [
        bent(2, |header| header.timestamp_ms = Some(8)),
        bent(2, |header| header.frame_packets = std::num::NonZeroU16::new(6)),
        bent(2, |header| header.first = true),
        bent(0, |header| header.first = false),
        bent(4, |header| header.sequence = 5),
        bent(4, |header| header.sequence = u32::MAX),
    ];
    for bad in contradictions {
        let mut reassembler = Reassembler::new(Policy::Slices);
        for index in [1, 0, 3] {
            assert_eq!(reassembler.push(&honest[index]), Ok(Progress::Stored));
        }
        assert!(matches!(reassembler.push(&bad), Err(PacketError::Contradiction { .. })));
        assert_eq!(reassembler.push(&honest[2]), Ok(Progress::Ignored(IgnoredCause::Old)));
        assert!(!reassembler.deliver_partial());
        assert_eq!(reassembler.stats().frames_incomplete, 1);
    }
}

#[test]
fn a_frame_that_gets_too_long_is_dropped_and_ends_the_one_before() {
    let mut reassembler = Reassembler::with_max_frame_bytes(Policy::Slices, 4);
    let packets = |frame, bytes: &[u8]| -> Vec<Bytes> {
        Packetizer::new(18).packets(FrameNumber(frame), 0, &bytes.to_vec().into()).unwrap().collect()
    };
    assert_eq!(reassembler.push(&packets(1, &[1; 6])[2]), Ok(Progress::Stored));
    assert_eq!(reassembler.push(&packets(1, &[1; 6])[0]), Ok(Progress::Stored));
    assert!(matches!(reassembler.push(&packets(1, &[1; 6])[1]), Err(PacketError::TooLong { limit: 4, .. })));
    assert_eq!(reassembler.push(&packets(2, &[2; 6])[1]), Ok(Progress::Stored));
    let long = Packetizer::new(30).packets(FrameNumber(3), 0, &vec![3; 5].into()).unwrap().next().unwrap();
    assert!(matches!(reassembler.push(&long), Err(PacketError::TooLong { limit: 4, .. })));
    let ended = reassembler.frame().unwrap();
    assert_eq!((ended.frame, ended.packets, ended.missing, ended.body), (FrameNumber(2), 1, 2, &[2, 2][..]));
    assert!(reassembler.buffer_bytes() <= 8);
}
