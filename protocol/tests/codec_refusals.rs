//! Anything but exactly one frame is refused, if possible before memory is taken.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers outside the test functions use these too")]

use gnomon_protocol::{
    codec::{CodecId, DecodeError, Decoder, EncodedFrame, Encoder},
    frame::FrameError,
    mask::{Mask, MaskShape},
};

/// A frame of one slice.
fn body(codec: u8, (width, height, lights): (u16, u16, u8), slice: &[u8]) -> Vec<u8> {
    let length = u32::try_from(slice.len()).unwrap();
    let sides = [width.to_le_bytes(), height.to_le_bytes()].concat();
    [&[codec][..], &sides, &[lights, 1, 0], &length.to_le_bytes(), slice].concat()
}

fn decode(body: &[u8]) -> (Result<(), DecodeError>, Mask) {
    let mut mask = Mask::new(MaskShape::new(1, 1, 1).unwrap());
    (Decoder::new().decode(body, &mut mask).map(drop), mask)
}

fn error(body: &[u8]) -> DecodeError {
    decode(body).0.unwrap_err()
}

#[test]
fn words_have_exactly_the_pixels_bytes() {
    assert!(decode(&body(0, (3, 2, 5), &[0; 24])).0.is_ok());
    for length in [0, 23, 25] {
        let error = error(&body(0, (3, 2, 5), &vec![0; length]));
        assert!(matches!(error, DecodeError::SliceLength { slice: 0, found, raw: 24 } if found == length), "{error}");
    }
}

#[test]
fn a_slice_longer_than_its_raw_bytes_is_refused() {
    for (codec, raw) in [(1, 24), (2, 40)] {
        let error = error(&body(codec, (3, 2, 5), &vec![0; raw + 1]));
        assert!(matches!(error, DecodeError::SliceLength { .. }), "{error}");
    }
}

/// 33 MB of mask demanded by a handful of bytes: refused before the mask grows.
#[test]
fn a_slice_too_short_for_its_raw_bytes_takes_no_memory() {
    for codec in [1, 2] {
        let (result, mask) = decode(&body(codec, (3840, 2160, 32), &[0x1F, 0, 1, 0, 255, 255, 255, 0]));
        assert!(matches!(result, Err(DecodeError::SliceLength { found: 8, raw: 33_177_600, .. })), "{result:?}");
        assert_eq!(mask.shape(), MaskShape::new(1, 1, 1).unwrap());
    }
}

/// 8×8 pixels and 20 lights are 160 raw bytes of planes. `0x1F 0 1 0 n` and a last token encode 20 + n zero bytes.
#[test]
fn blocks_that_do_not_give_the_raw_bytes_are_refused() {
    let planes = |slice: &[u8]| decode(&body(2, (8, 8, 20), slice)).0;
    assert!(planes(&[0x1F, 0, 1, 0, 135, 0x50, 0, 0, 0, 0, 0]).is_ok());
    let short = planes(&[0x1F, 0, 1, 0, 134, 0x50, 0, 0, 0, 0, 0]);
    assert!(matches!(short, Err(DecodeError::Short { slice: 0, found: 159, raw: 160 })), "{short:?}");
    for bad in [
        &[0x1F, 0, 1, 0, 136, 0x50, 0, 0, 0, 0, 0][..],      // One byte too many.
        &[0x1F, 0, 1, 0, 135, 0x50, 0, 0, 0, 0],             // Cut.
        &[0x1F, 0, 0, 0, 135, 0x50, 0, 0, 0, 0, 0],          // Offset 0.
        &[0x1F, 0, 2, 0, 135, 0x50, 0, 0, 0, 0, 0],          // Offset before the beginning.
        &[0x1F, 0, 1, 0, 135, 0x50, 0, 0, 0, 0, 0, 0x10, 0], // Something left over.
    ] {
        let result = planes(bad);
        assert!(matches!(result, Err(DecodeError::Lz4 { slice: 0, .. })), "{bad:?}: {result:?}");
    }
}

#[test]
fn words_with_bits_of_other_lights_are_refused() {
    let mut slice = [0; 24];
    slice[4] = 0b1_1111;
    assert!(decode(&body(0, (3, 2, 5), &slice)).0.is_ok());
    slice[23] = 0x80;
    let error = error(&body(0, (3, 2, 5), &slice));
    assert!(matches!(error, DecodeError::StrayLights { slice: 0, set: 0x8000_001F, lights: 5 }), "{error}");
    assert!(decode(&body(0, (3, 2, 32), &slice)).0.is_ok());
}

