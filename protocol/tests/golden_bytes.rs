//! Every wire type, byte by byte. A change here changes the protocol: raise `PROTOCOL_VERSION` with it.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers outside the test functions use these too")]

use std::num::NonZeroU16;

use gnomon_protocol::{
    PROTOCOL_VERSION,
    codec::{CodecId, Decoder, EncodedFrame, Encoder, Reference},
    edit::{Edit, LightEdit, NodeEdit},
    header::PacketHeader,
    ids::{BearerToken, FrameNumber, ResumeToken, SceneDigest, SessionId},
    mask::{Mask, MaskShape},
    message::{self, ClientMessage, Edited, Hello, Refusal, ServerMessage, Welcome},
    packetizer::Packetizer,
    pose::{Pose, decode_pose_packet, encode_pose_packet},
    text::PeerText,
};

/// Parses groups of hexadecimal digits; `'` and `|` separate fields.
fn hex(text: &str) -> Vec<u8> {
    let digits: Vec<u32> = text.chars().filter_map(|c| c.to_digit(16)).collect();
    digits.chunks(2).map(|pair| u8::try_from(pair[0] * 16 + pair[1]).unwrap()).collect()
}

#[test]
fn version() {
    assert_eq!(PROTOCOL_VERSION, 7);
}

#[test]
fn headers() {
    let full = PacketHeader {
        sequence: 0x0102_0304,
        frame: Some(FrameNumber(0x1112_1314)),
        data_bytes: 2,
        frame_packets: NonZeroU16::new(127),
        first: true,
        timestamp_ms: Some(0x2122_2324),
    };
    let later = PacketHeader { frame_packets: NonZeroU16::new(32_767), first: false, ..full };
    let bare = PacketHeader { frame: None, frame_packets: None, first: false, timestamp_ms: None, ..full };
    for (header, bytes) in [
        (full, "04030201 14131211 0200 ff00 24232221"),
        (later, "04030201 14131211 0200 feff 24232221"),
        (bare, "04030201 ffffffff 0200 0000 ffffffff"),
    ] {
        assert_eq!(header.encode(), *hex(bytes));
        let datagram = [hex(bytes), vec![0xAB, 0xCD]].concat();
        assert_eq!(PacketHeader::decode(&datagram), Ok((header, &[0xAB, 0xCD][..])));
    }
}

