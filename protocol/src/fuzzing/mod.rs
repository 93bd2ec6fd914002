//! Properties that hold for any bytes. Only the fuzz targets (`tests/fuzz`) and the stable smoke test
//! (`tests/fuzz_smoke.rs`) call these. Each panics if its property does not hold.
//!
//! All targets, for a minute, with the stable toolchain: `make fuzz` (`tests/fuzz/build` and `run`).

mod slices;

use std::num::NonZeroU16;

use serde::{Serialize, de::DeserializeOwned};

pub use self::slices::slices;
use crate::{
    acknowledgement::Acknowledgement,
    codec::{CodecId, Decoder, EncodedFrame, Encoder, Reference},
    fec::ParityEncoder,
    frame::{Frame, FrameHead},
    header::{HEADER_BYTES, PacketHeader},
    ids::FrameNumber,
    limits::{MAX_LIGHTS, MAX_MESSAGE_BYTES, MAX_PACKET_BYTES, MAX_PIXELS},
    loss::LossFeedback,
    mask::{Mask, MaskShape},
    message::{self, CheckText, ClientMessage, ServerMessage},
    packetizer::Packetizer,
    pose::{Pose, decode_pose_packet, encode_pose_packet},
    reassembler::{Policy, Progress, Reassembler},
};

/// A header that decodes encodes to the same bytes, and its payload is the rest of the input.
pub fn header(bytes: &[u8]) {
    if let Ok((header, payload)) = PacketHeader::decode(bytes) {
        assert_eq!(header.encode(), bytes[..HEADER_BYTES]);
        assert_eq!(payload, &bytes[HEADER_BYTES..]);
        assert_eq!(payload.len(), usize::from(header.data_bytes));
    }
}

/// A pose, or a pose packet, that decodes is valid and encodes to the same bytes.
pub fn pose(bytes: &[u8]) {
    if let Ok(pose) = Pose::decode(bytes) {
        assert_eq!(pose.validate(), Ok(()));
        assert_eq!(pose.encode(), bytes);
    }
    if let Ok((sequence, frame, pose)) = decode_pose_packet(bytes) {
        assert_eq!(pose.validate(), Ok(()));
        assert_eq!(encode_pose_packet(sequence, frame, &pose), bytes);
    }
}

/// A message that decodes, from either side, encodes to at most as many bytes, which decode to the same message. (Not
/// to the same bytes: postcard accepts numbers with leading zero groups.)
pub fn message(bytes: &[u8]) {
    one_message::<ClientMessage>(bytes);
    one_message::<ServerMessage>(bytes);
    if let Some((prefix, _)) = bytes.split_first_chunk() {
        let stated = u32::from_le_bytes(*prefix) as usize;
        assert_eq!(message::decode_length(*prefix).ok(), (stated <= MAX_MESSAGE_BYTES).then_some(stated));
    }
}

fn one_message<M: Serialize + DeserializeOwned + CheckText>(bytes: &[u8]) {
    if let Ok(message) = message::decode::<M>(bytes) {
        assert!(bytes.len() <= MAX_MESSAGE_BYTES);
        let encoded = message::encode(&message);
        assert!(encoded.as_ref().is_ok_and(|encoded| encoded.len() - 4 <= bytes.len()), "{encoded:?}");
        // Bytes are compared, for a number that is none does not equal itself.
        let again = encoded.clone().and_then(|encoded| message::decode::<M>(&encoded[4..]));
        assert_eq!(again.and_then(|again| message::encode(&again)), encoded);
    }
}

/// A frame that decodes has the shape in its head, within the limits, and every codec round-trips the mask bit by bit,
/// so no bit is set outside the picture. After an error, a decoder decodes the next frame as a new one does.
pub fn codec(bytes: &[u8]) {
    let tiny = Mask::new(tiny_shape());
    let (mut decoder, mut mask) = (Decoder::new(), tiny.clone());
    let result = decoder.decode(bytes, &mut mask);
    assert_eq!(mask.words().len(), mask.shape().words());
    if let Ok(codec) = result {
        let frame = Frame::parse(bytes);
        assert!(frame.is_ok_and(|frame| frame.head.shape == mask.shape() && frame.head.codec == codec));
        assert!(mask.shape().pixels() <= MAX_PIXELS as usize && mask.shape().lights() <= MAX_LIGHTS);
        for codec in CodecId::ALL {
            gives_back(codec, &mask, &mut decoder);
        }
    }
    gives_back(CodecId::PlanesLz4, &tiny, &mut decoder);
}

