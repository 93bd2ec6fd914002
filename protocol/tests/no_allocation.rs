//! Once warm, coding a mask, packetizing it and decoding it again allocates nothing.

#![allow(unsafe_code, reason = "counting allocations takes a global allocator, and that trait is unsafe")]
#![allow(clippy::unwrap_used, reason = "helpers outside the test functions use it too")]

use std::{
    alloc::{GlobalAlloc, Layout, System},
    sync::atomic::{AtomicU64, Ordering},
};

use gnomon_protocol::{
    codec::{CodecId, Decoder, EncodedFrame, Encoder},
    frame::Frame,
    ids::FrameNumber,
    mask::{Mask, MaskShape},
    packetizer::Packetizer,
    reassembler::{Policy, Progress, Reassembler},
    references::{KeptMasks, SentMasks},
};

/// The system's allocator, which counts the requests of all threads, since frames are coded on several.
struct Counting;

static COUNT: AtomicU64 = AtomicU64::new(0);

fn count() -> u64 {
    COUNT.load(Ordering::Relaxed)
}

// SAFETY: all calls go to the system's allocator as they are; counting touches no memory of theirs.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller's promises are the same.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promises are the same.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        COUNT.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller's promises are the same.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A mask whose shadow edge moves with `step`, and takes different lengths to code.
fn mask(shape: MaskShape, step: u32) -> Mask {
    let mut mask = Mask::new(shape);
    for light in 0..shape.lights() {
        for (x, y) in (0..shape.height()).flat_map(|y| (0..shape.width()).map(move |x| (x, y))) {
            mask.set(light, x, y, (x + step) % 64 > y % 32 + light);
        }
    }
    mask
}

/// Counts a session's allocations, frame by frame. Its masks repeat every third frame. The body starts with a capacity
/// of `body_bytes`. With `references`, each mask is acknowledged at once.
fn counts(codec: CodecId, shape: MaskShape, references: bool, frames: u32, body_bytes: usize) -> Vec<u64> {
    let masks = [0, 5, 9].map(|step| mask(shape, step));
    let (mut encoder, mut decoder) = (Encoder::new(codec), Decoder::new());
    let (mut sent_masks, mut kept_masks) = (SentMasks::default(), KeptMasks::default());
    let mut packetizer = Packetizer::new(1161);
    let mut reassembler = Reassembler::new(Policy::WholeFrame);
    let (mut body, mut received, mut counts) = (EncodedFrame::with_capacity(body_bytes), Mask::new(shape), Vec::new());
    for (frame, sent) in (0..frames).zip(masks.iter().cycle()) {
        let before = count();
        encoder.encode_for(None, sent_masks.reference(), sent, &mut body).unwrap();
        let mut complete = false;
        for packet in packetizer.packets(FrameNumber(frame), frame, &body).unwrap() {
            complete = reassembler.push(&packet) == Ok(Progress::Complete);
        }
        assert!(complete);
        let body = reassembler.frame().unwrap().body;
        if references {
            let named = Frame::parse(body).unwrap().head.reference;
            assert_eq!(named.is_some(), frame > 0);
            decoder.decode_onto(named.and_then(|name| kept_masks.reference(name)), body, &mut received).unwrap();
            sent_masks.keep(&encoder, FrameNumber(frame));
            sent_masks.acknowledge(kept_masks.keep(&decoder, FrameNumber(frame)).unwrap());
        } else {
            decoder.decode(body, &mut received).unwrap();
        }
        counts.push(count() - before);
        assert!(received == *sent);
    }
    counts
}

/// One test for all, because the harness allocates when one test ends beside another. In one pool, because rayon's
/// queue for outside work allocates now and then.
#[test]
fn a_warm_session_takes_no_memory() {
    let few_tiles = MaskShape::new(333, 222, 4).unwrap();
    let shared_out = MaskShape::new(1280, 720, 3).unwrap();
    rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap().install(|| {
        for codec in CodecId::ALL {
            // Warm once all masks have been seen. The first frame shows that counting works.
            let counts = counts(codec, few_tiles, false, 12, 0);
            assert!(counts[0] > 0, "{codec}: {counts:?}");
            assert_eq!(counts[3..], [0; 9], "{codec}: {counts:?}");
        }
        let references = counts(CodecId::TilesSmall, few_tiles, true, 24, 0);
        assert!(references[0] > 0, "{references:?}");
        assert_eq!(references[8..], [0; 16], "{references:?}");
        let shared = counts(CodecId::TilesSmall, shared_out, true, 24, 1 << 20);
        assert_eq!(shared[12..], [0; 12], "{shared:?}");
    });
}
