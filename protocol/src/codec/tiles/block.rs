//! A block of 64×8 pixels of one light, as eight rows of 64 bits.

use super::order::{BLOCK_TILES, Order, Place};
use crate::{
    codec::transpose::transpose_bytes,
    mask::{Mask, MaskShape, TILE_PX, inside},
};

/// Rows from the top; bit x of a row is pixel x from the left.
pub(super) type Block = [u64; 8];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Dark = 0,
    Lit = 1,
    Mixed = 2,
}

/// Columns of a block that are lit in `all` rows, and in `any` row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Extent {
    pub(super) all: u64,
    pub(super) any: u64,
}

impl Extent {
    pub(super) fn of(block: &Block) -> Self {
        Self { all: block.iter().fold(u64::MAX, |all, row| all & row), any: block.iter().fold(0, |any, row| any | row) }
    }

    pub(super) fn kind(self, tile: usize) -> Kind {
        let byte = 0xFF << (tile * 8);
        if self.any & byte == 0 {
            Kind::Dark
        } else if self.all & byte == byte {
            Kind::Lit
        } else {
            Kind::Mixed
        }
    }

    /// Returns the value of every pixel, or `None` if they differ.
    pub(super) const fn value(self) -> Option<bool> {
        match (self.all, self.any) {
            (_, 0) => Some(false),
            (u64::MAX, _) => Some(true),
            _ => None,
        }
    }
}

/// A block and its extent, which is often needed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct DecodedBlock {
    pub(super) rows: Block,
    pub(super) extent: Extent,
}

impl DecodedBlock {
    pub(super) fn new(rows: Block) -> Self {
        Self { rows, extent: Extent::of(&rows) }
    }

    pub(super) const fn flat(value: bool) -> Self {
        let row = if value { u64::MAX } else { 0 };
        Self { rows: [row; 8], extent: Extent { all: row, any: row } }
    }
}

/// Returns the block at a place. Pixels outside the picture repeat the picture's edge, so that they make no tile mixed.
/// A decoder does not restore them.
pub(super) fn gather(mask: &Mask, order: &Order, place: Place) -> DecodedBlock {
    let shape = mask.shape();
    let words = &mask.words()[place.light * shape.tiles()..][order.tiles(place)];
    let height = shape.height() as usize - place.y * TILE_PX as usize;
    let columns = shape.width() as usize - place.x * BLOCK_TILES * TILE_PX as usize;
    if columns >= 64 && height >= 8 {
        match words.iter().fold((u64::MAX, 0), |(all, any), word| (all & word, any | word)) {
            (_, 0) => return DecodedBlock::flat(false),
            (u64::MAX, _) => return DecodedBlock::flat(true),
            _ => {}
        }
    }
    let mut tiles = [0; BLOCK_TILES];
    for (tile, word) in tiles.iter_mut().zip(words) {
        *tile = *word;
    }
    let mut rows = transpose_bytes(tiles);
    if columns < 64 {
        for row in &mut rows {
            let last = *row >> (columns - 1) & 1;
            *row = *row & !(u64::MAX << columns) | last.wrapping_neg() << columns;
        }
    }
    if height < rows.len() {
        let last = rows[height - 1];
        rows[height..].fill(last);
    }
    DecodedBlock::new(rows)
}

/// Returns the block of [`gather`] as tiles instead of rows.
#[inline(always)]
pub(super) fn gather_tiles(mask: &Mask, order: &Order, place: Place) -> Block {
    let shape = mask.shape();
    let words = &mask.words()[place.light * shape.tiles()..][order.tiles(place)];
    match words.first_chunk() {
        Some(tiles) if !is_at_edge(shape, place) => *tiles,
        _ => transpose_bytes(gather(mask, order, place).rows),
    }
}

/// True if some of the block may lie outside the picture.
const fn is_at_edge(shape: MaskShape, place: Place) -> bool {
    shape.tiles_x() as usize <= (place.x + 1) * BLOCK_TILES || shape.tiles_y() as usize == place.y + 1
}

/// Writes the block's tiles into the mask, with 0 outside the picture.
pub(super) fn scatter(order: &Order, place: Place, known: &DecodedBlock, mask: &mut Mask) {
    let flat = known.extent.value().is_some();
    let tiles = if flat { known.rows } else { transpose_bytes(known.rows) };
    scatter_tiles(order, place, &tiles, mask);
}

/// As [`scatter`], for tiles.
#[inline(always)]
pub(super) fn scatter_tiles(order: &Order, place: Place, tiles: &Block, mask: &mut Mask) {
    let shape = mask.shape();
    let plane = &mut mask.words_mut()[place.light * shape.tiles()..][order.tiles(place)];
    if !is_at_edge(shape, place)
        && let Some(plane) = plane.first_chunk_mut()
    {
        *plane = *tiles;
        return;
    }
    for ((x, word), tile) in (place.x * BLOCK_TILES..).zip(plane).zip(tiles) {
        *word = tile & inside(shape, x, place.y);
    }
}
