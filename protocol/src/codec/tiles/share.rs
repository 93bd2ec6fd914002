//! How a frame's blocks are shared out to cores.

use std::ops::Range;

use super::{Way, order::Order};
use crate::mask::Mask;

/// Runs at most: what each of them ends with is a slice that is not full.
const MAX_RUNS: usize = 4;

/// Mixed tiles that are worth a run of their own. A frame of so few takes half a millisecond.
const RUN_MIXED_TILES: u32 = 2000;

/// The same where most of them are as in the reference.
const RUN_MOVED_TILES: u32 = 5000;

/// Bytes of slices that are worth a core of their own.
const RUN_BYTES: usize = 3000;

/// One row of tiles in so many is counted, and stands for the others: to look at all of them takes a seventh of what `tiles-fast` does.
const COUNTED_ROWS: usize = 4;

/// Where runs of blocks begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Cuts {
    /// The first blocks of so many runs.
    first: [usize; MAX_RUNS],
    runs: usize,
}

impl Cuts {
    /// All in one run.
    const WHOLE: Self = Self { first: [0; MAX_RUNS], runs: 1 };

    pub(super) const fn runs(&self) -> usize {
        self.runs
    }

    /// The first block of the first run.
    pub(super) const fn first(&self) -> usize {
        self.first[0]
    }

    fn push(&mut self, first: usize) {
        self.first[self.runs] = first;
        self.runs += 1;
    }

    /// The first half of the runs and the others, if there are several.
    pub(super) fn halves(&self) -> Option<(Self, Self)> {
        let half = self.runs / 2;
        let mut rest = Self { first: [0; MAX_RUNS], runs: self.runs - half };
        rest.first[..rest.runs].copy_from_slice(&self.first[half..self.runs]);
        (half > 0).then_some((Self { runs: half, ..*self }, rest))
    }

    /// Cuts between slices that lie one behind the other, so that each core has as many bytes; `slices` gives them as often as it is
    /// asked.
    pub(super) fn between_slices<S: Iterator<Item = (Range<usize>, usize)>>(
        order: &Order,
        slices: impl Fn() -> S,
    ) -> Self {
        let (mut cuts, mut end) = (Self::WHOLE, 0);
        let bytes: usize = slices().map(|(_, bytes)| bytes).sum();
        let runs = (bytes / RUN_BYTES).min(rayon::current_num_threads()).clamp(1, MAX_RUNS);
        let mut before = 0;
        for (blocks, length) in slices() {
            if blocks.start < end {
                return Self::WHOLE;
            }
            // Runs begin with a place, and not every slice does.
            if cuts.runs < runs && before * runs >= cuts.runs * bytes && blocks.start % order.lights == 0 {
                cuts.push(blocks.start);
            }
            end = blocks.end;
            before += length;
        }
        cuts
    }
}

/// The memory for shares of a mask.
#[derive(Debug, Default)]
pub(super) struct Shares {
    /// Mixed tiles in the places so far, by place.
    mixed: Vec<u32>,
}

impl Shares {
    /// Shares as many mixed tiles out to each run.
    pub(super) fn of_mask(&mut self, way: Way<'_>, order: &Order, mask: &Mask) -> Cuts {
        let tiles = mask.shape().tiles();
        let mut sum = 0;
        self.mixed.clear();
        for (_, place) in order.walk(0..order.blocks()) {
            if place.y % COUNTED_ROWS == 0 {
                let words = &mask.words()[place.light * tiles..][order.tiles(place)];
                // Neither 0 nor all ones.
                let mixed: usize = words.iter().map(|word| usize::from(word.wrapping_add(1) > 1)).sum();
                sum += u32::try_from(mixed * COUNTED_ROWS).unwrap_or(u32::MAX);
            }
            if place.light + 1 == order.lights {
                self.mixed.push(sum);
            }
        }
        let mut cuts = Cuts::WHOLE;
        let most = u32::try_from(MAX_RUNS).unwrap_or(1);
        let worth = if let Way::Moved(_) = way { RUN_MOVED_TILES } else { RUN_MIXED_TILES };
        let runs = (sum / worth).clamp(1, most);
        for run in 1..runs {
            let place = self
                .mixed
                .partition_point(|before| u64::from(*before) * u64::from(runs) < u64::from(sum) * u64::from(run));
            let first = (place + 1) * order.lights;
            if first > cuts.first[cuts.runs - 1] && first < order.blocks() {
                cuts.push(first);
            }
        }
        cuts
    }
}
