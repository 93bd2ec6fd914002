//! What masks teach the models.

use super::{
    Way, block,
    codes::Counts,
    fast::{self, Symbols},
    lane::{Blocks, Lane},
    order::Order,
    prior,
    reference::Reference,
    small,
};
use crate::{ids::FrameNumber, mask::Mask};

/// Counts what masks teach the models, each with one that may serve it as a reference: the bytes of `prior.bin`, `codes.bin`
/// and `refine.bin`.
#[must_use]
pub fn train<'a>(masks: impl IntoIterator<Item = (&'a Mask, Option<&'a Mask>)>) -> [Vec<u8>; 3] {
    let mut blocks = Blocks::default();
    let mut lane = Lane { states: prior::uncounted(), ..Lane::new() };
    let (mut counts, mut reference) = (Counts::new(), Reference::new());
    for (mask, before) in masks {
        let order = Order::new(mask.shape());
        blocks.make_room(&order, Way::Moved(&reference));
        if let Some(before) = before.filter(|before| before.shape() == mask.shape()) {
            for (number, place) in order.walk(0..order.blocks()) {
                blocks.known[number] = block::gather(before, &order, place);
            }
            reference.fill(FrameNumber(0), mask.shape(), &blocks.known);
            lane.count_moved(&mut prior::Counter, &reference, mask, &mut blocks.all(&order));
        }
        let mut run = blocks.all(&order);
        for (number, place) in order.walk(0..order.blocks()) {
            let block = block::gather(mask, &order, place);
            let near = run.near(place, 0, number);
            small::code(&mut prior::Counter, &mut lane.states, &near, &block);
            run.known[number] = block;
        }
        for (number, place) in order.walk(0..order.blocks()) {
            let tiles = block::gather_tiles(mask, &order, place);
            let beside = run.beside(place, 0, number);
            if tiles != [fast::expected(beside); 8] {
                fast::code(&mut counts, beside, order.tiles(place).len(), &tiles);
            }
            run.put_tiles(number, tiles);
        }
    }
    [prior::pack(&lane.states), counts.pack(), prior::pack_refined(&mut lane.moved.states)]
}

impl Symbols for Counts {
    fn short(&mut self, context: usize, symbol: u8) -> u8 {
        self.short[context][usize::from(symbol)] += 1;
        symbol
    }

    fn long(&mut self, context: usize, symbol: u8) -> u8 {
        self.long[context][usize::from(symbol)] += 1;
        symbol
    }
}
