//! Slices coded against a mask that both ends have: masks round-trip bit by bit, never against a wrong reference, and
//! whatever is lost, the ends agree again.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers outside the test functions use these too")]

mod common;

use std::collections::VecDeque;

use gnomon_protocol::{
    acknowledgement::Acknowledgement,
    codec::{CodecId, DecodeError, Decoder, EncodedFrame, Encoder, Reference},
    frame::Frame,
    ids::FrameNumber,
    limits::{MAX_PACKET_BYTES, MAX_REFERENCE_BYTES, MAX_REFERENCES},
    mask::{Mask, MaskShape},
    references::{KeptMasks, SentMasks},
};
use proptest::prelude::*;

use crate::common::Random;

/// Discs of shadow in a different place for each light, all moved by `moved` pixels; `noise` pixels of 256 are flipped.
fn mask(shape: MaskShape, seed: u64, moved: (i64, i64), noise: u64) -> Mask {
    let (mut places, mut grain) = (Random(seed), Random(seed ^ 77));
    let mut mask = Mask::new(shape);
    for light in 0..shape.lights() {
        let discs: Vec<[i64; 3]> = (0..3)
            .map(|_| [shape.width(), shape.height(), 40].map(|side| i64::try_from(places.below(side.into())).unwrap()))
            .collect();
        for (x, y) in (0..shape.height()).flat_map(|y| (0..shape.width()).map(move |x| (x, y))) {
            let at = (i64::from(x) - moved.0, i64::from(y) - moved.1);
            let dark = discs.iter().any(|[cx, cy, r]| (at.0 - cx).pow(2) + (at.1 - cy).pow(2) < r * r);
            mask.set(light, x, y, !dark ^ (noise > 0 && grain.below(256) < noise));
        }
    }
    mask
}

/// Returns the reference that a client with the whole frame keeps.
fn reference(mask: &Mask, frame: u32) -> Reference {
    let (mut encoder, mut reference) = (Encoder::new(CodecId::TilesSmall), Reference::new());
    encoder.encode(mask, &mut EncodedFrame::default()).unwrap();
    assert!(encoder.keep(FrameNumber(frame), &mut reference));
    reference
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_mask_comes_back_bit_by_bit_from_its_reference(
        (width, height, lights) in (1u32..=300, 1u32..=90, 1u32..=6),
        moved in (-20i64..20, -9i64..9),
        noise in prop_oneof![Just(0u64), Just(3), Just(128)],
        other in any::<bool>(),
        seed in any::<u64>(),
        packet_bytes in prop_oneof![Just(0usize), Just(MAX_PACKET_BYTES), Just(60_000)],
    ) {
        let shape = MaskShape::new(width, height, lights).unwrap();
        let before = reference(&mask(shape, seed, (0, 0), 0), 7);
        let sent = mask(shape, seed ^ u64::from(other), moved, noise);
        let (mut decoder, mut body, mut random) = (Decoder::new(), EncodedFrame::default(), Random(seed));
        let mut encoder = Encoder::new(CodecId::TilesSmall).for_packets_of(packet_bytes);
        encoder.encode_for(None, Some(&before), &sent, &mut body).unwrap();
        prop_assert_eq!(Frame::parse(&body).unwrap().head.reference, Some(before.name()));
        let mut received = Mask::new(MaskShape::new(9, 17, 2).unwrap());
        prop_assert_eq!(decoder.decode_against(Some(&before), &body, &mut received).unwrap(), CodecId::TilesSmall);
        prop_assert!(received == sent);
        // Both ends then hold the same, even beyond the picture's edge.
        let (mut ours, mut theirs) = (Reference::new(), Reference::new());
        prop_assert!(encoder.keep(FrameNumber(8), &mut ours) && decoder.keep(FrameNumber(8), &mut theirs));
        prop_assert!(ours == theirs);

        // A block of noise takes up to 1 KiB, and is never split.
        let room = packet_bytes.max(1024 + 64);
        let mut parts: Vec<&[u8]> = body.payloads(room).collect();
        prop_assert!(parts.iter().all(|part| part.len() <= room && Frame::parts(part).count() == 1));
        (1..parts.len()).for_each(|place| parts.swap(place, random.index(place + 1)));
        let mut received = mask(shape, seed ^ 3, (0, 0), 9);
        for part in &parts {
            let old = received.clone();
            decoder.decode_onto(Some(&before), part, &mut received).unwrap();
            prop_assert!(parts.len() == 1 || !decoder.keep(FrameNumber(8), &mut theirs));
            let mut places = old.words().iter().zip(received.words()).zip(sent.words());
            prop_assert!(places.all(|((old, new), sent)| new == old || new == sent));
        }
        prop_assert!(received == sent);
    }

    /// Poses go up and masks come down, late. Packets and acknowledgements are lost, repeated and reordered.
    #[test]
    fn the_ends_agree_whatever_is_lost(
        seed in any::<u64>(),
        late in 0usize..30,
        (lost, repeated, reordered) in (0u64..50, 0u64..20, 0u64..30),
    ) {
        let mut random = Random(seed);
        let (mut server, mut client) = (Server::new(), Client::new());
        let mut up: VecDeque<Vec<Acknowledgement>> = VecDeque::new();
        let mut down = VecDeque::new();
        for frame in 0..80u32 {
            // The shape changes once.
            let shape = MaskShape::new(if frame < 40 { 200 } else { 130 }, 40, 2).unwrap();
            let sent = mask(shape, 5, (i64::from(frame), 0), 2);
            let body = server.send(frame, &sent);
            down.push_back((frame, sent, body));
            if down.len() > late {
                let (frame, sent, body) = down.pop_front().unwrap();
                let parts: Vec<_> =
                    body.payloads(Server::PACKET_BYTES).filter(|_| random.below(100) >= lost).collect();
                if !parts.is_empty() {
                    up.push_back(client.receive(frame, &sent, &parts.concat()).into_iter().collect());
                }
            }
            if up.len() > late {
                let said = up.pop_front().unwrap();
                if random.below(100) < reordered && let Some(next) = up.front_mut() {
                    next.extend(said);
                } else if random.below(100) >= lost {
                    for heard in said {
                        let times = 1 + u8::from(random.below(100) < repeated);
                        (0..times).for_each(|_| server.references.acknowledge(heard));
                    }
                }
            }
        }
    }
}

