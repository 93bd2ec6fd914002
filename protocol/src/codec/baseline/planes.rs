//! Bit planes as bytes, in the mask's layout: for each light the slice's tiles, row by row, a little-endian u64 each.

use std::ops::Range;

use crate::mask::{MaskShape, inside};

pub(super) const TILE_BYTES: usize = 8;

/// Bits outside the picture are set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct StrayPixels {
    pub(super) light: usize,
    pub(super) tile: usize,
}

/// Returns the slice's tiles at the picture's right and lower edge: index in the plane, and bits inside the picture.
fn edge_tiles(shape: MaskShape, rows: Range<usize>) -> impl Iterator<Item = (usize, u64)> {
    let (last_x, last_y) = (shape.tiles_x() as usize - 1, shape.tiles_y() as usize - 1);
    rows.flat_map(move |y| {
        let from = if y == last_y { 0 } else { last_x };
        (from..=last_x).map(move |x| (y * (last_x + 1) + x, inside(shape, x, y)))
    })
}

/// Writes the planes of the rows of tiles `rows` into `bytes`, which has exactly their length. Bits outside the picture
/// become 0.
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
