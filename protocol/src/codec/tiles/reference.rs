//! A mask that both ends have. Later masks are coded against it, moved block by block.
//!
//! It holds all pixels of a frame's blocks, including those beyond the picture's edge, so that both ends have the same
//! bits everywhere. Every part that is coded against it carries its digest, so no part is decoded against another mask.

use std::fmt;

use super::{
    block::{Block, DecodedBlock},
    order::{Order, Place},
};
use crate::{
    ids::{FrameNumber, ReferenceName},
    mask::MaskShape,
};

/// Longest vector in pixels, in each direction of each axis.
pub(super) const MAX_MOTION_PX: i16 = 511;

/// A mask that later ones can be coded against.
#[derive(Clone, PartialEq, Eq)]
pub struct Reference {
    name: ReferenceName,
    shape: Option<MaskShape>,
    /// Words from one row to the next: a row's pixels, and a word at either end that repeats the end pixel.
    stride: usize,
    rows: usize,
    words: Vec<u64>,
}

impl fmt::Debug for Reference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Reference").field("name", &self.name).field("shape", &self.shape).finish_non_exhaustive()
    }
}

impl Default for Reference {
    fn default() -> Self {
        Self::new()
    }
}

/// Offset in pixels, to the right and down, from a block's place to its bits in the reference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Vector {
    pub(super) x: i16,
    pub(super) y: i16,
}

impl Vector {
    /// Returns the sum, or `None` if it is too long.
    pub(super) fn plus(self, x: i16, y: i16) -> Option<Self> {
        let within = |value: &i16| (-MAX_MOTION_PX..=MAX_MOTION_PX).contains(value);
        Some(Self { x: self.x.checked_add(x).filter(within)?, y: self.y.checked_add(y).filter(within)? })
    }
}

/// A row of 64 pixels, and one pixel beyond either end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Line {
    /// 64 pixels, from the one before the first.
    pub(super) from_left: u64,
    /// 64 pixels, from the second.
    pub(super) from_right: u64,
}

impl Line {
    pub(super) const fn row(self) -> u64 {
        self.from_left >> 1 | self.from_right >> 62 << 63
    }

    /// The lowest bits of `left` and `right` are the pixels beyond the ends.
    pub(super) const fn new(left: u64, row: u64, right: u64) -> Self {
        Self { from_left: row << 1 | left & 1, from_right: row >> 1 | right << 63 }
    }

    /// Returns the pixel before the first and the one after the last.
    pub(super) const fn ends(self) -> [u64; 2] {
        [self.from_left & 1, self.from_right >> 63]
    }

    /// Returns the tile that begins at pixel `shift`, with one pixel more at either end.
    #[inline(always)]
    pub(super) const fn window(self, shift: u32) -> u32 {
        let window = self.from_left >> shift & 0xFF | (self.from_right >> shift >> 6 & 3) << 8;
        let [low, high, ..] = window.to_le_bytes();
        u16::from_le_bytes([low, high]) as u32
    }
}

impl Reference {
    /// Holds no mask yet.
    #[must_use]
    pub const fn new() -> Self {
        let name = ReferenceName { frame: FrameNumber(0), digest: 0 };
        Self { name, shape: None, stride: 0, rows: 0, words: Vec::new() }
    }

    /// Returns its name in parts and acknowledgements.
    #[must_use]
    pub const fn name(&self) -> ReferenceName {
        self.name
    }

    /// Returns the mask's shape, or `None` without a mask.
    #[must_use]
    pub const fn shape(&self) -> Option<MaskShape> {
        self.shape
    }

    /// Returns its memory in bytes.
    #[must_use]
    pub const fn memory_bytes(&self) -> usize {
        self.words.capacity() * size_of::<u64>()
    }