#[test]
fn tiles_with_bits_outside_the_picture_are_refused() {
    // 9×9 pixels: four tiles a light. Only 1 column, 1 row or 1 pixel of the outer ones lies inside the picture.
    let allowed: [u64; 4] = [u64::MAX, 0x0101_0101_0101_0101, 0xFF, 1];
    let planes = |tiles: [u64; 8]| body(2, (9, 9, 2), &tiles.map(u64::to_le_bytes).concat());
    let full = [allowed, allowed].concat().try_into().unwrap();
    assert!(decode(&planes(full)).0.is_ok());
    for place in 0..8 {
        for bit in 0..64 {
            let mut tiles = full;
            tiles[place] |= 1 << bit;
            match decode(&planes(tiles)).0 {
                Ok(()) => assert_ne!(allowed[place % 4] >> bit & 1, 0),
                Err(DecodeError::StrayPixels { light, tile }) => {
                    assert_eq!((light, tile), (place / 4, place % 4));
                    assert_eq!(allowed[tile] >> bit & 1, 0);
                }
                Err(error) => panic!("{error}"),
            }
        }
    }
}

/// A frame of `tiles-small` or `tiles-fast`, a part for each slice: 200×20 pixels and 3 lights are 4 × 3 × 3 blocks.
fn tiles(codec: u8, slices: &[&[u8]]) -> Vec<u8> {
    slices.iter().flat_map(|slice| body(codec, (200, 20, 3), slice)).collect()
}

#[test]
fn slices_that_do_not_cover_the_blocks_in_order_take_no_memory() {
    let all: &[u8] = &[0, 0, 0, 36, 0];
    for codec in [3, 4] {
        let cases: [(&[&[u8]], usize); 9] = [
            (&[&[0, 0, 0, 20, 0], &[21, 0, 0, 15, 0]], 1),
            (&[&[0, 0, 0, 20, 0], &[19, 0, 0, 17, 0]], 1),
            (&[&[1, 0, 0, 35, 0]], 0),
            (&[&[0, 0, 0, 35, 0]], 1),
            (&[&[0, 0, 0, 37, 0]], 0),
            (&[&[0, 0, 0, 0, 0], all], 0),
            (&[&[0, 0, 0, 36]], 0),
            (&[all, &[36, 0, 0, 1, 0]], 1),
            (&[&[0, 0, 1, 36, 0]], 0),
        ];
        for (slices, bad) in cases {
            let (result, mask) = decode(&tiles(codec, slices));
            assert!(matches!(result, Err(DecodeError::Blocks { slice }) if slice == bad), "{slices:?}: {result:?}");
            assert_eq!(mask.shape(), MaskShape::new(1, 1, 1).unwrap());
        }
    }
}

/// Every slice of an encoder decodes. With nine bytes more, or nine or more fewer, it is refused.
#[test]
fn slices_with_too_few_or_too_many_bits_are_refused() {
    let mut mask = Mask::new(MaskShape::new(200, 20, 3).unwrap());
    for light in 0..3 {
        for (x, y) in (0..20).flat_map(|y| (0..200).map(move |x| (x, y))) {
            mask.set(light, x, y, (x * 7 + y * 3 + light) % 31 > 11 && (x / 9 + y) % 5 != light);
        }
    }
    for codec in [CodecId::TilesSmall, CodecId::TilesFast] {
        let mut body = EncodedFrame::default();
        Encoder::new(codec).for_packets_of(60_000).encode(&mask, &mut body).unwrap();
        let (head, slice) = (&body[12..17], &body[17..]);
        let with = |bits: &[u8]| decode(&tiles(codec.number(), &[&[head, bits].concat()])).0;
        assert!(with(slice).is_ok());
        assert!(matches!(with(&[slice, &[0; 9]].concat()), Err(DecodeError::Bits { slice: 0 })));
        for length in 0..slice.len() - 8 {
            let result = with(&slice[..length]);
            assert!(matches!(result, Err(DecodeError::Bits { slice: 0 })), "{codec}, {length}: {result:?}");
        }
    }
}

#[test]
fn parts_of_different_frames_are_refused() {
    let part = |codec, first| body(codec, (200, 20, 3), &[first, 0, 0, 18, 0]);
    let mixed = [part(3, 0), part(4, 18)].concat();
    assert!(matches!(error(&mixed), DecodeError::Frame(FrameError::Parts)));
    let cut = &[part(3, 0), part(3, 18)].concat()[..20];
    assert!(matches!(error(cut), DecodeError::Frame(FrameError::TooShort { needed: 8, found: 3 })));
    // Decoded onto a mask of another shape, or without parts.
    let mut mask = Mask::new(MaskShape::new(200, 21, 3).unwrap());
    let mut onto = |body: &[u8]| Decoder::new().decode_onto(None, body, &mut mask);
    assert!(matches!(onto(&part(3, 0)), Err(DecodeError::NoParts)));
    assert!(matches!(onto(&body(2, (200, 21, 3), &[0])), Err(DecodeError::NoParts)));
}

#[test]
fn malformed_frames_are_refused() {
    assert!(matches!(error(&[]), DecodeError::Frame(FrameError::TooShort { needed: 8, found: 0 })));
    assert!(matches!(error(&body(9, (8, 8, 1), &[0; 8])), DecodeError::Frame(FrameError::Codec(9))));
    let long = [&body(0, (1, 1, 1), &[0; 4])[..], &[0]].concat();
    assert!(matches!(error(&long), DecodeError::Frame(FrameError::Length { stated: 4, found: 5 })));
}
