//! Planes in blocks of 8×8 tiles, in slices that each fit one datagram and need nothing but themselves.
//!
//! | bytes of a slice | field |
//! |---|---|
//! | 0–2 | its first block, in the order of [`order`] |
//! | 3–4 | its number of blocks, at least one |
//! | to the end | the blocks' bits: of `tiles-small` as [`small`]'s model codes them with [`range`]'s coder, of `tiles-fast` as [`fast`] puts them into [`codes`] |
//!
//! All little-endian. A frame of `tiles-small` whose head names a reference says what has moved how, and what is not as it was: [`moved`]. A slice knows nothing of the others: its contexts end at its first block, and its probabilities begin with
//! [`prior`]. So it can be lost alone, and slices can be coded on several cores.

mod bits;
mod block;
mod codes;
mod fast;
mod motion;
mod moved;
mod near;
mod order;
mod prior;
mod range;
mod reference;
mod refine;
mod small;
mod state;

use std::ops::Range;

pub use self::reference::{Reference, ReferenceName};
use self::{
    bits::{BitReader, BitWriter},
    block::{Kind, Known},
    codes::{CODES, Codes},
    fast::Symbols,
    near::Near,
    order::{Order, Place},
    prior::PRIOR,
    range::{RangeDecoder, RangeEncoder},
    small::States,
};
use crate::{
    ids::FrameNumber,
    mask::{Mask, MaskShape},
};

/// Bytes before a slice's bits.
pub(super) const SLICE_HEAD_BYTES: usize = 5;

/// What is saved: bytes or time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Profile {
    Small,
    Fast,
}

/// How blocks are coded.
#[derive(Debug, Clone, Copy)]
pub(super) enum Way<'a> {
    Small,
    Fast,
    /// Against a mask of the same shape.
    Moved(&'a Reference),
}

impl<'a> Way<'a> {
    pub(super) fn new(profile: Profile, reference: Option<&'a Reference>) -> Self {
        match (profile, reference) {
            (Profile::Small, Some(reference)) => Self::Moved(reference),
            (Profile::Small, None) => Self::Small,
            (Profile::Fast, _) => Self::Fast,
        }
    }

    /// Whether what is coded may serve as a reference.
    pub(super) const fn is_kept(self) -> bool {
        !matches!(self, Self::Fast)
    }
}

/// Why bytes are no slice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Failure {
    /// They name no blocks of the picture.
    Blocks,
    /// They are not what an encoder makes of these blocks: too few, or too many.
    Bits,
}

/// The blocks that a slice holds, if its head names blocks of the picture.
pub(super) fn blocks_of(shape: MaskShape, slice: &[u8]) -> Option<Range<usize>> {
    let &[a, b, c, d, e] = slice.first_chunk()?;
    let first = u32::from_le_bytes([a, b, c, 0]) as usize;
    let count = usize::from(u16::from_le_bytes([d, e]));
    (count > 0 && first + count <= Order::new(shape).blocks()).then_some(first..first + count)
}

/// Number of blocks of a picture.
pub(super) fn block_count(shape: MaskShape) -> usize {
    Order::new(shape).blocks()
}

/// The memory of either direction.
pub(super) struct Workspace {
    /// All blocks, in their order.
    blocks: Vec<Known>,
    states: Box<States>,
    /// Of slices with a reference.
    moved: moved::Memory,
    /// Shape of the frame at hand, and a bit for each of its blocks that has been coded.
    shape: Option<MaskShape>,
    seen: Vec<u64>,
}

impl Workspace {
    pub(super) fn new() -> Self {
        Self {
            blocks: Vec::new(),
            states: Box::new(PRIOR.clone()),
            moved: moved::Memory::new(),
            shape: None,
            seen: Vec::new(),
        }
    }

    /// Makes a reference of the frame that was encoded or decoded last. Says no, and leaves `reference` as it is, where there is none
    /// or not all of its blocks were there.
    pub(super) fn keep(&self, frame: FrameNumber, reference: &mut Reference) -> bool {
        let Some(shape) = self.shape else { return false };
        let blocks = self.seen.iter().map(|bits| bits.count_ones() as usize).sum::<usize>();
        let whole = blocks == block_count(shape);
        if whole {
            reference.fill(frame, shape, &self.blocks);
        }
        whole
    }

    /// Begins another frame, or one of another codec, of which nothing is seen here.
    pub(super) fn begin(&mut self, shape: Option<MaskShape>) {
        self.shape = shape;
        self.seen.clear();
        self.seen.resize(shape.map_or(0, |shape| block_count(shape).div_ceil(64)), 0);
    }

    fn see(&mut self, blocks: Range<usize>) {
        for number in blocks {
            if let Some(bits) = self.seen.get_mut(number / 64) {
                *bits |= 1 << (number % 64);
            }
        }
    }

