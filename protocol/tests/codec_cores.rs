//! Frames coded on several cores: the same bytes and bits as on one.

#![allow(clippy::unwrap_used, reason = "helpers outside the test functions use these too")]

mod common;

use gnomon_protocol::{
    codec::{CodecId, Decoder, EncodedFrame, Encoder, Reference},
    ids::FrameNumber,
    limits::MAX_PACKET_BYTES,
    mask::{Mask, MaskShape},
};
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::common::Random;

fn pool(threads: usize) -> ThreadPool {
    ThreadPoolBuilder::new().num_threads(threads).build().unwrap()
}

/// Grains in most of the picture, moved to the right: every tile there is mixed.
fn grains(shape: MaskShape, moved: u32) -> Mask {
    let mut mask = Mask::new(shape);
    for light in 0..shape.lights() {
        for (x, y) in (0..shape.height()).flat_map(|y| (0..shape.width()).map(move |x| (x, y))) {
            let grain = u64::from((x + moved) / 3) << 40 | u64::from(y / 3) << 8 | u64::from(light);
            mask.set(light, x, y, y > 100 && Random(grain).below(3) > 0);
        }
    }
    mask
}

#[test]
fn frames_are_the_same_on_any_number_of_cores() {
    let shape = MaskShape::new(1000, 520, 3).unwrap();
    let (before, sent) = (grains(shape, 0), grains(shape, 7));
    let (mut reference, mut body) = (Reference::new(), EncodedFrame::default());
    let mut encoder = Encoder::new(CodecId::TilesSmall);
    encoder.encode(&before, &mut body).unwrap();
    assert!(encoder.keep(FrameNumber(1), &mut reference));
    let ways = [(CodecId::TilesFast, None), (CodecId::TilesSmall, None), (CodecId::TilesSmall, Some(&reference))];
    for (codec, reference) in ways {
        let mut bodies = Vec::new();
        for threads in [1, 2, 5] {
            pool(threads).install(|| {
                let (mut encoder, mut decoder) = (Encoder::new(codec), Decoder::new());
                let (mut body, mut received) = (EncodedFrame::default(), grains(shape, 1));
                encoder.encode_for(None, reference, &sent, &mut body).unwrap();
                decoder.decode_against(reference, &body, &mut received).unwrap();
                assert!(received == sent);
                let (mut ours, mut theirs) = (Reference::new(), Reference::new());
                let kept = encoder.keep(FrameNumber(2), &mut ours);
                assert_eq!(kept, codec.has_references());
                assert_eq!(decoder.keep(FrameNumber(2), &mut theirs), kept);
                assert!(ours == theirs);
                bodies.push(body);
            });
        }
        assert!(bodies.iter().all(|body| *body == bodies[0]), "{codec}");
    }
}

/// Parts may lie in any order, twice, or be missing.
#[test]
fn parts_in_any_order_are_decoded_on_any_number_of_cores() {
    let shape = MaskShape::new(1000, 520, 2).unwrap();
    let sent = grains(shape, 0);
    for codec in [CodecId::TilesFast, CodecId::TilesSmall] {
        let (mut body, mut random) = (EncodedFrame::default(), Random(5));
        Encoder::new(codec).encode(&sent, &mut body).unwrap();
        let mut parts: Vec<&[u8]> = body.payloads(MAX_PACKET_BYTES).collect();
        assert!(parts.len() > 12);
        parts.remove(3);
        let in_order = parts.concat();
        (1..parts.len()).for_each(|place| parts.swap(place, random.index(place + 1)));
        parts.push(parts[0]);
        for threads in [1, 4] {
            let decode = |body: &[u8]| {
                let mut received = Mask::new(shape);
                pool(threads).install(|| Decoder::new().decode_onto(None, body, &mut received)).unwrap();
                received
            };
            let received = decode(&in_order);
            assert!(received != sent);
            assert!(received.words().iter().zip(sent.words()).all(|(came, sent)| came == sent || *came == 0));
            assert!(decode(&parts.concat()) == received);
        }
    }
}
