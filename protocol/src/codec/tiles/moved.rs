//! Slices that are coded against a reference: what has moved how, and what is not as it was.
//!
//! Blocks are taken place by place, all lights of a place that are in the slice together. [`motion`] says what a vector is and
//! [`refine`] which bits there are; both directions walk the same way.

use std::ops::Range;

use super::{
    block::{self, Block, Known},
    lane::{Lane, Run},
    motion::{self, Search},
    order::{Order, Place},
    prior::REFINE_PRIOR,
    range::{Bits, RangeDecoder, RangeEncoder},
    reference::{Reference, Vector},
    refine::{self, Agreement, Guess, RefineStates, UNKNOWN},
};
use crate::mask::Mask;

/// Places of a frame that the encoder searches thoroughly at most.
const THOROUGH_PLACES: u32 = 8;

/// A thread's memory of slices with a reference.
pub(super) struct Memory {
    pub(super) states: Box<RefineStates>,
    /// Places that the encoder may still search thoroughly.
    thorough: u32,
    /// Blocks of one place: of the mask, and as expected.
    own: Vec<Known>,
    expected: Vec<Known>,
}

impl Memory {
    pub(super) fn new() -> Self {
        Self { states: Box::new(RefineStates::blank()), thorough: 0, own: Vec::new(), expected: Vec::new() }
    }

    /// Before a frame is encoded that is shared out to so many threads.
    pub(super) fn begin_frame(&mut self, threads: usize) {
        self.thorough = THOROUGH_PLACES / u32::try_from(threads).unwrap_or(1);
    }
}

/// What a slice is coded in.
struct Slice<'a, 'b> {
    reference: &'a Reference,
    run: &'a mut Run<'b>,
    /// Its first block.
    first: usize,
}

impl Lane {
    /// Appends as many of these blocks as fit, at least one, and says which is the next.
    pub(super) fn encode_moved(
        &mut self,
        reference: &Reference,
        mask: &Mask,
        run: &mut Run<'_>,
        mut blocks: Range<usize>,
        bytes: usize,
        output: &mut Vec<u8>,
    ) -> usize {
        let start = output.len();
        loop {
            if let Some(end) = self.encode_within(reference, mask, run, blocks.clone(), bytes, output) {
                return end;
            }
            // Not even one place fits: half its lights may.
            output.truncate(start);
            let lights = blocks.len().min(run.order.lights - blocks.start % run.order.lights);
            blocks.end = blocks.start + lights / 2;
        }
    }

