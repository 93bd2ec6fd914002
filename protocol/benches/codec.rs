//! Times every codec on one mask, beside `lz4_flex` on the same planes.
//!
//! ```text
//! cargo bench -p gnomon-protocol --bench codec
//! ```
//!
//! Codecs that run on several threads are timed on one, two and four of them, if the machine has as many cores.
//!
//! The mask is synthetic: 1920×1080 pixels, four lights, shadows of discs, one light in four with edges as ragged as
//! those of leaves. The reference is the same mask three pixels earlier. Times of the simplifier include copying the
//! mask.

#![allow(missing_docs, clippy::unwrap_used, reason = "a benchmark may panic")]

use std::{hint::black_box, num::NonZeroUsize};

use criterion::{Criterion, criterion_group, criterion_main};
use gnomon_protocol::{
    codec::{CodecId, Decoder, EncodedFrame, Encoder, Reference, Simplifier},
    ids::FrameNumber,
    mask::{Mask, MaskShape},
};

const WIDTH: i64 = 1920;
const HEIGHT: i64 = 1080;

/// 24 discs a light, moved to the right by `moved` pixels.
fn discs(moved: i64) -> Mask {
    let mut state = 1_u32;
    let mut random = |limit: i64| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        i64::from(state >> 8) % limit
    };
    let mut mask = Mask::new(MaskShape::new(1920, 1080, 4).unwrap());
    mask.words_mut().fill(u64::MAX);
    for light in (0..4).flat_map(|light| [light; 24]) {
        let (x, y, radius) = (random(WIDTH) + moved, random(HEIGHT), 10 + random(150));
        for py in (y - radius).max(0)..(y + radius).min(HEIGHT) {
            for px in (x - radius).max(0)..(x + radius).min(WIDTH) {
                let grain = (((px - moved) * 7919) ^ (py * 104_729)) % 5;
                let ragged = if light == 3 { grain * radius / 20 } else { 0 };
                if (px - x).pow(2) + (py - y).pow(2) < (radius - ragged).pow(2) {
                    mask.set(light, u32::try_from(px).unwrap(), u32::try_from(py).unwrap(), false);
                }
            }
        }
    }
    mask
}

fn codecs(criterion: &mut Criterion) {
    let (before, mask) = (discs(0), discs(3));
    let (mut encoder, mut reference, mut body) =
        (Encoder::new(CodecId::TilesSmall), Reference::new(), EncodedFrame::default());
    encoder.encode(&before, &mut body).unwrap();
    assert!(encoder.keep(FrameNumber(0), &mut reference));
    let plain = CodecId::ALL.into_iter().map(|codec| (codec, None));
    let with_reference = [(CodecId::TilesSmall, Some(&reference))];
    for (codec, reference) in plain.chain(with_reference) {
        let name = if reference.is_some() { format!("{codec} with a reference") } else { codec.to_string() };
        let cores = std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
        for threads in [1, 2, 4].into_iter().filter(|threads| *threads == 1 || (codec.is_sliced() && *threads <= cores))
        {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let name = if codec.is_sliced() { format!("{name}, threads: {threads}") } else { name.clone() };
            let (mut encoder, mut decoder, mut decoded) = (Encoder::new(codec), Decoder::new(), mask.clone());
            criterion.bench_function(&format!("encode/{name}"), |bencher| {
                pool.install(|| {
                    bencher.iter(|| encoder.encode_for(None, reference, black_box(&mask), &mut body).unwrap());
                });
            });
            criterion.bench_function(&format!("decode/{name}"), |bencher| {
                pool.install(|| {
                    bencher.iter(|| decoder.decode_against(reference, black_box(&body), &mut decoded).unwrap());
                });
            });
            assert!(decoded == mask, "{name} changes the mask");
        }
    }
    let (mut simplifier, mut simplified) = (Simplifier::default(), mask.clone());
    for wrong_ppm in [500, 5000] {
        criterion.bench_function(&format!("simplify/{wrong_ppm} wrong in a million"), |bencher| {
            bencher.iter(|| {
                simplified.words_mut().copy_from_slice(mask.words());
                simplifier.simplify(black_box(&mut simplified), wrong_ppm)
            });
        });
    }
    let planes: Vec<u8> = mask.words().iter().flat_map(|word| word.to_le_bytes()).collect();
    let mut compressed = vec![0; lz4_flex::block::get_maximum_output_size(planes.len())];
    let mut length = 0;
    criterion.bench_function("encode/lz4_flex", |bencher| {
        bencher.iter(|| length = lz4_flex::block::compress_into(black_box(&planes), &mut compressed).unwrap());
    });
    let mut decompressed = vec![0; planes.len()];
    criterion.bench_function("decode/lz4_flex", |bencher| {
        bencher.iter(|| lz4_flex::block::decompress_into(black_box(&compressed[..length]), &mut decompressed).unwrap());
    });
    assert_eq!(decompressed, planes);
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(30);
    targets = codecs
}
criterion_main!(benches);
