//! Counts the symbols of masks, to make the prior probabilities and codes.

use super::{
    bit_model::BitModel,
    block,
    block_range::Blocks,
    codes::Counts,
    fast::{self, SymbolCoder},
    inter::InterCoder,
    mode::Mode,
    models::Models,
    order::Order,
    range::BinaryCoder,
    reference::Reference,
    refine::RefineModels,
    small,
    symbol_model::SymbolModel,
};
use crate::{ids::FrameNumber, mask::Mask};

/// Counts the symbols of masks, each with its reference, if any. Returns the bytes of `prior.bin`, `codes.bin` and
/// `refine.bin`.
#[must_use]
pub fn train<'a>(masks: impl IntoIterator<Item = (&'a Mask, Option<&'a Mask>)>) -> [Vec<u8>; 3] {
    let (mut blocks, mut models, mut inter) = (Blocks::default(), Models::uncounted(), InterCoder::new());
    let (mut counts, mut reference) = (Counts::new(), Reference::new());
    for (mask, before) in masks {
        let order = Order::new(mask.shape());
        blocks.make_room(&order, Mode::Inter(&reference));
        if let Some(before) = before.filter(|before| before.shape() == mask.shape()) {
            for (number, place) in order.walk(0..order.blocks()) {
                blocks.decoded[number] = block::gather(before, &order, place);
            }
            reference.fill(FrameNumber(0), mask.shape(), &blocks.decoded);
            inter.count(&mut Counter, &reference, mask, &mut blocks.all(&order));
        }
        let mut range = blocks.all(&order);
        for (number, place) in order.walk(0..order.blocks()) {
            let block = block::gather(mask, &order, place);
            let neighbours = range.neighbours(place, 0, number);
            small::code(&mut Counter, &mut models, &neighbours, &block);
            range.decoded[number] = block;
        }
        for (number, place) in order.walk(0..order.blocks()) {
            let tiles = block::gather_tiles(mask, &order, place);
            let neighbours = range.tile_neighbours(place, 0, number);
            if tiles != [fast::predicted(neighbours); 8] {
                fast::code(&mut counts, neighbours, order.tiles(place).len(), &tiles);
            }
            range.put_tiles(number, tiles);
        }
    }
    [models.pack(), counts.pack(), pack_refined(&mut inter.models)]
}

fn pack_refined(counted: &mut RefineModels) -> Vec<u8> {
    counted.all().flat_map(|model| model.packed_count().to_le_bytes()).collect()
}

/// Counts instead of coding.
struct Counter;

impl BinaryCoder for Counter {
    type Registers = ();

    fn registers(&self) {}

    fn set_registers(&mut self, (): ()) {}

    fn bit_in<const RATE: u32>(&mut self, (): &mut (), model: &mut BitModel, bit: bool) -> bool {
        model.count(bit);
        bit
    }

    fn symbol_in(&mut self, (): &mut (), model: &mut SymbolModel, symbol: usize) -> usize {
        model.count(symbol);
        symbol
    }
}

impl SymbolCoder for Counts {
    fn short(&mut self, context: usize, symbol: u8) -> u8 {
        self.short[context][usize::from(symbol)] += 1;
        symbol
    }

    fn long(&mut self, context: usize, symbol: u8) -> u8 {
        self.long[context][usize::from(symbol)] += 1;
        symbol
    }
}
