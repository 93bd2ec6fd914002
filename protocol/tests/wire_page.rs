//! `docs/wire.md` says what the code does: its examples are the encoder's bytes, its limits the code's.
#![allow(clippy::unwrap_used, reason = "helpers outside the test functions use these too")]

use std::{collections::BTreeMap, num::NonZeroU16};

use gnomon_protocol::{
    PROTOCOL_VERSION,
    codec::{CodecId, EncodedFrame, Encoder},
    edit::{Edit, LightEdit, NodeEdit},
    ids::{FrameNumber, ResumeToken, SceneDigest, SessionId},
    limits,
    loss::{LossFeedback, LossTotals},
    mask::{Mask, MaskShape},
    message::{self, ClientMessage, Edited, Hello, ServerMessage, Welcome},
    packetizer::Packetizer,
    pose::{Pose, encode_pose_packet},
};

const PAGE: &str = include_str!("../docs/wire.md");

/// The page's blocks of hexadecimal digits by name. On each line a comment follows after three spaces, or after the
/// digits' column.
fn examples() -> BTreeMap<&'static str, Vec<u8>> {
    let mut examples = BTreeMap::new();
    let mut lines = PAGE.lines();
    while let Some(line) = lines.next() {
        let Some(name) = line.strip_prefix("```hex ") else { continue };
        let mut bytes = Vec::new();
        for line in lines.by_ref().take_while(|line| *line != "```") {
            let digits = line.split(' ').take_while(|word| {
                word.len().is_multiple_of(2) && !word.is_empty() && word.bytes().all(|byte| byte.is_ascii_hexdigit())
            });
            for word in digits {
                bytes.extend((0..word.len()).step_by(2).map(|at| u8::from_str_radix(&word[at..at + 2], 16).unwrap()));
            }
        }
        assert_eq!(examples.insert(name, bytes), None, "{name} is there twice");
    }
    examples
}

#[test]
fn examples_are_what_the_encoder_makes() {
    let hello = Hello {
        version: PROTOCOL_VERSION,
        token: Some("key".into()),
        client: "c/1".into(),
        width: 1920,
        height: 1080,
        codec: CodecId::PlanesLz4,
        rate_hz: 300,
        wrong_ppm: 500,
        resume: Some(ResumeToken([0xA5; 16])),
    };
    let welcome = Welcome {
        session: SessionId(1),
        scene_digest: SceneDigest(std::array::from_fn(|place| u8::try_from(place).unwrap())),
        scene_bytes: 65_536,
        lights: 4,
        backend: "cpu".into(),
        data_port: None,
        resume: ResumeToken([0x5A; 16]),
        may_edit: true,
        shared_world: false,
        revision: 0,
    };
    let edit = ClientMessage::Edit {
        number: 5,
        edits: vec![
            Edit::Node(NodeEdit { node: 3, translation_m: Some([1.0, -2.0, 0.5]), ..NodeEdit::default() }),
            Edit::Light(LightEdit { light: 2, intensity: Some(0.0), ..LightEdit::default() }),
        ],
    };
    let edited = Edited { revision: 9, yours: Some(5), whole: false, edits: Vec::new() };
    let pose = Pose {
        position_m: [1.0, -2.0, 0.5],
        orientation: [0.0, 0.6, -0.0, 0.8],
        yfov_rad: 1.0,
        scene_time_s: 4.0,
        client_time_ms: 0x0102_0304,
        mask_px: [1920, 1080],
        look_ahead_ms: 258,
        revision: 9,
    };
    let losses = LossFeedback { sequence: 2, totals: LossTotals { expected: 1000, lost: 10, runs: 4 } };
    let mut mask = Mask::new(MaskShape::new(2, 2, 1).unwrap());
    mask.set(0, 1, 0, true);
    mask.set(0, 0, 1, true);
    let mut body = EncodedFrame::default();
    Encoder::with_slices(CodecId::PlanesLz4, NonZeroU16::MIN).encode(&mask, &mut body).unwrap();
    let mut packetizer = Packetizer::new(limits::MAX_PACKET_BYTES);
    let packets: Vec<_> = packetizer.packets(FrameNumber(3), 16, &body).unwrap().collect();
    assert_eq!(packets.len(), 1);
    let expected = BTreeMap::from([
        ("hello", message::encode(&ClientMessage::Hello(hello)).unwrap()),
        ("welcome", message::encode(&ServerMessage::Welcome(welcome)).unwrap()),
        ("edit", message::encode(&edit).unwrap()),
        ("edited", message::encode(&ServerMessage::Edited(edited)).unwrap()),
        ("pose", encode_pose_packet(7, FrameNumber(2571), &pose).to_vec()),
        ("loss-report", losses.encode().to_vec()),
        ("frame", packets[0].to_vec()),
    ]);
    assert_eq!(examples(), expected);
}

#[test]
fn limits_and_version_are_the_codes() {
    assert!(PAGE.contains(&format!("The version is {PROTOCOL_VERSION}.")));
    let stated: BTreeMap<_, u64> = (PAGE.lines())
        .filter_map(|line| {
            let mut cells = line.split('|').map(str::trim).skip(1);
            let name = cells.next()?.strip_prefix('`')?.strip_suffix('`')?;
            Some((name, cells.next()?.parse().ok()?))
        })
        .collect();
    let expected = BTreeMap::from([
        ("MAX_PACKET_BYTES", limits::MAX_PACKET_BYTES as u64),
        ("MAX_MESSAGE_BYTES", limits::MAX_MESSAGE_BYTES as u64),
        ("MAX_TOKEN_BYTES", limits::MAX_TOKEN_BYTES as u64),
        ("MAX_TEXT_BYTES", limits::MAX_TEXT_BYTES as u64),
        ("MAX_EDITS", limits::MAX_EDITS as u64),
        ("MAX_EDITED", limits::MAX_EDITED as u64),
        ("KEPT_REVISIONS", limits::KEPT_REVISIONS as u64),
        ("SCENE_CHUNK_BYTES", limits::SCENE_CHUNK_BYTES as u64),
        ("MAX_SCENE_BYTES", limits::MAX_SCENE_BYTES),
        ("MAX_LIGHTS", limits::MAX_LIGHTS.into()),
        ("MAX_SIDE_PX", limits::MAX_SIDE_PX.into()),
        ("MAX_PIXELS", limits::MAX_PIXELS.into()),
        ("MAX_WRONG_PPM", limits::MAX_WRONG_PPM.into()),
        ("MAX_LOOK_AHEAD_MS", limits::MAX_LOOK_AHEAD_MS.into()),
        ("MAX_FRAME_PACKETS", limits::MAX_FRAME_PACKETS as u64),
        ("MAX_FRAME_SLICES", limits::MAX_FRAME_SLICES as u64),
    ]);
    assert_eq!(stated, expected);
    for codec in CodecId::ALL {
        assert!(PAGE.contains(&format!("{} `{codec}`", codec.number())), "{codec}");
    }
}
