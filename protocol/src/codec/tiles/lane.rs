//! What one thread codes: a run of a frame's blocks, with a memory of its own. Nothing that it reads or writes is another's, so
//! runs are coded on several cores.

use std::ops::Range;

use super::{
    Failure, NUMBER_BYTES, Reading, SLICE_HEAD_BYTES, Way, Writing,
    bits::{BitReader, BitWriter},
    block::{self, Block, Known},
    codes::CODES,
    fast::{self, Beside},
    moved::Memory,
    near::Near,
    order::{Order, Place},
    prior,
    range::{RangeDecoder, RangeEncoder},
    reference::Vector,
    small::{self, States},
};
use crate::mask::Mask;

/// All blocks of a frame, in their order, and all places.
#[derive(Default)]
pub(super) struct Blocks {
    pub(super) known: Vec<Known>,
    /// Which tiles of a block were as expected.
    equal: Vec<u8>,
    /// How each place has moved; of a place that is still to come, in the frame before.
    vectors: Vec<Vector>,
    /// Whether all of a place was as expected.
    settled: Vec<bool>,
}

impl Blocks {
    /// Makes room for the blocks of a picture.
    pub(super) fn make_room(&mut self, order: &Order, way: Way<'_>) {
        let (blocks, places) = (order.blocks(), order.blocks() / order.lights);
        if self.known.len() < blocks {
            self.known.resize(blocks, Known::flat(false));
        }
        if matches!(way, Way::Moved(_)) && (self.equal.len() < blocks || self.vectors.len() < places) {
            self.equal.resize(blocks, 0);
            self.vectors.resize(places, Vector::default());
            self.settled.resize(places, false);
        }
    }

    /// All of them.
    pub(super) fn all<'a>(&'a mut self, order: &'a Order) -> Run<'a> {
        let Self { known, equal, vectors, settled } = self;
        Run { order, first: 0, known: &mut known[..order.blocks()], equal, vectors, settled }
    }
}

/// Blocks that follow each other from the first light of a place on.
pub(super) struct Run<'a> {
    pub(super) order: &'a Order,
    /// Number of the first block.
    pub(super) first: usize,
    pub(super) known: &'a mut [Known],
    /// Of its blocks, and of its places: as long as these where there is a reference, and otherwise of any length.
    pub(super) equal: &'a mut [u8],
    pub(super) vectors: &'a mut [Vector],
    pub(super) settled: &'a mut [bool],
}

impl<'a> Run<'a> {
    /// Numbers of its blocks.
    pub(super) fn blocks(&self) -> Range<usize> {
        self.first..self.first + self.known.len()
    }

    /// What comes before block `number`, the first of its place, and the rest.
    pub(super) fn split(self, number: usize) -> (Self, Self) {
        fn cut<T>(part: &mut [T], at: usize) -> (&mut [T], &mut [T]) {
            let at = at.min(part.len());
            part.split_at_mut(at)
        }
        let (order, blocks) = (self.order, number - self.first);
        let places = blocks / order.lights;
        let (known, rest_known) = self.known.split_at_mut(blocks);
        let (equal, rest_equal) = cut(self.equal, blocks);
        let (vectors, rest_vectors) = cut(self.vectors, places);
        let (settled, rest_settled) = cut(self.settled, places);
        (
            Self { order, first: self.first, known, equal, vectors, settled },
            Self {
                order,
                first: number,
                known: rest_known,
                equal: rest_equal,
                vectors: rest_vectors,
                settled: rest_settled,
            },
        )
    }

    /// What is known around block `number` of a slice that begins with block `first`.
    #[inline(always)]
    pub(super) fn near(&self, place: Place, first: usize, number: usize) -> Near<'_> {
        Near::new(&self.known[first - self.first..number - self.first], self.order, place, first, number)
    }

    /// What `tiles-fast` knows around block `number` of a slice that begins with block `first`: its blocks are tiles, not rows.
    #[inline(always)]
    pub(super) fn beside(&self, place: Place, first: usize, number: usize) -> Beside<'_> {
        let around = self.order.around(number, place);
        let known =
            |number: Option<usize>| number.filter(|number| *number >= first).map(|n| &self.known[n - self.first]);
        Beside {
            above: known(around.above).map(|above| &above.rows),
            left: known(around.left).map(|left| left.rows[7]),
        }
    }

    /// Takes over a block of tiles.
    #[inline(always)]
    pub(super) fn put_tiles(&mut self, number: usize, tiles: Block) {
        self.known[number - self.first].rows = tiles;
    }
}

/// A thread's memory.
pub(super) struct Lane {
    pub(super) states: States,
    /// Of slices with a reference.
    pub(super) moved: Memory,
    /// The slices of a run.
    pub(super) output: Vec<u8>,
}

impl Lane {
    pub(super) fn new() -> Self {
        Self { states: prior::states(), moved: Memory::new(), output: Vec::new() }
    }

