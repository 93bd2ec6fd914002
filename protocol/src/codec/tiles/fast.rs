//! The model of `tiles-fast`: few symbols, each with one look into a table.
//!
//! How many blocks are as the tiles before them, and then a block that is not: what its tiles hold, in pairs, and for
//! each mixed tile which of its rows differ from the row above, and by which pixels those do. The context of a row is
//! where the row above changes and to which side that last moved: so the codes know that an edge runs on as it ran.
//! Tiles stay what they are in a mask, a word each.

use super::{
    block::{Block, Kind},
    neighbours::{UNKNOWN, uniformity},
};

/// Contexts of a pair of tiles: the tile to the left, and the two above.
pub(super) const PAIR_CONTEXTS: usize = 64;

/// Contexts of a row: nine kinds of the row above, three ways that it came there, and whether the pixel to the left
/// goes on as it is above.
const ROW_CONTEXTS: usize = 9 * 6;

/// Contexts of short codes.
pub(super) const SHORT_CONTEXTS: usize = PAIR_CONTEXTS + ROW_CONTEXTS;

/// Contexts of long codes, of which rows differ: the row above, and the tile to the left.
pub(super) const LONG_CONTEXTS: usize = 3 * 4;

/// Either direction of the coder, or a counter.
pub(super) trait SymbolCoder {
    /// Codes `symbol` and gives it back; a decoder gives the symbol that was coded instead.
    fn short(&mut self, context: usize, symbol: u8) -> u8;

    /// The same, of a symbol of the long codes.
    fn long(&mut self, context: usize, symbol: u8) -> u8;
}

/// What is known around a block: the tiles of the block above, and the tile to the left.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct TileNeighbours<'a> {
    pub(super) above: Option<&'a Block>,
    pub(super) left: Option<u64>,
}

/// What a tile holds.
#[inline(always)]
pub(super) const fn kind(tile: u64) -> Kind {
    match tile {
        0 => Kind::Dark,
        u64::MAX => Kind::Lit,
        _ => Kind::Mixed,
    }
}

/// What each tile of a block holds that goes on as the tile to the left, or else as the pixel above.
#[inline(always)]
pub(super) fn predicted(neighbours: TileNeighbours<'_>) -> u64 {
    match neighbours.left {
        Some(flat @ (0 | u64::MAX)) => flat,
        _ => neighbours.above.map_or(0, |above| (above[0] >> 56 & 1).wrapping_neg()),
    }
}

/// Codes the first `tiles` tiles of a block that is not all as predicted, and gives them back; a decoder is given any
/// block.
#[inline(always)]
pub(super) fn code(
    symbols: &mut impl SymbolCoder,
    neighbours: TileNeighbours<'_>,
    tiles: usize,
    block: &Block,
) -> Block {
    let above = neighbours.above.unwrap_or(&[0; 8]);
    let mut kinds = [Kind::Dark as u8; 8];
    let mut before = neighbours.left.map_or(UNKNOWN, |left| kind(left) as usize);
    for (pair, own) in block.as_chunks::<2>().0.iter().enumerate().take(tiles.div_ceil(2)) {
        let over = neighbours
            .above
            .map_or(UNKNOWN * 5, |above| uniformity(above[pair * 2] >> 56) * 4 + uniformity(above[pair * 2 + 1] >> 56));
        let symbol = symbols.short(over * 4 + before, kind(own[0]) as u8 * 3 + kind(own[1]) as u8);
        // Only a made-up slice has symbols above 8.
        (kinds[pair * 2], kinds[pair * 2 + 1]) = ((symbol / 3).min(2), symbol % 3);
        before = usize::from(symbol % 3);
    }
    let mut coded = [0; 8];
    let (mut left, mut left_kind) =
        (neighbours.left.unwrap_or(0), neighbours.left.map_or(UNKNOWN, |left| kind(left) as usize));
    for (((coded, own), above), kind) in coded.iter_mut().zip(block).zip(above).zip(kinds) {
        *coded = match kind {
            0 => 0,
            1 => u64::MAX,
            _ => code_tile(symbols, [low_byte(above >> 56), low_byte(above >> 48)], left, left_kind, *own),
        };
        (left, left_kind) = (*coded, usize::from(kind));
    }
    coded
}