    /// Makes room for the blocks of a picture.
    fn make_room(&mut self, blocks: usize) {
        if self.blocks.len() < blocks {
            self.blocks.resize(blocks, Known::flat(false));
        }
    }

    /// What is known around block `number` of a slice that begins with block `first`, and the memory of the model.
    #[inline(always)]
    fn near(&mut self, order: &Order, place: Place, first: usize, number: usize) -> (Near<'_>, &mut States) {
        (Near::new(&self.blocks, order, place, first, number), &mut self.states)
    }

    /// The value that block `number` of a slice that begins with block `first` has if it goes on as it is to the left, or
    /// else above.
    #[inline(always)]
    fn expected(&self, order: &Order, place: Place, first: usize, number: usize) -> bool {
        let around = order.around(number, place);
        let known = |number: Option<usize>| number.filter(|number| *number >= first).map(|number| &self.blocks[number]);
        match known(around.left).map(|left| left.extent.kind(7)) {
            Some(Kind::Dark) => false,
            Some(Kind::Lit) => true,
            _ => known(around.above).is_some_and(|above| above.rows[7] & 1 == 1),
        }
    }

    /// Appends slices of at most `slice_bytes` bytes. Only where that is too short for one block (at most 1 KiB) is a slice
    /// longer. What `open` appends comes before each of them, and `close` gets both and the slice's length.
    pub(super) fn encode(
        &mut self,
        way: Way<'_>,
        mask: &Mask,
        slice_bytes: usize,
        output: &mut Vec<u8>,
        open: impl Fn(&mut Vec<u8>),
        close: impl Fn(&mut [u8], usize),
    ) {
        let order = Order::new(mask.shape());
        self.make_room(order.blocks());
        self.begin(way.is_kept().then_some(mask.shape()));
        let bits_bytes = slice_bytes.saturating_sub(SLICE_HEAD_BYTES);
        let mut first = 0;
        while first < order.blocks() {
            let part = output.len();
            open(output);
            let start = output.len();
            output.extend_from_slice(&[0; SLICE_HEAD_BYTES]);
            let blocks = first..order.blocks().min(first + usize::from(u16::MAX));
            let next = match way {
                Way::Moved(reference) => self.encode_moved(reference, mask, &order, blocks, bits_bytes, output),
                Way::Small => self.encode_small(mask, &order, blocks, bits_bytes, output),
                Way::Fast => self.encode_fast(mask, &order, blocks, bits_bytes, output),
            };
            output[start..start + 3].copy_from_slice(&first.to_le_bytes()[..3]);
            output[start + 3..start + 5].copy_from_slice(&(next - first).to_le_bytes()[..2]);
            let bytes = output.len() - start;
            close(&mut output[part..], bytes);
            self.see(first..next);
            first = next;
        }
    }

    /// Appends as many of these blocks as fit, at least one, and says which is the next.
    fn encode_small(
        &mut self,
        mask: &Mask,
        order: &Order,
        blocks: Range<usize>,
        bytes: usize,
        output: &mut Vec<u8>,
    ) -> usize {
        self.states.as_mut().clone_from(&PRIOR);
        let mut bits = RangeEncoder::new(output);
        let mut end = blocks.end;
        for (number, place) in order.walk(blocks.clone()) {
            let here = bits.here();
            let block = block::gather(mask, order, place);
            let (near, states) = self.near(order, place, blocks.start, number);
            self.blocks[number] = small::code(&mut bits, states, &near, &block);
            if bits.most_bytes() > bytes && number > blocks.start {
                bits.back_to(here);
                end = number;
                break;
            }
        }
        bits.finish();
        end
    }

