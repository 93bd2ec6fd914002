//! What is around a block and around a part of a row, and the walk over the rows: what the models have in common.

use super::{
    block::{Block, Known},
    order::{Order, Place},
};

/// The context of a tile whose neighbour is not in the slice.
pub(super) const UNKNOWN: usize = 3;

/// What a block's bits may depend on: the blocks around it, as far as they come before it in its slice.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Near<'a> {
    pub(super) above: Option<&'a Known>,
    pub(super) above_left: Option<&'a Known>,
    pub(super) above_right: Option<&'a Known>,
    pub(super) left: Option<&'a Known>,
    /// The same place in the light before this one.
    pub(super) other: Option<&'a Known>,
    /// Tiles of the block that lie in the picture.
    pub(super) tiles: usize,
}

impl<'a> Near<'a> {
    /// What is known around block `number` of a slice that begins with block `first`; `before` are the blocks between.
    #[inline(always)]
    pub(super) fn new(before: &'a [Known], order: &Order, place: Place, first: usize, number: usize) -> Self {
        let known = |number: Option<usize>| number.and_then(|number| before.get(number.wrapping_sub(first)));
        let around = order.around(number, place);
        Self {
            above: known(around.above),
            above_left: known(around.above_left),
            above_right: known(around.above_right),
            left: known(around.left),
            other: known(around.other),
            tiles: order.tiles(place).len(),
        }
    }
}

/// 0 or 1 when the lowest eight bits all are, and 2 when they differ.
pub(super) const fn uniformity(row: u64) -> usize {
    match row & 0xFF {
        0 => 0,
        0xFF => 1,
        _ => 2,
    }
}

/// A row with two pixels beyond either end.
#[derive(Debug, Clone, Copy)]
struct Wide {
    /// All but the last four, the leftmost in bit 0.
    low: u64,
    /// The last four, where they are in the window of the last tile.
    top: u64,
}

impl Wide {
    /// With the two lowest bits of `left` and of `right`.
    const fn new(left: u64, row: u64, right: u64) -> Self {
        Self { low: left & 3 | row << 2, top: (row >> 62 | (right & 3) << 2) << 8 }
    }

    /// The tile that begins at pixel `shift`, from two pixels to the left to two to the right.
    #[inline(always)]
    const fn window(self, shift: u32) -> u32 {
        let top = if shift == 56 { self.top } else { 0 };
        low_bits((self.low >> shift) & 0xFFF | top)
    }
}

/// A row of a block, and what is known around it.
#[derive(Debug, Clone, Copy)]
struct Line {
    /// The same row, and the one above, of the light before this one.
    other: [u64; 2],
    place: usize,
    mixed: u64,
    lit: u64,
}

/// Eight pixels of a row, and what is known around them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Part<'a> {
    line: &'a Line,
    shift: u32,
    /// The row above from two pixels to the left to two to the right, and the one above that, one less at either end.
    pub(super) above: [u32; 2],
    /// The two pixels to the left.
    pub(super) before: u32,
}

impl Part<'_> {
    /// Where the light before this one changes, from the left and from above.
    #[inline(always)]
    pub(super) fn changes(&self) -> [u32; 2] {
        let [other, above] = self.line.other;
        [other ^ (other << 1 | other & 1), other ^ above].map(|change| low_bits(change >> self.shift & 0xFF))
    }

    /// Context of a part around which nothing changes: its row, whether the light before this one is of one value
    /// here, and what the tile to the right holds.
    pub(super) const fn surroundings(&self) -> usize {
        let Line { other: [other, _], place, mixed, lit, .. } = *self.line;
        let other = matches!(other >> self.shift & 0xFF, 0 | 0xFF) as usize;
        let next = if self.shift == 56 {
            UNKNOWN
        } else if mixed >> (self.shift + 8) & 1 == 1 {
            2
        } else {
            (lit >> (self.shift + 8) & 1) as usize
        };
        place | other << 3 | next << 4
    }
}

/// Walks over the rows of the mixed tiles; the tiles of `lit` are lit, and all others dark. `code` is given eight pixels'
/// surroundings and the pixels, which a decoder does not know yet, and gives the pixels back.
#[inline(always)]
pub(super) fn code_rows(
    near: &Near<'_>,
    truth: &Block,
    mixed: u64,
    lit: u64,
    mut code: impl FnMut(&Part<'_>, u32) -> u32,
) -> Known {
    let mut rows = [0; 8];
    let last = |row: u64| (row >> 63).wrapping_neg();
    let over = |place: usize| {
        near.above.map_or(Wide::new(0, 0, 0), |above| {
            let left = near.above_left.map_or(0, |left| left.rows[place] >> 62);
            let right = near.above_right.map_or(last(above.rows[place]), |right| right.rows[place]);
            Wide::new(left, above.rows[place], right)
        })
    };
    let (mut second, mut first) = (over(6), over(7));
    for (place, (row, truth)) in rows.iter_mut().zip(truth).enumerate() {
        let left = near.left.map_or(0, |left| left.rows[place] >> 62);
        let other = near.other.map_or([0; 2], |other| [other.rows[place], other.rows[place.max(1) - 1]]);
        let line = Line { other, place, mixed, lit };
        let (mut coded, mut rest) = (lit, mixed);
        while rest != 0 {
            let shift = rest.trailing_zeros() & 0x38;
            rest &= !(0xFF << shift);
            let part = Part {
                line: &line,
                shift,
                above: [first.window(shift), second.window(shift) >> 1 & 0x3FF],
                before: low_bits((coded << 2 | left) >> shift & 3),
            };
            coded |= u64::from(code(&part, low_bits(truth >> shift & 0xFF))) << shift;
        }
        *row = coded;
        second = first;
        first = Wide::new(left, coded, last(coded));
    }
    Known::new(rows)
}

#[expect(clippy::cast_possible_truncation, reason = "what is wanted lies in the lowest bits")]
const fn low_bits(value: u64) -> u32 {
    value as u32
}