/// Without loss, all frames after the first acknowledgement are coded with a reference.
#[test]
fn references_are_used_as_soon_as_they_are_known() {
    for late in 0..=4 {
        let frames = converse(80, late, 40, |_| false);
        for (number, frame) in frames.iter().enumerate() {
            assert_eq!(frame.has_reference, number % 40 > 2 * late, "frame {number}, {late} late");
            assert!(frame.was_shown, "frame {number}, {late} late");
        }
    }
}

/// If more frames are in flight than are kept, some are still coded with a reference.
#[test]
fn references_are_used_over_long_round_trips() {
    for late in 5..=12 {
        let frames = converse(40, late, u32::MAX, |_| false);
        let used = frames.iter().filter(|frame| frame.has_reference).count();
        assert!(used > 5 && frames.iter().all(|frame| frame.was_shown), "{used} of {}, {late} late", frames.len());
    }
}

/// Acknowledgements held up for long fill the client's memory. It continues with what it has, starts over if that
/// lasts, and afterwards agrees with the server again.
#[test]
fn the_ends_agree_again_after_delayed_acknowledgements() {
    for (late, held_up) in (0..=4).flat_map(|late| [2, 16, 40, 70, 100, 150].map(|held_up| (late, held_up))) {
        let begins = 10 + 2 * u32::try_from(late).unwrap();
        let ends = begins + held_up;
        let frames = converse(ends + 120, late, u32::MAX, |frame| (begins..ends).contains(&frame));
        let lost = frames.iter().filter(|frame| !frame.was_shown).count();
        // It keeps 16 masks, and names the newest for another 64 frames. After that, frames coded against its old masks
        // are useless until the server has heard that it started over.
        let most = (held_up as usize).saturating_sub(70) + 2 * late + 1;
        assert!(lost <= most && (held_up > 2 || lost == 0), "{lost} lost, {late} late, held up for {held_up}");
        assert!(held_up < 100 || lost > 0, "it never began anew, {late} late, held up for {held_up}");
        let last = &frames[frames.len() - 20..];
        assert!(last.iter().all(|frame| frame.has_reference && frame.was_shown), "{late} late, held up for {held_up}");
    }
}

struct Outcome {
    has_reference: bool,
    was_shown: bool,
}

