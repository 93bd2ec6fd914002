//! Planes in blocks of 8×8 tiles, in slices that each fit one datagram and need nothing but themselves.
//!
//! | bytes of a slice | field |
//! |---|---|
//! | 0–2 | its first block, in the order of [`order`] |
//! | 3–4 | its number of blocks, at least one |
//! | to the end | the blocks' bits: of `tiles-small` as [`small`]'s model codes them with [`range`]'s coder, of `tiles-fast` as [`fast`] puts them into [`codes`] |
//!
//! All little-endian. A frame of `tiles-small` whose head names a reference says what has moved how, and what is not as it was:
//! [`moved`]. A slice knows nothing of the others: its contexts end at its first block, and its probabilities begin with [`prior`].
//! So it can be lost alone, and runs of slices are coded on several cores ([`lane`]). Which blocks a run has depends on the mask
//! alone: a frame's bytes are the same on any number of cores.

mod bits;
mod block;
mod choice;
mod codes;
mod edges;
mod fast;
mod lane;
mod motion;
mod moved;
mod near;
mod order;
mod prior;
mod range;
mod reference;
mod refine;
mod share;
mod small;
mod state;
mod table;
mod training;

use std::{convert::Infallible, ops::Range};

use self::{
    bits::{BitReader, BitWriter},
    codes::Codes,
    fast::Symbols,
    lane::{Blocks, Lane, Run},
    order::Order,
    share::{Cuts, Shares},
};
pub use self::{
    reference::{Reference, ReferenceName},
    training::train,
};
use crate::{
    coverage::Coverage,
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

/// Places of these blocks' tiles in a mask's words.
pub(super) fn words_of(shape: MaskShape, blocks: Range<usize>) -> impl Iterator<Item = Range<usize>> {
    let order = Order::new(shape);
    order.walk(blocks).map(move |(_, place)| {
        let tiles = order.tiles(place);
        let plane = place.light * shape.tiles();
        plane + tiles.start..plane + tiles.end
    })
}

/// Number of blocks of a picture.
pub(super) fn block_count(shape: MaskShape) -> usize {
    Order::new(shape).blocks()
}

/// The memory of either direction.
pub(super) struct Workspace {
    blocks: Blocks,
    lanes: Vec<Lane>,
    shares: Shares,
    /// Shape of the frame at hand, whether it may serve as a reference, and a bit for each of its blocks that has been coded.
    shape: Option<MaskShape>,
    is_kept: bool,
    seen: Vec<u64>,
}

impl Workspace {
    pub(super) fn new() -> Self {
        Self {
            blocks: Blocks::default(),
            lanes: Vec::new(),
            shares: Shares::default(),
            shape: None,
            is_kept: false,
            seen: Vec::new(),
        }
    }

    /// Makes a reference of the frame that was encoded or decoded last. Says no, and leaves `reference` as it is, where there is none
    /// or not all of its blocks were there.
    pub(super) fn keep(&self, frame: FrameNumber, reference: &mut Reference) -> bool {
        let Some(shape) = self.shape.filter(|_| self.is_kept) else { return false };
        let blocks = self.seen.iter().map(|bits| bits.count_ones() as usize).sum::<usize>();
        let whole = blocks == block_count(shape);
        if whole {
            reference.fill(frame, shape, &self.blocks.known);
        }
        whole
    }

    /// Says what of the frame that was decoded last has come: all of it where it is none of these codecs'.
    pub(super) fn coverage(&self, shape: MaskShape, coverage: &mut Coverage) {
        if self.shape != Some(shape) {
            coverage.set_whole(shape);
            return;
        }
        coverage.set_none(shape);
        let order = Order::new(shape);
        for (number, place) in order.walk(0..order.blocks()) {
            if self.seen[number / 64] >> (number % 64) & 1 == 1 {
                coverage.add(place.x, place.y, place.light);
            }
        }
    }

    /// Begins another frame, or one of another codec, of which nothing is seen here.
    pub(super) fn begin(&mut self, shape: Option<MaskShape>) {
        self.shape = shape;
        self.seen.clear();
        self.seen.resize(shape.map_or(0, |shape| block_count(shape).div_ceil(64)), 0);
    }

    /// Goes on with the frame that has begun, or begins it where it has another shape.
    pub(super) fn go_on(&mut self, way: Way<'_>, shape: MaskShape) {
        if self.shape != Some(shape) {
            self.begin(Some(shape));
        }
        self.is_kept = way.is_kept();
    }

    fn see(&mut self, blocks: Range<usize>) {
        for number in blocks {
            if let Some(bits) = self.seen.get_mut(number / 64) {
                *bits |= 1 << (number % 64);
            }
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
        open: impl Fn(&mut Vec<u8>) + Sync,
        close: impl Fn(&mut [u8], usize) + Sync,
    ) {
        let order = Order::new(mask.shape());
        self.blocks.make_room(&order, way);
        self.begin(None);
        self.go_on(way, mask.shape());
        let cuts = self.shares.of_mask(way, &order, mask);
        make_lanes(&mut self.lanes, cuts.runs());
        let bits_bytes = slice_bytes.saturating_sub(SLICE_HEAD_BYTES);
        let lanes = &mut self.lanes[..cuts.runs()];
        lanes.iter_mut().for_each(|lane| lane.moved.begin_frame(cuts.runs()));
        let coded: Result<(), Infallible> = on_lanes(self.blocks.all(&order), &cuts, lanes, &|lane, run| {
            lane.encode(way, mask, run, bits_bytes, &open, &close);
            Ok(())
        });
        let Ok(()) = coded;
        lanes.iter().for_each(|lane| output.extend_from_slice(&lane.output));
        self.see(0..order.blocks());
    }

    /// Decodes these slices, each with its place in the frame, into `mask`. Where one fails, says which, and leaves `mask` as it is.
    pub(super) fn decode<'s, S: Iterator<Item = (usize, &'s [u8])>>(
        &mut self,
        way: Way<'_>,
        slices: impl Fn() -> S + Sync,
        mask: &mut Mask,
    ) -> Result<(), (usize, Failure)> {
        let (shape, order) = (mask.shape(), Order::new(mask.shape()));
        self.blocks.make_room(&order, way);
        let mut each = slices();
        let nameless = each.find(|(_, bytes)| blocks_of(shape, bytes).is_none());
        if let Some((slice, _)) = nameless {
            return Err((slice, Failure::Blocks));
        }
        let held = || slices().filter_map(|(slice, bytes)| Some((slice, blocks_of(shape, bytes)?, bytes)));
        // No honest frame says anything twice. One that does may, once; more is somebody who wants our time.
        if held().map(|(_, blocks, _)| blocks.len()).sum::<usize>() > 2 * order.blocks() {
            return Err((0, Failure::Blocks));
        }
        let cuts = Cuts::between_slices(&order, || held().map(|(_, blocks, bytes)| (blocks, bytes.len())));
        make_lanes(&mut self.lanes, cuts.runs());
        let lanes = &mut self.lanes[..cuts.runs()];
        on_lanes(self.blocks.all(&order), &cuts, lanes, &|lane: &mut Lane, mut run: Run<'_>| {
            let own = run.blocks();
            for (slice, blocks, bytes) in held().filter(|(_, blocks, _)| own.contains(&blocks.start)) {
                lane.decode(way, &mut run, blocks, bytes).map_err(|failure| (slice, failure))?;
            }
            Ok(())
        })?;
        for (_, blocks, _) in held() {
            for (number, place) in order.walk(blocks.clone()) {
                let known = &self.blocks.known[number];
                if way.is_kept() {
                    block::scatter(&order, place, known, mask);
                } else {
                    block::scatter_tiles(&order, place, &known.rows, mask);
                }
            }
            self.see(blocks);
        }
        Ok(())
    }
}

