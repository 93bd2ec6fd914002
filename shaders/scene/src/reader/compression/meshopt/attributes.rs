//! The codec ATTRIBUTES: blocks of vertices whose bytes are transposed, as differences from the vertex before.

use super::input::{Input, version};

const HEADER: u8 = 0xa0;
const NEWEST: u8 = 1;
/// Bytes that are encoded with one number of bits.
const GROUP: usize = 16;
const MAX_BLOCK_BYTES: usize = 8192;
const MAX_BLOCK_VERTICES: usize = 256;
/// Encoders pad the end so that decoders may read this far without a check. Each group must have so many bytes left.
const GROUP_READS: usize = 24;

/// How a word's four bytes belong together in version 1.
#[derive(Clone, Copy)]
enum Channel {
    Bytes,
    Words16,
    /// Exclusive or with the word before, rotated right by so many bits.
    Words32(u32),
}

/// Decodes `count` vertices of `stride` bytes, 4 to 256 and a multiple of 4.
/// Errors if the data are too short or too long, or of another codec or a later version.
pub(super) fn decode(data: &[u8], count: usize, stride: usize) -> Result<Vec<u8>, &'static str> {
    let version = version(data, HEADER, NEWEST)?;
    let channel_bytes = if version == 0 { 0 } else { stride / 4 };
    let tail = stride + channel_bytes;
    let padded = tail.max(if version == 0 { 32 } else { 24 });
    let Some(end) = data.len().checked_sub(padded).filter(|end| *end >= 1) else {
        return Err("its tail is cut");
    };
    let (first, channels) = data.get(data.len() - tail..).unwrap_or_default().split_at(stride);
    let channels: Vec<Channel> = if version == 0 {
        vec![Channel::Bytes; stride / 4]
    } else {
        channels.iter().map(|code| channel(*code)).collect::<Result<_, _>>()?
    };
    let mut input = Input { data, at: 1 };
    // The least that a block takes bounds what is allocated: a group of nothing takes two bits, and version 1 has a
    // control byte for each word. So memory is at most about a thousand times the data, besides the caller's bound.
    let mut out = vec![0; count * stride];
    let mut before = first.to_vec();
    let block = (MAX_BLOCK_BYTES / stride).min(MAX_BLOCK_VERTICES) & !(GROUP - 1);
    let mut planes = [0; 4 * MAX_BLOCK_VERTICES];
    for vertices in out.chunks_mut(block * stride) {
        decode_block(&mut input, vertices, &mut before, &channels, version, &mut planes)?;
    }
    if input.at == end { Ok(out) } else { Err("its length does not fit its count") }
}

fn channel(code: u8) -> Result<Channel, &'static str> {
    match code & 3 {
        0 => Ok(Channel::Bytes),
        1 => Ok(Channel::Words16),
        2 => Ok(Channel::Words32(u32::from(code >> 4))),
        _ => Err("it has a channel of no known kind"),
    }
}

fn decode_block(
    input: &mut Input<'_>,
    vertices: &mut [u8],
    before: &mut [u8],
    channels: &[Channel],
    version: u8,
    planes: &mut [u8; 4 * MAX_BLOCK_VERTICES],
) -> Result<(), &'static str> {
    let stride = before.len();
    let count = vertices.len() / stride;
    let controls = if version == 0 { &[][..] } else { input.take(channels.len())? };
    for (word, channel) in channels.iter().enumerate() {
        let control = controls.get(word).copied().unwrap_or(0);
        for (byte, plane) in planes.chunks_exact_mut(MAX_BLOCK_VERTICES).enumerate() {
            match (version, control >> (2 * byte) & 3) {
                (0, _) => decode_plane(input, plane, count, [0, 2, 4, 8])?,
                (_, 0) => decode_plane(input, plane, count, [0, 1, 2, 4])?,
                (_, 1) => decode_plane(input, plane, count, [1, 2, 4, 8])?,
                (_, 2) => plane.fill(0),
                (_, _) => plane.get_mut(..count).unwrap_or_default().copy_from_slice(input.take(count)?),
            }
        }
        let [a, b, c, d] = four(planes);
        let mut last = [0; 4];
        last.copy_from_slice(before.get(word * 4..word * 4 + 4).unwrap_or(&[0; 4]));
        for (number, vertex) in vertices.chunks_exact_mut(stride).enumerate() {
            let delta = [a, b, c, d].map(|plane| plane.get(number).copied().unwrap_or_default());
            last = channel.undo(delta, last);
            vertex.get_mut(word * 4..word * 4 + 4).unwrap_or_default().copy_from_slice(&last);
        }
        before.get_mut(word * 4..word * 4 + 4).unwrap_or_default().copy_from_slice(&last);
    }
    Ok(())
}

