//! Whatever the network does to the packets, only whole, byte-exact frames are delivered, in increasing order, and
//! exactly those that the receiving algorithm (dissertation §3.2) lets through.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers outside the test functions use these too")]

use std::collections::{BTreeMap, BTreeSet};

use bytes::Bytes;
use gnomon_protocol::{
    header::PacketHeader,
    ids::FrameNumber,
    packetizer::Packetizer,
    reassembler::{Policy, Progress, Reassembler},
};
use proptest::prelude::*;

/// What happens to one packet.
#[derive(Debug, Clone, Copy)]
enum Fate {
    Arrives,
    Lost,
    Twice,
    /// Arrives after this many of its successors.
    Late(usize),
    /// Arrives without this many of its last bytes.
    Cut(usize),
}

fn fates() -> impl Strategy<Value = Fate> {
    prop_oneof![
        20 => Just(Fate::Arrives),
        1 => Just(Fate::Lost),
        1 => Just(Fate::Twice),
        1 => (1..40usize).prop_map(Fate::Late),
        1 => (1..30usize).prop_map(Fate::Cut),
    ]
}

/// Frames with gaps in their numbers, cut into packets of at most 24 bytes.
fn stream(lengths: &[usize], steps: &[u32], from_sequence: u32) -> (BTreeMap<FrameNumber, Vec<u8>>, Vec<Bytes>) {
    let mut packetizer = Packetizer::new(24);
    let (mut frames, mut packets, mut number) = (BTreeMap::new(), Vec::new(), 0);
    for (length, step) in lengths.iter().zip(steps.iter().cycle()) {
        number += step;
        let body: Vec<u8> = (0..*length).map(|byte| (byte * 31 + number as usize * 7).to_le_bytes()[0]).collect();
        packets.extend(packetizer.packets(FrameNumber(number), number * 8, &body.clone().into()).unwrap().map(
            |packet| {
                // The packetizer starts at 0; a stream seen later may wrap anywhere.
                let (header, data) = PacketHeader::decode(&packet).unwrap();
                let header = PacketHeader { sequence: header.sequence.wrapping_add(from_sequence), ..header };
                Bytes::from([&header.encode()[..], data].concat())
            },
        ));
        frames.insert(FrameNumber(number), body);
    }
    (frames, packets)
}

fn network(packets: &[Bytes], fates: &[Fate]) -> Vec<Bytes> {
    let mut arriving: Vec<(usize, Bytes)> = Vec::new();
    for (place, (packet, fate)) in packets.iter().zip(fates.iter().cycle()).enumerate() {
        match *fate {
            Fate::Arrives => arriving.push((place * 2, packet.clone())),
            Fate::Lost => {}
            Fate::Twice => arriving.extend([(place * 2, packet.clone()), (place * 2 + 5, packet.clone())]),
            Fate::Late(later) => arriving.push((place * 2 + later * 2 + 1, packet.clone())),
            Fate::Cut(bytes) => arriving.push((place * 2, packet.slice(..packet.len().saturating_sub(bytes)))),
        }
    }
    arriving.sort_by_key(|(time, _)| *time);
    arriving.into_iter().map(|(_, packet)| packet).collect()
}

/// The algorithm again, as simply as possible: keeps the current frame's packets and looks at all of them.
#[derive(Default)]
struct Model {
    settled: Option<u32>,
    at_hand: Vec<(PacketHeader, Vec<u8>)>,
    complete: Vec<(u32, Vec<u8>)>,
}

impl Model {
    fn push(&mut self, datagram: &[u8]) {
        let Ok((header, data)) = PacketHeader::decode(datagram) else { return };
        let number = header.frame.unwrap().0;
        if let Some((first, _)) = self.at_hand.first() {
            let current = first.frame.unwrap().0;
            if number == current {
                if self.at_hand.iter().any(|(taken, _)| taken.sequence == header.sequence) {
                    return;
                }
                if self.at_hand.last().unwrap().0.sequence.wrapping_add(1) != header.sequence {
                    self.at_hand.clear();
                    self.settled = Some(current);
                    return;
                }
                self.take(header, data);
                return;
            }
            if number < current {
                return;
            }
            self.at_hand.clear();
            self.settled = Some(if header.first { current } else { number });
        }
        if header.first && self.settled < Some(number) {
            self.take(header, data);
        }
    }

    fn take(&mut self, header: PacketHeader, data: &[u8]) {
        self.at_hand.push((header, data.to_vec()));
        if self.at_hand.len() == usize::from(header.frame_packets.unwrap().get()) {
            let number = header.frame.unwrap().0;
            let body = self.at_hand.drain(..).flat_map(|(_, data)| data).collect();
            self.complete.push((number, body));
            self.settled = Some(number);
        }
    }
}