/// A byte for each row.
const EACH_ROW: u64 = 0x0101_0101_0101_0101;

/// Codes a mixed tile; `above` are the row above it and the one above that.
#[inline(always)]
fn code_tile(symbols: &mut impl SymbolCoder, above: [u8; 2], left: u64, left_kind: usize, truth: u64) -> u64 {
    let differs = truth ^ (truth << 8 | u64::from(above[0]));
    let [mut place, before] = above.map(|row| PLACES[usize::from(row)]);
    let context = usize::from(THREE[usize::from(place)]) * 4 + left_kind;
    let mut rest = symbols.long(context, rows_of(differs));
    let mut moved = MOVES[usize::from(before) % 16][usize::from(place) % 16];
    let mut tile = u64::from(above[0]) * EACH_ROW;
    while rest != 0 {
        let row = rest.trailing_zeros() * 8;
        rest &= rest - 1;
        // Before this row is known, its place holds the row above.
        let lags = usize::from((left >> (row + 7) ^ tile >> row) & 1 == 1);
        let context = PAIR_CONTEXTS + usize::from(place) * 6 + usize::from(moved) * 2 + lags;
        let symbol = symbols.short(context, low_byte(differs >> row));
        tile ^= (u64::from(symbol) * EACH_ROW) << row;
        let next = PLACES[usize::from(low_byte(tile >> row))];
        let step = MOVES[usize::from(place) % 16][usize::from(next) % 16];
        moved = if step == 0 { moved } else { step };
        place = next;
    }
    tile
}

/// Which bytes are not 0: a bit each.
#[inline(always)]
const fn rows_of(bytes: u64) -> u8 {
    let high = 0x7F * EACH_ROW;
    let set = (((bytes & high) + high) | bytes) >> 7 & EACH_ROW;
    // Each bit goes to its place in the highest byte.
    low_byte(set.wrapping_mul(0x0102_0408_1020_4080) >> 56)
}

#[inline(always)]
const fn low_byte(word: u64) -> u8 {
    let [low, ..] = word.to_le_bytes();
    low
}

/// Where a row of eight pixels changes, 1 to 7; 0 where it does not, and 8 where it does more than once.
static PLACES: [u8; 256] = {
    let mut places = [8; 256];
    let mut row: usize = 0;
    while row < places.len() {
        let changes = (row ^ row >> 1) & 0x7F;
        if changes == 0 {
            places[row] = 0;
        } else if changes & (changes - 1) == 0 {
            let [place, ..] = changes.trailing_zeros().to_le_bytes();
            places[row] = 1 + place;
        }
        row += 1;
    }
    places
};

/// The same in three kinds: no change, one, several.
static THREE: [u8; 9] = [0, 1, 1, 1, 1, 1, 1, 1, 2];

/// From one row's place to the next one's: 1 to the left, 2 to the right, and 0 where that is not to be seen.
static MOVES: [[u8; 16]; 16] = {
    let mut moves = [[0; 16]; 16];
    let mut from = 1;
    while from < 8 {
        let mut to = 1;
        while to < 8 {
            if to != from {
                moves[from][to] = if to < from { 1 } else { 2 };
            }
            to += 1;
        }
        from += 1;
    }
    moves
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_that_differ_are_found() {
        for rows in 0..=255_u8 {
            for byte in [1, 0x80, 0xFF, 0x7F] {
                let bytes: u64 = (0..8).filter(|row| rows >> row & 1 == 1).map(|row| byte << (8 * row)).sum();
                assert_eq!(rows_of(bytes), rows);
            }
        }
    }
}
