//! The visibility mask: one bit per pixel and light, in 8×8 tiles.
//!
//! Bit k of pixel p is 1 if the segment from the surface point seen at p's centre to light k is unoccluded.
//! A plane holds one light. Its tiles follow each other row by row, one `u64` a tile. Bit `8·(y mod 8) + (x mod 8)` of
//! a tile is pixel (x, y). Pixels outside the picture are 0. Tiles are what a workgroup traces, and their bytes
//! compress better than rows of the picture.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::limits::{MAX_LIGHTS, MAX_PIXELS, MAX_SIDE_PX};

/// Side of a tile in pixels.
pub const TILE_PX: u32 = 8;

/// Width, height and number of lights of a mask. Always within [`crate::limits`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "(u32, u32, u32)", into = "(u32, u32, u32)")]
pub struct MaskShape {
    width: u32,
    height: u32,
    lights: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum ShapeError {
    #[error("{width}×{height} pixels: each side must be 1 to {MAX_SIDE_PX} and the area at most {MAX_PIXELS}")]
    Size { width: u32, height: u32 },
    #[error("{0} lights: a mask has 1 to {MAX_LIGHTS}")]
    Lights(u32),
    #[error("{found} words of mask where the shape has {expected}")]
    Words { expected: usize, found: usize },
}

impl MaskShape {
    /// A picture of `width`×`height` pixels with `lights` planes.
    ///
    /// # Errors
    /// If a side is 0 or longer than [`MAX_SIDE_PX`], the area exceeds [`MAX_PIXELS`], or `lights` is not 1 to
    /// [`MAX_LIGHTS`].
    pub fn new(width: u32, height: u32, lights: u32) -> Result<Self, ShapeError> {
        if !(1..=MAX_SIDE_PX).contains(&width) || !(1..=MAX_SIDE_PX).contains(&height) || width * height > MAX_PIXELS {
            return Err(ShapeError::Size { width, height });
        }
        if !(1..=MAX_LIGHTS).contains(&lights) {
            return Err(ShapeError::Lights(lights));
        }
        Ok(Self { width, height, lights })
    }

    #[must_use]
    pub const fn width(self) -> u32 {
        self.width
    }

    #[must_use]
    pub const fn height(self) -> u32 {
        self.height
    }

    #[must_use]
    pub const fn lights(self) -> u32 {
        self.lights
    }

    #[must_use]
    pub const fn pixels(self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Tiles in a row of tiles.
    #[must_use]
    pub const fn tiles_x(self) -> u32 {
        self.width.div_ceil(TILE_PX)
    }

    #[must_use]
    pub const fn tiles_y(self) -> u32 {
        self.height.div_ceil(TILE_PX)
    }

    /// Tiles, and so `u64` words, in a plane.
    #[must_use]
    pub const fn tiles(self) -> usize {
        self.tiles_x() as usize * self.tiles_y() as usize
    }

    /// `u64` words in the whole mask.
    #[must_use]
    pub const fn words(self) -> usize {
        self.tiles() * self.lights as usize
    }
}

impl TryFrom<(u32, u32, u32)> for MaskShape {
    type Error = ShapeError;

    fn try_from((width, height, lights): (u32, u32, u32)) -> Result<Self, ShapeError> {
        Self::new(width, height, lights)
    }
}

impl From<MaskShape> for (u32, u32, u32) {
    fn from(shape: MaskShape) -> Self {
        (shape.width, shape.height, shape.lights)
    }
}

/// One frame's visibility. The module documents the layout.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mask {
    shape: MaskShape,
    words: Vec<u64>,
}

impl Mask {
    /// Every bit is 0.
    #[must_use]
    pub fn new(shape: MaskShape) -> Self {
        Self { shape, words: vec![0; shape.words()] }
    }

    /// `words` goes plane after plane.
    ///
    /// # Errors
    /// If the number of words is not [`MaskShape::words`].
    pub fn from_words(shape: MaskShape, words: Vec<u64>) -> Result<Self, ShapeError> {
        if words.len() != shape.words() {
            return Err(ShapeError::Words { expected: shape.words(), found: words.len() });
        }
        Ok(Self { shape, words })
    }

