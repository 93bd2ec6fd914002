//! The receiving algorithm, case by case: dissertation §3.2, Figures 2 and 3.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers outside the test functions use these too")]

use std::num::NonZeroU16;

use gnomon_protocol::{
    header::{HeaderError, PacketHeader},
    ids::FrameNumber,
    reassembler::{
        IgnoredCause::{Duplicate, Newer, NotFirst, Old, OutOfOrder},
        PacketError, Policy,
        Progress::{self, Complete, Ignored, Stored},
        Reassembler,
    },
};

/// Packet `index` of frame `frame`, which has `of` packets. Each frame has ten sequence numbers.
#[derive(Debug, Clone, Copy)]
struct P(u32, u16, u16);

impl P {
    fn header(self) -> PacketHeader {
        let Self(frame, index, of) = self;
        PacketHeader {
            sequence: frame * 10 + u32::from(index),
            frame: Some(FrameNumber(frame)),
            data_bytes: 3,
            frame_packets: NonZeroU16::new(of),
            first: index == 0,
            timestamp_ms: Some(frame * 8),
        }
    }

    fn data(self) -> [u8; 3] {
        [self.0.to_le_bytes()[0], self.1.to_le_bytes()[0], b'.']
    }
}

fn datagram(header: &PacketHeader, data: &[u8]) -> Vec<u8> {
    [&header.encode()[..], data].concat()
}

/// Pushes the packets. Checks the effect of each, the body of each completed frame, and the counts.
#[track_caller]
fn expect(steps: &[(P, Progress)], complete: u64, incomplete: u64) {
    let mut reassembler = Reassembler::new(Policy::WholeFrame);
    for (step, (packet, expected)) in steps.iter().enumerate() {
        let progress = reassembler.push(&datagram(&packet.header(), &packet.data()));
        assert_eq!(progress, Ok(*expected), "step {step}: {packet:?}");
        let frame = reassembler.frame();
        assert_eq!(frame.is_some(), *expected == Complete, "step {step}");
        if let Some(frame) = frame {
            let P(number, _, of) = *packet;
            let whole: Vec<u8> = (0..of).flat_map(|index| P(number, index, of).data()).collect();
            assert_eq!((frame.frame, frame.timestamp_ms, frame.packets), (FrameNumber(number), number * 8, of));
            assert_eq!(frame.body, whole);
        }
    }
    let stats = reassembler.stats();
    let count = |wanted: fn(&Progress) -> bool| steps.iter().filter(|(_, progress)| wanted(progress)).count() as u64;
    assert_eq!(stats.packets, steps.len() as u64);
    assert_eq!(stats.bytes, steps.len() as u64 * 19);
    assert_eq!(stats.stored, count(|p| matches!(p, Stored | Complete)));
    assert_eq!(stats.ignored_not_first, count(|p| *p == Ignored(NotFirst)));
    assert_eq!(stats.ignored_old, count(|p| *p == Ignored(Old)));
    assert_eq!(stats.ignored_duplicate, count(|p| *p == Ignored(Duplicate)));
    assert_eq!(stats.ignored_out_of_order, count(|p| *p == Ignored(OutOfOrder)));
    assert_eq!(stats.ignored_newer, count(|p| *p == Ignored(Newer)));
    assert_eq!(stats.malformed, 0);
    assert_eq!((stats.frames_complete, stats.frames_incomplete), (complete, incomplete), "frames");
}

#[test]
fn a_frame_in_order_is_delivered() {
    expect(&[(P(0, 0, 3), Stored), (P(0, 1, 3), Stored), (P(0, 2, 3), Complete)], 1, 0);
}

#[test]
fn a_frame_of_one_packet_is_delivered_at_once() {
    expect(&[(P(0, 0, 1), Complete), (P(1, 0, 1), Complete)], 2, 0);
}

#[test]
fn frames_follow_each_other() {
    expect(&[(P(0, 0, 2), Stored), (P(0, 1, 2), Complete), (P(1, 0, 2), Stored), (P(1, 1, 2), Complete)], 2, 0);
}

#[test]
fn at_the_start_all_but_a_first_packet_is_ignored() {
    expect(
        &[
            (P(3, 1, 3), Ignored(NotFirst)),
            (P(3, 2, 3), Ignored(NotFirst)),
            (P(4, 0, 2), Stored),
            (P(4, 1, 2), Complete),
        ],
        1,
        1,
    );
}

