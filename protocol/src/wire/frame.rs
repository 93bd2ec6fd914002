//! A frame's body: the joined payloads of its packets.
//!
//! | bytes | field |
//! |---|---|
//! | 0 | codec ([`CodecId`]'s number) |
//! | 1–2 | width in pixels |
//! | 3–4 | height in pixels |
//! | 5 | lights; bit 7: a pose follows; bit 6: a reference follows |
//! | 6–7 | number of slices n |
//! | 86 more, if bit 7 | the pose that the mask was traced for ([`crate::pose`]), if not the client's own |
//! | 8 more, if bit 6 | the reference that the slices are coded against: its frame, u32, and its digest, u32 |
//! | 4n more | length of each slice in bytes, u32 |
//! | to the end | the slices, one after the other |
//!
//! All little-endian. Slices are independent: slice i of n covers the rows of tiles from ⌊i·rows/n⌋ up to
//! ⌊(i+1)·rows/n⌋ ([`slice_tile_rows`]), so a frame has at most as many slices as rows of tiles. With a
//! [sliced](CodecId::is_sliced) codec, a body is a sequence of such frames, its *parts*, with one slice each that names
//! what it covers. A part fits a datagram and can be read alone ([`Frame::parts`]).

use std::ops::Range;

use thiserror::Error;

use crate::{
    ids::{FrameNumber, ReferenceName},
    limits::{MAX_FRAME_BYTES, MAX_FRAME_SLICES},
    mask::{MaskShape, ShapeError},
    pose::{POSE_BYTES, Pose, PoseError},
    wire::CodecId,
};

/// Bytes before the table of slice lengths, without pose and reference.
pub const FRAME_HEAD_BYTES: usize = 8;

/// Beside the number of lights: a pose follows.
const POSE_FOLLOWS: u8 = 0x80;

/// Beside the number of lights: a reference follows.
const REFERENCE_FOLLOWS: u8 = 0x40;

const REFERENCE_BYTES: usize = 8;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameHead {
    pub codec: CodecId,
    pub shape: MaskShape,
    /// The pose that the mask was traced for, if the server looked ahead; otherwise it is the client's own pose.
    pub traced_for: Option<Pose>,
    /// What the slices are coded against; only for codecs that [have references](CodecId::has_references).
    pub reference: Option<ReferenceName>,
}

