//! Codes slices predicted from a reference: motion, and differences from the moved reference.
//!
//! Blocks are coded place by place, all lights of a place in the slice together. [`motion`] codes the vectors and
//! [`refine`] the differences. Encoder and decoder run the same code.

use std::ops::Range;

use super::{
    block::{self, Block, DecodedBlock},
    block_range::BlockRange,
    motion::{self, Search},
    order::{Order, Place},
    prior::REFINE_PRIOR,
    range::{BinaryCoder, RangeDecoder, RangeEncoder},
    reference::{Reference, Vector},
    refine::{self, Agreement, Prediction, RefineModels, UNKNOWN},
};
use crate::mask::Mask;

/// Most places of a frame that the encoder searches exhaustively.
const THOROUGH_PLACES: u32 = 8;

/// The memory of one thread.
pub(super) struct InterCoder {
    pub(super) models: Box<RefineModels>,
    /// Exhaustive searches left in this frame.
    searches: u32,
    /// Blocks of one place: those of the mask, and the predicted ones.
    own: Vec<DecodedBlock>,
    predicted: Vec<DecodedBlock>,
}

impl InterCoder {
    pub(super) fn new() -> Self {
        Self { models: Box::new(RefineModels::blank()), searches: 0, own: Vec::new(), predicted: Vec::new() }
    }

    /// Starts a frame that `threads` threads encode.
    pub(super) fn begin_frame(&mut self, threads: usize) {
        self.searches = THOROUGH_PLACES / u32::try_from(threads).unwrap_or(1);
    }
}

/// The slice that is being coded.
struct Slice<'a, 'b> {
    reference: &'a Reference,
    range: &'a mut BlockRange<'b>,
    /// First block of the slice.
    first: usize,
}

impl InterCoder {
    /// Appends as many of these blocks as fit, at least one. Returns the next block.
    pub(super) fn encode(
        &mut self,
        reference: &Reference,
        mask: &Mask,
        range: &mut BlockRange<'_>,
        mut blocks: Range<usize>,
        bytes: usize,
        output: &mut Vec<u8>,
    ) -> usize {
        let start = output.len();
        loop {
            if let Some(end) = self.encode_within(reference, mask, range, blocks.clone(), bytes, output) {
                return end;
            }
            // One place does not fit: try half its lights.
            output.truncate(start);
            let lights = blocks.len().min(range.order.lights - blocks.start % range.order.lights);
            blocks.end = blocks.start + lights / 2;
        }
    }