#[test]
fn a_late_first_packet_begins_a_frame_that_a_gap_drops() {
    expect(&[(P(3, 1, 3), Ignored(NotFirst)), (P(3, 0, 3), Stored), (P(3, 2, 3), Ignored(OutOfOrder))], 0, 1);
}

#[test]
fn a_lost_packet_drops_its_frame_and_the_rest_of_it_is_ignored() {
    expect(
        &[
            (P(0, 0, 4), Stored),
            (P(0, 2, 4), Ignored(OutOfOrder)),
            (P(0, 3, 4), Ignored(Old)),
            (P(1, 0, 2), Stored),
            (P(1, 1, 2), Complete),
        ],
        1,
        1,
    );
}

#[test]
fn swapped_packets_drop_their_frame() {
    expect(
        &[
            (P(0, 0, 4), Stored),
            (P(0, 2, 4), Ignored(OutOfOrder)),
            (P(0, 1, 4), Ignored(Old)),
            (P(0, 3, 4), Ignored(Old)),
        ],
        0,
        1,
    );
}

#[test]
fn a_dropped_frame_does_not_begin_again() {
    expect(&[(P(0, 0, 3), Stored), (P(0, 2, 3), Ignored(OutOfOrder)), (P(0, 0, 3), Ignored(Old))], 0, 1);
}

#[test]
fn packets_of_older_frames_are_ignored_and_disturb_nothing() {
    expect(
        &[
            (P(5, 0, 2), Stored),
            (P(4, 0, 2), Ignored(Old)),
            (P(4, 1, 2), Ignored(Old)),
            (P(5, 1, 2), Complete),
            (P(4, 0, 1), Ignored(Old)),
        ],
        1,
        0,
    );
}

#[test]
fn the_first_packet_of_a_newer_frame_begins_it_at_once() {
    expect(&[(P(0, 0, 2), Stored), (P(1, 0, 2), Stored), (P(0, 1, 2), Ignored(Old)), (P(1, 1, 2), Complete)], 1, 1);
}

#[test]
fn a_newer_frame_of_one_packet_is_delivered_at_once() {
    expect(&[(P(0, 0, 2), Stored), (P(1, 0, 1), Complete), (P(0, 1, 2), Ignored(Old))], 1, 1);
}

/// Figure 2: "returns to the initial state and waits for packets from the frame j + 1".
#[test]
fn another_packet_of_a_newer_frame_loses_both_frames() {
    expect(
        &[
            (P(0, 0, 2), Stored),
            (P(1, 1, 3), Ignored(Newer)),
            (P(0, 1, 2), Ignored(Old)),
            (P(1, 0, 3), Ignored(Old)),
            (P(1, 2, 3), Ignored(Old)),
            (P(2, 0, 2), Stored),
            (P(2, 1, 2), Complete),
        ],
        1,
        2,
    );
}

#[test]
fn frames_may_be_left_out() {
    expect(&[(P(2, 0, 1), Complete), (P(9, 0, 1), Complete), (P(8, 0, 1), Ignored(Old))], 2, 0);
}

#[test]
fn duplicates_inside_a_frame_are_ignored() {
    expect(
        &[
            (P(0, 0, 3), Stored),
            (P(0, 0, 3), Ignored(Duplicate)),
            (P(0, 1, 3), Stored),
            (P(0, 0, 3), Ignored(Duplicate)),
            (P(0, 1, 3), Ignored(Duplicate)),
            (P(0, 2, 3), Complete),
        ],
        1,
        0,
    );
}

#[test]
fn duplicates_of_a_delivered_frame_are_ignored() {
    expect(
        &[
            (P(0, 0, 2), Stored),
            (P(0, 1, 2), Complete),
            (P(0, 1, 2), Ignored(Old)),
            (P(0, 0, 2), Ignored(Old)),
            (P(1, 0, 1), Complete),
        ],
        2,
        0,
    );
}

/// The only way to deliver a frame whose second packet arrived first.
#[test]
fn a_duplicate_can_save_a_frame_that_was_counted_lost() {
    expect(&[(P(0, 1, 2), Ignored(NotFirst)), (P(0, 0, 2), Stored), (P(0, 1, 2), Complete)], 1, 0);
}

#[test]
fn sequence_numbers_may_wrap_inside_a_frame() {
    let mut reassembler = Reassembler::new(Policy::WholeFrame);
    for (index, expected) in [(0, Stored), (1, Stored), (2, Complete)] {
        let sequence = (u32::MAX - 1).wrapping_add(index);
        let header = PacketHeader { sequence, first: index == 0, ..P(7, 0, 3).header() };
        assert_eq!(reassembler.push(&datagram(&header, b"abc")), Ok(expected));
    }
    assert_eq!(reassembler.frame().unwrap().body, b"abcabcabc");
}

