//! Simplified masks: every codec round-trips them in fewer bytes, and they become the references.

#![allow(clippy::unwrap_used, reason = "a helper outside the test functions uses it too")]

mod common;

use gnomon_protocol::{
    codec::{CodecId, Decoder, EncodedFrame, Encoder, Reference, Simplifier},
    ids::FrameNumber,
    mask::{Mask, MaskShape},
};

use crate::common::Random;

const BITS: u64 = 320 * 200 * 2;

/// The shadow of a disc moved by `step` pixels, with specks in one pixel of 200.
fn speckled(step: u64, seed: u64) -> Mask {
    let mut random = Random(seed);
    let mut mask = Mask::new(MaskShape::new(320, 200, 2).unwrap());
    for (light, y) in (0..2).flat_map(|light| (0..200).map(move |y| (light, y))) {
        for x in 0..320 {
            let (dx, dy) = (u64::from(x).abs_diff(100 + step), u64::from(y).abs_diff(90));
            mask.set(light, x, y, (dx * dx + dy * dy > 60 * 60) != (random.below(200) == 0));
        }
    }
    mask
}

fn wrong_bits(a: &Mask, b: &Mask) -> u64 {
    a.words().iter().zip(b.words()).map(|(a, b)| u64::from((a ^ b).count_ones())).sum()
}

#[test]
fn all_codecs_round_trip_the_simplified_mask_in_fewer_bytes() {
    let mut simplifier = Simplifier::default();
    for codec in CodecId::ALL {
        let (mut encoder, mut decoder, mut body) = (Encoder::new(codec), Decoder::new(), EncodedFrame::default());
        let mut bytes = Vec::new();
        for wrong_ppm in [0, 1000, 5000] {
            let whole = speckled(0, 1);
            let mut mask = whole.clone();
            let turned = simplifier.simplify(&mut mask, wrong_ppm);
            encoder.encode(&mask, &mut body).unwrap();
            let mut decoded = Mask::new(mask.shape());
            decoder.decode(&body, &mut decoded).unwrap();
            assert_eq!(decoded, mask);
            assert_eq!(wrong_bits(&decoded, &whole), turned);
            assert!(turned <= BITS * u64::from(wrong_ppm) / 1_000_000);
            bytes.push(body.len());
        }
        let is_coded = codec != CodecId::Words;
        assert!(
            bytes.is_sorted_by(|less, more| if is_coded { more < less } else { more == less }),
            "{codec}: {bytes:?}"
        );
    }
}

#[test]
fn errors_do_not_add_up_from_frame_to_frame() {
    let mut simplifier = Simplifier::default();
    let (mut encoder, mut decoder, mut body) =
        (Encoder::new(CodecId::TilesSmall), Decoder::new(), EncodedFrame::default());
    let (mut sent, mut kept) = (Reference::new(), Reference::new());
    let mut decoded = Mask::new(speckled(0, 0).shape());
    for frame in 0..6 {
        let whole = speckled(u64::from(frame) * 3, frame.into());
        let mut mask = whole.clone();
        let turned = simplifier.simplify(&mut mask, 2000);
        assert!(turned > 0);
        encoder.encode_for(None, (frame > 0).then_some(&sent), &mask, &mut body).unwrap();
        decoder.decode_against((frame > 0).then_some(&kept), &body, &mut decoded).unwrap();
        assert!(encoder.keep(FrameNumber(frame), &mut sent) && decoder.keep(FrameNumber(frame), &mut kept));
        assert_eq!(wrong_bits(&decoded, &whole), turned);
    }
}