    /// As [`Self::encode_small`].
    fn encode_fast(
        &mut self,
        mask: &Mask,
        order: &Order,
        blocks: Range<usize>,
        bytes: usize,
        output: &mut Vec<u8>,
    ) -> usize {
        let codes = &*CODES;
        let mut bits = BitWriter::new(output);
        let (mut end, mut as_expected) = (blocks.end, 0);
        for (number, place) in order.walk(blocks.clone()) {
            let block = block::gather(mask, order, place);
            let expected = self.expected(order, place, blocks.start, number);
            if block.extent.value() == Some(expected) {
                as_expected += 1;
                self.blocks[number] = block;
                continue;
            }
            let (near, _) = self.near(order, place, blocks.start, number);
            let here = bits.here();
            bits.put_number(as_expected);
            self.blocks[number] = fast::code(&mut Writing(&mut bits), codes, &near, &block);
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

    /// Decodes a slice into `mask`, and says which blocks it held. Of a slice that fails, some blocks may have been
    /// written.
    pub(super) fn decode(&mut self, way: Way<'_>, slice: &[u8], mask: &mut Mask) -> Result<Range<usize>, Failure> {
        let (shape, order) = (mask.shape(), Order::new(mask.shape()));
        let blocks = blocks_of(shape, slice).ok_or(Failure::Blocks)?;
        self.make_room(order.blocks());
        let bits = &slice[SLICE_HEAD_BYTES..];
        let done = match way {
            Way::Moved(reference) => self.decode_moved(reference, &order, blocks.clone(), bits, mask),
            Way::Small => self.decode_small(&order, blocks.clone(), bits, mask),
            Way::Fast => self.decode_fast(&order, blocks.clone(), bits, mask),
        };
        if done {
            self.see(blocks.clone());
        }
        done.then_some(blocks).ok_or(Failure::Bits)
    }

    /// Whether the bits are those of these blocks.
    fn decode_small(&mut self, order: &Order, blocks: Range<usize>, bits: &[u8], mask: &mut Mask) -> bool {
        self.states.as_mut().clone_from(&PRIOR);
        let mut bits = RangeDecoder::new(bits);
        for (number, place) in order.walk(blocks.clone()) {
            let (near, states) = self.near(order, place, blocks.start, number);
            let block = small::code(&mut bits, states, &near, &Known::flat(false));
            if !bits.is_within() {
                return false;
            }
            block::scatter(order, place, &block, mask);
            self.blocks[number] = block;
        }
        bits.is_at_end()
    }

    /// As [`Self::decode_small`].
    fn decode_fast(&mut self, order: &Order, blocks: Range<usize>, bits: &[u8], mask: &mut Mask) -> bool {
        let codes = &*CODES;
        let mut bits = BitReader::new(bits);
        let mut as_expected = bits.number();
        for (number, place) in order.walk(blocks.clone()) {
            let block = match as_expected {
                None => return false,
                Some(0) => {
                    let (near, _) = self.near(order, place, blocks.start, number);
                    let block = fast::code(&mut Reading(&mut bits), codes, &near, &Known::flat(false));
                    as_expected = if number + 1 < blocks.end { bits.number() } else { Some(0) };
                    block
                }
                Some(more) => {
                    as_expected = Some(more - 1);
                    Known::flat(self.expected(order, place, blocks.start, number))
                }
            };
            if !bits.is_within() {
                return false;
            }
            block::scatter(order, place, &block, mask);
            self.blocks[number] = block;
        }
        as_expected == Some(0) && bits.is_at_end()
    }
}

/// The most that a number of blocks takes.
const NUMBER_BYTES: usize = 5;

struct Writing<'a, 'b>(&'a mut BitWriter<'b>);

impl Symbols for Writing<'_, '_> {
    #[inline(always)]
    fn symbol(&mut self, codes: &Codes, context: usize, symbol: u8) -> u8 {
        codes.write(self.0, context, symbol);
        symbol
    }
}

struct Reading<'a, 'b>(&'a mut BitReader<'b>);

impl Symbols for Reading<'_, '_> {
    #[inline(always)]
    fn symbol(&mut self, codes: &Codes, context: usize, _: u8) -> u8 {
        codes.read(self.0, context)
    }
}

/// Counts what masks teach the models, each with one that may serve it as a reference: the bytes of `prior.bin`, `codes.bin`
/// and `refine.bin`.
#[must_use]
pub fn train<'a>(masks: impl IntoIterator<Item = (&'a Mask, Option<&'a Mask>)>) -> [Vec<u8>; 3] {
    let mut workspace = Workspace { states: prior::uncounted(), ..Workspace::new() };
    let (mut counts, mut reference) = (vec![[0; 256]; fast::CONTEXTS], Reference::new());
    for (mask, before) in masks {
        let order = Order::new(mask.shape());
        workspace.make_room(order.blocks());
        if let Some(before) = before.filter(|before| before.shape() == mask.shape()) {
            for (number, place) in order.walk(0..order.blocks()) {
                workspace.blocks[number] = block::gather(before, &order, place);
            }
            reference.fill(FrameNumber(0), mask.shape(), &workspace.blocks);
            workspace.count_moved(&mut prior::Counter, &reference, mask);
        }
        for (number, place) in order.walk(0..order.blocks()) {
            let block = block::gather(mask, &order, place);
            let expected = workspace.expected(&order, place, 0, number);
            let (near, states) = workspace.near(&order, place, 0, number);
            small::code(&mut prior::Counter, states, &near, &block);
            if block.extent.value() != Some(expected) {
                fast::code(&mut Counting(&mut counts), &CODES, &near, &block);
            }
            workspace.blocks[number] = block;
        }
    }
    [prior::pack(&workspace.states), codes::pack(&counts), prior::pack_refined(&mut workspace.moved.states)]
}

struct Counting<'a>(&'a mut [[u64; 256]]);

impl Symbols for Counting<'_> {
    fn symbol(&mut self, _: &Codes, context: usize, symbol: u8) -> u8 {
        self.0[context][usize::from(symbol)] += 1;
        symbol
    }
}
