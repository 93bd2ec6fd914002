//! Byte budgets: a frame with parts left out fits its budget, what is sent is right, the largest changes come first,
//! and every tile is sent in time.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers outside the test functions use these too")]

mod common;

use std::collections::VecDeque;

use gnomon_protocol::{
    codec::{CodecId, Decoder, EncodedFrame, Encoder, part_words},
    coverage::{Coverage, max_layers},
    header::HEADER_BYTES,
    mask::{Mask, MaskShape},
    refresh::{FULL_WEIGHT, Refresh, Selection},
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

/// Flips some pixels of some rows.
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

    /// Once all tiles have arrived, a client never misses one, even if a frame is lost now and then.
    #[test]
    fn sent_parts_are_right_and_every_tile_is_refreshed(
        budget in 0usize..3000, fast in any::<bool>(), lossy in any::<bool>(), seed in any::<u64>()
    ) {
        let mut random = Random(seed);
        let shape = MaskShape::new(300, 200, 2).unwrap();
        let codec = if fast { CodecId::TilesFast } else { CodecId::TilesSmall };
        let mut encoder = Encoder::new(codec).for_packets_of(200);
        let (mut decoder, mut refresh) = (Decoder::new(), Refresh::default());
        let (mut shown, mut body, mut mask) = (Mask::new(shape), EncodedFrame::default(), noise(shape, &mut random));
        let (mut coverage, mut layers, mut unchanged) = (Coverage::whole(shape), VecDeque::new(), 0);
        let mut lost = false;
        for frame in 0..40 {
            if frame < 30 {
                scribble(&mut mask, &mut random);
            }
            encoder.encode(&mask, &mut body).unwrap();
            let all = body.len() + body.parts().len() * HEADER_BYTES;
            let before = body.len();
            let selection = refresh.select(&mask, &mut body, budget, lossy);
            let count = body.parts().len();
            match selection {
                Selection::Whole => prop_assert!(all <= budget),
                Selection::Parts => prop_assert!(budget < all && body.len() + count * HEADER_BYTES <= budget),
                Selection::Nothing => {
                    let round = if lossy { max_layers(shape) / 2 - 1 } else { max_layers(shape) - 2 };
                    prop_assert!(budget < all / round + 200 && body.len() == before);
                    refresh.sent(&mask);
                    continue;
                }
            }
            // Loses one of every `max_layers` frames.
            if lossy && frame % max_layers(shape) == 5 {
                refresh.sent(&mask);
                lost = true;
                continue;
            }
            let mut expected = shown.clone();
            for words in body.parts().iter().flat_map(|part| part_words(shape, part)) {
                expected.words_mut()[words.clone()].copy_from_slice(&mask.words()[words]);
            }
            decoder.decode_onto(None, &body, &mut shown).unwrap();
            prop_assert!(shown == expected);
            decoder.coverage(shape, &mut coverage);
            prop_assert_eq!(coverage.is_whole(), selection == Selection::Whole);
            refresh.sent(&mask);
            layers.push_back(coverage.clone());
            if layers.len() > max_layers(shape) {
                layers.pop_front();
            }
            if layers.len() == max_layers(shape) {
                let all = layers.iter().skip(1).fold(layers[0].clone(), Coverage::or);
                prop_assert!(all.is_whole(), "frame {}, budget {}", frame, budget);
            }
            unchanged += usize::from(frame >= 30);
        }
        prop_assert!(unchanged < max_layers(shape) || lost || shown == mask);
    }
}