    /// As [`Self::encode`], but returns `None` if the first place has several blocks and does not fit.
    fn encode_within(
        &mut self,
        reference: &Reference,
        mask: &Mask,
        range: &mut BlockRange<'_>,
        blocks: Range<usize>,
        bytes: usize,
        output: &mut Vec<u8>,
    ) -> Option<usize> {
        self.models.as_mut().clone_from(&REFINE_PRIOR);
        let mut bits = RangeEncoder::new(output);
        let mut end = blocks.end;
        for (group, place) in places(range.order, blocks.clone()) {
            let position = bits.position();
            let slice = Slice { reference, range, first: blocks.start };
            self.code_place(&mut bits, slice, group.clone(), place, Some(mask));
            if bits.most_bytes() > bytes {
                if group.start > blocks.start {
                    bits.rollback(position);
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

    /// Returns true if the bits are exactly those of these blocks.
    pub(super) fn decode(
        &mut self,
        reference: &Reference,
        range: &mut BlockRange<'_>,
        blocks: Range<usize>,
        bits: &[u8],
    ) -> bool {
        self.models.as_mut().clone_from(&REFINE_PRIOR);
        let mut bits = RangeDecoder::new(bits);
        for (group, place) in places(range.order, blocks.clone()) {
            let slice = Slice { reference, range, first: blocks.start };
            if !self.code_place(&mut bits, slice, group, place, None) || !bits.is_within() {
                return false;
            }
        }
        bits.is_at_end()
    }

    /// Counts the symbols of a frame with this reference.
    pub(super) fn count(
        &mut self,
        bits: &mut impl BinaryCoder,
        reference: &Reference,
        mask: &Mask,
        range: &mut BlockRange<'_>,
    ) {
        for (group, place) in places(range.order, range.blocks()) {
            self.code_place(bits, Slice { reference, range, first: 0 }, group, place, Some(mask));
        }
    }

    /// Codes the blocks `group` of one place, the first of which is at `place`. An encoder reads them from `truth`; a
    /// decoder passes `None` and finds them in the range. Returns false for bits that no encoder makes.
    fn code_place(
        &mut self,
        bits: &mut impl BinaryCoder,
        slice: Slice<'_, '_>,
        group: Range<usize>,
        place: Place,
        truth: Option<&Mask>,
    ) -> bool {
        let Slice { reference, range, first } = slice;
        let Self { models, searches, own, predicted } = self;
        let (order, from, from_place) = (range.order, range.first, range.first / range.order.lights);
        let number = group.start / order.lights - from_place;
        let around = order.around(group.start, place);
        let within_slice =
            |block: Option<usize>| block.filter(|block| *block >= first).map(|block| block / order.lights - from_place);
        let (above, left) = (within_slice(around.above), within_slice(around.left));
        let predicted_vector = above.or(left).map_or(Vector::default(), |place| range.vectors[place]);
        let tiles = order.tiles(place).len();
        let columns = u64::MAX >> (64 - 8 * tiles);
        // The group's blocks in the range.
        let in_range = group.start - from..group.end - from;

        own.clear();
        if let Some(mask) = truth {
            let lights = (place.light..).zip(group.clone());
            own.extend(lights.map(|(light, _)| block::gather(mask, order, Place { light, ..place })));
        } else {
            own.resize(group.len(), DecodedBlock::flat(false));
        }
        let predict = |vector: Vector, predicted: &mut Vec<DecodedBlock>| {
            predicted.clear();
            let lights = (place.light..).zip(group.clone());
            predicted
                .extend(lights.map(|(light, _)| DecodedBlock::new(reference.block(Place { light, ..place }, vector))));
        };
        predict(predicted_vector, predicted);
        let agrees = |own: &DecodedBlock, predicted: &DecodedBlock| {
            own.rows.iter().zip(&predicted.rows).all(|(own, predicted)| (own ^ predicted) & columns == 0)
        };
        let mixed = predicted.iter().any(|block| block.extent.value().is_none());
        let skipped = |place: Option<usize>| place.map_or(UNKNOWN, |place| usize::from(range.skipped[place]));
        let context = (skipped(above) * 3 + skipped(left)) * 2 + usize::from(mixed);
        let all = own.iter().zip(&*predicted).all(|(own, predicted)| agrees(own, predicted));
        range.skipped[number] = bits.bit(&mut models.place[context], all);
        if range.skipped[number] {
            range.vectors[number] = predicted_vector;
            range.decoded[in_range.clone()].copy_from_slice(predicted);
            range.equal[in_range].fill(u8::MAX);
            return true;
        }

        let certain = above.zip(left).is_some_and(|(above, left)| range.vectors[above] == range.vectors[left]);
        let best = if truth.is_some() {
            // Candidates need not be known to a decoder of this slice.
            let within = |block: Option<usize>| Some(block?.checked_sub(from)? / order.lights);
            let (left, above) = (within(around.left), within(around.above));
            let neighbours = [left, above, number.checked_sub(1), Some(number), Some(number + 1), Some(number + 4)];
            let candidates = neighbours.into_iter().flatten().filter_map(|place| range.vectors.get(place).copied());
            Search { reference, place, own, predicted: predicted_vector }
                .best(candidates.chain([Vector::default()]), searches)
        } else {
            Vector::default()
        };
        let Some(vector) = motion::code(bits, &mut models.motion, certain, predicted_vector, best) else {
            return false;
        };
        if vector != predicted_vector {
            predict(vector, predicted);
        }
        range.vectors[number] = vector;
        // Pixels of the previous light that differ from the prediction.
        let mut wrong: Option<Block> = None;
        let blocks = (place.light..).zip(group).zip(own.iter().zip(&*predicted));
        for ((light, number), (own, predicted)) in blocks {
            let place = Place { light, ..place };
            let around = order.around(number, place);
            let tiles_of =
                |block: Option<usize>| block.filter(|block| *block >= first).map(|block| range.equal[block - from]);
            let agreement =
                Agreement { above: tiles_of(around.above), left: tiles_of(around.left), other: tiles_of(around.other) };
            if refine::code_block(bits, models, agreement, predicted, agrees(own, predicted)) {
                range.decoded[number - from] = *predicted;
                range.equal[number - from] = u8::MAX;
                wrong = Some([0; 8]);
                continue;
            }
            let prediction =
                Prediction { lines: reference.lines(place, vector), block: predicted, wrong: wrong.as_ref() };
            let neighbours = range.neighbours(place, first, number);
            let (block, tiles) = refine::code(bits, models, &neighbours, agreement, &prediction, own);
            wrong = Some(std::array::from_fn(|row| block.rows[row] ^ predicted.rows[row]));
            range.decoded[number - from] = block;
            range.equal[number - from] = tiles;
        }
        true
    }
}

/// Groups these blocks by place. Returns each group with the place of its first block.
fn places(order: &Order, blocks: Range<usize>) -> impl Iterator<Item = (Range<usize>, Place)> {
    let (order, end) = (*order, blocks.end);
    let starts = order.walk(blocks.clone()).filter(move |(number, place)| place.light == 0 || *number == blocks.start);
    starts.map(move |(number, place)| (number..end.min(number - place.light + order.lights), place))
}