    /// Changes the shape and sets every bit to 0, reusing the memory.
    pub fn reset(&mut self, shape: MaskShape) {
        self.shape = shape;
        self.words.clear();
        self.words.resize(shape.words(), 0);
    }

    #[must_use]
    pub const fn shape(&self) -> MaskShape {
        self.shape
    }

    /// All words, plane after plane.
    #[must_use]
    pub fn words(&self) -> &[u64] {
        &self.words
    }

    pub fn words_mut(&mut self) -> &mut [u64] {
        &mut self.words
    }

    /// Returns whether light `light` reaches pixel (x, y).
    ///
    /// # Panics
    /// If the light or the pixel is outside the shape.
    #[must_use]
    pub fn get(&self, light: u32, x: u32, y: u32) -> bool {
        let (word, bit) = self.place(light, x, y);
        self.words[word] >> bit & 1 == 1
    }

    /// Sets whether light `light` reaches pixel (x, y).
    ///
    /// # Panics
    /// If the light or the pixel is outside the shape.
    pub fn set(&mut self, light: u32, x: u32, y: u32, lit: bool) {
        let (word, bit) = self.place(light, x, y);
        self.words[word] = self.words[word] & !(1 << bit) | u64::from(lit) << bit;
    }

    fn place(&self, light: u32, x: u32, y: u32) -> (usize, u32) {
        let shape = self.shape;
        assert!(light < shape.lights && x < shape.width && y < shape.height, "({light}, {x}, {y}) outside {shape:?}");
        let tile = (y / TILE_PX) as usize * shape.tiles_x() as usize + (x / TILE_PX) as usize;
        (light as usize * shape.tiles() + tile, y % TILE_PX * TILE_PX + x % TILE_PX)
    }
}

/// Returns the bits of a tile that are inside the picture.
pub(crate) fn inside(shape: MaskShape, tile_x: usize, tile_y: usize) -> u64 {
    let side = TILE_PX as usize;
    let columns = (shape.width() as usize - tile_x * side).min(side);
    let rows = (shape.height() as usize - tile_y * side).min(side);
    let row = 0xFF >> (side - columns);
    let below = u64::MAX >> (64 - rows * side);
    (row * 0x0101_0101_0101_0101) & below
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_outside_the_limits_are_refused() {
        for (w, h) in [(0, 1), (1, 0), (MAX_SIDE_PX + 1, 1), (1, u32::MAX), (MAX_SIDE_PX, MAX_SIDE_PX)] {
            assert_eq!(MaskShape::new(w, h, 1), Err(ShapeError::Size { width: w, height: h }));
        }
        for lights in [0, 33, u32::MAX] {
            assert_eq!(MaskShape::new(8, 8, lights), Err(ShapeError::Lights(lights)));
        }
        assert_eq!(MaskShape::new(3840, 2160, 32).map(MaskShape::tiles), Ok(480 * 270));
    }

    #[test]
    fn every_bit_has_its_own_place() {
        let shape = MaskShape::new(19, 11, 3).unwrap();
        let mut seen = std::collections::HashSet::new();
        for light in 0..3 {
            for y in 0..11 {
                for x in 0..19 {
                    let mut mask = Mask::new(shape);
                    mask.set(light, x, y, true);
                    assert!(mask.get(light, x, y));
                    assert_eq!(mask.words().iter().map(|w| w.count_ones()).sum::<u32>(), 1);
                    assert!(seen.insert(mask.words().to_vec()));
                    mask.set(light, x, y, false);
                    assert_eq!(mask, Mask::new(shape));
                }
            }
        }
    }

    #[test]
    fn the_layout_is_tiles_of_eight_by_eight() {
        let mut mask = Mask::new(MaskShape::new(24, 16, 2).unwrap());
        mask.set(1, 9, 10, true);
        let mut expected = [0; 12];
        expected[6 + 3 + 1] = 1 << (2 * 8 + 1);
        assert_eq!(mask.words(), expected);
    }
}
