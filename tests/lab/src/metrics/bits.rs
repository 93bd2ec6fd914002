//! Errors of a mask, counted over the relevant bits.

use std::{fmt, ops::AddAssign};

use gnomon_protocol::mask::Mask;

use crate::reference::Truth;

/// Most wrong bits kept as examples.
const EXAMPLES: usize = 8;

/// Bit counts of one mask, or summed over several.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RelevantError {
    pub relevant: u64,
    pub wrong: u64,
    /// Bits that are 1 where the referee has 0: light leaks.
    pub leaks: u64,
    /// Leaks where the referee is certain.
    pub sure_leaks: u64,
    /// Bits whose relevance or value rounding may change, wrong or not.
    pub undecided: u64,
    pub wrong_undecided: u64,
    /// Bits that are 1 where the referee is certain that they are irrelevant: a back end must leave them 0.
    pub irrelevant_set: u64,
    /// The first wrong bits that are not undecided: light, x, y.
    pub examples: Vec<[u32; 3]>,
    /// Greatest distance of a wrong bit that is not undecided from an edge of the truth, in pixels: see
    /// [`distance_from_edge_px`].
    pub worst_distance_px: f64,
}

/// Search radius for edges, in pixels.
const FARTHEST_PX: u32 = 16;

/// Returns the distance of pixel (x, y) to the nearest edge in light `light`'s plane of the truth, in pixels: to the
/// nearest pixel centre with another verdict (lit, dark, irrelevant, no surface), less half a pixel. At most
/// [`FARTHEST_PX`].
pub fn distance_from_edge_px(truth: &Truth, light: u32, x: u32, y: u32) -> f64 {
    let state = |x: u32, y: u32| {
        let verdict = truth.at(x, y);
        (verdict.surface, verdict.relevant >> light & 1, verdict.lit >> light & 1)
    };
    let here = state(x, y);
    let around = |at: u32, size: u32| at.saturating_sub(FARTHEST_PX)..(at + FARTHEST_PX + 1).min(size);
    let mut nearest = f64::from(FARTHEST_PX);
    for v in around(y, truth.height) {
        for u in around(x, truth.width) {
            if state(u, v) != here {
                nearest = nearest.min(f64::from(u.abs_diff(x)).hypot(f64::from(v.abs_diff(y))) - 0.5);
            }
        }
    }
    nearest
}

impl RelevantError {
    /// Compares a mask with the truth, bit by bit. Panics if their sizes differ.
    pub fn of(mask: &Mask, truth: &Truth) -> Self {
        let shape = mask.shape();
        assert_eq!((shape.width(), shape.height(), shape.lights()), (truth.width, truth.height, truth.lights));
        let mut error = Self::default();
        for y in 0..truth.height {
            for x in 0..truth.width {
                let verdict = truth.at(x, y);
                for light in 0..truth.lights {
                    let bit = |word: u32| word >> light & 1 == 1;
                    let (set, undecided) = (mask.get(light, x, y), bit(verdict.undecided));
                    error.undecided += u64::from(undecided);
                    if !bit(verdict.relevant) {
                        error.irrelevant_set += u64::from(set && !undecided);
                        continue;
                    }
                    error.relevant += 1;
                    if set != bit(verdict.lit) {
                        error.wrong += 1;
                        error.leaks += u64::from(set);
                        error.wrong_undecided += u64::from(undecided);
                        if undecided {
                            continue;
                        }
                        error.sure_leaks += u64::from(set);
                        let distance_px = distance_from_edge_px(truth, light, x, y);
                        error.worst_distance_px = error.worst_distance_px.max(distance_px);
                        if error.examples.len() < EXAMPLES {
                            error.examples.push([light, x, y]);
                        }
                    }
                }
            }
        }
        error
    }

    /// Share of relevant bits that are wrong, including undecided ones; 0 if nothing is relevant.
    #[expect(clippy::cast_precision_loss, reason = "counts stay far below 2^53")]
    pub fn share(&self) -> f64 {
        if self.relevant == 0 { 0.0 } else { self.wrong as f64 / self.relevant as f64 }
    }

    /// Excludes undecided bits.
    pub fn surely_wrong(&self) -> u64 {
        self.wrong - self.wrong_undecided
    }

    /// Share of relevant bits that are wrong where the referee is certain; 0 if nothing is relevant.
    #[expect(clippy::cast_precision_loss, reason = "counts stay far below 2^53")]
    pub fn sure_share(&self) -> f64 {
        if self.relevant == 0 { 0.0 } else { self.surely_wrong() as f64 / self.relevant as f64 }
    }
}

impl AddAssign for RelevantError {
    fn add_assign(&mut self, other: Self) {
        self.relevant += other.relevant;
        self.wrong += other.wrong;
        self.leaks += other.leaks;
        self.sure_leaks += other.sure_leaks;
        self.undecided += other.undecided;
        self.wrong_undecided += other.wrong_undecided;
        self.irrelevant_set += other.irrelevant_set;
        self.worst_distance_px = self.worst_distance_px.max(other.worst_distance_px);
        self.examples.extend(other.examples.into_iter().take(EXAMPLES.saturating_sub(self.examples.len())));
    }
}

impl fmt::Display for RelevantError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:.4} % of {} relevant bits wrong ({}: {} leaks, {} of all among the {} undecided), \
             {:.1} px from an edge at most; {} irrelevant bits set",
            self.share() * 100.0,
            self.relevant,
            self.wrong,
            self.leaks,
            self.wrong_undecided,
            self.undecided,
            self.worst_distance_px,
            self.irrelevant_set
        )
    }
}

#[cfg(test)]
mod tests {
    use gnomon_protocol::mask::MaskShape;

    use super::*;
    use crate::reference::Verdict;

    #[test]
    fn each_kind_of_wrong_bit_is_counted_once() {
        let verdict = |relevant, lit, undecided| Verdict { surface: true, relevant, lit, undecided };
        let truth = Truth {
            width: 3,
            height: 1,
            lights: 2,
            pixels: vec![verdict(0b11, 0b01, 0), verdict(0b01, 0b00, 0b01), Verdict::default()],
        };
        let mut mask = Mask::new(MaskShape::new(3, 1, 2).unwrap());
        mask.set(0, 0, 0, true);
        let exact = RelevantError::of(&mask, &truth);
        let expected = RelevantError { relevant: 3, undecided: 1, ..RelevantError::default() };
        assert_eq!(exact, expected);
        // A false shadow, a leak, an undecided leak, a bit on an irrelevant pixel.
        mask.set(0, 0, 0, false);
        mask.set(1, 0, 0, true);
        mask.set(0, 1, 0, true);
        mask.set(1, 2, 0, true);
        let error = RelevantError::of(&mask, &truth);
        let examples = vec![[0, 0, 0], [1, 0, 0]];
        let expected = RelevantError {
            wrong: 3,
            leaks: 2,
            sure_leaks: 1,
            wrong_undecided: 1,
            irrelevant_set: 1,
            examples,
            worst_distance_px: 0.5,
            ..expected
        };
        assert_eq!(error.surely_wrong(), 2);
        assert_eq!(error, expected);
        assert!((error.share() - 1.0).abs() < 1e-12);
        let mut sum = exact;
        sum += error;
        assert_eq!((sum.relevant, sum.wrong, sum.undecided), (6, 3, 2));
    }
}
