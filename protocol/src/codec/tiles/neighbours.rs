//! What is around a block and around a part of a row, and the walk over the rows: what the models have in common.

use super::{
    block::{Block, DecodedBlock},
    order::{Order, Place},
};

/// The context of a tile whose neighbour is not in the slice.
pub(super) const UNKNOWN: usize = 3;

/// What a block's bits may depend on: the blocks around it, as far as they come before it in its slice.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Neighbours<'a> {
    pub(super) above: Option<&'a DecodedBlock>,
    pub(super) above_left: Option<&'a DecodedBlock>,
    pub(super) above_right: Option<&'a DecodedBlock>,
    pub(super) left: Option<&'a DecodedBlock>,
    /// The same place in the light before this one.
    pub(super) other: Option<&'a DecodedBlock>,
    /// Tiles of the block that lie in the picture.
    pub(super) tiles: usize,
}

impl<'a> Neighbours<'a> {
    /// What is known around block `number` of a slice that begins with block `first`; `before` are the blocks between.
    #[inline(always)]
    pub(super) fn new(before: &'a [DecodedBlock], order: &Order, place: Place, first: usize, number: usize) -> Self {
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

/// A row with eight pixels beyond either end, as bytes: they are read where they lie, four at once.
#[derive(Debug, Clone, Copy, Default)]
struct WideRow([u8; 16]);

impl WideRow {
    /// With the rows to the left and to the right.
    #[inline(always)]
    fn new(left: u64, row: u64, right: u64) -> Self {
        Self((u128::from(left >> 56) | u128::from(row) << 8 | u128::from(right & 0xFF) << 72).to_le_bytes())
    }

    /// A row that goes on as it ends.
    #[inline(always)]
    fn alone(row: u64) -> Self {
        Self::new(replicated(row), row, replicated(row >> 63))
    }

    /// The tile that begins at pixel `shift`, from eight pixels to the left to eight to the right, and what is beyond.
    #[inline(always)]
    fn window(&self, shift: u32) -> u32 {
        let tile = (shift / 8 % 8) as usize;
        u32::from_le_bytes([self.0[tile], self.0[tile + 1], self.0[tile + 2], self.0[tile + 3]])
    }
}

/// What a row's end goes on as, where nothing is known beyond it.
const fn replicated(end: u64) -> u64 {
    (end & 1).wrapping_neg()
}

/// Place of a window's first pixel in the tile: bit 8 of a window is the tile's first.
pub(super) const BEYOND: u32 = 8;

/// The rows of a block that are known so far, and what is known around them.
pub(super) struct Rows {
    /// From the third row above the block on.
    own: [WideRow; 11],
    /// Of the light before this one, from the first row on, which is there twice.
    other: [WideRow; 9],
    /// Whether there is one.
    has_other: bool,
    mixed: u64,
    lit: u64,
}

/// Eight pixels of a row, and what is known around them.
#[derive(Clone, Copy)]
pub(super) struct RowPart<'a> {
    rows: &'a Rows,
    shift: u32,
    place: usize,
    /// The two pixels to the left.
    pub(super) before: u32,
}

impl RowPart<'_> {
    /// The first row above, the second or the third, from [`BEYOND`] pixels to the left to as many to the right; higher
    /// bits mean nothing.
    #[inline(always)]
    pub(super) fn above(&self, nth: usize) -> u32 {
        self.rows.own[(self.place % 8 + 3 - nth) % 11].window(self.shift)
    }

    /// The same row in the light before this one, as [`Self::above`].
    #[inline(always)]
    pub(super) fn other(&self) -> Option<u32> {
        self.rows.has_other.then(|| self.rows.other[self.place % 8 + 1].window(self.shift))
    }

    /// Where the light before this one changes, from the left and from above.
    #[inline(always)]
    pub(super) fn changes(&self) -> [u32; 2] {
        let [above, row] = [0, 1].map(|below| self.rows.other[self.place % 8 + below].window(self.shift));
        [row ^ row << 1, row ^ above].map(|change| change >> BEYOND & 0xFF)
    }

    /// Whether this is a tile's last row.
    #[inline(always)]
    pub(super) const fn is_last(&self) -> bool {
        self.place == 7
    }

    /// Context of a part around which nothing changes: its row, whether the light before this one is of one value
    /// here, and what the tile to the right holds.
    #[inline(always)]
    pub(super) fn surroundings(&self) -> usize {
        let Rows { mixed, lit, ref other, .. } = *self.rows;
        let other = other[self.place % 8 + 1].window(self.shift) >> BEYOND;
        let other = usize::from(matches!(other & 0xFF, 0 | 0xFF));
        let next = if self.shift == 56 {
            UNKNOWN
        } else if mixed >> (self.shift + 8) & 1 == 1 {
            2
        } else {
            usize::from(lit >> (self.shift + 8) & 1 == 1)
        };
        self.place | other << 3 | next << 4
    }
}

/// Walks over the rows of the mixed tiles; the tiles of `lit` are lit, and all others dark. `code` is given eight
/// pixels' surroundings and the pixels, which a decoder does not know yet, and gives the pixels back.
#[inline(always)]
pub(super) fn code_rows(
    neighbours: &Neighbours<'_>,
    truth: &Block,
    mixed: u64,
    lit: u64,
    mut code: impl FnMut(&RowPart<'_>, u32) -> u32,
) -> DecodedBlock {
    let mut block = [0; 8];
    let mut rows = Rows { own: [WideRow::default(); 11], other: [WideRow::default(); 9], has_other: false, mixed, lit };
    if let Some(above) = neighbours.above {
        for (place, wide) in (5..8).zip(&mut rows.own) {
            let row = above.rows[place];
            let left = neighbours.above_left.map_or(0, |left| left.rows[place]);
            let right = neighbours.above_right.map_or(replicated(row >> 63), |right| right.rows[place]);
            *wide = WideRow::new(left, row, right);
        }
    }
    if let Some(other) = neighbours.other {
        rows.has_other = true;
        rows.other[0] = WideRow::alone(other.rows[0]);
        for (wide, row) in rows.other[1..].iter_mut().zip(other.rows) {
            *wide = WideRow::alone(row);
        }
    }
    for place in 0..8 {
        let left = neighbours.left.map_or(0, |left| left.rows[place]);
        let (mut coded, mut rest) = (lit, mixed);
        while rest != 0 {
            let shift = rest.trailing_zeros() & 0x38;
            rest &= !(0xFF << shift);
            let before = low_bits((coded << 2 | left >> 62) >> shift & 3);
            let part = RowPart { rows: &rows, shift, place, before };
            coded |= u64::from(code(&part, low_bits(truth[place] >> shift & 0xFF))) << shift;
        }
        block[place] = coded;
        rows.own[place + 3] = WideRow::new(left, coded, replicated(coded >> 63));
    }
    DecodedBlock::new(block)
}

#[expect(clippy::cast_possible_truncation, reason = "what is wanted lies in the lowest bits")]
const fn low_bits(value: u64) -> u32 {
    value as u32
}
