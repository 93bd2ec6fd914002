//! The head of a slice, which names its blocks.

use std::ops::Range;

use super::order::Order;
use crate::{codec::part::Part, mask::MaskShape};

/// Bytes before a slice's bits: the first block (3), the number of blocks (2).
pub(super) const SLICE_HEAD_BYTES: usize = 5;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::codec) enum Failure {
    /// The head names no blocks, or some outside the picture.
    Blocks,
    Bits,
}

/// Returns the blocks of a slice, or `None` if its head names none or some outside the picture.
pub(in crate::codec) fn blocks_of(shape: MaskShape, slice: &[u8]) -> Option<Range<usize>> {
    let &[a, b, c, d, e] = slice.first_chunk()?;
    let first = u32::from_le_bytes([a, b, c, 0]) as usize;
    let count = usize::from(u16::from_le_bytes([d, e]));
    (count > 0 && first + count <= Order::new(shape).blocks()).then_some(first..first + count)
}

/// Returns the word ranges of a part's tiles in its mask.
pub fn part_words(shape: MaskShape, part: &Part) -> impl Iterator<Item = Range<usize>> + use<> {
    let order = Order::new(shape);
    order.walk(part.blocks.clone()).map(move |(_, place)| {
        let tiles = order.tiles(place);
        let plane = place.light * shape.tiles();
        plane + tiles.start..plane + tiles.end
    })
}

pub(in crate::codec) fn block_count(shape: MaskShape) -> usize {
    Order::new(shape).blocks()
}
