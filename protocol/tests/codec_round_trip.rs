//! Whatever a mask holds, each codec gives it back bit by bit, in any number of slices.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers outside the test functions use these too")]

mod common;

use std::num::NonZeroU16;

use gnomon_protocol::{
    codec::{CodecId, Decoder, EncodeError, Encoder},
    frame::{FRAME_HEAD_BYTES, Frame},
    header::HEADER_BYTES,
    limits::{MAX_FRAME_BYTES, MAX_FRAME_SLICES},
    mask::{Mask, MaskShape},
};
use proptest::prelude::*;

use crate::common::Random;

/// How the bits of a test mask come about.
#[derive(Debug, Clone, Copy)]
enum Pattern {
    Noise,
    AllDark,
    AllLit,
    /// One disc of shadow a light: long runs with curved edges, as real masks have.
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
        let (mut decoder, mut body) = (Decoder::new(), vec![1, 2, 3]);
        // A mask of another shape, with bits set: nothing of it may shine through.
        let mut received = mask(MaskShape::new(9, 17, 2).unwrap(), Pattern::AllLit, 0);
        for codec in CodecId::ALL {
            let mut encoder = Encoder::with_slices(codec, NonZeroU16::new(slices).unwrap()).for_packets_of(packet_bytes);
            encoder.encode(&sent, &mut body).unwrap();
            let frame = Frame::parse(&body).unwrap();
            if codec.is_sliced() {
                // A block of noise takes up to 1 KiB, and is never cut.
                let room = packet_bytes.saturating_sub(HEADER_BYTES + FRAME_HEAD_BYTES);
                prop_assert!(frame.slices().all(|(_, slice)| slice.len() <= room.max(1024)));
            } else {
                prop_assert_eq!(frame.slice_count(), usize::from(slices).min(shape.tiles_y() as usize));
            }
            prop_assert_eq!(decoder.decode(&body, &mut received).unwrap(), codec);
            prop_assert_eq!(&received, &sent);
        }
    }

    /// The words on the wire are the dissertation's: bit k of pixel p's word is light k (§3.1).
    #[test]
    fn words_hold_light_k_in_bit_k(
        (width, height, lights) in (1u32..=40, 1u32..=40, 1u32..=32),
        seed in any::<u64>(),
    ) {
        let shape = MaskShape::new(width, height, lights).unwrap();
        let sent = mask(shape, Pattern::Noise, seed);
        let mut body = Vec::new();
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
fn bits_outside_the_picture_do_not_travel() {
    let shape = MaskShape::new(13, 9, 2).unwrap();
    let clean = mask(shape, Pattern::AllLit, 0);
    let mut dirty = clean.clone();
    dirty.words_mut().fill(u64::MAX);
    assert_ne!(dirty, clean);
    let (mut expected, mut body, mut received) = (Vec::new(), Vec::new(), Mask::new(shape));
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
        let (mut body, mut received) = (Vec::new(), Mask::new(shape));
        // Noise in the upper half: as long as LZ4 can make it there, and short below.
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
        // In slices of a datagram each, noise is too much, and shadows are not.
        for codec in [CodecId::TilesSmall, CodecId::TilesFast] {
            let refused = Encoder::new(codec).encode(&sent, &mut body);
            assert!(
                matches!(refused, Err(EncodeError::TooManySlices(slices)) if slices > MAX_FRAME_SLICES),
                "{refused:?}"
            );
            let discs = mask(shape, Pattern::Discs, 7);
            Encoder::new(codec).encode(&discs, &mut body).unwrap();
            Decoder::new().decode(&body, &mut received).unwrap();
            assert!(received == discs, "{codec}");
        }
    }
}