#[derive(Debug, Clone, PartialEq, Error)]
pub enum FrameError {
    #[error("a frame of {found} bytes, at least {needed} are needed")]
    TooShort { needed: usize, found: usize },
    #[error("a frame of {0} bytes: at most {MAX_FRAME_BYTES} are allowed")]
    TooLong(usize),
    #[error("no codec has number {0}")]
    Codec(u8),
    #[error("the frame's shape: {0}")]
    Shape(#[from] ShapeError),
    #[error("the frame names a reference, and {0} has none")]
    Reference(CodecId),
    #[error("the frame's pose: {0}")]
    Pose(#[from] PoseError),
    /// None, or more than rows of tiles or than [`MAX_FRAME_SLICES`].
    #[error("{found} slices: this shape has 1 to {most}")]
    Slices { found: usize, most: usize },
    #[error("the parts of the frame have different heads")]
    Parts,
    #[error("the slices have {stated} bytes, {found} follow the table")]
    Length { stated: u64, found: usize },
}

impl FrameHead {
    /// Returns the most slices that the frame can have.
    #[must_use]
    pub fn max_slices(&self) -> usize {
        if self.codec.is_sliced() { 1 } else { (self.shape.tiles_y() as usize).min(MAX_FRAME_SLICES) }
    }

    /// Returns the bytes before the table of slice lengths.
    pub(crate) fn bytes(&self) -> usize {
        let pose = if self.traced_for.is_some() { POSE_BYTES } else { 0 };
        FRAME_HEAD_BYTES + pose + if self.reference.is_some() { REFERENCE_BYTES } else { 0 }
    }

    /// Returns the bytes of a part before its slice.
    pub(crate) fn part_bytes(&self) -> usize {
        self.bytes() + 4
    }

    /// Writes the length of slice `index` into a body that begins with this head.
    pub(crate) fn set_slice_length(&self, body: &mut [u8], index: usize, bytes: u32) {
        let place = self.bytes() + index * 4;
        body[place..place + 4].copy_from_slice(&bytes.to_le_bytes());
    }

    /// Appends the head for `slices` slices of length 0 to `body`. [`Self::set_slice_length`] fills in the table.
    pub(crate) fn begin(&self, slices: u16, body: &mut Vec<u8>) {
        let (width, height, lights) = self.shape.into();
        body.push(self.codec.number());
        body.extend_from_slice(&low_u16(width).to_le_bytes());
        body.extend_from_slice(&low_u16(height).to_le_bytes());
        let pose = if self.traced_for.is_some() { POSE_FOLLOWS } else { 0 };
        let reference = if self.reference.is_some() { REFERENCE_FOLLOWS } else { 0 };
        body.push(low_u16(lights).to_le_bytes()[0] | pose | reference);
        body.extend_from_slice(&slices.to_le_bytes());
        if let Some(pose) = &self.traced_for {
            body.extend_from_slice(&pose.encode());
        }
        if let Some(ReferenceName { frame, digest }) = self.reference {
            body.extend_from_slice(&frame.0.to_le_bytes());
            body.extend_from_slice(&digest.to_le_bytes());
        }
        body.resize(body.len() + usize::from(slices) * 4, 0);
    }
}

/// Lossless, because every number in a shape is at most 4096.
fn low_u16(value: u32) -> u16 {
    let [low, high, ..] = value.to_le_bytes();
    u16::from_le_bytes([low, high])
}

/// Returns the rows of tiles that slice `index` of `count` covers.
#[must_use]
pub fn slice_tile_rows(shape: MaskShape, index: usize, count: usize) -> Range<usize> {
    let rows = shape.tiles_y() as usize;
    index * rows / count..(index + 1) * rows / count
}

/// A parsed frame body. Its slices fill it exactly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame<'a> {
    pub head: FrameHead,
    table: &'a [u8],
    slices: &'a [u8],
}

impl<'a> Frame<'a> {
    /// Parses a body, or the first part of a sliced one. Decodes and allocates nothing.
    ///
    /// # Errors
    /// If the body is too short or too long, the codec or shape is invalid, or the slices do not fill the body.
    pub fn parse(body: &'a [u8]) -> Result<Self, FrameError> {
        Self::parse_part(body).map(|(frame, _)| frame)
    }