    /// As [`Self::encode_moved`], but nothing where the first place has more than one block and does not fit.
    fn encode_within(
        &mut self,
        reference: &Reference,
        mask: &Mask,
        run: &mut Run<'_>,
        blocks: Range<usize>,
        bytes: usize,
        output: &mut Vec<u8>,
    ) -> Option<usize> {
        self.moved.states.as_mut().clone_from(&REFINE_PRIOR);
        let mut bits = RangeEncoder::new(output);
        let mut end = blocks.end;
        for (group, place) in places(run.order, blocks.clone()) {
            let here = bits.here();
            let slice = Slice { reference, run, first: blocks.start };
            self.moved.code_place(&mut bits, slice, group.clone(), place, Some(mask));
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
        run: &mut Run<'_>,
        blocks: Range<usize>,
        bits: &[u8],
    ) -> bool {
        self.moved.states.as_mut().clone_from(&REFINE_PRIOR);
        let mut bits = RangeDecoder::new(bits);
        for (group, place) in places(run.order, blocks.clone()) {
            let slice = Slice { reference, run, first: blocks.start };
            if !self.moved.code_place(&mut bits, slice, group, place, None) || !bits.is_within() {
                return false;
            }
        }
        bits.is_at_end()
    }

    /// Counts what a frame with this reference teaches.
    pub(super) fn count_moved(&mut self, bits: &mut impl Bits, reference: &Reference, mask: &Mask, run: &mut Run<'_>) {
        for (group, place) in places(run.order, run.blocks()) {
            self.moved.code_place(bits, Slice { reference, run, first: 0 }, group, place, Some(mask));
        }
    }
}

impl Memory {
    /// Codes the blocks `group` of one place, whose first is at `place`. An encoder takes them from `truth`; a decoder has none,
    /// and finds them in the run afterwards. Says no where a decoder was given what no encoder makes.
    fn code_place(
        &mut self,
        bits: &mut impl Bits,
        slice: Slice<'_, '_>,
        group: Range<usize>,
        place: Place,
        truth: Option<&Mask>,
    ) -> bool {
        let Slice { reference, run, first } = slice;
        let Self { states, thorough, own, expected } = self;
        let (order, from, from_place) = (run.order, run.first, run.first / run.order.lights);
        let number = group.start / order.lights - from_place;
        let around = order.around(group.start, place);
        let before =
            |block: Option<usize>| block.filter(|block| *block >= first).map(|block| block / order.lights - from_place);
        let (above, left) = (before(around.above), before(around.left));
        let guess = above.or(left).map_or(Vector::default(), |place| run.vectors[place]);
        let tiles = order.tiles(place).len();
        let columns = u64::MAX >> (64 - 8 * tiles);
        // The group's blocks in the run.
        let in_run = group.start - from..group.end - from;

        own.clear();
        if let Some(mask) = truth {
            let lights = (place.light..).zip(group.clone());
            own.extend(lights.map(|(light, _)| block::gather(mask, order, Place { light, ..place })));
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
        let was = |place: Option<usize>| place.map_or(UNKNOWN, |place| usize::from(run.settled[place]));
        let context = (was(above) * 3 + was(left)) * 2 + usize::from(mixed);
        let all = own.iter().zip(&*expected).all(|(own, expected)| agrees(own, expected));
        run.settled[number] = bits.bit(&mut states.place[context], all);
        if run.settled[number] {
            run.vectors[number] = guess;
            run.known[in_run.clone()].copy_from_slice(expected);
            run.equal[in_run].fill(u8::MAX);
            return true;
        }

        let certain = above.zip(left).is_some_and(|(above, left)| run.vectors[above] == run.vectors[left]);
        let best = if truth.is_some() {
            // Also those that a decoder of this slice does not know.
            let within = |block: Option<usize>| Some(block?.checked_sub(from)? / order.lights);
            let (left, above) = (within(around.left), within(around.above));
            let near = [left, above, number.checked_sub(1), Some(number), Some(number + 1), Some(number + 4)];
            let known = near.into_iter().flatten().filter_map(|place| run.vectors.get(place).copied());
            Search { reference, place, own, expected: guess }.best(known.chain([Vector::default()]), thorough)
        } else {
            Vector::default()
        };
        let Some(vector) = motion::code(bits, &mut states.motion, certain, guess, best) else { return false };
        if vector != guess {
            move_by(vector, expected);
        }
        run.vectors[number] = vector;
        // Which pixels of the light before were not as expected.
        let mut wrong: Option<Block> = None;
        let blocks = (place.light..).zip(group).zip(own.iter().zip(&*expected));
        for ((light, number), (own, expected)) in blocks {
            let place = Place { light, ..place };
            let around = order.around(number, place);
            let tiles_of =
                |block: Option<usize>| block.filter(|block| *block >= first).map(|block| run.equal[block - from]);
            let agreement =
                Agreement { above: tiles_of(around.above), left: tiles_of(around.left), other: tiles_of(around.other) };
            if refine::code_block(bits, states, agreement, expected, agrees(own, expected)) {
                run.known[number - from] = *expected;
                run.equal[number - from] = u8::MAX;
                wrong = Some([0; 8]);
                continue;
            }
            let guess = Guess { lines: reference.lines(place, vector), block: expected, wrong: wrong.as_ref() };
            let near = run.near(place, first, number);
            let (block, tiles) = refine::code(bits, states, &near, agreement, &guess, own);
            wrong = Some(std::array::from_fn(|row| block.rows[row] ^ expected.rows[row]));
            run.known[number - from] = block;
            run.equal[number - from] = tiles;
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
