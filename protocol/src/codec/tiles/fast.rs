//! The model of `tiles-fast`: few symbols, each with one table lookup.
//!
//! It codes how many blocks are as predicted, and then the next block: the kinds of its tiles, in pairs, and for each
//! mixed tile which rows differ from the row above, and in which pixels. A row's context is where the row above changes
//! and to which side that change last moved, so straight edges are cheap. Tiles stay words, as in a mask.

use super::{
    block::{Block, Kind},
    neighbours::{UNKNOWN, uniformity},
};

/// Contexts of a pair of tiles: the kinds of the tile to the left and the two above.
pub(super) const PAIR_CONTEXTS: usize = 64;

/// Contexts of a row: nine kinds of the row above, three ways that its change moved, and whether the pixel to the left
/// differs from the first one above.
const ROW_CONTEXTS: usize = 9 * 6;

pub(super) const SHORT_CONTEXTS: usize = PAIR_CONTEXTS + ROW_CONTEXTS;

/// Contexts of the long codes, which say which rows differ: the row above, and the tile to the left.
pub(super) const LONG_CONTEXTS: usize = 3 * 4;

/// An encoder, a decoder or a counter.
pub(super) trait SymbolCoder {
    /// Codes `symbol` with a short code and returns it. A decoder ignores `symbol` and returns the coded one.
    fn short(&mut self, context: usize, symbol: u8) -> u8;

    /// As [`Self::short`], with a long code.
    fn long(&mut self, context: usize, symbol: u8) -> u8;
}

/// Known tiles around a block: those of the block above, and the one to the left.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct TileNeighbours<'a> {
    pub(super) above: Option<&'a Block>,
    pub(super) left: Option<u64>,
}

#[inline(always)]
pub(super) const fn kind(tile: u64) -> Kind {
    match tile {
        0 => Kind::Dark,
        u64::MAX => Kind::Lit,
        _ => Kind::Mixed,
    }
}

/// Predicts every tile of a block: uniform like the tile to the left, otherwise like the pixel above.
#[inline(always)]
pub(super) fn predicted(neighbours: TileNeighbours<'_>) -> u64 {
    match neighbours.left {
        Some(flat @ (0 | u64::MAX)) => flat,
        _ => neighbours.above.map_or(0, |above| (above[0] >> 56 & 1).wrapping_neg()),
    }
}

/// Codes the first `tiles` tiles of a block that is not as predicted. Returns the coded tiles; a decoder ignores
/// `block`.
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
        // Only a corrupt slice has symbols above 8.
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

const EACH_ROW: u64 = 0x0101_0101_0101_0101;

/// Codes a mixed tile. `above` is the row above it and the row above that.
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
        // Until this row is known, `tile` has the row above in its place.
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

/// Returns a bit for each byte that is not 0.
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

/// Where a row of eight pixels changes, 1 to 7; 0 if nowhere, 8 if more than once.
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

/// The same in three classes: no change, one, several.
static THREE: [u8; 9] = [0, 1, 1, 1, 1, 1, 1, 1, 2];

/// How the change moves from one row to the next: 1 left, 2 right, 0 not at all or unknown.
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
    fn differing_rows_are_found() {
        for rows in 0..=255_u8 {
            for byte in [1, 0x80, 0xFF, 0x7F] {
                let bytes: u64 = (0..8).filter(|row| rows >> row & 1 == 1).map(|row| byte << (8 * row)).sum();
                assert_eq!(rows_of(bytes), rows);
            }
        }
    }
}
