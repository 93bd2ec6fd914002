//! The fuzz targets' entry points on the stable toolchain: noise, valid inputs, and damaged ones. Seeded, so that
//! failures repeat. `make fuzz` runs the targets themselves (see `tests/fuzz`).

#![allow(clippy::unwrap_used, reason = "helpers outside the test functions use it too")]

mod common;

use std::num::NonZeroU16;

use gnomon_protocol::{
    acknowledgement::Acknowledgement,
    codec::{CodecId, EncodedFrame, Encoder, ReferenceName},
    edit::{Edit, LightEdit, NodeEdit},
    fuzzing,
    header::PacketHeader,
    ids::{FrameNumber, ResumeToken, SceneDigest, SessionId},
    mask::{Mask, MaskShape},
    message::{self, ClientMessage, Edited, Hello, Refusal, ServerMessage, Welcome},
    pose::{Pose, encode_pose_packet},
    text::PeerText,
};

use crate::common::Random;

/// Runs noise, the seeds, and damaged seeds, `rounds` of each. With `GNOMON_FUZZ_SEEDS=FOLDER` the seeds are also
/// written there, for the targets.
#[expect(clippy::unwrap_used, reason = "a test's helper")]
fn drive(entry: fn(&[u8]), seeds: &[Vec<u8>], rounds: u32) {
    let mut random = Random(1);
    if let Some(folder) = std::env::var_os("GNOMON_FUZZ_SEEDS") {
        // A test is named like its target.
        let folder = std::path::Path::new(&folder).join(std::thread::current().name().unwrap());
        std::fs::create_dir_all(&folder).unwrap();
        for (index, seed) in seeds.iter().enumerate() {
            std::fs::write(folder.join(index.to_string()), seed).unwrap();
        }
    }
    for seed in seeds {
        entry(seed);
        // Every prefix, up to 300.
        (0..seed.len().min(300)).for_each(|length| entry(&seed[..length]));
    }
    for _ in 0..rounds {
        let length = random.index(200);
        let noise: Vec<u8> = (0..length).map(|_| random.byte()).collect();
        entry(&noise);
        entry(&damaged(seeds, &mut random));
    }
}

/// A seed with one to four changes: bits, bytes, lengths, or a part of another seed.
fn damaged(seeds: &[Vec<u8>], random: &mut Random) -> Vec<u8> {
    let pick = |random: &mut Random| &seeds[random.index(seeds.len())];
    let mut bytes = pick(random).clone();
    for _ in 0..=random.below(3) {
        let place = random.index(bytes.len() + 1);
        match random.below(6) {
            0 => bytes.truncate(place),
            1 => bytes.insert(place, random.byte()),
            2 => bytes.extend((0..random.below(9)).map(|_| 0xFF)),
            3 => {
                let other = pick(random);
                bytes.truncate(place);
                bytes.extend_from_slice(&other[random.index(other.len() + 1)..]);
            }
            kind => {
                if let Some(byte) = bytes.get_mut(place) {
                    *byte = if kind == 4 { *byte ^ (1 << random.below(8)) } else { random.byte() };
                }
            }
        }
    }
    bytes
}

#[test]
fn header() {
    let full = PacketHeader {
        sequence: 7,
        frame: Some(FrameNumber(3)),
        data_bytes: 4,
        frame_packets: NonZeroU16::new(2),
        first: true,
        timestamp_ms: Some(99),
    };
    let empty = PacketHeader { frame: None, data_bytes: 0, frame_packets: None, timestamp_ms: None, ..full };
    let seeds = [[&full.encode()[..], b"data"].concat(), empty.encode().to_vec()];
    drive(fuzzing::header, &seeds, 20_000);
}

#[test]
fn pose() {
    let pose = Pose {
        position_m: [1.0, 2.0, -3.0],
        orientation: [0.0, 0.0, 0.0, 1.0],
        yfov_rad: 1.0,
        scene_time_s: 0.0,
        client_time_ms: 5,
        mask_px: [64, 36],
        look_ahead_ms: 0,
        revision: 0,
    };
    let seeds = [pose.encode().to_vec(), encode_pose_packet(1, FrameNumber(2), &pose).to_vec()];
    drive(fuzzing::pose, &seeds, 20_000);
}