#[test]
fn packets_need_not_be_of_one_length() {
    let mut reassembler = Reassembler::new(Policy::WholeFrame);
    for (index, data) in [(0, &b"a"[..]), (1, b"bcd"), (2, b"ef")] {
        let header = PacketHeader { data_bytes: u16::try_from(data.len()).unwrap(), ..P(1, index, 3).header() };
        reassembler.push(&datagram(&header, data)).unwrap();
    }
    assert_eq!(reassembler.frame().unwrap().body, b"abcdef");
}

#[test]
fn packets_that_contradict_their_frame_drop_it() {
    let first = P(1, 0, 3).header();
    let next = P(1, 1, 3).header();
    for bad in [
        PacketHeader { frame_packets: NonZeroU16::new(4), ..next },
        PacketHeader { timestamp_ms: Some(9), ..next },
        PacketHeader { first: true, ..next },
        PacketHeader { first: false, ..first },
        PacketHeader { timestamp_ms: Some(9), ..first },
    ] {
        let mut reassembler = Reassembler::new(Policy::WholeFrame);
        assert_eq!(reassembler.push(&datagram(&first, b"abc")), Ok(Stored));
        let error = PacketError::Contradiction { sequence: bad.sequence, frame: FrameNumber(1) };
        assert_eq!(reassembler.push(&datagram(&bad, b"def")), Err(error));
        assert_eq!(reassembler.push(&datagram(&next, b"def")), Ok(Ignored(Old)));
        assert_eq!((reassembler.stats().malformed, reassembler.stats().frames_incomplete), (1, 1));
    }
}

#[test]
fn malformed_packets_are_counted_and_change_nothing_else() {
    let good = P(1, 1, 2).header();
    let mut reassembler = Reassembler::new(Policy::WholeFrame);
    reassembler.push(&datagram(&P(1, 0, 2).header(), b"abc")).unwrap();
    let missing = |field| PacketError::Placeholder { sequence: 11, field };
    for (bad, error) in [
        (PacketHeader { frame: None, ..good }, missing("frame number")),
        (PacketHeader { frame_packets: None, ..good }, missing("number of packets")),
        (PacketHeader { timestamp_ms: None, ..good }, missing("timestamp")),
        (PacketHeader { data_bytes: 4, ..good }, HeaderError::DataSize { stated: 4, found: 3 }.into()),
    ] {
        assert_eq!(reassembler.push(&datagram(&bad, b"def")), Err(error));
    }
    let empty = PacketHeader { data_bytes: 0, ..good };
    assert_eq!(reassembler.push(&datagram(&empty, b"")), Err(PacketError::Empty(11)));
    assert_eq!(reassembler.push(&good.encode()[..9]), Err(HeaderError::TooShort(9).into()));
    assert_eq!(reassembler.stats().malformed, 6);
    assert_eq!(reassembler.push(&datagram(&good, b"def")), Ok(Complete));
    assert_eq!(reassembler.frame().unwrap().body, b"abcdef");
    // A frame stays until the next packet of any kind.
    assert!(reassembler.push(b"").is_err());
    assert_eq!(reassembler.frame(), None);
}

#[test]
fn a_frame_that_gets_too_long_is_dropped_and_takes_no_memory() {
    let mut reassembler = Reassembler::with_max_frame_bytes(Policy::WholeFrame, 8);
    let error = |frame| Err(PacketError::TooLong { frame: FrameNumber(frame), limit: 8 });
    for (packet, expected) in [
        (P(1, 0, 3), Ok(Stored)),
        (P(1, 1, 3), Ok(Stored)),
        (P(1, 2, 3), error(1)),
        (P(2, 0, 2), Ok(Stored)),
        (P(2, 1, 2), Ok(Complete)),
    ] {
        assert_eq!(reassembler.push(&datagram(&packet.header(), &packet.data())), expected, "{packet:?}");
    }
    let long = PacketHeader { data_bytes: 9, ..P(3, 0, 1).header() };
    assert_eq!(reassembler.push(&datagram(&long, &[0; 9])), error(3));
    assert_eq!(reassembler.push(&datagram(&P(3, 0, 1).header(), b"abc")), Ok(Ignored(Old)));
    assert!(reassembler.buffer_bytes() <= 8, "{}", reassembler.buffer_bytes());
    let stats = reassembler.stats();
    assert_eq!((stats.frames_complete, stats.frames_incomplete, stats.malformed), (1, 2, 2));
}