fn four(planes: &[u8; 4 * MAX_BLOCK_VERTICES]) -> [&[u8]; 4] {
    let (front, back) = planes.split_at(2 * MAX_BLOCK_VERTICES);
    let ((a, b), (c, d)) = (front.split_at(MAX_BLOCK_VERTICES), back.split_at(MAX_BLOCK_VERTICES));
    [a, b, c, d]
}

impl Channel {
    fn undo(self, delta: [u8; 4], last: [u8; 4]) -> [u8; 4] {
        match self {
            Self::Bytes => std::array::from_fn(|at| last[at].wrapping_add(unzigzag8(delta[at]))),
            Self::Words16 => {
                let [a, b, c, d] = delta;
                let [e, f, g, h] = last;
                let add = |delta: [u8; 2], last: [u8; 2]| {
                    u16::from_le_bytes(last).wrapping_add(unzigzag16(u16::from_le_bytes(delta))).to_le_bytes()
                };
                let ([a, b], [c, d]) = (add([a, b], [e, f]), add([c, d], [g, h]));
                [a, b, c, d]
            }
            Self::Words32(rotation) => {
                (u32::from_le_bytes(delta).rotate_right(rotation) ^ u32::from_le_bytes(last)).to_le_bytes()
            }
        }
    }
}

fn unzigzag8(value: u8) -> u8 {
    (value >> 1) ^ 0_u8.wrapping_sub(value & 1)
}

fn unzigzag16(value: u16) -> u16 {
    (value >> 1) ^ 0_u16.wrapping_sub(value & 1)
}

/// Decodes one byte of each of `count` vertices: two bits for each group say with how many bits its bytes are stored.
fn decode_plane(input: &mut Input<'_>, plane: &mut [u8], count: usize, widths: [u8; 4]) -> Result<(), &'static str> {
    let groups = count.div_ceil(GROUP);
    let header = input.take(groups.div_ceil(4))?;
    for (number, group) in plane.chunks_exact_mut(GROUP).take(groups).enumerate() {
        if input.left() < GROUP_READS {
            return Err("it is cut");
        }
        let code = header.get(number / 4).copied().unwrap_or_default() >> (number % 4 * 2) & 3;
        match widths[usize::from(code)] {
            0 => group.fill(0),
            8 => group.copy_from_slice(input.take(GROUP)?),
            width => decode_group(input, group, width)?,
        }
    }
    Ok(())
}

/// Decodes bytes of 1, 2 or 4 bits. One with all bits set stands for a whole byte that follows the group.
fn decode_group(input: &mut Input<'_>, group: &mut [u8], width: u8) -> Result<(), &'static str> {
    let full = (1_u8 << width) - 1;
    let packed = input.take(GROUP * usize::from(width) / 8)?;
    let each = usize::from(8 / width);
    for (values, byte) in group.chunks_exact_mut(each).zip(packed) {
        // Single bits start at the lowest, wider ones at the highest.
        let mut left = if width == 1 { byte.reverse_bits() } else { *byte };
        for value in values {
            let bits = left >> (8 - width);
            left <<= width;
            *value = if bits == full { input.byte()? } else { bits };
        }
    }
    Ok(())
}