/// Frames and acknowledgements each arrive `late` frames late, and none is lost. Acknowledgements wait while
/// `are_held_up` is true. From frame `new_shape` on, masks have another shape.
fn converse(frames: u32, late: usize, new_shape: u32, are_held_up: impl Fn(u32) -> bool) -> Vec<Outcome> {
    let (mut server, mut client) = (Server::new(), Client::new());
    let (mut down, mut up) = (VecDeque::new(), VecDeque::new());
    let mut outcomes = Vec::new();
    for frame in 0..frames {
        let shape = MaskShape::new(if frame < new_shape { 100 } else { 70 }, 20, 2).unwrap();
        let sent = mask(shape, 5, (i64::from(frame), 0), 2);
        let body = server.send(frame, &sent);
        outcomes
            .push(Outcome { has_reference: Frame::parse(&body).unwrap().head.reference.is_some(), was_shown: true });
        down.push_back((frame, sent, body));
        if down.len() > late {
            let (frame, sent, body) = down.pop_front().unwrap();
            up.extend(client.receive(frame, &sent, &body));
            outcomes[frame as usize].was_shown = client.shown == sent;
        }
        while up.len() > late && !are_held_up(frame) {
            server.references.acknowledge(up.pop_front().unwrap());
        }
    }
    outcomes
}

struct Server {
    encoder: Encoder,
    references: SentMasks,
}

impl Server {
    const PACKET_BYTES: usize = 1200;

    fn new() -> Self {
        Self { encoder: Encoder::new(CodecId::TilesSmall).for_packets_of(300), references: SentMasks::default() }
    }

    fn send(&mut self, frame: u32, mask: &Mask) -> EncodedFrame {
        let mut body = EncodedFrame::default();
        self.encoder.encode_for(None, self.references.reference(), mask, &mut body).unwrap();
        self.references.keep(&self.encoder, FrameNumber(frame));
        assert!(self.references.memory_bytes() <= MAX_REFERENCE_BYTES + MAX_REFERENCE_BYTES / MAX_REFERENCES * 4);
        body
    }
}

struct Client {
    decoder: Decoder,
    references: KeptMasks,
    shown: Mask,
}

impl Client {
    fn new() -> Self {
        let shown = Mask::new(MaskShape::new(1, 1, 1).unwrap());
        Self { decoder: Decoder::new(), references: KeptMasks::default(), shown }
    }

    /// Every arrived tile must be as sent; a frame whose reference is missing must change nothing.
    fn receive(&mut self, frame: u32, sent: &Mask, body: &[u8]) -> Option<Acknowledgement> {
        let head = Frame::parse(body).unwrap().head;
        if self.shown.shape() != sent.shape() {
            self.shown.reset(sent.shape());
        }
        let before = self.shown.clone();
        let reference = head.reference.and_then(|name| self.references.reference(name));
        match self.decoder.decode_onto(reference, body, &mut self.shown) {
            Ok(_) => {
                let mut places = before.words().iter().zip(self.shown.words()).zip(sent.words());
                assert!(places.all(|((old, new), sent)| new == old || new == sent));
                let said = self.references.keep(&self.decoder, FrameNumber(frame));
                let this = said.is_some_and(|said| said.mask.is_some_and(|name| name.frame.0 == frame));
                assert!(!this || self.shown == *sent);
                said
            }
            Err(DecodeError::Reference(name)) => {
                assert_eq!((Some(name), &self.shown), (head.reference, &before));
                Some(self.references.lose())
            }
            Err(error) => panic!("{error}"),
        }
    }
}

#[test]
fn moved_content_costs_next_to_nothing() {
    let shape = MaskShape::new(1280, 720, 3).unwrap();
    // Grains of 3×3 pixels, one in three dark: only the previous mask predicts the next.
    let grains = |moved: (u32, u32)| {
        let mut mask = Mask::new(shape);
        for light in 0..3 {
            for (x, y) in (0..720).flat_map(|y| (0..1280).map(move |x| (x, y))) {
                let grain = u64::from((x + moved.0) / 3) << 40 | u64::from((y + moved.1) / 3) << 8 | u64::from(light);
                mask.set(light, x, y, Random(grain).below(3) > 0);
            }
        }
        mask
    };
    let (before, sent) = (reference(&grains((0, 40)), 1), grains((13, 36)));
    let (mut alone, mut with) = (EncodedFrame::default(), EncodedFrame::default());
    let mut encoder = Encoder::new(CodecId::TilesSmall);
    encoder.encode(&sent, &mut alone).unwrap();
    encoder.encode_for(None, Some(&before), &sent, &mut with).unwrap();
    assert!(with.len() * 10 < alone.len(), "{} bytes, without a reference {}", with.len(), alone.len());
}

