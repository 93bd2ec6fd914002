//! Codes a range of a frame's blocks on one thread. Threads share no mutable state.

use std::ops::Range;

use super::{
    bits::{BitReader, BitWriter},
    block::{self, DecodedBlock},
    block_range::BlockRange,
    codes::{CODES, SymbolReader, SymbolWriter},
    fast,
    inter::InterCoder,
    mode::Mode,
    models::Models,
    range::{RangeDecoder, RangeEncoder},
    slice::{Failure, SLICE_HEAD_BYTES},
    small,
};
use crate::{codec::part::Part, frame::FrameHead, mask::Mask};

/// Most bytes of a block count in `tiles-fast`.
const NUMBER_BYTES: usize = 5;

/// The memory of one thread.
pub(super) struct CoderThread {
    pub(super) models: Models,
    pub(super) inter: InterCoder,
    /// The parts of a range, and their bytes.
    pub(super) parts: Vec<Part>,
    pub(super) output: Vec<u8>,
}

impl CoderThread {
    pub(super) fn new() -> Self {
        Self { models: Models::new(), inter: InterCoder::new(), parts: Vec::new(), output: Vec::new() }
    }

    /// Encodes a range into [`Self::output`], a part for each slice. A slice's bits take at most `bits_bytes` bytes, or
    /// one block if that alone is longer (at most 1 KiB).
    pub(super) fn encode(
        &mut self,
        mode: Mode<'_>,
        head: &FrameHead,
        mask: &Mask,
        mut range: BlockRange<'_>,
        bits_bytes: usize,
    ) {
        let mut output = std::mem::take(&mut self.output);
        output.clear();
        self.parts.clear();
        let Range { start: mut first, end } = range.blocks();
        while first < end {
            let part = output.len();
            head.begin(1, &mut output);
            let start = output.len();
            output.extend_from_slice(&[0; SLICE_HEAD_BYTES]);
            let blocks = first..end.min(first + usize::from(u16::MAX));
            let next = match mode {
                Mode::Inter(reference) => {
                    self.inter.encode(reference, mask, &mut range, blocks, bits_bytes, &mut output)
                }
                Mode::Small => self.encode_small(mask, &mut range, blocks, bits_bytes, &mut output),
                Mode::Fast => encode_fast(mask, &mut range, blocks, bits_bytes, &mut output),
            };
            output[start..start + 3].copy_from_slice(&first.to_le_bytes()[..3]);
            output[start + 3..start + 5].copy_from_slice(&(next - first).to_le_bytes()[..2]);
            // A slice has at most 12 bits a pixel.
            let slice_bytes = u32::try_from(output.len() - start).unwrap_or(u32::MAX);
            head.set_slice_length(&mut output[part..], 0, slice_bytes);
            self.parts.push(Part { bytes: output.len() - part, blocks: first..next });
            first = next;
        }
        self.output = output;
    }

    /// Appends as many of these blocks as fit, at least one. Returns the next block.
    fn encode_small(
        &mut self,
        mask: &Mask,
        range: &mut BlockRange<'_>,
        blocks: Range<usize>,
        bytes: usize,
        output: &mut Vec<u8>,
    ) -> usize {
        let models = &mut self.models;
        models.begin_slice();
        let mut bits = RangeEncoder::new(output);
        let mut end = blocks.end;
        for (number, place) in range.order.walk(blocks.clone()) {
            let position = bits.position();
            let own = block::gather(mask, range.order, place);
            let neighbours = range.neighbours(place, blocks.start, number);
            range.decoded[number - range.first] = small::code(&mut bits, models, &neighbours, &own);
            if bits.most_bytes() > bytes && number > blocks.start {
                bits.rollback(position);
                end = number;
                break;
            }
        }
        bits.finish();
        end
    }

    /// Decodes a slice of a range.
    ///
    /// # Errors
    /// If its bits are not those of its blocks. Some of them may have been written.
    pub(super) fn decode(
        &mut self,
        mode: Mode<'_>,
        range: &mut BlockRange<'_>,
        blocks: Range<usize>,
        slice: &[u8],
    ) -> Result<(), Failure> {
        let bits = &slice[SLICE_HEAD_BYTES..];
        let decoded = match mode {
            Mode::Inter(reference) => self.inter.decode(reference, range, blocks, bits),
            Mode::Small => self.decode_small(range, blocks, bits),
            Mode::Fast => decode_fast(range, blocks, bits),
        };
        if decoded { Ok(()) } else { Err(Failure::Bits) }
    }

    /// Returns true if the bits are exactly those of these blocks.
    fn decode_small(&mut self, range: &mut BlockRange<'_>, blocks: Range<usize>, bits: &[u8]) -> bool {
        let models = &mut self.models;
        models.begin_slice();
        let mut bits = RangeDecoder::new(bits);
        for (number, place) in range.order.walk(blocks.clone()) {
            let neighbours = range.neighbours(place, blocks.start, number);
            let block = small::code(&mut bits, models, &neighbours, &DecodedBlock::flat(false));
            if !bits.is_within() {
                return false;
            }
            range.decoded[number - range.first] = block;
        }
        bits.is_at_end()
    }
}

/// As [`CoderThread::encode_small`].
fn encode_fast(
    mask: &Mask,
    range: &mut BlockRange<'_>,
    blocks: Range<usize>,
    bytes: usize,
    output: &mut Vec<u8>,
) -> usize {
    let mut bits = BitWriter::new(output);
    let (mut end, mut predicted_blocks) = (blocks.end, 0);
    for (number, place) in range.order.walk(blocks.clone()) {
        let own = block::gather_tiles(mask, range.order, place);
        let neighbours = range.tile_neighbours(place, blocks.start, number);
        let predicted = fast::predicted(neighbours);
        if own.iter().fold(0, |differs, tile| differs | (tile ^ predicted)) == 0 {
            predicted_blocks += 1;
            range.put_tiles(number, own);
            continue;
        }
        let position = bits.position();
        bits.put_number(predicted_blocks);
        let tiles = range.order.tiles(place).len();
        let own = fast::code(&mut SymbolWriter(&mut bits, &CODES), neighbours, tiles, &own);
        range.put_tiles(number, own);
        // Leave room for the number at the end.
        if bits.bytes() + NUMBER_BYTES > bytes && number > blocks.start {
            bits.rollback(position);
            end = number;
            break;
        }
        predicted_blocks = 0;
    }
    if predicted_blocks > 0 {
        bits.put_number(predicted_blocks);
    }
    bits.finish();
    end
}

/// As [`CoderThread::decode_small`].
fn decode_fast(range: &mut BlockRange<'_>, blocks: Range<usize>, bits: &[u8]) -> bool {
    let mut bits = BitReader::new(bits);
    let mut predicted_blocks = bits.number();
    for (number, place) in range.order.walk(blocks.clone()) {
        let neighbours = range.tile_neighbours(place, blocks.start, number);
        let tiles = match predicted_blocks {
            None => return false,
            Some(0) => {
                let tiles = range.order.tiles(place).len();
                let tiles = fast::code(&mut SymbolReader(&mut bits, &CODES), neighbours, tiles, &[0; 8]);
                predicted_blocks = if number + 1 < blocks.end { bits.number() } else { Some(0) };
                tiles
            }
            Some(more) => {
                predicted_blocks = Some(more - 1);
                [fast::predicted(neighbours); 8]
            }
        };
        if !bits.is_within() {
            return false;
        }
        range.put_tiles(number, tiles);
    }
    predicted_blocks == Some(0) && bits.is_at_end()
}
