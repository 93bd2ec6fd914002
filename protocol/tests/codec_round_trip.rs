//! Each codec round-trips any mask bit by bit, in any number of slices.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers outside the test functions use these too")]

mod common;

use std::num::NonZeroU16;

use gnomon_protocol::{
    codec::{CodecId, Decoder, EncodedFrame, Encoder},
    frame::{FRAME_HEAD_BYTES, Frame},
    header::HEADER_BYTES,
    limits::{MAX_FRAME_BYTES, MAX_FRAME_PACKETS, MAX_PACKET_BYTES},
    mask::{Mask, MaskShape},
    packetizer::Packetizer,
};
use proptest::prelude::*;

use crate::common::Random;

/// The pattern of a test mask's bits.
#[derive(Debug, Clone, Copy)]
enum Pattern {
    Noise,
    AllDark,
    AllLit,
    /// One disc of shadow for each light: long runs with curved edges, as in real masks.
    Discs,
    Checkers,
}

fn mask(shape: MaskShape, pattern: Pattern, seed: u64) -> Mask {
    let mut random = Random(seed);
    let mut mask = Mask::new(shape);
    let (width, height) = (u64::from(shape.width()), u64::from(shape.height()));
    for light in 0..shape.lights() {
        let centre = (random.below(width), random.below(height), 1 + random.below(width.max(height)));
        for y in 0..shape.height() {
            for x in 0..shape.width() {
                let lit = match pattern {
                    Pattern::Noise => random.below(2) == 1,
                    Pattern::AllDark => false,
                    Pattern::AllLit => true,
                    Pattern::Checkers => (x + y + light) % 2 == 1,
                    Pattern::Discs => {
                        let (dx, dy) = (u64::from(x).abs_diff(centre.0), u64::from(y).abs_diff(centre.1));
                        dx * dx + dy * dy > centre.2 * centre.2 / 4
                    }
                };
                mask.set(light, x, y, lit);
            }
        }
    }
    mask
}

