//! The surroundings of a block and of a part of a row, and the walk over the rows: shared by the models.

use super::{
    block::{Block, DecodedBlock},
    order::{Order, Place},
};

/// The context of a tile whose neighbour is not in the slice.
pub(super) const UNKNOWN: usize = 3;

/// The blocks around a block that its bits may depend on: those that precede it in its slice.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Neighbours<'a> {
    pub(super) above: Option<&'a DecodedBlock>,
    pub(super) above_left: Option<&'a DecodedBlock>,
    pub(super) above_right: Option<&'a DecodedBlock>,
    pub(super) left: Option<&'a DecodedBlock>,
    /// The same place in the previous light.
    pub(super) other: Option<&'a DecodedBlock>,
    /// Tiles of the block inside the picture.
    pub(super) tiles: usize,
}

impl<'a> Neighbours<'a> {
    /// `number` is a block in the slice that begins with block `first`; `before` has the blocks between.
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

/// Returns 0 or 1 if the lowest eight bits all have that value, otherwise 2.
pub(super) const fn uniformity(row: u64) -> usize {
    match row & 0xFF {
        0 => 0,
        0xFF => 1,
        _ => 2,
    }
}

/// A row and eight pixels beyond either end, as bytes, so that four bytes can be read at once.
#[derive(Debug, Clone, Copy, Default)]
struct WideRow([u8; 16]);

impl WideRow {
    #[inline(always)]
    fn new(left: u64, row: u64, right: u64) -> Self {
        Self((u128::from(left >> 56) | u128::from(row) << 8 | u128::from(right & 0xFF) << 72).to_le_bytes())
    }

    /// A row whose end pixels repeat beyond it.
    #[inline(always)]
    fn alone(row: u64) -> Self {
        Self::new(replicated(row), row, replicated(row >> 63))
    }

    /// Returns the tile that begins at pixel `shift`, with eight pixels either side; the highest byte is arbitrary.
    #[inline(always)]
    fn window(&self, shift: u32) -> u32 {
        let tile = (shift / 8 % 8) as usize;
        u32::from_le_bytes([self.0[tile], self.0[tile + 1], self.0[tile + 2], self.0[tile + 3]])
    }
}

/// Repeats a row's end where nothing is known beyond it.
const fn replicated(end: u64) -> u64 {
    (end & 1).wrapping_neg()
}

/// Bit of a window that is the tile's first pixel.
pub(super) const BEYOND: u32 = 8;

/// The known rows of a block and around it.
pub(super) struct Rows {
    /// Starts with the third row above the block.
    own: [WideRow; 11],
    /// Rows of the previous light; the first is there twice.
    other: [WideRow; 9],
    has_other: bool,
    mixed: u64,
    lit: u64,
}

/// Eight pixels of a row and their known surroundings.
#[derive(Clone, Copy)]
pub(super) struct RowPart<'a> {
    rows: &'a Rows,
    shift: u32,
    place: usize,
    /// The two pixels to the left.
    pub(super) before: u32,
}

impl RowPart<'_> {
    /// Returns the `nth` row above, 1 to 3, from [`BEYOND`] pixels to the left to as many to the right. Higher bits are
    /// arbitrary.
    #[inline(always)]
    pub(super) fn above(&self, nth: usize) -> u32 {
        self.rows.own[(self.place % 8 + 3 - nth) % 11].window(self.shift)
    }

    /// Returns the same row of the previous light, as [`Self::above`].
    #[inline(always)]
    pub(super) fn other(&self) -> Option<u32> {
        self.rows.has_other.then(|| self.rows.other[self.place % 8 + 1].window(self.shift))
    }

    /// Returns where the previous light changes from the left, and from above.
    #[inline(always)]
    pub(super) fn changes(&self) -> [u32; 2] {
        let [above, row] = [0, 1].map(|below| self.rows.other[self.place % 8 + below].window(self.shift));
        [row ^ row << 1, row ^ above].map(|change| change >> BEYOND & 0xFF)
    }

    #[inline(always)]
    pub(super) const fn is_last(&self) -> bool {
        self.place == 7
    }

    /// Returns the context of a part around which nothing changes: its row, whether the previous light has one value
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

/// Walks over the rows of the `mixed` tiles; `lit` tiles are lit, all others dark. `code` codes eight pixels in their
/// surroundings and returns them. A decoder passes any `truth`.
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

#[expect(clippy::cast_possible_truncation, reason = "only the lowest bits are used")]
const fn low_bits(value: u64) -> u32 {
    value as u32
}