/// Slice bits coded against a reference give a mask or an error. A mask round-trips bit by bit against the same
/// reference. The first byte picks the shape.
pub fn moved(bytes: &[u8]) {
    let Some((&pick, bits)) = bytes.split_first() else { return };
    let (width, height, lights) = [(1, 1, 1), (64, 8, 3), (130, 20, 2), (300, 33, 1)][usize::from(pick) % 4];
    let Ok(shape) = MaskShape::new(width, height, lights) else { return };
    let mut mask = Mask::new(shape);
    for (word, place) in mask.words_mut().iter_mut().zip(1u64..) {
        *word = place.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    }
    let (mut encoder, mut decoder) = (Encoder::new(CodecId::TilesSmall), Decoder::new());
    let (mut reference, mut encoded, mut body) = (Reference::new(), EncodedFrame::default(), Vec::new());
    assert_eq!(encoder.encode(&mask, &mut encoded), Ok(()));
    assert!(encoder.keep(FrameNumber(5), &mut reference));
    let blocks = width.div_ceil(64) * height.div_ceil(8) * lights;
    let head = FrameHead { codec: CodecId::TilesSmall, shape, traced_for: None, reference: Some(reference.name()) };
    let slice = [&[0, 0, 0], &blocks.to_le_bytes()[..2], bits].concat();
    head.begin(1, &mut body);
    head.set_slice_length(&mut body, 0, u32::try_from(slice.len()).unwrap_or(u32::MAX));
    body.extend_from_slice(&slice);
    if decoder.decode_against(Some(&reference), &body, &mut mask).is_ok() {
        let mut again = Mask::new(tiny_shape());
        assert_eq!(encoder.encode_for(None, Some(&reference), &mask, &mut encoded), Ok(()));
        assert!(decoder.decode_against(Some(&reference), &encoded, &mut again).is_ok());
        assert!(again == mask, "a mask coded against its reference changed");
    }
}

/// An acknowledgement that decodes encodes to the same bytes, except for the digest when it names no frame. So does
/// loss feedback, and no bytes decode as both.
pub fn acknowledgement(bytes: &[u8]) {
    if let Ok(feedback) = LossFeedback::decode(bytes) {
        assert_eq!(feedback.encode(), bytes);
        assert!(Acknowledgement::decode(bytes).is_err());
    }
    if let Ok(acknowledgement) = Acknowledgement::decode(bytes) {
        let compared = if acknowledgement.mask.is_some() { bytes.len() } else { HEADER_BYTES };
        assert_eq!(acknowledgement.encode()[..compared], bytes[..compared]);
    }
}

fn gives_back(codec: CodecId, mask: &Mask, decoder: &mut Decoder) {
    let (mut body, mut again) = (EncodedFrame::default(), Mask::new(tiny_shape()));
    // Only noise in 32 lights near the largest size cannot be encoded, and no input here is that long.
    assert_eq!(Encoder::new(codec).encode(mask, &mut body), Ok(()));
    assert!(decoder.decode(&body, &mut again).is_ok_and(|found| found == codec));
    assert!(again == *mask, "{codec} changes the mask");
}

/// Returns the smallest shape, which is always within the limits.
fn tiny_shape() -> MaskShape {
    let Ok(shape) = MaskShape::new(1, 1, 1) else { unreachable!("1×1×1 is a shape") };
    shape
}

/// The longest frame that [`reassembler`] allows.
const MAX_BODY_BYTES: usize = 64;

/// For any packets, frames are delivered in increasing order and within their limit, memory stays within it, and the
/// counts add up. While only honest packets arrive, in any order, every delivered frame is byte-exact.
///
/// The input is a list of packets. A first byte below 0x80 is the length of a raw packet. Otherwise, the next byte
/// names the frame (upper four bits) and packet (lower four, modulo) of an honest packet; if bit 6 of the first byte is
/// set, its low six bits alter the number of packets and the first-packet flag.
pub fn reassembler(bytes: &[u8]) {
    for policy in [Policy::WholeFrame, Policy::Slices] {
        reassemble(policy, bytes);
    }
}