fn receive(packets: &[Bytes], reassembler: &mut Reassembler) -> Vec<(u32, Vec<u8>)> {
    let mut complete = Vec::new();
    for packet in packets {
        let progress = reassembler.push(packet);
        assert_eq!(reassembler.frame().is_some(), progress == Ok(Progress::Complete));
        complete.extend(reassembler.frame().map(|frame| {
            assert_eq!(frame.timestamp_ms, frame.frame.0 * 8);
            (frame.frame.0, frame.body.to_vec())
        }));
    }
    complete
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn only_whole_exact_frames_come_out_in_increasing_order(
        lengths in prop::collection::vec(1..60usize, 1..30),
        steps in prop::collection::vec(1..4u32, 1..5),
        fates in prop::collection::vec(fates(), 1..200),
        from_sequence in prop_oneof![Just(0), Just(u32::MAX - 20), any::<u32>()],
    ) {
        let (frames, packets) = stream(&lengths, &steps, from_sequence);
        let arriving = network(&packets, &fates);
        let longest = lengths.iter().copied().max().unwrap();
        let mut reassembler = Reassembler::with_max_frame_bytes(Policy::WholeFrame, longest);
        let complete = receive(&arriving, &mut reassembler);

        prop_assert!(complete.is_sorted_by(|(a, _), (b, _)| a < b), "out of order: {complete:?}");
        for (number, body) in &complete {
            prop_assert_eq!(&frames[&FrameNumber(*number)], body);
        }
        let mut model = Model::default();
        arriving.iter().for_each(|packet| model.push(packet));
        prop_assert_eq!(&complete, &model.complete);

        let stats = reassembler.stats();
        prop_assert_eq!(stats.packets, arriving.len() as u64);
        prop_assert_eq!(stats.bytes, arriving.iter().map(|packet| packet.len() as u64).sum::<u64>());
        prop_assert_eq!(stats.stored + stats.ignored() + stats.malformed, stats.packets);
        prop_assert_eq!(stats.frames_complete, complete.len() as u64);
        prop_assert!(reassembler.buffer_bytes() <= longest);
    }

    /// If packets are only lost, the frames without loss are delivered, and all others that arrived in part counted.
    #[test]
    fn loss_alone_costs_exactly_the_frames_that_it_hits(
        lengths in prop::collection::vec(1..60usize, 1..30),
        lost in prop::collection::vec(prop::bool::weighted(0.1), 1..200),
    ) {
        // A last frame of one packet always arrives, to settle the one before.
        let (frames, packets) = stream(&[&lengths[..], &[1]].concat(), &[1], 0);
        let fates: Vec<_> = lost.iter().map(|lost| if *lost { Fate::Lost } else { Fate::Arrives }).collect();
        let (last, before) = packets.split_last().unwrap();
        let arriving = [&network(before, &fates)[..], std::slice::from_ref(last)].concat();
        let number = |packet: &Bytes| PacketHeader::decode(packet).unwrap().0.frame.unwrap();
        let arrived = arriving.iter().map(number).collect::<BTreeSet<_>>();
        let count = |packets: &[Bytes], frame| packets.iter().filter(|packet| number(packet) == frame).count();
        let whole: Vec<_> = frames
            .iter()
            .filter(|(frame, _)| count(&arriving, **frame) == count(&packets, **frame))
            .map(|(frame, body)| (frame.0, body.clone()))
            .collect();

        let mut reassembler = Reassembler::new(Policy::WholeFrame);
        let complete = receive(&arriving, &mut reassembler);
        prop_assert_eq!(&complete, &whole);
        let stats = reassembler.stats();
        prop_assert_eq!(stats.frames_incomplete, (arrived.len() - whole.len()) as u64);
        prop_assert_eq!(stats.malformed, 0);
    }
}

/// Checks that the test network does every kind of harm, and that frames still arrive.
#[test]
fn the_test_network_can_harm() {
    let (frames, packets) = stream(&[40; 50], &[1], 0);
    for (fate, least) in [(Fate::Lost, 30), (Fate::Late(1), 30), (Fate::Cut(1), 30)] {
        let mut fates = vec![Fate::Arrives; 20];
        fates[7] = fate;
        let complete = receive(&network(&packets, &fates), &mut Reassembler::new(Policy::WholeFrame));
        assert!((least..frames.len()).contains(&complete.len()), "{fate:?}: {}", complete.len());
    }
}