    /// Returns the parts of a sliced body, or the whole of another one. Ends after an error.
    pub fn parts(body: &'a [u8]) -> impl Iterator<Item = Result<Self, FrameError>> + use<'a> {
        let (mut rest, mut head) = (Some(body), None);
        std::iter::from_fn(move || {
            let parsed = Self::parse_part(rest.take()?).and_then(|(frame, after)| {
                rest = Some(after).filter(|after| !after.is_empty());
                if *head.get_or_insert(frame.head) == frame.head { Ok(frame) } else { Err(FrameError::Parts) }
            });
            if parsed.is_err() {
                rest = None;
            }
            Some(parsed)
        })
    }

    fn parse_part(body: &'a [u8]) -> Result<(Self, &'a [u8]), FrameError> {
        if body.len() > MAX_FRAME_BYTES {
            return Err(FrameError::TooLong(body.len()));
        }
        let Some((head, rest)) = body.split_first_chunk::<FRAME_HEAD_BYTES>() else {
            return Err(FrameError::TooShort { needed: FRAME_HEAD_BYTES, found: body.len() });
        };
        let [codec, w0, w1, h0, h1, lights, n0, n1] = *head;
        let codec = CodecId::from_number(codec).ok_or(FrameError::Codec(codec))?;
        let [width, height] = [[w0, w1], [h0, h1]].map(|side| u32::from(u16::from_le_bytes(side)));
        let shape = MaskShape::new(width, height, u32::from(lights & !(POSE_FOLLOWS | REFERENCE_FOLLOWS)))?;
        let (traced_for, rest) = if lights & POSE_FOLLOWS == 0 {
            (None, rest)
        } else {
            let needed = FRAME_HEAD_BYTES + POSE_BYTES;
            let (pose, rest) =
                rest.split_at_checked(POSE_BYTES).ok_or(FrameError::TooShort { needed, found: body.len() })?;
            (Some(Pose::decode(pose)?), rest)
        };
        let (reference, rest) = if lights & REFERENCE_FOLLOWS == 0 {
            (None, rest)
        } else if !codec.has_references() {
            return Err(FrameError::Reference(codec));
        } else {
            let needed = body.len() - rest.len() + REFERENCE_BYTES;
            let Some((&[f0, f1, f2, f3, d0, d1, d2, d3], rest)) = rest.split_first_chunk() else {
                return Err(FrameError::TooShort { needed, found: body.len() });
            };
            let frame = FrameNumber(u32::from_le_bytes([f0, f1, f2, f3]));
            (Some(ReferenceName { frame, digest: u32::from_le_bytes([d0, d1, d2, d3]) }), rest)
        };
        let head = FrameHead { codec, shape, traced_for, reference };
        let count = usize::from(u16::from_le_bytes([n0, n1]));
        if count == 0 || count > head.max_slices() {
            return Err(FrameError::Slices { found: count, most: head.max_slices() });
        }
        let Some((table, slices)) = rest.split_at_checked(count * 4) else {
            return Err(FrameError::TooShort { needed: head.bytes() + count * 4, found: body.len() });
        };
        let stated: u64 = lengths(table).map(u64::from).sum();
        let end = usize::try_from(stated).ok().filter(|end| head.codec.is_sliced() || *end == slices.len());
        let Some((slices, after)) = end.and_then(|end| slices.split_at_checked(end)) else {
            return Err(FrameError::Length { stated, found: slices.len() });
        };
        Ok((Self { head, table, slices }, after))
    }

    #[must_use]
    pub const fn slice_count(&self) -> usize {
        self.table.len() / 4
    }

    /// Returns for each slice the rows of tiles that it covers, and its bytes.
    pub fn slices(&self) -> impl Iterator<Item = (Range<usize>, &'a [u8])> + use<'a> {
        let (shape, count) = (self.head.shape, self.slice_count());
        let mut rest = self.slices;
        lengths(self.table).enumerate().map(move |(index, length)| {
            // `parse` has checked that the lengths add up.
            let (slice, after) = rest.split_at(length as usize);
            rest = after;
            (slice_tile_rows(shape, index, count), slice)
        })
    }
}

fn lengths(table: &[u8]) -> impl Iterator<Item = u32> + use<'_> {
    table.as_chunks::<4>().0.iter().map(|length| u32::from_le_bytes(*length))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn head() -> FrameHead {
        let shape = MaskShape::new(10, 20, 2).unwrap();
        FrameHead { codec: CodecId::PlanesLz4, shape, traced_for: None, reference: None }
    }

    /// A planes frame of 10×20 pixels and 2 lights whose slices have these lengths.
    fn body(lengths: &[u32]) -> Vec<u8> {
        let head = head();
        let mut body = Vec::new();
        head.begin(u16::try_from(lengths.len()).unwrap(), &mut body);
        for (index, length) in lengths.iter().enumerate() {
            head.set_slice_length(&mut body, index, *length);
        }
        body.extend((0..lengths.iter().sum()).map(|byte: u32| byte.to_le_bytes()[0]));
        body
    }

    #[test]
    fn slices_round_trip() {
        let body = body(&[3, 0, 2]);
        let frame = Frame::parse(&body).unwrap();
        assert_eq!(frame.head.codec, CodecId::PlanesLz4);
        assert_eq!(frame.head.shape, MaskShape::new(10, 20, 2).unwrap());
        let slices: Vec<_> = frame.slices().collect();
        assert_eq!(slices, [(0..1, &[0, 1, 2][..]), (1..2, &[]), (2..3, &[3, 4])]);
    }

    #[test]
    fn a_pose_in_the_head_round_trips_or_is_refused() {
        let pose = Pose {
            position_m: [1.0, 2.0, 3.0],
            orientation: [0.0, 0.6, 0.0, 0.8],
            yfov_rad: 1.0,
            scene_time_s: 4.0,
            client_time_ms: 5,
            mask_px: [10, 20],
            look_ahead_ms: 6,
            revision: 0,
        };
        let head = FrameHead { traced_for: Some(pose), ..head() };
        let mut body = Vec::new();
        head.begin(2, &mut body);
        head.set_slice_length(&mut body, 1, 3);
        body.extend([7, 8, 9]);
        let frame = Frame::parse(&body).unwrap();
        assert_eq!(frame.head, head);
        assert_eq!(frame.slices().map(|(_, bytes)| bytes).collect::<Vec<_>>(), [&[][..], &[7, 8, 9]]);
        for length in 8..8 + POSE_BYTES {
            let needed = 8 + POSE_BYTES;
            assert_eq!(Frame::parse(&body[..length]), Err(FrameError::TooShort { needed, found: length }));
        }
        body[8..16].copy_from_slice(&f64::NAN.to_le_bytes());
        assert_eq!(Frame::parse(&body), Err(FrameError::Pose(PoseError::Range("position_m"))));
    }

    #[test]
    fn a_reference_in_the_head_round_trips_or_is_refused() {
        let reference = Some(ReferenceName { frame: FrameNumber(0x0102_0304), digest: 0xA0B0_C0D0 });
        let sliced = FrameHead { codec: CodecId::TilesSmall, reference, ..head() };
        let mut body = Vec::new();
        sliced.begin(1, &mut body);
        assert_eq!(body[5..16], [2 | 0x40, 1, 0, 4, 3, 2, 1, 0xD0, 0xC0, 0xB0, 0xA0]);
        assert_eq!(Frame::parse(&body).unwrap().head, sliced);
        for length in 8..16 {
            assert_eq!(Frame::parse(&body[..length]), Err(FrameError::TooShort { needed: 16, found: length }));
        }
        for codec in [CodecId::PlanesLz4, CodecId::TilesFast] {
            body[0] = codec.number();
            assert_eq!(Frame::parse(&body), Err(FrameError::Reference(codec)));
        }
        // Parts that are coded against different masks are no frame.
        body[0] = CodecId::TilesSmall.number();
        let mut other = body.clone();
        other[12] ^= 1;
        let both = [body, other].concat();
        assert_eq!(Frame::parts(&both).last(), Some(Err(FrameError::Parts)));
    }

    #[test]
    fn slices_cover_every_row_of_tiles_once() {
        let shape = MaskShape::new(8, 1080, 1).unwrap();
        for count in 1..=135 {
            let mut next = 0;
            for index in 0..count {
                let rows = slice_tile_rows(shape, index, count);
                assert_eq!(rows.start, next);
                assert!(!rows.is_empty());
                next = rows.end;
            }
            assert_eq!(next, 135);
        }
    }

    #[test]
    fn malformed_frames_are_refused_with_the_numbers() {
        let good = body(&[3, 2]);
        assert!(Frame::parse(&good).is_ok());
        let with = |place: usize, byte: u8| {
            let mut bad = good.clone();
            bad[place] = byte;
            Frame::parse(&bad).unwrap_err()
        };
        assert_eq!(with(0, 9), FrameError::Codec(9));
        assert_eq!(with(1, 0), FrameError::Shape(ShapeError::Size { width: 0, height: 20 }));
        assert_eq!(with(4, 0xFF), FrameError::Shape(ShapeError::Size { width: 10, height: 0xFF14 }));
        assert_eq!(with(5, 33), FrameError::Shape(ShapeError::Lights(33)));
        assert_eq!(with(6, 0), FrameError::Slices { found: 0, most: 3 });
        assert_eq!(with(6, 4), FrameError::Slices { found: 4, most: 3 });
        assert_eq!(with(8, 4), FrameError::Length { stated: 6, found: 5 });
        assert_eq!(with(15, 0xFF), FrameError::Length { stated: 0xFF00_0005, found: 5 });
        for length in 0..8 {
            assert_eq!(Frame::parse(&good[..length]), Err(FrameError::TooShort { needed: 8, found: length }));
        }
        for length in 8..16 {
            assert_eq!(Frame::parse(&good[..length]), Err(FrameError::TooShort { needed: 16, found: length }));
        }
        assert_eq!(Frame::parse(&good[..20]), Err(FrameError::Length { stated: 5, found: 4 }));
        let long = [&good[..], &[0]].concat();
        assert_eq!(Frame::parse(&long), Err(FrameError::Length { stated: 5, found: 6 }));
        let huge = vec![0; MAX_FRAME_BYTES + 1];
        assert_eq!(Frame::parse(&huge), Err(FrameError::TooLong(MAX_FRAME_BYTES + 1)));
    }
}
