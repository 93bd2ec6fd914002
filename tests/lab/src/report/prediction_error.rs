//! Error of predicted visibility, by place: inside, at shadow edges, or unknown to the mask.

use gnomon_client::render::PixelVisibility;

use crate::reference::{Point, Truth};

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PredictionError {
    pub lights: u32,
    pub relevant: u64,
    /// Wrong bits of points that the mask's view saw, next to a shadow's or surface's edge: the cost of resampling.
    pub known_edge: u64,
    /// Wrong bits of such points without an edge within a pixel.
    pub known_inside: u64,
    /// Wrong bits of points that the mask's view did not see.
    pub unknown: u64,
    /// Of the relevant and of the wrong bits, those near what moves.
    pub relevant_near: u64,
    pub wrong_near: u64,
}

/// How near a pixel is to what moves, across and down, in pixels.
const NEAR_PX: usize = 16;

/// Returns which pixels are near what moves: within [`NEAR_PX`] of one whose surface or whose light would be another
/// without it. `with` and `without` are of one view and time, of the scene with what moves and without.
pub fn near_movers(
    (with, points_with): (&Truth, &[Option<Point>]),
    (without, points_without): (&Truth, &[Option<Point>]),
) -> Vec<bool> {
    let verdicts = with
        .pixels
        .iter()
        .zip(&without.pixels)
        .map(|(one, other)| one.surface != other.surface || one.relevant != other.relevant || one.lit != other.lit);
    let points = points_with.iter().zip(points_without).map(|(one, other)| one != other);
    let touched: Vec<bool> = verdicts.zip(points).map(|(bit, point)| bit || point).collect();
    let (width, height) = (with.width as usize, with.height as usize);
    let around = |at: usize, end: usize| at.saturating_sub(NEAR_PX)..(at + NEAR_PX + 1).min(end);
    let across: Vec<bool> = (0..touched.len())
        .map(|pixel| around(pixel % width, width).any(|x| touched[pixel / width * width + x]))
        .collect();
    (0..touched.len()).map(|pixel| around(pixel / width, height).any(|y| across[y * width + pixel % width])).collect()
}

impl PredictionError {
    /// Counts a picture. `near` says which of its pixels are near what moves, if anything does.
    pub fn add(&mut self, visibility: &[PixelVisibility], truth: &Truth, near: Option<&[bool]>) {
        self.lights = truth.lights;
        for (place, (found, verdict)) in (0_u32..).zip(visibility.iter().zip(&truth.pixels)) {
            let wrong = (found.word ^ verdict.lit) & verdict.relevant;
            self.relevant += u64::from(verdict.relevant.count_ones());
            if near.is_some_and(|near| near.get(place as usize) == Some(&true)) {
                self.relevant_near += u64::from(verdict.relevant.count_ones());
                self.wrong_near += u64::from(wrong.count_ones());
            }
            if wrong == 0 {
                continue;
            }
            if !found.known {
                self.unknown += u64::from(wrong.count_ones());
                continue;
            }
            let edge = edges(truth, place % truth.width, place / truth.width);
            self.known_edge += u64::from((wrong & edge).count_ones());
            self.known_inside += u64::from((wrong & !edge).count_ones());
        }
    }

    /// All wrong bits, in per cent of the relevant ones.
    pub fn wrong_percent(&self) -> f64 {
        self.percent(self.known_edge + self.known_inside + self.unknown)
    }

    /// A count in per cent of the relevant bits.
    pub fn percent(&self, count: u64) -> f64 {
        percent(count, self.relevant)
    }

    /// Wrong bits near what moves, in per cent of the relevant ones there. `None` if nothing moves.
    pub fn near_percent(&self) -> Option<f64> {
        (self.relevant_near > 0).then(|| percent(self.wrong_near, self.relevant_near))
    }
}