fn reassemble(policy: Policy, bytes: &[u8]) {
    let mut reassembler = Reassembler::with_max_frame_bytes(policy, MAX_BODY_BYTES);
    let (mut newest, mut honest, mut packets, mut complete, mut rest) = (None, true, 0, 0, bytes);
    while let [control, name, after @ ..] = rest {
        let progress = if control & 0x80 == 0 {
            honest = false;
            let (datagram, after) = rest[1..].split_at(usize::from(*control).min(rest.len() - 1));
            rest = after;
            reassembler.push(datagram)
        } else {
            rest = after;
            let frame = name >> 4;
            let index = (name & 15) % honest_count(frame);
            let change = if control & 0x40 == 0 { 0 } else { control & 0x3F };
            honest &= change == 0;
            reassembler.push(&honest_packet(frame, index, change))
        };
        packets += 1;
        let frame = reassembler.frame();
        match progress {
            Ok(progress) => assert_eq!(frame.is_some(), matches!(progress, Progress::Complete | Progress::Partial)),
            // Even a refused packet can end the frame before it.
            Err(_) => assert!(frame.is_none_or(|frame| frame.missing > 0)),
        }
        if let Some(frame) = frame {
            complete += u64::from(frame.missing == 0);
            // A partial frame is delivered again only with more of it.
            assert!(newest < Some((frame.frame, frame.packets)), "{newest:?}, then {frame:?}");
            assert!(frame.known_bytes < frame.body.len());
            newest = Some((frame.frame, frame.packets));
            assert!((1..=MAX_BODY_BYTES).contains(&frame.body.len()));
            assert!(frame.body.len() >= usize::from(frame.packets));
            assert!(frame.missing == 0 || policy == Policy::Slices);
            if honest {
                let number = frame.frame.0.to_le_bytes()[0];
                assert_eq!(frame.packets + frame.missing, u16::from(honest_count(number)));
                let whole: Vec<u8> = (0..honest_count(number)).flat_map(|index| honest_data(number, index)).collect();
                match policy {
                    Policy::WholeFrame => assert_eq!(frame.body, whole),
                    Policy::Slices => assert!(frame.body.len() < whole.len() || frame.missing == 0),
                }
            }
        }
        if rest.len() % 3 == 0 && reassembler.deliver_partial() {
            let frame = reassembler.frame().map(|frame| (frame.frame, frame.packets));
            assert!(frame.is_some() && newest < frame, "{newest:?}, then {frame:?}");
            newest = frame;
        }
        assert!(reassembler.buffer_bytes() <= if policy == Policy::Slices { 2 } else { 1 } * MAX_BODY_BYTES);
    }
    let stats = reassembler.stats();
    assert_eq!((stats.packets, stats.frames_complete), (packets, complete));
    assert_eq!(stats.stored + stats.ignored() + stats.malformed, packets);
}

/// For any parity, the packets of a frame that arrived stay unchanged and in order, and memory is bounded.
///
/// The first byte gives the frame's number of packets (low four bits) and of parity packets. Then each three bytes send
/// one of them: its index, an offset into it, and the change to that byte (parity only).
pub fn parity(bytes: &[u8]) {
    let Some((&counts, steps)) = bytes.split_first() else { return };
    let body: Vec<u8> = (0..=counts & 15).flat_map(|payload| [payload + 1; 9]).collect();
    let body = EncodedFrame::from(body);
    let (mut packetizer, mut encoder) = (Packetizer::new(HEADER_BYTES + 9), ParityEncoder::default());
    let mut packets: Vec<Vec<u8>> = Vec::new();
    if let Ok(honest) = packetizer.packets(FrameNumber(1), 1, &body) {
        packets.extend(honest.map(Vec::from));
    }
    let honest = packets.len();
    let parity = encoder.encode(body.payloads(9), counts >> 4);
    packets.extend(packetizer.parity_packets(FrameNumber(1), 1, parity).map(Vec::from));
    let mut reassembler = Reassembler::with_max_frame_bytes(Policy::Slices, 4 * MAX_BODY_BYTES);
    let mut came = Vec::new();
    for &[place, at, change] in steps.as_chunks::<3>().0 {
        let place = usize::from(place) % packets.len();
        let mut packet = packets[place].clone();
        // The frame's number and the parity mark stay.
        let at = usize::from(at) % packet.len();
        if place >= honest && !(4..12).contains(&at) {
            packet[at] ^= change;
        }
        let progress = reassembler.push(&packet);
        if place < honest {
            match progress {
                Ok(Progress::Stored | Progress::Complete) => came.extend_from_slice(&packets[place][HEADER_BYTES..]),
                progress => assert!(matches!(progress, Ok(Progress::Ignored(_))), "{progress:?}"),
            }
        }
        if let Some(frame) = reassembler.frame() {
            assert!(frame.body.starts_with(&came) && frame.missing == 0);
            // With only parity, nothing can contradict it.
            assert!(came.is_empty() || usize::from(frame.packets) == honest);
        }
        assert!(reassembler.parity_bytes() <= 2 * 255 * MAX_PACKET_BYTES);
    }
}

/// Number of packets of an honest frame: 1 to 7.
fn honest_count(frame: u8) -> u8 {
    1 + frame * 5 % 7
}

/// Data of one packet of an honest frame: 1 to 4 bytes.
fn honest_data(frame: u8, index: u8) -> impl Iterator<Item = u8> {
    (0..1 + (frame + index) % 4).map(move |byte| frame << 4 ^ index ^ byte << 6)
}

fn honest_packet(frame: u8, index: u8, change: u8) -> Vec<u8> {
    let data: Vec<u8> = honest_data(frame, index).collect();
    let header = PacketHeader {
        // The last frames' sequence numbers lie beyond the wrap.
        sequence: (u32::MAX - 60).wrapping_add(u32::from(frame) * 8 + u32::from(index)),
        frame: Some(FrameNumber(u32::from(frame))),
        data_bytes: u16::from(data.len().to_le_bytes()[0]),
        frame_packets: NonZeroU16::new(u16::from(honest_count(frame) ^ change >> 2)),
        first: (index == 0) != (change & 1 == 1),
        timestamp_ms: Some(u32::from(frame ^ change & 2)),
    };
    [&header.encode()[..], &data].concat()
}