#[test]
fn pose_packet() {
    let pose = Pose {
        position_m: [1.0, -2.0, 0.5],
        orientation: [0.0, 0.6, -0.0, 0.8],
        yfov_rad: 1.0,
        scene_time_s: 4.0,
        client_time_ms: 0x0102_0304,
        mask_px: [1920, 1080],
        look_ahead_ms: 0x0102,
        revision: 0x0A0B_0C0D,
    };
    let bytes = hex("07000000 0b0a0000 5600 0000 ffffffff |
        000000000000f03f 00000000000000c0 000000000000e03f |
        0000000000000000 333333333333e33f 0000000000000080 9a9999999999e93f |
        000000000000f03f 0000000000001040 04030201 8007 3804 0201 0d0c0b0a");
    assert_eq!(encode_pose_packet(7, FrameNumber(0x0A0B), &pose), *bytes);
    assert_eq!(decode_pose_packet(&bytes), Ok((7, FrameNumber(0x0A0B), pose)));
}

#[test]
fn frame_packets() {
    let packets: Vec<_> =
        Packetizer::new(20).packets(FrameNumber(3), 16, &b"abcdef".to_vec().into()).unwrap().collect();
    let expected = ["00000000 03000000 0400 0500 10000000 | 61626364", "01000000 03000000 0200 0400 10000000 | 6566"];
    assert_eq!(packets, expected.map(hex));
}

fn node() -> Edit {
    let translation_m = Some([1.0, -2.0, 0.5]);
    Edit::Node(NodeEdit { node: 3, translation_m, rotation: None, scale: None, shown: Some(false) })
}

fn light() -> Edit {
    Edit::Light(LightEdit {
        light: 2,
        position_m: None,
        direction: Some([0.0, -1.0, 0.0]),
        color: Some([1.0, 0.5, 0.0]),
        intensity: Some(2.0),
        range_m: Some(f32::INFINITY),
        cone_rad: Some([0.5, 1.0]),
    })
}

#[test]
fn client_messages() {
    let hello = |token: Option<&str>, codec| {
        let (token, client) = (token.map(BearerToken::from), "c/1".into());
        let resume = token.as_ref().map(|_| ResumeToken([0xA5; 16]));
        let wrong_ppm = if token.is_some() { 500 } else { 0 };
        ClientMessage::Hello(Hello {
            version: 1,
            token,
            client,
            width: 1920,
            height: 1080,
            codec,
            rate_hz: 300,
            wrong_ppm,
            resume,
        })
    };
    for (message, bytes) in [
        (
            hello(Some("key"), CodecId::PlanesLz4),
            "25000000 | 00 01 01'03'6b6579 03'632f31 800f b808 02 ac02 f403 01'a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5",
        ),
        (hello(None, CodecId::WordsLz4), "10000000 | 00 01 00 03'632f31 800f b808 01 ac02 00 00"),
        (hello(None, CodecId::Words), "10000000 | 00 01 00 03'632f31 800f b808 00 ac02 00 00"),
        (ClientMessage::FetchScene { offset: 300 }, "03000000 | 01 ac02"),
        (ClientMessage::Start, "01000000 | 02"),
        (ClientMessage::Ping(5), "02000000 | 03 05"),
        (ClientMessage::Bye, "01000000 | 04"),
        (
            ClientMessage::Edit { number: 5, edits: vec![node(), light()] },
            "5e000000 | 05 05 02 | 00 03 01'000000000000f03f'00000000000000c0'000000000000e03f 00 00 01'00 | \
             01 02 00 01'0000000000000000'000000000000f0bf'0000000000000000 01'0000803f'0000003f'00000000 01'00000040 \
             01'0000807f 01'0000003f'0000803f",
        ),
    ] {
        assert_eq!(message::encode(&message), Ok(hex(bytes)));
        assert_eq!(message::decode(&hex(bytes)[4..]), Ok(message));
    }
}

#[test]
fn server_messages() {
    let digest: [u8; 32] = std::array::from_fn(|place| u8::try_from(place).unwrap());
    let digest_hex = "000102030405060708090a0b0c0d0e0f101112131415161718191a1b1c1d1e1f";
    let resume = "5a".repeat(16);
    let welcome = |data_port| {
        ServerMessage::Welcome(Welcome {
            session: SessionId(1),
            scene_digest: SceneDigest(digest),
            scene_bytes: 65_536,
            lights: 4,
            backend: "cpu".into(),
            data_port,
            resume: ResumeToken([0x5A; 16]),
            may_edit: true,
            shared_world: false,
            revision: 300,
        })
    };
    let draining = |alternative: Option<&str>| ServerMessage::Draining {
        reason: "up".into(),
        deadline_ms: 5000,
        alternative: alternative.map(PeerText::from),
    };
    for (message, bytes) in [
        (welcome(None), format!("3f000000 | 00 01 {digest_hex} 808004 04 03'637075 00 {resume} 01 00 ac02")),
        (welcome(Some(4433)), format!("41000000 | 00 01 {digest_hex} 808004 04 03'637075 01'd122 {resume} 01 00 ac02")),
        (ServerMessage::Refused(Refusal::Version { server: 1, client: 2 }), "04000000 | 01 00 01 02".to_owned()),
        (ServerMessage::Refused(Refusal::Token), "02000000 | 01 01".to_owned()),
        (
            ServerMessage::Refused(Refusal::Full { sessions: 8, retry_after_ms: 1000 }),
            "05000000 | 01 02 08 e807".to_owned(),
        ),
        (ServerMessage::Refused(Refusal::Unsupported("no".into())), "05000000 | 01 03 02'6e6f".to_owned()),
        (ServerMessage::Refused(Refusal::Draining), "02000000 | 01 04".to_owned()),
        (
            ServerMessage::Refused(Refusal::Busy { reason: "no".into(), retry_after_ms: 1000 }),
            "07000000 | 01 05 02'6e6f e807".to_owned(),
        ),
        (
            ServerMessage::SceneChunk { offset: 65_536, bytes: vec![0xAA, 0xBB] },
            "07000000 | 02 808004 02'aabb".to_owned(),
        ),
        (ServerMessage::Pong(5), "02000000 | 03 05".to_owned()),
        (draining(Some("u")), "09000000 | 04 02'7570 8827 01'01'75".to_owned()),
        (draining(None), "07000000 | 04 02'7570 8827 00".to_owned()),
        (
            ServerMessage::Edited(Edited { revision: 300, yours: Some(5), whole: false, edits: Vec::new() }),
            "07000000 | 06 ac02 01'05 00 00".to_owned(),
        ),
        (
            ServerMessage::Edited(Edited {
                revision: 1,
                yours: None,
                whole: true,
                edits: vec![Edit::Node(NodeEdit { node: 7, shown: Some(true), ..NodeEdit::default() })],
            }),
            "0c000000 | 06 01 00 01 01 | 00 07 00 00 00 01'01".to_owned(),
        ),
        (ServerMessage::EditRefused { number: 5, reason: "no".into() }, "05000000 | 07 05 02'6e6f".to_owned()),
        (ServerMessage::Clock(300), "03000000 | 08 ac02".to_owned()),
        (ServerMessage::Closing { reason: "end".into(), may_return: true }, "06000000 | 05 03'656e64 01".to_owned()),
        (ServerMessage::Closing { reason: "end".into(), may_return: false }, "06000000 | 05 03'656e64 00".to_owned()),
    ] {
        assert_eq!(message::encode(&message), Ok(hex(&bytes)));
        assert_eq!(message::decode(&hex(&bytes)[4..]), Ok(message));
    }
}

/// 10×9 pixels: light 0 reaches all from column 4 on, light 1 the last row.
fn wide() -> Mask {
    let mut mask = Mask::new(MaskShape::new(10, 9, 2).unwrap());
    for (x, y) in (0..9).flat_map(|y| (0..10).map(move |x| (x, y))) {
        mask.set(0, x, y, x >= 4);
        mask.set(1, x, y, y == 8);
    }
    mask
}

/// 3×2 pixels, 9 lights: word `100·y + 10·x` at (x, y).
fn deep() -> Mask {
    let mut mask = Mask::new(MaskShape::new(3, 2, 9).unwrap());
    for (light, x, y) in
        (0..9).flat_map(|light| [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1)].map(|(x, y)| (light, x, y)))
    {
        mask.set(light, x, y, (100 * y + 10 * x) >> light & 1 == 1);
    }
    mask
}