    /// Replaces the mask with the blocks of a frame.
    pub(super) fn fill(&mut self, frame: FrameNumber, shape: MaskShape, blocks: &[DecodedBlock]) {
        let order = Order::new(shape);
        let across = order.blocks_across();
        (self.stride, self.rows) = (across + 2, shape.tiles_y() as usize * 8);
        self.words.resize(self.stride * self.rows * order.lights, 0);
        for ((_, place), block) in order.walk(0..order.blocks()).zip(blocks) {
            let first = (place.light * self.rows + place.y * 8) * self.stride + 1 + place.x;
            for (row, word) in block.rows.iter().zip(self.words[first..].iter_mut().step_by(self.stride)) {
                *word = *row;
            }
        }
        let mut digest = Digest::of(shape);
        for row in self.words.chunks_exact_mut(self.stride) {
            row[0] = (row[1] & 1).wrapping_neg();
            row[across + 1] = (row[across] >> 63).wrapping_neg();
            row[1..=across].iter().for_each(|word| digest.add(*word));
        }
        self.shape = Some(shape);
        self.name = ReferenceName { frame, digest: digest.finish() };
    }

    /// Returns 64 pixels of a row of a plane, from `x` on. Edge pixels repeat beyond the plane.
    #[inline(always)]
    fn row(&self, light: usize, x: i32, y: i32) -> u64 {
        let start = (light * self.rows + clamped(y, self.rows)) * self.stride;
        let row = &self.words[start..start + self.stride];
        let (word, shift) = (x >> 6, x & 63);
        let (low, high) = (row[clamped(word + 1, row.len())], row[clamped(word + 2, row.len())]);
        // In two steps, because a shift by 64 overflows.
        low >> shift | high << 1 << (63 - shift)
    }

    /// Returns the rows of a moved block.
    #[inline(always)]
    pub(super) fn block(&self, place: Place, vector: Vector) -> Block {
        let [x, y] = corner(place, vector);
        let (word, shift) = (x >> 6, x & 63);
        let (low, high) = (clamped(word + 1, self.stride), clamped(word + 2, self.stride));
        let mut block = [0; 8];
        if let Ok(first) = usize::try_from(y)
            && first + block.len() <= self.rows
        {
            // The usual case: no row is outside the picture.
            let rows = self.words[(place.light * self.rows + first) * self.stride..].chunks_exact(self.stride);
            for (own, row) in block.iter_mut().zip(rows) {
                *own = row[low] >> shift | row[high] << 1 << (63 - shift);
            }
        } else {
            for (row, y) in block.iter_mut().zip(y..) {
                *row = self.row(place.light, x, y);
            }
        }
        block
    }

    /// Returns the rows of a moved block, with one row above and one below.
    pub(super) fn lines(&self, place: Place, vector: Vector) -> [Line; 10] {
        let [x, y] = corner(place, vector);
        let mut lines = [Line::default(); 10];
        for (line, y) in lines.iter_mut().zip(y - 1..) {
            *line = Line { from_left: self.row(place.light, x - 1, y), from_right: self.row(place.light, x + 1, y) };
        }
        lines
    }
}

/// Returns the upper left pixel of a moved block in the reference. A picture has at most 2¹² pixels a side.
#[expect(clippy::cast_possible_truncation, clippy::cast_possible_wrap, reason = "places of a picture")]
fn corner(place: Place, vector: Vector) -> [i32; 2] {
    [place.x as i32 * 64 + i32::from(vector.x), place.y as i32 * 8 + i32::from(vector.y)]
}

/// Clamps an index to 0..`count`.
#[expect(clippy::cast_sign_loss, reason = "negative indices are 0")]
#[inline(always)]
fn clamped(index: i32, count: usize) -> usize {
    (index.max(0) as usize).min(count - 1)
}

/// A hash of 64-bit words. Each is mixed in by a multiplication whose halves are folded.
struct Digest(u64);

impl Digest {
    fn of(shape: MaskShape) -> Self {
        let (width, height, lights) = shape.into();
        let mut digest = Self(0x9E37_79B9_7F4A_7C15);
        [width, height, lights].into_iter().for_each(|side| digest.add(side.into()));
        digest
    }

    #[expect(clippy::cast_possible_truncation, reason = "the halves of a product")]
    fn add(&mut self, word: u64) {
        let product = u128::from(self.0 ^ word) * 0xA076_1D64_78BD_642F;
        self.0 = (product as u64 ^ (product >> 64) as u64).wrapping_add(word.rotate_left(32) | 1);
    }

    const fn finish(self) -> u32 {
        let [a, b, c, d, e, f, g, h] = self.0.to_le_bytes();
        u32::from_le_bytes([a, b, c, d]) ^ u32::from_le_bytes([e, f, g, h])
    }
}
