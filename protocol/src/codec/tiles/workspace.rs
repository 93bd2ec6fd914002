//! Codes frames of tiles on several threads and records which blocks arrived.

use std::{convert::Infallible, ops::Range};

use super::{
    block,
    block_range::{BlockRange, Blocks},
    coder_thread::CoderThread,
    mode::Mode,
    order::Order,
    partition::{Partition, Partitioner},
    reference::Reference,
    slice::{Failure, SLICE_HEAD_BYTES, block_count, blocks_of},
};
use crate::{
    codec::encoded_frame::EncodedFrame,
    coverage::Coverage,
    frame::FrameHead,
    ids::FrameNumber,
    mask::{Mask, MaskShape},
};

/// The memory of an encoder or a decoder.
pub(in crate::codec) struct Workspace {
    blocks: Blocks,
    threads: Vec<CoderThread>,
    partitioner: Partitioner,
    /// Shape of the current frame. `None` for codecs without tiles.
    shape: Option<MaskShape>,
    /// The current frame may become a reference.
    is_reference: bool,
    /// A bit for each block that was coded.
    seen: Vec<u64>,
}

impl Workspace {
    pub(in crate::codec) fn new() -> Self {
        Self {
            blocks: Blocks::default(),
            threads: Vec::new(),
            partitioner: Partitioner::default(),
            shape: None,
            is_reference: false,
            seen: Vec::new(),
        }
    }

    /// Makes `reference` the last coded frame. Returns false, and leaves `reference` unchanged, if its codec has no
    /// references or blocks are missing.
    pub(in crate::codec) fn keep(&self, frame: FrameNumber, reference: &mut Reference) -> bool {
        let Some(shape) = self.shape.filter(|_| self.is_reference) else { return false };
        let blocks = self.seen.iter().map(|bits| bits.count_ones() as usize).sum::<usize>();
        let whole = blocks == block_count(shape);
        if whole {
            reference.fill(frame, shape, &self.blocks.decoded);
        }
        whole
    }

    /// Writes which tiles of the last decoded frame arrived: all, if its codec has no tiles.
    pub(in crate::codec) fn coverage(&self, shape: MaskShape, coverage: &mut Coverage) {
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

    /// Starts a frame. `shape` is `None` for codecs without tiles.
    pub(in crate::codec) fn begin(&mut self, shape: Option<MaskShape>) {
        self.shape = shape;
        self.seen.clear();
        self.seen.resize(shape.map_or(0, |shape| block_count(shape).div_ceil(64)), 0);
    }

    /// Continues the current frame, or starts one of another shape.
    pub(in crate::codec) fn resume(&mut self, mode: Mode<'_>, shape: MaskShape) {
        if self.shape != Some(shape) {
            self.begin(Some(shape));
        }
        self.is_reference = mode.is_reference();
    }

    fn mark_seen(&mut self, blocks: Range<usize>) {
        for number in blocks {
            if let Some(bits) = self.seen.get_mut(number / 64) {
                *bits |= 1 << (number % 64);
            }
        }
    }

    /// Appends a part for each slice. A slice has at most `slice_bytes` bytes, or one block if that alone is longer (at
    /// most 1 KiB).
    pub(in crate::codec) fn encode(
        &mut self,
        mode: Mode<'_>,
        head: &FrameHead,
        mask: &Mask,
        slice_bytes: usize,
        frame: &mut EncodedFrame,
    ) {
        let order = Order::new(mask.shape());
        self.blocks.make_room(&order, mode);
        self.begin(None);
        self.resume(mode, mask.shape());
        let partition = self.partitioner.partition(mode, &order, mask);
        make_threads(&mut self.threads, partition.len());
        let bits_bytes = slice_bytes.saturating_sub(SLICE_HEAD_BYTES);
        let threads = &mut self.threads[..partition.len()];
        threads.iter_mut().for_each(|thread| thread.inter.begin_frame(partition.len()));
        let coded: Result<(), Infallible> =
            on_threads(self.blocks.all(&order), &partition, threads, &|thread, range| {
                thread.encode(mode, head, mask, range, bits_bytes);
                Ok(())
            });
        let Ok(()) = coded;
        for thread in threads {
            frame.body.extend_from_slice(&thread.output);
            frame.parts.extend_from_slice(&thread.parts);
        }
        self.mark_seen(0..order.blocks());
    }

    /// Decodes these slices, each with its index in the frame, into `mask`.
    ///
    /// # Errors
    /// Returns the index of a slice that fails. `mask` is unchanged.
    pub(in crate::codec) fn decode<'s, S: Iterator<Item = (usize, &'s [u8])>>(
        &mut self,
        mode: Mode<'_>,
        slices: impl Fn() -> S + Sync,
        mask: &mut Mask,
    ) -> Result<(), (usize, Failure)> {
        let (shape, order) = (mask.shape(), Order::new(mask.shape()));
        self.blocks.make_room(&order, mode);
        if let Some((slice, _)) = slices().find(|(_, bytes)| blocks_of(shape, bytes).is_none()) {
            return Err((slice, Failure::Blocks));
        }
        let held = || slices().filter_map(|(slice, bytes)| Some((slice, blocks_of(shape, bytes)?, bytes)));
        // An honest frame holds each block once. Twice is tolerated; more would let a peer burn our time.
        if held().map(|(_, blocks, _)| blocks.len()).sum::<usize>() > 2 * order.blocks() {
            return Err((0, Failure::Blocks));
        }
        let partition = Partition::between_slices(&order, || held().map(|(_, blocks, bytes)| (blocks, bytes.len())));
        make_threads(&mut self.threads, partition.len());
        let threads = &mut self.threads[..partition.len()];
        on_threads(
            self.blocks.all(&order),
            &partition,
            threads,
            &|thread: &mut CoderThread, mut range: BlockRange<'_>| {
                let own = range.blocks();
                for (slice, blocks, bytes) in held().filter(|(_, blocks, _)| own.contains(&blocks.start)) {
                    thread.decode(mode, &mut range, blocks, bytes).map_err(|failure| (slice, failure))?;
                }
                Ok(())
            },
        )?;
        for (_, blocks, _) in held() {
            for (number, place) in order.walk(blocks.clone()) {
                let decoded = &self.blocks.decoded[number];
                if mode.is_reference() {
                    block::scatter(&order, place, decoded, mask);
                } else {
                    block::scatter_tiles(&order, place, &decoded.rows, mask);
                }
            }
            self.mark_seen(blocks);
        }
        Ok(())
    }
}

fn make_threads(threads: &mut Vec<CoderThread>, count: usize) {
    while threads.len() < count {
        threads.push(CoderThread::new());
    }
}

/// Lets every thread code its range; there are as many threads as ranges. Returns the first range's error.
fn on_threads<E: Send>(
    range: BlockRange<'_>,
    partition: &Partition,
    threads: &mut [CoderThread],
    code: &(impl Fn(&mut CoderThread, BlockRange<'_>) -> Result<(), E> + Sync),
) -> Result<(), E> {
    let Some((half, rest)) = partition.halves() else {
        return threads.first_mut().map_or(Ok(()), |thread| code(thread, range));
    };
    let (threads, rest_threads) = threads.split_at_mut(half.len());
    let (range, rest_range) = range.split(rest.first());
    let halves = (|| on_threads(range, &half, threads, code), || on_threads(rest_range, &rest, rest_threads, code));
    // On a single core, a second thread only costs time.
    let (done, rest_done) =
        if rayon::current_num_threads() == 1 { (halves.0(), halves.1()) } else { rayon::join(halves.0, halves.1) };
    done.and(rest_done)
}
