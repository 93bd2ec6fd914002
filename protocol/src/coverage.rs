//! Which parts of a mask have arrived. Sliced frames can arrive in part; a bit that has not arrived means nothing.

use crate::{
    limits::{MAX_LAYER_BYTES, MAX_LAYERS},
    mask::MaskShape,
};

/// Tiles across a place: 64×8 pixels of a light, the smallest unit that arrives.
pub const PLACE_TILES: u32 = 8;

/// Returns how many masks of this shape a client keeps, to look up what is missing in newer ones.
#[must_use]
pub fn max_layers(shape: MaskShape) -> usize {
    (MAX_LAYER_BYTES / (shape.pixels() * 8)).clamp(2, MAX_LAYERS)
}

/// For each place of a mask, a bit for every light that has arrived there.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Coverage {
    shape: MaskShape,
    words: Vec<u32>,
}

impl Coverage {
    /// Coverage of a mask that has arrived whole.
    #[must_use]
    pub fn whole(shape: MaskShape) -> Self {
        let mut coverage = Self { shape, words: Vec::new() };
        coverage.set_whole(shape);
        coverage
    }

    /// Marks a mask of this shape as arrived whole.
    pub fn set_whole(&mut self, shape: MaskShape) {
        self.reset(shape, u32::MAX >> (32 - shape.lights()));
    }

    /// Marks a mask of this shape as missing.
    pub fn set_none(&mut self, shape: MaskShape) {
        self.reset(shape, 0);
    }

    fn reset(&mut self, shape: MaskShape, word: u32) {
        self.shape = shape;
        self.words.clear();
        self.words.resize(Self::places(shape).into_iter().map(|side| side as usize).product(), word);
    }

    /// Marks a light as arrived at a place, counted from the left and from the top. Ignores places outside the mask.
    pub(crate) fn add(&mut self, x: usize, y: usize, light: usize) {
        let across = Self::places(self.shape)[0] as usize;
        if let Some(word) = self.words.get_mut(y * across + x) {
            *word |= 1 << light;
        }
    }

    #[must_use]
    pub const fn shape(&self) -> MaskShape {
        self.shape
    }

    /// Returns the places of a mask of this shape, across and down.
    #[must_use]
    pub const fn places(shape: MaskShape) -> [u32; 2] {
        [shape.tiles_x().div_ceil(PLACE_TILES), shape.tiles_y()]
    }

    /// A word for each place, row by row; bit k is 1 if light k has arrived.
    #[must_use]
    pub fn words(&self) -> &[u32] {
        &self.words
    }

    /// Returns what has arrived of either mask, or of this one if the shapes differ.
    #[must_use]
    pub fn or(mut self, other: &Self) -> Self {
        if self.shape == other.shape {
            self.words.iter_mut().zip(&other.words).for_each(|(word, more)| *word |= more);
        }
        self
    }

    #[must_use]
    pub fn is_whole(&self) -> bool {
        let all = u32::MAX >> (32 - self.shape.lights());
        self.words.iter().all(|word| *word == all)
    }

    /// Returns `None` unless there is one word per place.
    #[must_use]
    pub fn from_words(shape: MaskShape, words: Vec<u32>) -> Option<Self> {
        let [across, down] = Self::places(shape);
        (words.len() == across as usize * down as usize).then_some(Self { shape, words })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_counted_and_filled() {
        let shape = MaskShape::new(65, 17, 2).unwrap();
        assert_eq!(Coverage::places(shape), [2, 3]);
        let mut coverage = Coverage::whole(shape);
        assert!(coverage.is_whole());
        coverage.set_none(shape);
        for (number, (x, y, light)) in (0..12).map(|n| (n, (n % 2, n / 2 % 3, n / 6))) {
            assert!(!coverage.is_whole(), "{number}");
            coverage.add(x, y, light);
        }
        assert!(coverage.is_whole());
        assert_eq!(coverage.words(), [0b11; 6]);
        assert!(Coverage::whole(MaskShape::new(1, 1, 32).unwrap()).is_whole());
        let layers = |width, height| max_layers(MaskShape::new(width, height, 4).unwrap());
        assert_eq!([layers(1, 1), layers(1920, 1080), layers(3840, 2160)], [8, 8, 2]);
        assert!(Coverage::from_words(shape, vec![0; 5]).is_none());
    }
}