/// Decoding these bytes is the protocol. The encoder gives the same bytes only on 64-bit machines and with this version
/// of `lz4_flex`: if only encoding fails after an update, take the new bytes.
#[track_caller]
fn frame(codec: CodecId, slices: u16, mask: &Mask, bytes: &str) {
    let mut decoded = Mask::new(MaskShape::new(1, 1, 1).unwrap());
    assert_eq!(Decoder::new().decode(&hex(bytes), &mut decoded).unwrap(), codec);
    assert_eq!(decoded, *mask);
    let mut body = EncodedFrame::default();
    Encoder::with_slices(codec, NonZeroU16::new(slices).unwrap()).encode(mask, &mut body).unwrap();
    assert_eq!(body.body(), hex(bytes));
}

#[test]
fn frames_of_words() {
    let rows = "00000000 0a000000 14000000 | 64000000 6e000000 78000000";
    frame(CodecId::Words, 1, &deep(), &format!("00 0300 0200 09 0100 | 18000000 | {rows}"));
}

#[test]
fn frames_of_compressed_words() {
    let block = "1b00 0100 | 1f01 0400 04 | 0c 0200 | 0f 2800 f5 | 1b02 0400 | 1d03 0400 | 60 000003000000";
    frame(CodecId::WordsLz4, 1, &wide(), &format!("01 0a00 0900 02 0100 | 1f000000 | {block}"));
    // Too little to compress: raw words.
    let rows = "00000000 0a000000 14000000 | 64000000 6e000000 78000000";
    frame(CodecId::WordsLz4, 1, &deep(), &format!("01 0300 0200 09 0100 | 18000000 | {rows}"));
}

