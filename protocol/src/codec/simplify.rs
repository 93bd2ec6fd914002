//! Makes a frame lossy before it is coded: flips pixels that stand out, within a budget of wrong bits.
//!
//! A pixel that differs from its surroundings costs many bits and matters little. Each flip shortens the border between
//! light and shadow by two or more pixel sides. The choice depends only on the mask and the budget, so it is the same
//! on every machine. Both ends know only the result, which is also the reference of later frames.

use crate::{
    limits::MAX_WRONG_PPM,
    mask::{Mask, MaskShape, inside},
};

/// Kinds of pixels that stand out, the best first; each kind includes the one before.
///
/// 0. All four neighbours and all four corner neighbours differ.
/// 1. All four neighbours differ.
/// 2. Three neighbours differ: bumps, notches, ends of lines.
const KINDS: usize = 3;

/// Kinds in the order of passes. The last kind has the most pixels: its second pass spends what its first left.
const PASSES: [usize; KINDS + 1] = [0, 1, 2, 2];

/// Most times that a pass visits a tile: removing the end of a line makes a new end.
const ROUNDS: usize = 3;

/// Every other pixel. No two are neighbours, within a tile or across tiles, so all can be flipped at once.
const CHESSBOARD: [u64; 2] = [0xAA55_AA55_AA55_AA55, 0x55AA_55AA_55AA_55AA];

const FIRST_COLUMN: u64 = 0x0101_0101_0101_0101;
const LAST_COLUMN: u64 = FIRST_COLUMN << 7;
const FIRST_ROW: u64 = 0xFF;

/// Flips pixels. Reuses its memory from frame to frame.
#[derive(Debug, Default)]
pub struct Simplifier {
    /// Indices of words that are neither 0 nor all ones; has room for every word.
    mixed: Vec<u32>,
    /// Indices of words with pixels of each kind.
    found: [Vec<u32>; KINDS],
}

impl Simplifier {
    /// Flips at most `wrong_ppm` millionths of the mask's bits, never more than [`MAX_WRONG_PPM`]. Returns how many. If
    /// more pixels stand out, the flips are spread over the frame.
    pub fn simplify(&mut self, mask: &mut Mask, wrong_ppm: u16) -> u64 {
        let shape = mask.shape();
        let bits = shape.pixels() as u64 * u64::from(shape.lights());
        let budget = bits * u64::from(wrong_ppm.min(MAX_WRONG_PPM)) / 1_000_000;
        if budget == 0 {
            return 0;
        }
        self.find(mask);
        let mut left = budget;
        for kind in PASSES {
            left -= turn(mask, &self.found[kind], kind, left);
        }
        budget - left
    }

    fn find(&mut self, mask: &Mask) {
        let (shape, words) = (mask.shape(), mask.words());
        if self.mixed.len() < words.len() {
            self.mixed.resize(words.len(), 0);
        }
        // A word of one value has no pixel that stands out. Branchless, because a branch would be mispredicted.
        let mut mixed = 0;
        for (word, pixels) in (0..).zip(words) {
            self.mixed[mixed] = word;
            mixed += usize::from(pixels.wrapping_add(1) > 1);
        }
        self.found.iter_mut().for_each(Vec::clear);
        for (word, place) in places(shape, &self.mixed[..mixed]) {
            // The last kind first, because it includes the others.
            for kind in (0..KINDS).rev() {
                if place.pixels(words, kind) == 0 {
                    break;
                }
                self.found[kind].push(word);
            }
        }
    }
}

/// Flips at most `limit` pixels of a kind in the words `found`. Returns how many.
fn turn(mask: &mut Mask, found: &[u32], kind: usize, limit: u64) -> u64 {
    let shape = mask.shape();
    let words = mask.words_mut();
    let mut turned = 0;
    for (number, (_, place)) in (1..).zip(places(shape, found)) {
        // The limit is shared out evenly; a word may also use what those before it left.
        let due = number * limit / found.len() as u64;
        if turned == due {
            continue;
        }
        let mut pixels = place.pixels(words, kind);
        for half in CHESSBOARD.into_iter().cycle().take(2 * ROUNDS) {
            if pixels == 0 || turned == due {
                break;
            }
            let chosen = first_of(pixels & half, due - turned);
            if chosen != 0 {
                words[place.word] ^= chosen;
                turned += u64::from(chosen.count_ones());
                pixels = place.pixels(words, kind);
            }
        }
    }
    turned
}

