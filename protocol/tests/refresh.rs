//! Byte budgets: a frame of which parts are left out stays within its budget, what is sent is right, what changes most comes first,
//! and everything comes in the end.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers outside the test functions use these too")]

mod common;

use gnomon_protocol::{
    codec::{CodecId, Decoder, Encoder, part_words},
    frame::pieces,
    header::HEADER_BYTES,
    mask::{Mask, MaskShape},
    refresh::Refresh,
};
use proptest::prelude::*;

use crate::common::Random;

fn noise(shape: MaskShape, random: &mut Random) -> Mask {
    let mut mask = Mask::new(shape);
    for _ in 0..40 {
        scribble(&mut mask, random);
    }
    mask
}

/// Turns some pixels of some rows over.
fn scribble(mask: &mut Mask, random: &mut Random) {
    let shape = mask.shape();
    let (light, y) = (random.index(shape.lights() as usize), random.index(shape.height() as usize));
    for x in 0..shape.width() {
        if random.one_in(3) {
            let (light, y) = (u32::try_from(light).unwrap(), u32::try_from(y).unwrap());
            mask.set(light, x, y, random.one_in(2));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn what_is_sent_is_right_and_everything_comes_in_the_end(budget in 0usize..3000, fast in any::<bool>(), seed in any::<u64>()) {
        let mut random = Random(seed);
        let shape = MaskShape::new(300, 200, 2).unwrap();
        let codec = if fast { CodecId::TilesFast } else { CodecId::TilesSmall };
        let (mut encoder, mut decoder, mut refresh) = (Encoder::new(codec).for_packets_of(200), Decoder::new(), Refresh::default());
        let (mut shown, mut body, mut mask) = (Mask::new(shape), Vec::new(), noise(shape, &mut random));
        for _ in 0..5 {
            scribble(&mut mask, &mut random);
            encoder.encode(&mask, &mut body).unwrap();
            let all = body.len() + pieces(&body, usize::MAX).count() * HEADER_BYTES;
            let before = shown.clone();
            let whole = refresh.choose(&mask, &mut body, budget);
            prop_assert_eq!(whole, all <= budget);
            prop_assert_eq!(whole, refresh.is_whole());
            let count = pieces(&body, usize::MAX).count();
            prop_assert!(count == 1 || body.len() + count * HEADER_BYTES <= budget);
            decoder.decode_onto(None, &body, &mut shown).unwrap();
            let mut expected = before;
            for words in pieces(&body, usize::MAX).flat_map(|part| part_words(shape, part).collect::<Vec<_>>()) {
                expected.words_mut()[words.clone()].copy_from_slice(&mask.words()[words]);
            }
            prop_assert!(shown == expected);
            refresh.sent(&mask);
        }
        // Nothing changes any more: in as many frames as there are parts all have come.
        let mut frames = 0;
        while shown != mask {
            encoder.encode(&mask, &mut body).unwrap();
            let parts = pieces(&body, usize::MAX).count();
            prop_assert!(frames < parts, "{} parts", parts);
            refresh.choose(&mask, &mut body, budget);
            decoder.decode_onto(None, &body, &mut shown).unwrap();
            refresh.sent(&mask);
            frames += 1;
        }
    }
}

/// A quarter of the picture changes wholly, another one in a few pixels: the first one is sent, and then the other.
#[test]
fn large_changes_come_first_and_waiting_counts() {
    let shape = MaskShape::new(1024, 512, 1).unwrap();
    let mut random = Random(5);
    let mut encoder = Encoder::new(CodecId::TilesFast).for_packets_of(400);
    let (mut refresh, mut body, mut mask) = (Refresh::default(), Vec::new(), noise(shape, &mut random));
    encoder.encode(&mask, &mut body).unwrap();
    assert!(refresh.choose(&mask, &mut body, usize::MAX));
    refresh.sent(&mask);
    for (x, y) in (0..256).flat_map(|x| (0..512).map(move |y| (x, y))) {
        let lit = mask.get(0, x, y);
        mask.set(0, x, y, !lit);
        mask.set(0, 768 + x, y, if x == y { !lit } else { mask.get(0, 768 + x, y) });
    }
    let mut columns = Vec::new();
    for _ in 0..200 {
        encoder.encode(&mask, &mut body).unwrap();
        refresh.choose(&mask, &mut body, 420);
        let part = pieces(&body, usize::MAX).next().unwrap();
        let first = part_words(shape, part).next().unwrap().start;
        columns.push(first % shape.tiles_x() as usize / 32);
        refresh.sent(&mask);
    }
    // A stripe of blocks is 256 pixels wide, so the parts of the left quarter begin there, or just before it ends.
    let left = columns.iter().take_while(|column| **column == 0).count();
    assert!(left >= 3, "{columns:?}");
    let right = columns.iter().position(|column| *column == 3).unwrap();
    assert!(right >= left, "{columns:?}");
}

#[test]
fn frames_that_are_not_sliced_stay_whole() {
    let mut random = Random(9);
    let mask = noise(MaskShape::new(300, 200, 2).unwrap(), &mut random);
    let mut body = Vec::new();
    Encoder::new(CodecId::PlanesLz4).encode(&mask, &mut body).unwrap();
    let before = body.clone();
    assert!(Refresh::default().choose(&mask, &mut body, 10));
    assert_eq!(body, before);
    assert_eq!(part_words(mask.shape(), &body).count(), 0);
    assert_eq!(part_words(mask.shape(), &[1, 2, 3]).count(), 0);
}