    /// Makes slices of a run, in [`Self::output`]. `bits_bytes` is what the bits of each may take; only where that is too short for
    /// one block (at most 1 KiB) they take more. What `open` appends comes before each slice, and `close` gets both and the
    /// slice's length.
    pub(super) fn encode(
        &mut self,
        way: Way<'_>,
        mask: &Mask,
        mut run: Run<'_>,
        bits_bytes: usize,
        open: impl Fn(&mut Vec<u8>),
        close: impl Fn(&mut [u8], usize),
    ) {
        let mut output = std::mem::take(&mut self.output);
        output.clear();
        let Range { start: mut first, end } = run.blocks();
        while first < end {
            let part = output.len();
            open(&mut output);
            let start = output.len();
            output.extend_from_slice(&[0; SLICE_HEAD_BYTES]);
            let blocks = first..end.min(first + usize::from(u16::MAX));
            let next = match way {
                Way::Moved(reference) => self.encode_moved(reference, mask, &mut run, blocks, bits_bytes, &mut output),
                Way::Small => self.encode_small(mask, &mut run, blocks, bits_bytes, &mut output),
                Way::Fast => encode_fast(mask, &mut run, blocks, bits_bytes, &mut output),
            };
            output[start..start + 3].copy_from_slice(&first.to_le_bytes()[..3]);
            output[start + 3..start + 5].copy_from_slice(&(next - first).to_le_bytes()[..2]);
            let bytes = output.len() - start;
            close(&mut output[part..], bytes);
            first = next;
        }
        self.output = output;
    }

    /// Appends as many of these blocks as fit, at least one, and says which is the next.
    fn encode_small(
        &mut self,
        mask: &Mask,
        run: &mut Run<'_>,
        blocks: Range<usize>,
        bytes: usize,
        output: &mut Vec<u8>,
    ) -> usize {
        let states = &mut self.states;
        states.begin();
        let mut bits = RangeEncoder::new(output);
        let mut end = blocks.end;
        for (number, place) in run.order.walk(blocks.clone()) {
            let here = bits.here();
            let own = block::gather(mask, run.order, place);
            let near = run.near(place, blocks.start, number);
            run.known[number - run.first] = small::code(&mut bits, states, &near, &own);
            if bits.most_bytes() > bytes && number > blocks.start {
                bits.back_to(here);
                end = number;
                break;
            }
        }
        bits.finish();
        end
    }

    /// Decodes a slice of a run. Of one that fails, some blocks may have been written.
    pub(super) fn decode(
        &mut self,
        way: Way<'_>,
        run: &mut Run<'_>,
        blocks: Range<usize>,
        slice: &[u8],
    ) -> Result<(), Failure> {
        let bits = &slice[SLICE_HEAD_BYTES..];
        let done = match way {
            Way::Moved(reference) => self.decode_moved(reference, run, blocks, bits),
            Way::Small => self.decode_small(run, blocks, bits),
            Way::Fast => decode_fast(run, blocks, bits),
        };
        if done { Ok(()) } else { Err(Failure::Bits) }
    }

    /// Whether the bits are those of these blocks.
    fn decode_small(&mut self, run: &mut Run<'_>, blocks: Range<usize>, bits: &[u8]) -> bool {
        let states = &mut self.states;
        states.begin();
        let mut bits = RangeDecoder::new(bits);
        for (number, place) in run.order.walk(blocks.clone()) {
            let near = run.near(place, blocks.start, number);
            let block = small::code(&mut bits, states, &near, &Known::flat(false));
            if !bits.is_within() {
                return false;
            }
            run.known[number - run.first] = block;
        }
        bits.is_at_end()
    }
}

/// As [`Lane::encode_small`].
fn encode_fast(mask: &Mask, run: &mut Run<'_>, blocks: Range<usize>, bytes: usize, output: &mut Vec<u8>) -> usize {
    let mut bits = BitWriter::new(output);
    let (mut end, mut as_expected) = (blocks.end, 0);
    for (number, place) in run.order.walk(blocks.clone()) {
        let own = block::gather_tiles(mask, run.order, place);
        let beside = run.beside(place, blocks.start, number);
        let expected = fast::expected(beside);
        if own.iter().fold(0, |differs, tile| differs | (tile ^ expected)) == 0 {
            as_expected += 1;
            run.put_tiles(number, own);
            continue;
        }
        let here = bits.here();
        bits.put_number(as_expected);
        let tiles = run.order.tiles(place).len();
        let own = fast::code(&mut Writing(&mut bits, &CODES), beside, tiles, &own);
        run.put_tiles(number, own);
        // There must be room for the number at the end.
        if bits.bytes() + NUMBER_BYTES > bytes && number > blocks.start {
            bits.back_to(here);
            end = number;
            break;
        }
        as_expected = 0;
    }
    if as_expected > 0 {
        bits.put_number(as_expected);
    }
    bits.finish();
    end
}

/// As [`Lane::decode_small`].
fn decode_fast(run: &mut Run<'_>, blocks: Range<usize>, bits: &[u8]) -> bool {
    let mut bits = BitReader::new(bits);
    let mut as_expected = bits.number();
    for (number, place) in run.order.walk(blocks.clone()) {
        let beside = run.beside(place, blocks.start, number);
        let tiles = match as_expected {
            None => return false,
            Some(0) => {
                let tiles = run.order.tiles(place).len();
                let tiles = fast::code(&mut Reading(&mut bits, &CODES), beside, tiles, &[0; 8]);
                as_expected = if number + 1 < blocks.end { bits.number() } else { Some(0) };
                tiles
            }
            Some(more) => {
                as_expected = Some(more - 1);
                [fast::expected(beside); 8]
            }
        };
        if !bits.is_within() {
            return false;
        }
        run.put_tiles(number, tiles);
    }
    as_expected == Some(0) && bits.is_at_end()
}
