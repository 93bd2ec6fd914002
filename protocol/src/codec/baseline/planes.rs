//! Bit planes as bytes: for each light the slice's tiles, row by row, a u64 each, little-endian. The mask's own layout.

use std::ops::Range;

use crate::mask::{MaskShape, inside};

/// Bytes of a tile.
pub(super) const TILE_BYTES: usize = 8;

/// Bits outside the picture are set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct StrayPixels {
    pub(super) light: usize,
    pub(super) tile: usize,
}

/// The tiles of a slice, as places in a plane, that lie across the picture's right or lower edge.
fn edge_tiles(shape: MaskShape, rows: Range<usize>) -> impl Iterator<Item = (usize, u64)> {
    let (last_x, last_y) = (shape.tiles_x() as usize - 1, shape.tiles_y() as usize - 1);
    rows.flat_map(move |y| {
        let from = if y == last_y { 0 } else { last_x };
        (from..=last_x).map(move |x| (y * (last_x + 1) + x, inside(shape, x, y)))
    })
}

/// Writes the planes of the rows of tiles `rows`; `bytes` has room for exactly these. Bits outside the picture are
/// written as 0, whatever they are.
pub(super) fn write(shape: MaskShape, planes: &[u64], rows: &Range<usize>, bytes: &mut [u8]) {
    let tiles_x = shape.tiles_x() as usize;
    let part = rows.start * tiles_x..rows.end * tiles_x;
    let parts = bytes.chunks_exact_mut(part.len() * TILE_BYTES);
    for (plane, bytes) in planes.chunks_exact(shape.tiles()).zip(parts) {
        let (tiles, _) = bytes.as_chunks_mut::<TILE_BYTES>();
        for (tile, word) in tiles.iter_mut().zip(&plane[part.clone()]) {
            *tile = word.to_le_bytes();
        }
        for (place, inside) in edge_tiles(shape, rows.clone()) {
            tiles[place - part.start] = (plane[place] & inside).to_le_bytes();
        }
    }
}

/// Reads the planes of the rows of tiles `rows`.
pub(super) fn read(shape: MaskShape, bytes: &[u8], rows: &Range<usize>, planes: &mut [u64]) -> Result<(), StrayPixels> {
    let tiles_x = shape.tiles_x() as usize;
    let part = rows.start * tiles_x..rows.end * tiles_x;
    let parts = bytes.chunks_exact(part.len() * TILE_BYTES);
    for (light, (plane, bytes)) in planes.chunks_exact_mut(shape.tiles()).zip(parts).enumerate() {
        let (tiles, _) = bytes.as_chunks::<TILE_BYTES>();
        for (tile, word) in tiles.iter().zip(&mut plane[part.clone()]) {
            *word = u64::from_le_bytes(*tile);
        }
        for (place, inside) in edge_tiles(shape, rows.clone()) {
            if plane[place] & !inside != 0 {
                return Err(StrayPixels { light, tile: place });
            }
        }
    }
    Ok(())
}