#[test]
fn message() {
    let text = || PeerText::from("a reason");
    let (codec, resume) = (CodecId::PlanesLz4, Some(ResumeToken([9; 16])));
    let (width, height, rate_hz, wrong_ppm) = (1920, 1080, 60, 500);
    let hello = Hello {
        version: 1,
        token: Some("a token".into()),
        client: text(),
        width,
        height,
        codec,
        rate_hz,
        wrong_ppm,
        resume,
    };
    let welcome = Welcome {
        session: SessionId(u64::MAX),
        scene_digest: SceneDigest([7; 32]),
        scene_bytes: 1 << 29,
        lights: 4,
        backend: text(),
        data_port: Some(4433),
        resume: ResumeToken([7; 16]),
        may_edit: true,
        shared_world: true,
        revision: 1 << 20,
    };
    let node = NodeEdit {
        node: 3,
        translation_m: Some([1.0, 2.0, f64::NAN]),
        rotation: Some([0.0, 0.0, 0.0, 1.0]),
        scale: Some([1.0; 3]),
        shown: Some(true),
    };
    let light = LightEdit {
        light: 1,
        position_m: Some([1e9; 3]),
        direction: Some([0.0, 1.0, 0.0]),
        color: Some([1.0; 3]),
        intensity: Some(3.0),
        range_m: Some(f32::INFINITY),
        cone_rad: Some([0.1, 0.2]),
    };
    let edits = vec![Edit::Node(node), Edit::Light(light), Edit::Light(LightEdit::default())];
    let client = [
        ClientMessage::Hello(hello),
        ClientMessage::FetchScene { offset: 1 << 40 },
        ClientMessage::Start,
        ClientMessage::Ping(300),
        ClientMessage::Bye,
        ClientMessage::Edit { number: 7, edits: edits.clone() },
    ];
    let server = [
        ServerMessage::Welcome(welcome),
        ServerMessage::Refused(Refusal::Version { server: 1, client: 2 }),
        ServerMessage::Refused(Refusal::Full { sessions: 8, retry_after_ms: 1000 }),
        ServerMessage::Refused(Refusal::Unsupported(text())),
        ServerMessage::Refused(Refusal::Busy { reason: text(), retry_after_ms: 1000 }),
        ServerMessage::SceneChunk { offset: 65_536, bytes: vec![1; 100] },
        ServerMessage::Pong(300),
        ServerMessage::Draining { reason: text(), deadline_ms: 5000, alternative: Some(text()) },
        ServerMessage::Closing { reason: text(), may_return: false },
        ServerMessage::Edited(Edited { revision: 5, yours: Some(7), whole: false, edits }),
        ServerMessage::EditRefused { number: 7, reason: text() },
        ServerMessage::Clock(1 << 40),
    ];
    let encoded = client.iter().map(message::encode).chain(server.iter().map(message::encode));
    let seeds: Vec<_> = encoded.map(|bytes| bytes.unwrap()[4..].to_vec()).collect();
    drive(fuzzing::message, &seeds, 20_000);
}

#[test]
fn codec() {
    let mut seeds = Vec::new();
    for (width, height, lights) in [(1, 1, 1), (8, 8, 3), (37, 21, 2), (64, 40, 9)] {
        let mut mask = Mask::new(MaskShape::new(width, height, lights).unwrap());
        for light in 0..lights {
            for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
                mask.set(light, x, y, x * 3 > y * (light + 1));
            }
        }
        for codec in CodecId::ALL {
            for slices in [1, 3] {
                let mut body = EncodedFrame::default();
                Encoder::with_slices(codec, NonZeroU16::new(slices).unwrap()).encode(&mask, &mut body).unwrap();
                seeds.push(body.into_body());
            }
        }
    }
    drive(fuzzing::codec, &seeds, 4_000);
}

#[test]
fn slices() {
    let mut random = Random(4);
    let seeds: Vec<Vec<u8>> =
        (0..40).map(|pick| [vec![pick, pick / 5], (0..200).map(|_| random.byte()).collect()].concat()).collect();
    drive(fuzzing::slices, &seeds, 4_000);
}

#[test]
fn moved() {
    let mut random = Random(3);
    let seeds: Vec<Vec<u8>> =
        (0..40).map(|pick| [vec![pick], (0..4000).map(|_| random.byte()).collect()].concat()).collect();
    drive(fuzzing::moved, &seeds, 4_000);
}

#[test]
fn acknowledgement() {
    let mask = Some(ReferenceName { frame: FrameNumber(9), digest: 0xFEED });
    let seeds = [mask, None].map(|mask| Acknowledgement { sequence: 3, mask }.encode().to_vec());
    drive(fuzzing::acknowledgement, &seeds, 20_000);
}

#[test]
fn reassembler() {
    let mut random = Random(2);
    let in_order = || (0..16u8).flat_map(|frame| (0..7).map(move |packet| frame << 4 | packet));
    // All packets; nine in ten; some swapped; some damaged.
    let all: Vec<u8> = in_order().flat_map(|name| [0x80, name]).collect();
    let some: Vec<u8> = in_order().filter(|_| random.below(10) > 0).flat_map(|name| [0x80, name]).collect();
    let mut mixed: Vec<u8> = in_order().collect();
    for _ in 0..8 {
        let place = random.index(mixed.len() - 1);
        mixed.swap(place, place + 1);
    }
    let mixed = mixed.into_iter().flat_map(|name| [0x80, name]).collect();
    let bent = in_order().flat_map(|name| [if random.below(9) > 0 { 0x80 } else { random.byte() | 0x80 }, name]);
    let bent: Vec<u8> = bent.collect();
    drive(fuzzing::reassembler, &[all, some, mixed, bent], 10_000);
}

#[test]
fn parity() {
    // Some packets missing, with honest and with altered parity, and everything twice.
    let seeds = [
        [
            &[0x3A][..],
            &[0, 0, 0, 2, 0, 0, 3, 0, 0, 4, 0, 0, 5, 0, 0, 7, 0, 0, 8, 0, 0, 9, 0, 0, 11, 0, 0, 12, 0, 0, 13, 0, 0],
        ]
        .concat(),
        [&[0x20][..], &[1, 16, 3, 2, 0, 1, 0, 0, 0]].concat(),
        [&[0x11][..], &[2, 18, 4, 2, 20, 9, 1, 0, 0, 0, 0, 0]].concat(),
    ];
    drive(fuzzing::parity, &seeds, 20_000);
}
