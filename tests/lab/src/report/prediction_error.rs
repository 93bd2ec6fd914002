//! Error of predicted visibility, by place: inside, at shadow edges, or unknown to the mask.

use gnomon_client::render::PixelVisibility;

use crate::reference::Truth;

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
}

impl PredictionError {
    pub fn add(&mut self, visibility: &[PixelVisibility], truth: &Truth) {
        self.lights = truth.lights;
        for (place, (found, verdict)) in (0_u32..).zip(visibility.iter().zip(&truth.pixels)) {
            self.relevant += u64::from(verdict.relevant.count_ones());
            let wrong = (found.word ^ verdict.lit) & verdict.relevant;
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
    #[expect(clippy::cast_precision_loss, reason = "counts stay far below 2^53")]
    pub fn percent(&self, count: u64) -> f64 {
        if self.relevant == 0 { 0.0 } else { count as f64 / self.relevant as f64 * 100.0 }
    }
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
        error.add(&shown([2, 2, 2, 3, 3, 3], true), &truth);
        assert_eq!(error, PredictionError { lights: 2, relevant: 12, ..PredictionError::default() });
        // At the edge: light 0 of pixel 2. Inside: light 0 of pixel 0, light 1 of pixel 3.
        error.add(&shown([3, 2, 3, 1, 3, 3], true), &truth);
        assert_eq!((error.known_edge, error.known_inside, error.unknown), (1, 2, 0));
        error.add(&shown([3, 2, 3, 1, 3, 3], false), &truth);
        assert_eq!((error.known_edge, error.known_inside, error.unknown, error.relevant), (1, 2, 3, 36));
        assert!((error.wrong_percent() - 100.0 / 6.0).abs() < 1e-9);
    }
}