#[test]
fn frames_of_planes() {
    let block = "13f0 0100 | 1303 0100 | 22f000 0100 | 1203 0700 | 0d 0200 | 13ff 1200 | 80 0300000000000000";
    frame(CodecId::PlanesLz4, 1, &wide(), &format!("02 0a00 0900 02 0100 | 21000000 | {block}"));
    let upper = "13f0 0100 | 1303 0100 | 1500 0100 | 60 000000000000";
    let lower = "22f000 0100 | 1203 0700 | 2300ff 0800 | 80 0300000000000000";
    frame(CodecId::PlanesLz4, 2, &wide(), &format!("02 0a00 0900 02 0200 | 13000000 17000000 | {upper} | {lower}"));
    // Too little to compress: the raw tile.
    let mut corner = Mask::new(MaskShape::new(2, 2, 1).unwrap());
    corner.set(0, 1, 0, true);
    corner.set(0, 0, 1, true);
    frame(CodecId::PlanesLz4, 1, &corner, "02 0200 0200 01 0100 | 08000000 | 0201000000000000");
}

#[test]
fn frames_of_tiles() {
    let small = "03 0a00 0900 02 0100 | 0a000000 | 000000 0400 | 11a5aaed7d";
    frame(CodecId::TilesSmall, 1, &wide(), small);
    let fast = "04 0a00 0900 02 0100 | 0b000000 | 000000 0400 | fc1f69d03e08";
    frame(CodecId::TilesFast, 1, &wide(), fast);
}

/// Discs that use most of the codecs' contexts, moved by this many pixels.
fn discs(moved: u32) -> Mask {
    let mut mask = Mask::new(MaskShape::new(700, 300, 3).unwrap());
    for light in 0..3 {
        for (x, y) in (0..300_u32).flat_map(|y| (0..700_u32).map(move |x| (x, y))) {
            let (dx, dy) = ((x + moved) % 90, (y + moved) % 70);
            let from_centre = dx.abs_diff(40 + light).pow(2) + dy.abs_diff(30).pow(2);
            mask.set(light, x, y, from_centre > (x / 90 + y / 70 * 8) * 17 + ((x * 7) ^ (y * 3)) % 40);
        }
    }
    mask
}

/// FNV-1a.
fn digest(body: &[u8]) -> u64 {
    body.iter().fold(0xCBF2_9CE4_8422_2325_u64, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x100_0000_01B3))
}

/// The codecs' initial statistics are part of the protocol too.
#[test]
fn frames_of_many_tiles() {
    let mask = discs(0);
    for (codec, length, expected) in
        [(CodecId::TilesSmall, 2808, 675_061_410_788_137_403), (CodecId::TilesFast, 3848, 802_019_334_841_049_628)]
    {
        let mut body = EncodedFrame::default();
        Encoder::new(codec).encode(&mask, &mut body).unwrap();
        let mut decoded = Mask::new(MaskShape::new(1, 1, 1).unwrap());
        Decoder::new().decode(&body, &mut decoded).unwrap();
        assert_eq!(decoded, mask);
        assert_eq!((body.len(), digest(&body)), (length, expected), "{codec}");
    }
}

#[test]
fn frames_with_a_reference() {
    let (mut encoder, mut reference, mut body) =
        (Encoder::new(CodecId::TilesSmall), Reference::new(), EncodedFrame::default());
    encoder.encode(&wide(), &mut body).unwrap();
    assert!(encoder.keep(FrameNumber(0x0102), &mut reference));
    encoder.encode_for(None, Some(&reference), &wide(), &mut body).unwrap();
    // Nothing has changed, which takes no bits at all. The digest is the mask's.
    assert_eq!(body.body(), hex("03 0a00 0900 42 0100 | 02010000 cadf674f | 05000000 | 000000 0400"));

    encoder.encode(&discs(3), &mut body).unwrap();
    assert!(encoder.keep(FrameNumber(1), &mut reference));
    encoder.encode_for(None, Some(&reference), &discs(0), &mut body).unwrap();
    let mut decoded = Mask::new(MaskShape::new(1, 1, 1).unwrap());
    Decoder::new().decode_against(Some(&reference), &body, &mut decoded).unwrap();
    assert_eq!(decoded, discs(0));
    assert_eq!((reference.name().digest, body.len(), digest(&body)), (2_380_633_871, 1912, 2_861_280_507_218_559_075));
}