/// Returns the lowest `count` of these pixels.
fn first_of(pixels: u64, count: u64) -> u64 {
    if u64::from(pixels.count_ones()) <= count {
        return pixels;
    }
    let rest = (0..count).fold(pixels, |rest, _| rest & rest.wrapping_sub(1));
    pixels & !rest
}

/// Returns each word with its place. `words` are ascending indices in the whole mask. Rows are counted because a
/// division would cost more than all the rest.
fn places(shape: MaskShape, words: &[u32]) -> impl Iterator<Item = (u32, Place)> {
    let (mut y, mut row) = (0, 0);
    words.iter().map(move |&word| {
        while word - row >= shape.tiles_x() {
            (y, row) = ((y + 1) % shape.tiles_y(), row + shape.tiles_x());
        }
        (word, Place::new(shape, word, (word - row, y)))
    })
}

/// A word of a mask and its surroundings.
#[derive(Debug, Clone, Copy)]
struct Place {
    word: usize,
    tiles_x: usize,
    /// Pixels that have a neighbour to the left, to the right, above and below.
    with: [u64; 4],
}

impl Place {
    /// `word` is an index in the whole mask; `x` and `y` count its tile from the left and from the top.
    #[inline]
    fn new(shape: MaskShape, word: u32, (x, y): (u32, u32)) -> Self {
        let (is_first_x, is_last_x) = (x == 0, x + 1 == shape.tiles_x());
        let (is_first_y, is_last_y) = (y == 0, y + 1 == shape.tiles_y());
        let mut with = [u64::MAX; 4];
        if is_first_x || is_last_x || is_first_y || is_last_y {
            let inside = inside(shape, x as usize, y as usize);
            let left = if is_first_x { !FIRST_COLUMN } else { u64::MAX };
            let right = if is_last_x { inside >> 1 & !LAST_COLUMN } else { u64::MAX };
            let above = if is_first_y { !FIRST_ROW } else { u64::MAX };
            let below = if is_last_y { inside >> 8 } else { u64::MAX };
            with = [left, right, above, below].map(|pixels| pixels & inside);
        }
        Self { word: word as usize, tiles_x: shape.tiles_x() as usize, with }
    }

    /// Returns the word's pixels of a kind.
    #[inline(always)]
    fn pixels(&self, words: &[u64], kind: usize) -> u64 {
        let [left, right, above, below] = self.differing(words);
        let (across, down) = (left & right, above & below);
        match kind {
            0 if across & down != 0 => across & down & self.differing_at_corners(words),
            0 | 1 => across & down,
            _ => across & (above | below) | down & (left | right),
        }
    }

    /// Returns the word and those to the left, to the right, above and below. A missing word may have any value.
    #[inline(always)]
    fn cross(&self, words: &[u64]) -> [u64; 5] {
        let steps = [0, 1_usize.wrapping_neg(), 1, self.tiles_x.wrapping_neg(), self.tiles_x];
        steps.map(|step| words.get(self.word.wrapping_add(step)).copied().unwrap_or_default())
    }

    /// Returns the pixels that differ from the neighbour to the left, to the right, above and below. A missing
    /// neighbour never differs.
    #[inline(always)]
    fn differing(&self, words: &[u64]) -> [u64; 4] {
        let [own, left, right, above, below] = self.cross(words);
        let there = [from_left(own, left), from_right(own, right), from_above(own, above), from_below(own, below)];
        std::array::from_fn(|side| (own ^ there[side]) & self.with[side])
    }

    /// Returns the pixels that differ from all four corner neighbours. Only valid for pixels with four neighbours.
    fn differing_at_corners(&self, words: &[u64]) -> u64 {
        let [own, left, right, above, below] = self.cross(words);
        let row = |step| Self { word: self.word.wrapping_add(step), ..*self }.cross(words);
        let [_, above_left, above_right, ..] = row(self.tiles_x.wrapping_neg());
        let [_, below_left, below_right, ..] = row(self.tiles_x);
        let (upper, lower) = (from_above(own, above), from_below(own, below));
        (own ^ from_left(upper, from_above(left, above_left)))
            & (own ^ from_right(upper, from_above(right, above_right)))
            & (own ^ from_left(lower, from_below(left, below_left)))
            & (own ^ from_right(lower, from_below(right, below_right)))
    }
}

