//! Bit planes to the dissertation's words and back: one u32 a pixel, bit k for light k, row by row, little-endian.
//!
//! Works on one row of tiles at a time. In a tile, eight lights make an 8×8×8 cube of bits (light, row, column); words
//! want it as (row, column, light). One transposition of bytes and eight of bits turn it, in registers.

use crate::mask::{MaskShape, TILE_PX};

const SIDE: usize = TILE_PX as usize;

/// Bytes of a word.
pub(super) const WORD_BYTES: usize = 4;

/// The words of one tile: rows of pixels.
type TileWords = [[u32; SIDE]; SIDE];

/// Bits that stand for no light of the frame are set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct StrayLights(pub(super) u32);

/// Writes the words of one row of tiles; `bytes` has room for exactly these.
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

/// One tile's words from its planes.
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

/// One tile's planes from its words.
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

/// Transposes an 8×8 matrix of bits: bit 8r + c goes to 8c + r. Swaps the off-diagonal quarters of every 2×2, then 4×4,
/// then the whole 8×8 block (Warren, Hacker's Delight, §7-3).
const fn transpose_bits(mut bits: u64) -> u64 {
    let mut swap = (bits ^ bits >> 7) & 0x00AA_00AA_00AA_00AA;
    bits ^= swap ^ swap << 7;
    swap = (bits ^ bits >> 14) & 0x0000_CCCC_0000_CCCC;
    bits ^= swap ^ swap << 14;
    swap = (bits ^ bits >> 28) & 0x0000_0000_F0F0_F0F0;
    bits ^ swap ^ swap << 28
}

/// Transposes an 8×8 matrix of bytes, a row in each u64: swaps the off-diagonal quarters of the whole, then of each
/// quarter, and so on.
#[inline]
pub(super) const fn transpose_bytes(rows: [u64; 8]) -> [u64; 8] {
    const fn swap(a: u64, b: u64, shift: u32, low: u64) -> (u64, u64) {
        (a & low | (b & low) << shift, a >> shift & low | b & !low)
    }
    let [a, b, c, d, e, f, g, h] = rows;
    let low = 0x0000_0000_FFFF_FFFF;
    let ((a, e), (b, f), (c, g), (d, h)) =
        (swap(a, e, 32, low), swap(b, f, 32, low), swap(c, g, 32, low), swap(d, h, 32, low));
    let low = 0x0000_FFFF_0000_FFFF;
    let ((a, c), (b, d), (e, g), (f, h)) =
        (swap(a, c, 16, low), swap(b, d, 16, low), swap(e, g, 16, low), swap(f, h, 16, low));
    let low = 0x00FF_00FF_00FF_00FF;
    let ((a, b), (c, d), (e, f), (g, h)) =
        (swap(a, b, 8, low), swap(c, d, 8, low), swap(e, f, 8, low), swap(g, h, 8, low));
    [a, b, c, d, e, f, g, h]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bit_of_a_tile_has_its_place_in_a_word() {
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

    #[test]
    fn transposing_twice_changes_nothing() {
        let rows = [1, 0x0203, 0xFF00_0000_0000_0000, 4, 0x0123_4567_89AB_CDEF, 6, 7, u64::MAX];
        let transposed = transpose_bytes(rows);
        assert_eq!(transposed[7].to_le_bytes(), [0, 0, 0xFF, 0, 0x01, 0, 0, 0xFF]);
        assert_eq!(transpose_bytes(transposed), rows);
        assert_eq!(transpose_bits(1 << 9), 1 << 9);
        assert_eq!(transpose_bits(1 << 7), 1 << 56);
        for row in rows {
            assert_eq!(transpose_bits(transpose_bits(row)), row);
        }
    }
}
