//! Slices that are coded against a reference: what has moved how, and what is not as it was.
//!
//! Blocks are taken place by place, all lights of a place that are in the slice together. [`motion`] says what a vector is and
//! [`refine`] which bits there are; both directions walk the same way.

use std::ops::Range;

use super::{
    Workspace, block,
    block::{Block, Known},
    motion::{self, Search},
    near::Near,
    order::{Order, Place},
    prior::REFINE_PRIOR,
    range::{Bits, RangeDecoder, RangeEncoder},
    reference::{Reference, Vector},
    refine::{self, Agreement, Guess, RefineStates, UNKNOWN},
};
use crate::mask::Mask;

/// Places of a frame that the encoder searches thoroughly at most.
const THOROUGH_PLACES: u32 = 8;

/// The memory of slices with a reference.
pub(super) struct Memory {
    pub(super) states: Box<RefineStates>,
    /// How each place has moved; of a place that is still to come, in the frame before.
    vectors: Vec<Vector>,
    /// Whether all of a place was as expected.
    settled: Vec<bool>,
    /// Which tiles of a block were as expected.
    equal: Vec<u8>,
    /// Places of a frame that the encoder may still search thoroughly.
    thorough: u32,
    /// Blocks of one place: of the mask, and as expected.
    own: Vec<Known>,
    expected: Vec<Known>,
}

impl Memory {
    pub(super) fn new() -> Self {
        Self {
            states: Box::new(RefineStates::blank()),
            vectors: Vec::new(),
            settled: Vec::new(),
            equal: Vec::new(),
            thorough: 0,
            own: Vec::new(),
            expected: Vec::new(),
        }
    }

    fn make_room(&mut self, order: &Order) {
        let places = order.blocks() / order.lights;
        if self.equal.len() < order.blocks() || self.vectors.len() < places {
            self.equal.resize(order.blocks(), 0);
            self.vectors.resize(places, Vector::default());
            self.settled.resize(places, false);
        }
    }
}

/// What a slice is coded in.
struct Slice<'a> {
    reference: &'a Reference,
    order: &'a Order,
    /// Its first block.
    first: usize,
}

impl Workspace {
    /// Appends as many of these blocks as fit, at least one, and says which is the next.
    pub(super) fn encode_moved(
        &mut self,
        reference: &Reference,
        mask: &Mask,
        order: &Order,
        mut blocks: Range<usize>,
        bytes: usize,
        output: &mut Vec<u8>,
    ) -> usize {
        let start = output.len();
        loop {
            if let Some(end) = self.encode_within(reference, mask, order, blocks.clone(), bytes, output) {
                return end;
            }
            // Not even one place fits: half its lights may.
            output.truncate(start);
            let lights = blocks.len().min(order.lights - blocks.start % order.lights);
            blocks.end = blocks.start + lights / 2;
        }
    }

    /// As [`Self::encode_moved`], but nothing where the first place has more than one block and does not fit.
    fn encode_within(
        &mut self,
        reference: &Reference,
        mask: &Mask,
        order: &Order,
        blocks: Range<usize>,
        bytes: usize,
        output: &mut Vec<u8>,
    ) -> Option<usize> {
        self.begin_moved(order);
        if blocks.start == 0 {
            self.moved.thorough = THOROUGH_PLACES;
        }
        let slice = Slice { reference, order, first: blocks.start };
        let mut bits = RangeEncoder::new(output);
        let mut end = blocks.end;
        for (group, place) in places(order, blocks.clone()) {
            let here = bits.here();
            self.code_place(&mut bits, &slice, group.clone(), place, Some(mask));
            if bits.most_bytes() > bytes {
                if group.start > blocks.start {
                    bits.back_to(here);
                    end = group.start;
                    break;
                }
                if group.len() > 1 {
                    return None;
                }
            }
        }
        bits.finish();
        Some(end)
    }

    /// Whether the bits are those of these blocks.
    pub(super) fn decode_moved(
        &mut self,
        reference: &Reference,
        order: &Order,
        blocks: Range<usize>,
        bits: &[u8],
        mask: &mut Mask,
    ) -> bool {
        self.begin_moved(order);
        let slice = Slice { reference, order, first: blocks.start };
        let mut bits = RangeDecoder::new(bits);
        for (group, place) in places(order, blocks) {
            if !self.code_place(&mut bits, &slice, group.clone(), place, None) || !bits.is_within() {
                return false;
            }
            for (light, block) in (place.light..).zip(&self.blocks[group]) {
                block::scatter(order, Place { light, ..place }, block, mask);
            }
        }
        bits.is_at_end()
    }

    /// Counts what a frame with this reference teaches.
    pub(super) fn count_moved(&mut self, bits: &mut impl Bits, reference: &Reference, mask: &Mask) {
        let order = Order::new(mask.shape());
        self.make_room(order.blocks());
        self.moved.make_room(&order);
        let slice = Slice { reference, order: &order, first: 0 };
        for (group, place) in places(&order, 0..order.blocks()) {
            self.code_place(bits, &slice, group, place, Some(mask));
        }
    }