#[test]
fn nothing_is_decoded_against_a_wrong_reference() {
    let shape = MaskShape::new(200, 90, 3).unwrap();
    let (right, sent) = (mask(shape, 1, (0, 0), 0), mask(shape, 1, (4, 1), 3));
    let mut wrong = right.clone();
    wrong.set(2, 199, 89, !wrong.get(2, 199, 89));
    let (mut body, mut decoder) = (EncodedFrame::default(), Decoder::new());
    let known = reference(&right, 7);
    // A reference with one bit changed, of another frame, of another shape, and none.
    let smaller = MaskShape::new(200, 89, 3).unwrap();
    let others = [reference(&wrong, 7), reference(&right, 6), reference(&mask(smaller, 1, (0, 0), 0), 7)];
    Encoder::new(CodecId::TilesSmall).encode_for(None, Some(&known), &sent, &mut body).unwrap();
    for planted in others.iter().map(Some).chain([None]) {
        let before = mask(shape, 9, (0, 0), 0);
        let mut received = before.clone();
        let onto = decoder.decode_onto(planted, &body, &mut received);
        assert!(matches!(onto, Err(DecodeError::Reference(name)) if name == known.name()), "{planted:?}: {onto:?}");
        let whole = decoder.decode_against(planted, &body, &mut received);
        assert!(matches!(whole, Err(DecodeError::Reference(name)) if name == known.name()), "{planted:?}: {whole:?}");
        assert!(received == before && !decoder.keep(FrameNumber(8), &mut Reference::new()));
    }
    let mut received = Mask::new(shape);
    decoder.decode_onto(Some(&known), &body, &mut received).unwrap();
    assert!(received == sent);
    // With a mask of another shape, a frame is coded without reference.
    Encoder::new(CodecId::TilesSmall).encode_for(None, Some(&others[2]), &sent, &mut body).unwrap();
    assert_eq!(Frame::parse(&body).unwrap().head.reference, None);
    // So is one in a codec without references, and nothing of it is kept.
    let mut fast = Encoder::new(CodecId::TilesFast);
    fast.encode_for(None, Some(&known), &sent, &mut body).unwrap();
    assert_eq!(Frame::parse(&body).unwrap().head.reference, None);
    decoder.decode(&body, &mut Mask::new(shape)).unwrap();
    assert!(!fast.keep(FrameNumber(8), &mut Reference::new()) && !decoder.keep(FrameNumber(8), &mut Reference::new()));
}

#[test]
fn a_client_without_its_reference_gets_independent_slices_at_once() {
    let shape = MaskShape::new(100, 40, 2).unwrap();
    let (mut server, mut client) = (Server::new(), Client::new());
    let frame = |number: u32| mask(shape, 3, (i64::from(number), 0), 1);
    let reference_of = |body: &[u8]| Frame::parse(body).unwrap().head.reference.map(|name| name.frame.0);
    let first = server.send(0, &frame(0));
    assert_eq!(reference_of(&first), None);
    let said = client.receive(0, &frame(0), &first).unwrap();
    server.references.acknowledge(said);
    let second = server.send(1, &frame(1));
    assert_eq!(reference_of(&second), Some(0));
    // The client starts over, and an old acknowledgement arrives late.
    client.references.lose();
    let lost = client.receive(1, &frame(1), &second).unwrap();
    assert_eq!(lost.mask, None);
    server.references.acknowledge(lost);
    server.references.acknowledge(said);
    let third = server.send(2, &frame(2));
    assert_eq!(reference_of(&third), None);
    let said = client.receive(2, &frame(2), &third).unwrap();
    server.references.acknowledge(said);
    assert_eq!(reference_of(&server.send(3, &frame(3))), Some(2));
    // A frame that was never sent is no reference.
    let made_up = Acknowledgement { sequence: said.sequence + 1, mask: Some(reference(&frame(9), 3).name()) };
    server.references.acknowledge(made_up);
    assert_eq!(reference_of(&server.send(4, &frame(4))), Some(2));
}