/// One sixth of the picture changes wholly, another one in a few pixels. The first is sent first, then the other, and
/// unchanged parts when they are due.
#[test]
fn large_changes_come_first_and_waiting_counts() {
    let shape = MaskShape::new(1536, 256, 1).unwrap();
    let mut random = Random(5);
    let mut encoder = Encoder::new(CodecId::TilesFast).for_packets_of(400);
    let (mut refresh, mut body, mut mask) = (Refresh::default(), EncodedFrame::default(), noise(shape, &mut random));
    encoder.encode(&mask, &mut body).unwrap();
    assert_eq!(refresh.select(&mask, &mut body, usize::MAX, false), Selection::Whole);
    refresh.sent(&mask);
    for (x, y) in (0..256).flat_map(|x| (0..256).map(move |y| (x, y))) {
        let lit = mask.get(0, x, y);
        mask.set(0, x, y, !lit);
        mask.set(0, 1280 + x, y, if x == y { !lit } else { mask.get(0, 1280 + x, y) });
    }
    // Blocks are 256 pixels wide: six stripes.
    let mut stripes = Vec::new();
    for _ in 0..max_layers(shape) {
        encoder.encode(&mask, &mut body).unwrap();
        let budget = (body.len() + body.parts().len() * HEADER_BYTES) / 4;
        assert_eq!(refresh.select(&mask, &mut body, budget, false), Selection::Parts);
        let columns = body.parts().iter().flat_map(|part| part_words(shape, part));
        let mut sent: Vec<_> = columns.map(|words| words.start % shape.tiles_x() as usize / 32).collect();
        sent.sort_unstable();
        sent.dedup();
        stripes.push(sent);
        refresh.sent(&mask);
    }
    assert!(stripes[0].contains(&0), "{stripes:?}");
    let last = stripes.iter().position(|sent| sent.contains(&5)).unwrap();
    let still = stripes.iter().position(|sent| sent.contains(&3)).unwrap();
    assert!(last <= 2 && still >= last, "{stripes:?}");
    assert!((0..6).all(|stripe| stripes.iter().any(|sent| sent.contains(&stripe))), "{stripes:?}");
}

/// A dim and a bright light change in equally many bits, elsewhere: the bright one's come first.
#[test]
fn bits_of_dim_lights_count_less() {
    let shape = MaskShape::new(1536, 256, 2).unwrap();
    let mut random = Random(7);
    let mut encoder = Encoder::new(CodecId::TilesFast).for_packets_of(400);
    let changed = |mask: &mut Mask, light: u32, left: u32| {
        (0..256).for_each(|y| {
            (0..256).for_each(|x| {
                let lit = mask.get(light, left + x, y);
                mask.set(light, left + x, y, !lit);
            });
        });
    };
    for (dim, first) in [(0, 5), (1, 0)] {
        let mut weights = vec![FULL_WEIGHT; 2];
        weights[dim] = 3;
        let (mut refresh, mut body, mut mask) =
            (Refresh::new(weights), EncodedFrame::default(), noise(shape, &mut random));
        encoder.encode(&mask, &mut body).unwrap();
        assert_eq!(refresh.select(&mask, &mut body, usize::MAX, false), Selection::Whole);
        refresh.sent(&mask);
        // Light 0 changes in the leftmost stripe, light 1 in the rightmost.
        changed(&mut mask, 0, 0);
        changed(&mut mask, 1, 1280);
        encoder.encode(&mask, &mut body).unwrap();
        let budget = (body.len() + body.parts().len() * HEADER_BYTES) / 4;
        // The refresh share may go anywhere; the rest goes to the bright light.
        assert_eq!(refresh.select(&mask, &mut body, budget, false), Selection::Parts);
        let mut bits = [0; 6];
        for words in body.parts().iter().flat_map(|part| part_words(shape, part)) {
            bits[words.start % shape.tiles() % shape.tiles_x() as usize / 32] += words.len();
        }
        assert!(bits[first] > bits[5 - first], "light {dim} is dim: {bits:?}");
    }
}

#[test]
fn frames_that_are_not_sliced_stay_whole() {
    let mut random = Random(9);
    let mask = noise(MaskShape::new(300, 200, 2).unwrap(), &mut random);
    let mut body = EncodedFrame::default();
    Encoder::new(CodecId::PlanesLz4).encode(&mask, &mut body).unwrap();
    let before = body.clone();
    assert_eq!(Refresh::default().select(&mask, &mut body, 10, false), Selection::Whole);
    assert_eq!(body, before);
    assert!(body.parts().is_empty());
}