fn patterns() -> impl Strategy<Value = Pattern> {
    prop_oneof![
        Just(Pattern::Noise),
        Just(Pattern::AllDark),
        Just(Pattern::AllLit),
        Just(Pattern::Discs),
        Just(Pattern::Checkers),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_mask_comes_back_bit_by_bit(
        (width, height, lights) in (1u32..=70, 1u32..=70, 1u32..=32),
        pattern in patterns(),
        seed in any::<u64>(),
        slices in 1u16..=12,
        packet_bytes in 0usize..2000,
    ) {
        let shape = MaskShape::new(width, height, lights).unwrap();
        let sent = mask(shape, pattern, seed);
        let (mut decoder, mut body) = (Decoder::new(), EncodedFrame::from(vec![1, 2, 3]));
        // A mask of another shape with bits set, none of which may survive.
        let mut received = mask(MaskShape::new(9, 17, 2).unwrap(), Pattern::AllLit, 0);
        for codec in CodecId::ALL {
            let count = NonZeroU16::new(slices).unwrap();
            let mut encoder = Encoder::with_slices(codec, count).for_packets_of(packet_bytes);
            encoder.encode(&sent, &mut body).unwrap();
            let frame = Frame::parse(&body).unwrap();
            if codec.is_sliced() {
                // A block of noise takes up to 1 KiB, and is never split.
                let room = packet_bytes.saturating_sub(HEADER_BYTES).max(1024 + FRAME_HEAD_BYTES + 4);
                prop_assert!(body.payloads(room).all(|part| part.len() <= room && Frame::parts(part).count() == 1));
            } else {
                prop_assert_eq!(frame.slice_count(), usize::from(slices).min(shape.tiles_y() as usize));
            }
            prop_assert_eq!(decoder.decode(&body, &mut received).unwrap(), codec);
            prop_assert_eq!(&received, &sent);
        }
    }

    /// The parts of a sliced frame that arrive, in any order, change their own tiles and no others.
    #[test]
    fn each_part_stands_alone(
        (width, height, lights) in (1u32..=300, 1u32..=150, 1u32..=5),
        pattern in patterns(),
        seed in any::<u64>(),
    ) {
        let shape = MaskShape::new(width, height, lights).unwrap();
        let (before, sent) = (mask(shape, Pattern::Checkers, 0), mask(shape, pattern, seed));
        let (mut decoder, mut body, mut random) = (Decoder::new(), EncodedFrame::default(), Random(seed));
        for codec in CodecId::ALL.into_iter().filter(|codec| codec.is_sliced()) {
            Encoder::new(codec).for_packets_of(0).encode(&sent, &mut body).unwrap();
            let mut parts: Vec<&[u8]> = body.payloads(MAX_PACKET_BYTES).collect();
            (1..parts.len()).for_each(|place| parts.swap(place, random.index(place + 1)));
            let mut received = before.clone();
            for (count, part) in (1..).zip(&parts) {
                let old = received.clone();
                prop_assert_eq!(decoder.decode_onto(None, part, &mut received).unwrap(), codec);
                let places = || old.words().iter().zip(received.words()).zip(sent.words());
                prop_assert!(places().all(|((old, new), sent)| new == old || new == sent));
                let mut all_so_far = before.clone();
                decoder.decode_onto(None, &parts[..count].concat(), &mut all_so_far).unwrap();
                prop_assert_eq!(&all_so_far, &received);
            }
            prop_assert_eq!(&received, &sent);
        }
    }

    /// The words on the wire are the dissertation's: light k is bit k of the pixel's word (§3.1).
    #[test]
    fn words_hold_light_k_in_bit_k(
        (width, height, lights) in (1u32..=40, 1u32..=40, 1u32..=32),
        seed in any::<u64>(),
    ) {
        let shape = MaskShape::new(width, height, lights).unwrap();
        let sent = mask(shape, Pattern::Noise, seed);
        let mut body = EncodedFrame::default();
        Encoder::new(CodecId::Words).encode(&sent, &mut body).unwrap();
        let frame = Frame::parse(&body).unwrap();
        let (_, slice) = frame.slices().next().unwrap();
        for y in 0..height {
            for x in 0..width {
                let expected = (0..lights).fold(0, |word, k| word | u32::from(sent.get(k, x, y)) << k);
                let place = ((y * width + x) * 4) as usize;
                prop_assert_eq!(u32::from_le_bytes(slice[place..place + 4].try_into().unwrap()), expected);
            }
        }
    }
}

#[test]
fn bits_outside_the_picture_are_not_sent() {
    let shape = MaskShape::new(13, 9, 2).unwrap();
    let clean = mask(shape, Pattern::AllLit, 0);
    let mut dirty = clean.clone();
    dirty.words_mut().fill(u64::MAX);
    assert_ne!(dirty, clean);
    let (mut expected, mut body, mut received) = (EncodedFrame::default(), EncodedFrame::default(), Mask::new(shape));
    for codec in CodecId::ALL {
        let mut encoder = Encoder::new(codec);
        encoder.encode(&clean, &mut expected).unwrap();
        encoder.encode(&dirty, &mut body).unwrap();
        assert_eq!(body, expected, "{codec}");
        Decoder::new().decode(&body, &mut received).unwrap();
        assert_eq!(received, clean, "{codec}");
    }
}

#[test]
fn the_largest_masks_fit_a_frame() {
    for (width, height) in [(3840, 2160), (4096, 2025)] {
        let shape = MaskShape::new(width, height, 32).unwrap();
        let mut sent = Mask::new(shape);
        let mut random = Random(7);
        let (mut body, mut received) = (EncodedFrame::default(), Mask::new(shape));
        // Noise in the upper half, as long as LZ4 can make it; short below.
        let words = shape.words();
        sent.words_mut()[..words / 2].fill_with(|| random.next());
        let clean = {
            Encoder::new(CodecId::Words).encode(&sent, &mut body).unwrap();
            Decoder::new().decode(&body, &mut received).unwrap();
            received.clone()
        };
        assert!(body.len() <= MAX_FRAME_BYTES);
        for codec in [CodecId::WordsLz4, CodecId::PlanesLz4] {
            Encoder::new(codec).encode(&sent, &mut body).unwrap();
            assert!(body.len() <= MAX_FRAME_BYTES, "{codec}: {}", body.len());
            Decoder::new().decode(&body, &mut received).unwrap();
            assert!(received == clean, "{codec}");
        }
        // In parts of one datagram each; with less noise, which is slow to code this way.
        sent.words_mut()[words / 32..].fill(u64::MAX);
        Encoder::new(CodecId::Words).encode(&sent, &mut body).unwrap();
        Decoder::new().decode(&body, &mut received).unwrap();
        let clean = received.clone();
        for codec in [CodecId::TilesSmall, CodecId::TilesFast] {
            Encoder::new(codec).encode(&sent, &mut body).unwrap();
            assert!(Packetizer::new(MAX_PACKET_BYTES).packet_count(&body) <= MAX_FRAME_PACKETS);
            Decoder::new().decode(&body, &mut received).unwrap();
            assert!(received == clean, "{codec}");
        }
    }
}
