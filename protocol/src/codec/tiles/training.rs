//! What masks teach the models.

use super::{
    Way, block,
    codes::{self, CODES, Codes},
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
    let (mut counts, mut reference) = (vec![[0; 256]; fast::CONTEXTS], Reference::new());
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
        let run = blocks.all(&order);
        for (number, place) in order.walk(0..order.blocks()) {
            let block = block::gather(mask, &order, place);
            let expected = run.expected(place, 0, number);
            let near = run.near(place, 0, number);
            small::code(&mut prior::Counter, &mut lane.states, &near, &block);
            if block.extent.value() != Some(expected) {
                fast::code(&mut Counting(&mut counts), &CODES, &near, &block);
            }
            run.known[number] = block;
        }
    }
    [prior::pack(&lane.states), codes::pack(&counts), prior::pack_refined(&mut lane.moved.states)]
}

struct Counting<'a>(&'a mut [[u64; 256]]);

impl Symbols for Counting<'_> {
    fn symbol(&mut self, _: &Codes, context: usize, symbol: u8) -> u8 {
        self.0[context][usize::from(symbol)] += 1;
        symbol
    }
}