/// The left neighbour of each pixel.
const fn from_left(own: u64, left: u64) -> u64 {
    (own & !LAST_COLUMN) << 1 | (left & LAST_COLUMN) >> 7
}

const fn from_right(own: u64, right: u64) -> u64 {
    (own & !FIRST_COLUMN) >> 1 | (right & FIRST_COLUMN) << 7
}

const fn from_above(own: u64, above: u64) -> u64 {
    own << 8 | above >> 56
}

const fn from_below(own: u64, below: u64) -> u64 {
    own >> 8 | below << 56
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Noise: one pixel in `2^thin` is lit.
    fn noise(shape: MaskShape, thin: u32, mut seed: u64) -> Mask {
        let mut mask = Mask::new(shape);
        for light in 0..shape.lights() {
            for (x, y) in (0..shape.height()).flat_map(|y| (0..shape.width()).map(move |x| (x, y))) {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                mask.set(light, x, y, seed >> 33 & ((1 << thin) - 1) == 0);
            }
        }
        mask
    }

    /// Reference implementation, pixel by pixel.
    fn is_of_kind(mask: &Mask, kind: usize, [light, x, y]: [u32; 3]) -> bool {
        let differs = |dx: u32, dy: u32| {
            let (x_2, y_2) = (x.wrapping_add(dx), y.wrapping_add(dy));
            let within = x_2 < mask.shape().width() && y_2 < mask.shape().height();
            within && mask.get(light, x_2, y_2) != mask.get(light, x, y)
        };
        let back = u32::MAX;
        let sides = [(back, 0), (1, 0), (0, back), (0, 1)].iter().filter(|(x, y)| differs(*x, *y)).count();
        let corners = [(back, back), (1, back), (back, 1), (1, 1)].iter().filter(|(x, y)| differs(*x, *y)).count();
        match kind {
            0 => sides == 4 && corners == 4,
            1 => sides == 4,
            _ => sides >= 3,
        }
    }

    /// Counts pixel sides between light and shadow.
    fn border(mask: &Mask) -> u64 {
        let shape = mask.shape();
        let mut sides = 0;
        for light in 0..shape.lights() {
            for (x, y) in (0..shape.height()).flat_map(|y| (0..shape.width()).map(move |x| (x, y))) {
                let own = mask.get(light, x, y);
                sides += u64::from(x + 1 < shape.width() && mask.get(light, x + 1, y) != own);
                sides += u64::from(y + 1 < shape.height() && mask.get(light, x, y + 1) != own);
            }
        }
        sides
    }

    fn differing_bits(a: &Mask, b: &Mask) -> u64 {
        a.words().iter().zip(b.words()).map(|(a, b)| u64::from((a ^ b).count_ones())).sum()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn word_search_matches_pixel_search(
            width in 1_u32..30, height in 1_u32..30, lights in 1_u32..3, thin in 1_u32..5, seed: u64,
        ) {
            let shape = MaskShape::new(width, height, lights).unwrap();
            let mask = noise(shape, thin, seed);
            for kind in 0..KINDS {
                let mut expected = Mask::new(shape);
                for light in 0..lights {
                    for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
                        expected.set(light, x, y, is_of_kind(&mask, kind, [light, x, y]));
                    }
                }
                let all: Vec<u32> = (0..u32::try_from(shape.words()).unwrap()).collect();
                let found: Vec<u64> = places(shape, &all).map(|(_, place)| place.pixels(mask.words(), kind)).collect();
                prop_assert_eq!(&found, expected.words());
                // The search of a whole mask misses none.
                let mut simplifier = Simplifier::default();
                simplifier.find(&mask);
                let with_some = (0..).zip(&found).filter(|(_, pixels)| **pixels != 0).map(|(word, _)| word);
                prop_assert_eq!(&simplifier.found[kind], &with_some.collect::<Vec<u32>>());
            }
        }

        #[test]
        fn the_budget_holds_and_each_wrong_bit_shortens_the_border(
            width in 1_u32..200, height in 1_u32..120, lights in 1_u32..4, thin in 1_u32..6, seed: u64,
            wrong_ppm in prop_oneof![Just(0_u16), 1..=MAX_WRONG_PPM, Just(u16::MAX)],
        ) {
            let shape = MaskShape::new(width, height, lights).unwrap();
            let before = noise(shape, thin, seed);
            let mut mask = before.clone();
            let turned = Simplifier::default().simplify(&mut mask, wrong_ppm);
            let bits = u64::from(width) * u64::from(height) * u64::from(lights);
            prop_assert!(turned <= bits * u64::from(wrong_ppm.min(MAX_WRONG_PPM)) / 1_000_000);
            prop_assert_eq!(turned, differing_bits(&before, &mask));
            prop_assert!(border(&mask) + 2 * turned <= border(&before));
            if wrong_ppm == 0 {
                prop_assert_eq!(mask, before);
            }
        }
    }

    #[test]
    fn isolated_pixels_are_flipped_before_bumps() {
        let shape = MaskShape::new(100, 100, 1).unwrap();
        let mut mask = Mask::new(shape);
        // An edge with a bump across the border of two tiles, and three specks.
        (0..40).for_each(|y| (0..100).for_each(|x| mask.set(0, x, y, true)));
        mask.set(0, 64, 40, true);
        let edge_with_bump = mask.clone();
        for [x, y] in [[20, 20], [31, 8], [77, 87]] {
            mask.set(0, x, y, y > 40);
        }
        let mut simplifier = Simplifier::default();
        let simplified = |simplifier: &mut Simplifier, wrong_ppm| {
            let mut mask = mask.clone();
            let turned = simplifier.simplify(&mut mask, wrong_ppm);
            (mask, turned)
        };
        assert_eq!(simplified(&mut simplifier, 99), (mask.clone(), 0));
        assert_eq!(simplified(&mut simplifier, 200).1, 2);
        assert_eq!(simplified(&mut simplifier, 300), (edge_with_bump.clone(), 3));
        let mut edge = edge_with_bump;
        edge.set(0, 64, 40, false);
        assert_eq!(simplified(&mut simplifier, MAX_WRONG_PPM), (edge, 4));
    }

    #[test]
    fn a_small_budget_is_spread_over_the_frame() {
        let shape = MaskShape::new(800, 800, 1).unwrap();
        let mut mask = Mask::new(shape);
        (0..800).step_by(8).for_each(|y| (0..800).step_by(8).for_each(|x| mask.set(0, x + 3, y + 3, true)));
        let before = mask.clone();
        assert_eq!(Simplifier::default().simplify(&mut mask, 1000), 640);
        let quarters = before.words().chunks(2500).zip(mask.words().chunks(2500));
        for (before, after) in quarters {
            assert_eq!(before.iter().zip(after).filter(|(before, after)| before != after).count(), 160);
        }
    }

    #[test]
    fn memory_is_kept_from_frame_to_frame() {
        let shape = MaskShape::new(333, 222, 4).unwrap();
        let mut simplifier = Simplifier::default();
        let held = |simplifier: &Simplifier| {
            [&simplifier.mixed, &simplifier.found[0], &simplifier.found[1], &simplifier.found[2]]
                .map(|words| (words.as_ptr(), words.capacity()))
        };
        let masks = [1, 2, 3, 5].map(|thin| noise(shape, thin, 1));
        for mask in &masks {
            simplifier.simplify(&mut mask.clone(), 5000);
        }
        let warm = held(&simplifier);
        for mask in &masks {
            assert!(simplifier.simplify(&mut mask.clone(), 5000) > 0);
            assert_eq!(held(&simplifier), warm);
        }
    }

    /// Integer arithmetic makes this hold everywhere.
    #[test]
    fn the_result_is_the_same_on_any_machine() {
        let mut mask = noise(MaskShape::new(203, 101, 3).unwrap(), 3, 7);
        let turned = Simplifier::default().simplify(&mut mask, 5000);
        let sum =
            mask.words().iter().fold(0_u64, |sum, word| sum.rotate_left(5) ^ word.wrapping_mul(0x9E37_79B9_7F4A_7C15));
        assert_eq!((turned, sum), (307, 0x18D5_3312_6138_A2B1));
    }
}
