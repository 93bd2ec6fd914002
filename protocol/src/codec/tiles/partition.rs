//! Divides a frame's blocks among threads.

use std::ops::Range;

use super::{mode::Mode, order::Order};
use crate::mask::Mask;

/// Most ranges. Each ends with a slice that is not full, which costs bytes.
const MAX_RANGES: usize = 4;

/// Mixed tiles that justify a range of their own: coding them takes half a millisecond.
const RANGE_MIXED_TILES: u32 = 2000;

/// The same with a reference, which predicts most of them.
const RANGE_INTER_TILES: u32 = 5000;

/// Bytes of slices that justify a thread of their own.
const RANGE_BYTES: usize = 3000;

/// One row of tiles in four is counted: counting all of them would take a seventh of the time of `tiles-fast`.
const COUNTED_ROWS: usize = 4;

/// First blocks of the ranges.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Partition {
    first: [usize; MAX_RANGES],
    ranges: usize,
}

impl Partition {
    const WHOLE: Self = Self { first: [0; MAX_RANGES], ranges: 1 };

    pub(super) const fn len(&self) -> usize {
        self.ranges
    }

    /// Returns the first block of the first range.
    pub(super) const fn first(&self) -> usize {
        self.first[0]
    }

    fn push(&mut self, first: usize) {
        self.first[self.ranges] = first;
        self.ranges += 1;
    }

    /// Splits the ranges in halves. Returns `None` for one range.
    pub(super) fn halves(&self) -> Option<(Self, Self)> {
        let half = self.ranges / 2;
        let mut rest = Self { first: [0; MAX_RANGES], ranges: self.ranges - half };
        rest.first[..rest.ranges].copy_from_slice(&self.first[half..self.ranges]);
        (half > 0).then_some((Self { ranges: half, ..*self }, rest))
    }

    /// Divides consecutive slices between threads by their bytes. Slices out of order stay in one range.
    pub(super) fn between_slices<S: Iterator<Item = (Range<usize>, usize)>>(
        order: &Order,
        slices: impl Fn() -> S,
    ) -> Self {
        let (mut partition, mut end) = (Self::WHOLE, 0);
        let bytes: usize = slices().map(|(_, bytes)| bytes).sum();
        let ranges = (bytes / RANGE_BYTES).min(rayon::current_num_threads()).clamp(1, MAX_RANGES);
        let mut before = 0;
        for (blocks, length) in slices() {
            if blocks.start < end {
                return Self::WHOLE;
            }
            // Ranges begin with the first light of a place, and not every slice does.
            if partition.ranges < ranges
                && before * ranges >= partition.ranges * bytes
                && blocks.start % order.lights == 0
            {
                partition.push(blocks.start);
            }
            end = blocks.end;
            before += length;
        }
        partition
    }
}

/// Divides masks. Reuses its memory.
#[derive(Debug, Default)]
pub(super) struct Partitioner {
    /// Running total of mixed tiles, up to each place.
    mixed: Vec<u32>,
}

impl Partitioner {
    /// Divides a mask into ranges with equally many mixed tiles.
    pub(super) fn partition(&mut self, mode: Mode<'_>, order: &Order, mask: &Mask) -> Partition {
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
        let mut partition = Partition::WHOLE;
        let most = u32::try_from(MAX_RANGES).unwrap_or(1);
        let tiles_per_range = if let Mode::Inter(_) = mode { RANGE_INTER_TILES } else { RANGE_MIXED_TILES };
        let ranges = (sum / tiles_per_range).clamp(1, most);
        for range in 1..ranges {
            let place = self
                .mixed
                .partition_point(|before| u64::from(*before) * u64::from(ranges) < u64::from(sum) * u64::from(range));
            let first = (place + 1) * order.lights;
            if first > partition.first[partition.ranges - 1] && first < order.blocks() {
                partition.push(first);
            }
        }
        partition
    }
}