fn make_lanes(lanes: &mut Vec<Lane>, count: usize) {
    while lanes.len() < count {
        lanes.push(Lane::new());
    }
}

/// Has every lane code its run; the lanes are as many as the runs. The first run's failure comes out.
fn on_lanes<E: Send>(
    run: Run<'_>,
    cuts: &Cuts,
    lanes: &mut [Lane],
    code: &(impl Fn(&mut Lane, Run<'_>) -> Result<(), E> + Sync),
) -> Result<(), E> {
    let Some((half, rest)) = cuts.halves() else {
        return lanes.first_mut().map_or(Ok(()), |lane| code(lane, run));
    };
    let (lanes, rest_lanes) = lanes.split_at_mut(half.runs());
    let (run, rest_run) = run.split(rest.first());
    let halves = (|| on_lanes(run, &half, lanes, code), || on_lanes(rest_run, &rest, rest_lanes, code));
    // A single core need not be handed over from thread to thread.
    let (done, rest_done) =
        if rayon::current_num_threads() == 1 { (halves.0(), halves.1()) } else { rayon::join(halves.0, halves.1) };
    done.and(rest_done)
}

/// The most that a number of blocks takes.
const NUMBER_BYTES: usize = 5;

struct Writing<'a, 'b>(&'a mut BitWriter<'b>, &'a Codes);

impl Symbols for Writing<'_, '_> {
    #[inline(always)]
    fn short(&mut self, context: usize, symbol: u8) -> u8 {
        self.1.short.write(self.0, context, symbol);
        symbol
    }

    #[inline(always)]
    fn long(&mut self, context: usize, symbol: u8) -> u8 {
        self.1.long.write(self.0, context, symbol);
        symbol
    }
}

struct Reading<'a, 'b>(&'a mut BitReader<'b>, &'a Codes);

impl Symbols for Reading<'_, '_> {
    #[inline(always)]
    fn short(&mut self, context: usize, _: u8) -> u8 {
        self.1.short.read(self.0, context)
    }

    #[inline(always)]
    fn long(&mut self, context: usize, _: u8) -> u8 {
        self.1.long.read(self.0, context)
    }
}
