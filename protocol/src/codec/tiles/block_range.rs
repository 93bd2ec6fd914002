//! A frame's blocks while they are coded, and the range of them that one thread codes.

use std::ops::Range;

use super::{
    block::{Block, DecodedBlock},
    fast::TileNeighbours,
    mode::Mode,
    neighbours::Neighbours,
    order::{Order, Place},
    reference::Vector,
};

/// The blocks and places of a frame, in coding order.
#[derive(Default)]
pub(super) struct Blocks {
    pub(super) decoded: Vec<DecodedBlock>,
    /// For each block, a bit per tile that is as predicted.
    equal: Vec<u8>,
    /// Motion of each place. Places that are not coded yet still have that of the frame before.
    vectors: Vec<Vector>,
    /// For each place, true if all of it is as predicted.
    skipped: Vec<bool>,
}

impl Blocks {
    /// Grows to the blocks of a picture.
    pub(super) fn make_room(&mut self, order: &Order, mode: Mode<'_>) {
        let (blocks, places) = (order.blocks(), order.blocks() / order.lights);
        if self.decoded.len() < blocks {
            self.decoded.resize(blocks, DecodedBlock::flat(false));
        }
        if matches!(mode, Mode::Inter(_)) && (self.equal.len() < blocks || self.vectors.len() < places) {
            self.equal.resize(blocks, 0);
            self.vectors.resize(places, Vector::default());
            self.skipped.resize(places, false);
        }
    }

    pub(super) fn all<'a>(&'a mut self, order: &'a Order) -> BlockRange<'a> {
        let Self { decoded, equal, vectors, skipped } = self;
        BlockRange { order, first: 0, decoded: &mut decoded[..order.blocks()], equal, vectors, skipped }
    }
}

/// Consecutive blocks, beginning with the first light of a place.
pub(super) struct BlockRange<'a> {
    pub(super) order: &'a Order,
    /// Number of the first block.
    pub(super) first: usize,
    pub(super) decoded: &'a mut [DecodedBlock],
    /// Per block. Empty, as are `vectors` and `skipped`, when coding without a reference.
    pub(super) equal: &'a mut [u8],
    /// Per place.
    pub(super) vectors: &'a mut [Vector],
    pub(super) skipped: &'a mut [bool],
}

impl<'a> BlockRange<'a> {
    pub(super) fn blocks(&self) -> Range<usize> {
        self.first..self.first + self.decoded.len()
    }

    /// Splits before block `number`, which is the first of its place.
    pub(super) fn split(self, number: usize) -> (Self, Self) {
        fn cut<T>(part: &mut [T], at: usize) -> (&mut [T], &mut [T]) {
            let at = at.min(part.len());
            part.split_at_mut(at)
        }
        let (order, blocks) = (self.order, number - self.first);
        let places = blocks / order.lights;
        let (decoded, rest_decoded) = self.decoded.split_at_mut(blocks);
        let (equal, rest_equal) = cut(self.equal, blocks);
        let (vectors, rest_vectors) = cut(self.vectors, places);
        let (skipped, rest_skipped) = cut(self.skipped, places);
        (
            Self { order, first: self.first, decoded, equal, vectors, skipped },
            Self {
                order,
                first: number,
                decoded: rest_decoded,
                equal: rest_equal,
                vectors: rest_vectors,
                skipped: rest_skipped,
            },
        )
    }

    /// Returns the neighbours of block `number` in a slice that begins with block `first`.
    #[inline(always)]
    pub(super) fn neighbours(&self, place: Place, first: usize, number: usize) -> Neighbours<'_> {
        Neighbours::new(&self.decoded[first - self.first..number - self.first], self.order, place, first, number)
    }

    /// Returns the same for `tiles-fast`, whose blocks are tiles instead of rows.
    #[inline(always)]
    pub(super) fn tile_neighbours(&self, place: Place, first: usize, number: usize) -> TileNeighbours<'_> {
        let around = self.order.around(number, place);
        let decoded =
            |number: Option<usize>| number.filter(|number| *number >= first).map(|n| &self.decoded[n - self.first]);
        TileNeighbours {
            above: decoded(around.above).map(|above| &above.rows),
            left: decoded(around.left).map(|left| left.rows[7]),
        }
    }

    /// Stores a block of tiles.
    #[inline(always)]
    pub(super) fn put_tiles(&mut self, number: usize, tiles: Block) {
        self.decoded[number - self.first].rows = tiles;
    }
}
