//! Bit planes to the dissertation's words and back: a u32 a pixel, bit k for light k, row by row, little-endian.
//!
//! Works on one row of tiles at a time. In a tile, eight lights make an 8×8×8 cube of bits (light, row, column); words
//! need (row, column, light). One transposition of bytes and eight of bits convert it in registers.

use crate::{
    codec::transpose::{transpose_bits, transpose_bytes},
    mask::{MaskShape, TILE_PX},
};

const SIDE: usize = TILE_PX as usize;

pub(super) const WORD_BYTES: usize = 4;

type TileWords = [[u32; SIDE]; SIDE];

/// Bits without a light in the frame are set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct StrayLights(pub(super) u32);

/// Writes the words of one row of tiles into `bytes`, which has exactly their length.
pub(super) fn from_planes(shape: MaskShape, planes: &[u64], tile_row: usize, bytes: &mut [u8]) {
    let row_bytes = shape.width() as usize * WORD_BYTES;
    let lights = shape.lights() as usize;
    let tiles_x = shape.tiles_x() as usize;
    for tile_x in 0..tiles_x {
        let mut tile = [0; 32];
        let tile_planes = planes.chunks_exact(shape.tiles());
        for (light, plane) in tile[..lights].iter_mut().zip(tile_planes) {
            *light = plane[tile_row * tiles_x + tile_x];
        }
        let words = words_of(&tile, lights);
        let place = tile_x * SIDE * WORD_BYTES;
        for (row, words) in bytes.chunks_exact_mut(row_bytes).zip(&words) {
            let row = &mut row[place..];
            let (pixels, _) = row.as_chunks_mut::<WORD_BYTES>();
            // Writes 8 words, or fewer at the right edge.
            for (pixel, word) in pixels.iter_mut().zip(words) {
                *pixel = word.to_le_bytes();
            }
        }
    }
}

/// Reads the words of one row of tiles into the planes. Bits outside the picture become 0.
pub(super) fn to_planes(
    shape: MaskShape,
    bytes: &[u8],
    tile_row: usize,
    planes: &mut [u64],
) -> Result<(), StrayLights> {
    let row_bytes = shape.width() as usize * WORD_BYTES;
    let lights = shape.lights() as usize;
    let tiles_x = shape.tiles_x() as usize;
    let mut all = 0;
    for tile_x in 0..tiles_x {
        let mut words: TileWords = [[0; SIDE]; SIDE];
        let place = tile_x * SIDE * WORD_BYTES;
        for (row, words) in bytes.chunks_exact(row_bytes).zip(&mut words) {
            let (pixels, _) = row[place..].as_chunks::<WORD_BYTES>();
            for (pixel, word) in pixels.iter().zip(words) {
                *word = u32::from_le_bytes(*pixel);
                all |= *word;
            }
        }
        let tile = planes_of(&words, lights);
        let tile_planes = planes.chunks_exact_mut(shape.tiles());
        for (light, plane) in tile[..lights].iter().zip(tile_planes) {
            plane[tile_row * tiles_x + tile_x] = *light;
        }
    }
    match u64::from(all) >> lights {
        0 => Ok(()),
        _ => Err(StrayLights(all)),
    }
}

fn words_of(planes: &[u64; 32], lights: usize) -> TileWords {
    let mut words: TileWords = [[0; SIDE]; SIDE];
    for (group, eight) in planes.as_chunks::<8>().0[..lights.div_ceil(8)].iter().enumerate() {
        let rows = transpose_bytes(*eight);
        for (words, row) in words.iter_mut().zip(rows) {
            for (word, byte) in words.iter_mut().zip(transpose_bits(row).to_le_bytes()) {
                *word |= u32::from(byte) << (8 * group);
            }
        }
    }
    words
}

fn planes_of(words: &TileWords, lights: usize) -> [u64; 32] {
    let mut planes = [0; 32];
    for (group, eight) in planes.as_chunks_mut::<8>().0[..lights.div_ceil(8)].iter_mut().enumerate() {
        let rows = words.map(|words| {
            let bytes = words.map(|word| word.to_le_bytes()[group]);
            transpose_bits(u64::from_le_bytes(bytes))
        });
        *eight = transpose_bytes(rows);
    }
    planes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bit_of_a_tile_becomes_one_bit_of_a_word() {
        for light in 0..32 {
            for place in 0..64 {
                let mut planes = [0; 32];
                planes[light] = 1 << place;
                let words = words_of(&planes, light + 1);
                let mut expected: TileWords = [[0; SIDE]; SIDE];
                expected[place / 8][place % 8] = 1 << light;
                assert_eq!(words, expected, "light {light}, place {place}");
                assert_eq!(planes_of(&words, light + 1), planes);
            }
        }
    }
}
