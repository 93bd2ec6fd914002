//! Once warm, a frame's way from mask to packets and back to a mask takes no memory.

#![allow(unsafe_code, reason = "counting allocations takes a global allocator, and that trait is unsafe")]

use std::{
    alloc::{GlobalAlloc, Layout, System},
    sync::{
        Mutex,
        atomic::{AtomicU64, Ordering},
    },
};

use gnomon_protocol::{
    codec::{CodecId, Decoder, Encoder},
    frame::Frame,
    ids::FrameNumber,
    mask::{Mask, MaskShape},
    packetizer::Packetizer,
    reassembler::{Policy, Progress, Reassembler},
    references::{KeptMasks, SentMasks},
};

/// The system's allocator, counting what it is asked for by any thread, since frames are coded on several.
struct Counting;

static COUNT: AtomicU64 = AtomicU64::new(0);

/// One test at a time, so that none counts what another takes.
static TURN: Mutex<()> = Mutex::new(());

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

#[test]
fn a_warm_session_with_references_takes_no_memory() {
    let _turn = TURN.lock();
    let shape = MaskShape::new(333, 222, 4).unwrap();
    let masks = [0, 5, 9].map(|step| mask(shape, step));
    let (mut encoder, mut decoder) = (Encoder::new(CodecId::TilesSmall), Decoder::new());
    let (mut sent_masks, mut kept_masks) = (SentMasks::default(), KeptMasks::default());
    let (mut body, mut received, mut counts) = (Vec::new(), Mask::new(shape), Vec::new());
    for frame in 0..24 {
        let sent = &masks[frame as usize % 3];
        let before = count();
        encoder.encode_for(None, sent_masks.reference(), sent, &mut body).unwrap();
        sent_masks.keep(&encoder, FrameNumber(frame));
        let named = Frame::parse(&body).unwrap().head.reference;
        assert_eq!(named.is_some(), frame > 0);
        let reference = named.and_then(|name| kept_masks.reference(name));
        decoder.decode_onto(reference, &body, &mut received).unwrap();
        sent_masks.acknowledge(kept_masks.keep(&decoder, FrameNumber(frame)).unwrap());
        counts.push(count() - before);
        assert!(received == *sent);
    }
    assert!(counts[0] > 0, "{counts:?}");
    assert_eq!(counts[8..], [0; 16], "{counts:?}");
}

#[test]
fn a_warm_session_takes_no_memory() {
    let _turn = TURN.lock();
    let shape = MaskShape::new(333, 222, 4).unwrap();
    let masks = [0, 5, 9].map(|step| mask(shape, step));
    for codec in CodecId::ALL {
        let (mut encoder, mut decoder) = (Encoder::new(codec), Decoder::new());
        let mut packetizer = Packetizer::new(1161);
        let mut reassembler = Reassembler::new(Policy::WholeFrame);
        let (mut body, mut received) = (Vec::new(), Mask::new(shape));
        let mut counts = Vec::new();
        for frame in 0..12 {
            let sent = &masks[frame as usize % 3];
            let before = count();
            encoder.encode(sent, &mut body).unwrap();
            let mut complete = false;
            for packet in packetizer.packets(FrameNumber(frame), frame, &body).unwrap() {
                complete = reassembler.push(&packet) == Ok(Progress::Complete);
            }
            assert!(complete);
            decoder.decode(reassembler.frame().unwrap().body, &mut received).unwrap();
            counts.push(count() - before);
            assert!(received == *sent);
        }
        // Warm after all masks have been seen once; that counting works, the first frame shows.
        assert!(counts[0] > 0, "{codec}: {counts:?}");
        assert_eq!(counts[3..], [0; 9], "{codec}: {counts:?}");
    }
}

/// Within the pool: rayon's queue of what comes from outside takes memory of its own now and then.
#[test]
fn a_warm_session_whose_frames_are_shared_out_to_cores_takes_no_memory() {
    let _turn = TURN.lock();
    let shape = MaskShape::new(1280, 720, 3).unwrap();
    let masks = [0, 5, 9].map(|step| mask(shape, step));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
    let counts = pool.install(|| {
        let (mut encoder, mut decoder) = (Encoder::new(CodecId::TilesSmall), Decoder::new());
        let (mut sent_masks, mut kept_masks) = (SentMasks::default(), KeptMasks::default());
        let (mut body, mut received, mut counts) = (Vec::with_capacity(1 << 20), Mask::new(shape), Vec::new());
        for frame in 0..24 {
            let sent = &masks[frame as usize % 3];
            let before = count();
            encoder.encode_for(None, sent_masks.reference(), sent, &mut body).unwrap();
            sent_masks.keep(&encoder, FrameNumber(frame));
            let named = Frame::parse(&body).unwrap().head.reference;
            let reference = named.and_then(|name| kept_masks.reference(name));
            decoder.decode_onto(reference, &body, &mut received).unwrap();
            sent_masks.acknowledge(kept_masks.keep(&decoder, FrameNumber(frame)).unwrap());
            counts.push(count() - before);
            assert!(received == *sent);
        }
        counts
    });
    assert_eq!(counts[12..], [0; 12], "{counts:?}");
}