/// Draws the truth in grey, brighter where more lights reach; over it wrong bits that a mask said in red, and those
/// that the client's maps said in blue.
pub fn wrong_bits(visibility: &[PixelVisibility], truth: &Truth) -> image::RgbImage {
    let pixels = visibility.iter().zip(&truth.pixels).flat_map(|(found, verdict)| {
        let bits = |word: u32| word.count_ones().to_le_bytes()[0];
        let grey = bits(verdict.lit) * (160 / bits(verdict.relevant).max(1));
        match ((found.word ^ verdict.lit) & verdict.relevant != 0, found.known) {
            (false, _) => [grey; 3],
            (true, true) => [255, 0, 0],
            (true, false) => [60, 120, 255],
        }
    });
    image::RgbImage::from_vec(truth.width, truth.height, pixels.collect()).unwrap_or_default()
}

#[expect(clippy::cast_precision_loss, reason = "counts stay far below 2^53")]
fn percent(count: u64, of: u64) -> f64 {
    if of == 0 { 0.0 } else { count as f64 / of as f64 * 100.0 }
}

/// Returns the lights whose bit differs between a pixel and one of its eight neighbours. A neighbour without a surface,
/// or where the light is irrelevant, counts as different.
fn edges(truth: &Truth, x: u32, y: u32) -> u32 {
    let here = truth.at(x, y);
    let mut edges = 0;
    for ny in y.saturating_sub(1)..=(y + 1).min(truth.height - 1) {
        for nx in x.saturating_sub(1)..=(x + 1).min(truth.width - 1) {
            let there = truth.at(nx, ny);
            edges |= (here.lit ^ there.lit) | (here.relevant & !there.relevant);
        }
    }
    edges
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::Verdict;

    #[test]
    fn wrong_bits_are_counted_where_they_are() {
        let verdict = |lit| Verdict { surface: true, relevant: 0b11, lit, undecided: 0 };
        // Light 0 has an edge between the third and the fourth pixel; light 1 reaches all.
        let truth = Truth {
            width: 6,
            height: 1,
            lights: 2,
            pixels: vec![verdict(2), verdict(2), verdict(2), verdict(3), verdict(3), verdict(3)],
        };
        let shown = |words: [u32; 6], known| words.map(|word| PixelVisibility { word, known, oldest_layer: 0, own: 0 });
        let mut error = PredictionError::default();
        error.add(&shown([2, 2, 2, 3, 3, 3], true), &truth, None);
        assert_eq!(error, PredictionError { lights: 2, relevant: 12, ..PredictionError::default() });
        // At the edge: light 0 of pixel 2. Inside: light 0 of pixel 0, light 1 of pixel 3.
        error.add(&shown([3, 2, 3, 1, 3, 3], true), &truth, None);
        assert_eq!((error.known_edge, error.known_inside, error.unknown), (1, 2, 0));
        assert_eq!(error.near_percent(), None);
        // Pixels 1 and 2 are near what moves: there, one of four bits is wrong.
        error.add(&shown([3, 2, 3, 1, 3, 3], false), &truth, Some(&[false, true, true, false, false, false]));
        assert_eq!(error.near_percent(), Some(25.0));
        assert_eq!((error.known_edge, error.known_inside, error.unknown, error.relevant), (1, 2, 3, 36));
        assert!((error.wrong_percent() - 100.0 / 6.0).abs() < 1e-9);
    }
    #[test]
    fn near_is_within_so_many_pixels_of_what_moves() {
        let size = 40_u32;
        let bare = Truth { width: size, height: 1, lights: 1, pixels: vec![Verdict::default(); size as usize] };
        let mut with = bare.clone();
        with.pixels[2].lit = 1;
        let mut points = vec![None; size as usize];
        points[39] = Some(Point { place: glam::DVec3::ZERO, normal: glam::DVec3::Y, depth_m: 1.0 });
        let near = near_movers((&with, &points), (&bare, &vec![None; size as usize]));
        let expected: Vec<bool> = (0..size).map(|x| x <= 2 + 16 || x >= 39 - 16).collect();
        assert_eq!(near, expected);
    }
}