    fn begin_moved(&mut self, order: &Order) {
        self.moved.make_room(order);
        self.moved.states.as_mut().clone_from(&REFINE_PRIOR);
    }

    /// Codes the blocks `group` of one place, whose first is at `place`. An encoder takes them from `truth`; a decoder has none,
    /// and finds them in the memory afterwards. Says no where a decoder was given what no encoder makes.
    fn code_place(
        &mut self,
        bits: &mut impl Bits,
        slice: &Slice<'_>,
        group: Range<usize>,
        place: Place,
        truth: Option<&Mask>,
    ) -> bool {
        let &Slice { reference, order, first } = slice;
        let Memory { states, vectors, settled, equal, thorough, own, expected } = &mut self.moved;
        let number = group.start / order.lights;
        let around = order.around(group.start, place);
        let before = |block: Option<usize>| block.filter(|block| *block >= first).map(|block| block / order.lights);
        let (above, left) = (before(around.above), before(around.left));
        let guess = above.or(left).map_or(Vector::default(), |place| vectors[place]);
        let tiles = order.tiles(place).len();
        let columns = u64::MAX >> (64 - 8 * tiles);

        own.clear();
        if let Some(mask) = truth {
            own.extend(
                (place.light..)
                    .zip(group.clone())
                    .map(|(light, _)| block::gather(mask, order, Place { light, ..place })),
            );
        } else {
            own.resize(group.len(), Known::flat(false));
        }
        let move_by = |vector: Vector, expected: &mut Vec<Known>| {
            expected.clear();
            let lights = (place.light..).zip(group.clone());
            expected.extend(lights.map(|(light, _)| Known::new(reference.block(Place { light, ..place }, vector))));
        };
        move_by(guess, expected);
        let agrees = |own: &Known, expected: &Known| {
            own.rows.iter().zip(&expected.rows).all(|(own, expected)| (own ^ expected) & columns == 0)
        };
        let mixed = expected.iter().any(|block| block.extent.value().is_none());
        let was = |place: Option<usize>| place.map_or(UNKNOWN, |place| usize::from(settled[place]));
        let context = (was(above) * 3 + was(left)) * 2 + usize::from(mixed);
        let all = own.iter().zip(&*expected).all(|(own, expected)| agrees(own, expected));
        settled[number] = bits.bit(&mut states.place[context], all);
        if settled[number] {
            vectors[number] = guess;
            self.blocks[group.clone()].copy_from_slice(expected);
            equal[group].fill(u8::MAX);
            return true;
        }

        let certain = above.zip(left).is_some_and(|(above, left)| vectors[above] == vectors[left]);
        let best = if truth.is_some() {
            let near = [left, above, Some(number), Some(number + 1), Some(number + 4)];
            let known = near.into_iter().flatten().filter_map(|place| vectors.get(place).copied());
            Search { reference, place, own, expected: guess }.best(known.chain([Vector::default()]), thorough)
        } else {
            Vector::default()
        };
        let Some(vector) = motion::code(bits, &mut states.motion, certain, guess, best) else { return false };
        if vector != guess {
            move_by(vector, expected);
        }
        vectors[number] = vector;
        // Which pixels of the light before were not as expected.
        let mut wrong: Option<Block> = None;
        let blocks = (place.light..).zip(group).zip(own.iter().zip(&*expected));
        for ((light, number), (own, expected)) in blocks {
            let place = Place { light, ..place };
            let around = order.around(number, place);
            let tiles_of = |block: Option<usize>| block.filter(|block| *block >= first).map(|block| equal[block]);
            let agreement =
                Agreement { above: tiles_of(around.above), left: tiles_of(around.left), other: tiles_of(around.other) };
            if refine::code_block(bits, states, agreement, expected, agrees(own, expected)) {
                self.blocks[number] = *expected;
                equal[number] = u8::MAX;
                wrong = Some([0; 8]);
                continue;
            }
            let guess = Guess { lines: reference.lines(place, vector), block: expected, wrong: wrong.as_ref() };
            let near = Near::new(&self.blocks, order, place, first, number);
            let (block, tiles) = refine::code(bits, states, &near, agreement, &guess, own);
            wrong = Some(std::array::from_fn(|row| block.rows[row] ^ expected.rows[row]));
            self.blocks[number] = block;
            equal[number] = tiles;
        }
        true
    }
}

/// The blocks of each place that are among these, and where the first of them is.
fn places(order: &Order, blocks: Range<usize>) -> impl Iterator<Item = (Range<usize>, Place)> {
    let (order, end) = (*order, blocks.end);
    let starts = order.walk(blocks.clone()).filter(move |(number, place)| place.light == 0 || *number == blocks.start);
    starts.map(move |(number, place)| (number..end.min(number - place.light + order.lights), place))
}
