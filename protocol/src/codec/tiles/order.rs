//! The order in which a frame's blocks are coded.
//!
//! A block is 8 tiles of a row, 64×8 pixels, of one light. Blocks are ordered in upright stripes of 4 blocks (256
//! pixels): within a stripe row by row from the top, within a row from the left, and at each place all lights in turn.
//! So a slice's blocks are about as wide as high, and few of them miss a neighbour.

use std::ops::Range;

use crate::{coverage::PLACE_TILES, mask::MaskShape};

pub(super) const BLOCK_TILES: usize = PLACE_TILES as usize;

/// Blocks across a stripe.
const STRIPE_BLOCKS: usize = 4;

/// A frame's blocks, numbered in coding order.
#[derive(Debug, Clone, Copy)]
pub(super) struct Order {
    blocks_x: usize,
    tiles_x: usize,
    tiles_y: usize,
    pub(super) lights: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Place {
    /// Blocks from the left.
    pub(super) x: usize,
    /// Rows of tiles from the top.
    pub(super) y: usize,
    pub(super) light: usize,
}

/// Numbers of the blocks around a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Around {
    pub(super) above: Option<usize>,
    pub(super) above_left: Option<usize>,
    /// Only in the same stripe: the next stripe comes later.
    pub(super) above_right: Option<usize>,
    pub(super) left: Option<usize>,
    /// Same place in the previous light.
    pub(super) other: Option<usize>,
}

impl Order {
    pub(super) const fn new(shape: MaskShape) -> Self {
        let (tiles_x, tiles_y) = (shape.tiles_x() as usize, shape.tiles_y() as usize);
        Self { blocks_x: tiles_x.div_ceil(BLOCK_TILES), tiles_x, tiles_y, lights: shape.lights() as usize }
    }

    /// Returns the number of blocks of all lights.
    pub(super) const fn blocks(&self) -> usize {
        self.blocks_x * self.tiles_y * self.lights
    }

    /// Returns the blocks in a row.
    pub(super) const fn blocks_across(&self) -> usize {
        self.blocks_x
    }

    /// Returns the width in blocks of the stripe that begins at block `x`.
    fn across(&self, x: usize) -> usize {
        STRIPE_BLOCKS.min(self.blocks_x - x)
    }

    /// Returns the place of block `number`, which must be below [`Self::blocks`].
    pub(super) fn place(&self, number: usize) -> Place {
        let (at, light) = (number / self.lights, number % self.lights);
        let stripe = at / (STRIPE_BLOCKS * self.tiles_y);
        let first_x = stripe * STRIPE_BLOCKS;
        let (within, across) = (at - first_x * self.tiles_y, self.across(first_x));
        Place { x: first_x + within % across, y: within / across, light }
    }

    /// Returns these blocks with their places, in order.
    pub(super) fn walk(self, blocks: Range<usize>) -> impl Iterator<Item = (usize, Place)> {
        let mut place = self.place(blocks.start);
        blocks.map(move |number| {
            let now = place;
            place = self.after(now);
            (number, now)
        })
    }

    fn after(&self, Place { x, y, light }: Place) -> Place {
        let first_x = x - x % STRIPE_BLOCKS;
        if light + 1 < self.lights {
            Place { x, y, light: light + 1 }
        } else if x + 1 < first_x + self.across(first_x) {
            Place { x: x + 1, y, light: 0 }
        } else if y + 1 < self.tiles_y {
            Place { x: first_x, y: y + 1, light: 0 }
        } else {
            Place { x: x + 1, y: 0, light: 0 }
        }
    }

    /// Returns the blocks around a block that precede it and are in the picture.
    #[inline(always)]
    pub(super) fn around(&self, number: usize, place: Place) -> Around {
        let Place { x, y, light } = place;
        let first_x = x - x % STRIPE_BLOCKS;
        let across = self.across(first_x);
        let above = |number: usize, across: usize| number.checked_sub(across * self.lights).filter(|_| y > 0);
        let over = above(number, across);
        let (left, above_left) = if x > first_x {
            (Some(number - self.lights), over.map(|over| over - self.lights))
        } else if x > 0 {
            // All stripes but the last one are equally wide.
            let column = (first_x - STRIPE_BLOCKS) * self.tiles_y + STRIPE_BLOCKS - 1;
            let left = (column + y * STRIPE_BLOCKS) * self.lights + light;
            (Some(left), above(left, STRIPE_BLOCKS))
        } else {
            (None, None)
        };
        Around {
            above: over,
            above_left,
            above_right: over.map(|over| over + self.lights).filter(|_| x + 1 < first_x + across),
            left,
            other: (light > 0).then(|| number - 1),
        }
    }

    /// Returns the block's tiles inside the picture, which are consecutive in its plane.
    pub(super) fn tiles(&self, place: Place) -> Range<usize> {
        let (row, first) = (place.y * self.tiles_x, place.x * BLOCK_TILES);
        row + first..row + self.tiles_x.min(first + BLOCK_TILES)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_tile_of_every_light_is_in_one_block() {
        for (width, height, lights) in [(1, 1, 1), (64, 8, 2), (65, 9, 3), (1000, 70, 1), (320, 33, 32), (8, 4096, 1)] {
            let shape = MaskShape::new(width, height, lights).unwrap();
            let order = Order::new(shape);
            let mut seen = vec![0; shape.words()];
            for (number, place) in order.walk(0..order.blocks()) {
                assert_eq!(order.place(number), place);
                order.tiles(place).for_each(|tile| seen[place.light * shape.tiles() + tile] += 1);
            }
            assert!(seen.iter().all(|&times| times == 1), "{shape:?}");
        }
    }

    #[test]
    fn neighbours_match_a_search_by_place() {
        for (width, height, lights) in [(640, 24, 2), (64, 40, 3), (300, 9, 1)] {
            let order = Order::new(MaskShape::new(width, height, lights).unwrap());
            let places: Vec<Place> = order.walk(0..order.blocks()).map(|(_, place)| place).collect();
            for (number, &place) in places.iter().enumerate() {
                let at = |right: isize, below: isize| {
                    let x = place.x.checked_add_signed(right)?;
                    let y = place.y.checked_add_signed(below)?;
                    places[..number].iter().position(|other| *other == Place { x, y, ..place })
                };
                let around = Around {
                    above: at(0, -1),
                    above_left: at(-1, -1),
                    above_right: at(1, -1),
                    left: at(-1, 0),
                    other: (place.light > 0).then(|| number - 1),
                };
                assert_eq!(order.around(number, place), around, "{place:?}");
            }
        }
    }
}
