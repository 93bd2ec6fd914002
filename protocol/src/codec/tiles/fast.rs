//! The model of `tiles-fast`: few symbols, each with one look into a table.
//!
//! How many blocks are as the tiles before them, and then a block that is not: what its tiles hold, in pairs, and for
//! each row of its mixed tiles how it differs from the row above. The context of a row is where the row above changes, and
//! how that differs from the row above it: so the codes know that an edge runs on as it ran.

use super::{
    block::Known,
    codes::Codes,
    near::{Near, Part, UNKNOWN, code_rows, uniformity},
};

/// Contexts of a pair of tiles: the tile to the left, and the two above.
const PAIR_CONTEXTS: usize = 64;

/// Contexts of a row: 9 places of a single change above by 6 slopes, no change, and several; and whether the pixel to the left goes
/// on as it is above.
const ROW_CONTEXTS: usize = (9 * 6 + 2) * 2;

/// All contexts.
pub(super) const CONTEXTS: usize = PAIR_CONTEXTS + ROW_CONTEXTS;

/// Either direction of the coder, or a counter.
pub(super) trait Symbols {
    /// Codes `symbol` and gives it back; a decoder gives the symbol that was coded instead.
    fn symbol(&mut self, codes: &Codes, context: usize, symbol: u8) -> u8;
}

/// Codes a block that is not all as the blocks beside it, and gives it back; a decoder is given any block.
pub(super) fn code(symbols: &mut impl Symbols, codes: &Codes, near: &Near<'_>, block: &Known) -> Known {
    let own = block.extent;
    let (mut mixed, mut lit) = (0_u64, 0_u64);
    let mut before = near.left.map_or(UNKNOWN, |left| left.extent.kind(7) as usize);
    for pair in 0..near.tiles.div_ceil(2) {
        let over = near.above.map_or(UNKNOWN * 5, |above| {
            let row = above.rows[7] >> (pair * 16);
            uniformity(row) * 4 + uniformity(row >> 8)
        });
        let kinds = [own.kind(pair * 2), own.kind(pair * 2 + 1)];
        let symbol = symbols.symbol(codes, over * 4 + before, kinds[0] as u8 * 3 + kinds[1] as u8);
        for (tile, kind) in (pair * 2..).zip([symbol / 3, symbol % 3]) {
            let byte = 0xFF << (tile * 8);
            match kind {
                0 => {}
                1 => lit |= byte,
                _ => mixed |= byte,
            }
        }
        before = usize::from(symbol % 3);
    }
    code_rows(near, &block.rows, mixed, lit, |part, truth| {
        let above = part.above[0] >> 2 & 0xFF;
        let differs = (truth ^ above).to_le_bytes()[0];
        above ^ u32::from(symbols.symbol(codes, PAIR_CONTEXTS + row_context(part), differs))
    })
}

/// The single change among ten pixels, 0 to 8, by where neighbours differ; 9 where there is none and 10 where there are
/// several.
static CHANGE: [u8; 512] = {
    let mut change = [0; 512];
    let mut places: usize = 0;
    while places < 512 {
        change[places] = match places.count_ones() {
            0 => 9,
            1 => places.trailing_zeros().to_le_bytes()[0],
            _ => 10,
        };
        places += 1;
    }
    change
};

/// The context of a row by the change in the row above and in the one above that.
static CLASS: [[u8; 16]; 16] = {
    let mut class = [[0; 16]; 16];
    let (mut first, mut second): (u8, u8) = (0, 0);
    while first < 11 {
        class[first as usize][second as usize] = match (first, second) {
            (9 | 10, _) => 9 * 6 + first - 9,
            (_, 9 | 10) => first * 6 + 5,
            _ => first * 6 + slope(first, second),
        };
        (first, second) = if second == 10 { (first + 1, 0) } else { (first, second + 1) };
    }
    class
};

/// 0 to 4: how far a change has moved from row to row, two to the left, one, not, one to the right, two or more.
const fn slope(first: u8, second: u8) -> u8 {
    match (first + 2).saturating_sub(second) {
        moved @ 0..4 => moved,
        _ => 4,
    }
}

#[inline(always)]
fn change(ten: u32) -> usize {
    usize::from(CHANGE[(ten ^ ten >> 1) as usize & 0x1FF])
}

#[inline(always)]
fn row_context(part: &Part<'_>) -> usize {
    let ten = part.above[0] >> 1 & 0x3FF;
    let class = CLASS[change(ten) & 15][change(part.above[1]) & 15];
    usize::from(class) << 1 | (part.before >> 1 ^ ten) as usize & 1
}
