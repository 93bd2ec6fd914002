//! The buffers of frames that have begun: one frame is traced, an earlier one is copied, and others are interrupted.
//!
//! Buffers are made when a session needs larger ones, never for a frame. All frames share the buffers between the
//! kernels: the queue runs their parts one after the other, and their content does not outlive a part.

use std::{
    ops::Range,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU8, Ordering},
    },
};

use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_shaders::host::TracedCounts;

use super::{
    kernels::{FrameBuffers, Kernels},
    timing::{PART_QUERIES, QUERY_BYTES},
};

/// Whole frames in flight on the device: one is traced, one copied, one waits.
pub const RING_FRAMES: usize = 3;

/// Frames that have buffers: those in flight, and as many interrupted ones.
pub const SLOTS: usize = 2 * RING_FRAMES;

/// Bytes per pixel between the kernels: a position, and a bit per light.
const SURFACE_BYTES: u64 = 16;
const TILE_PIXELS: u64 = 64;
/// Sides of a block in `wgsl/visibility/lists.wgsl`, in tiles.
pub(super) const BLOCK_TILES: u32 = 2;
/// A block's state for a light, and its place in the queue.
const STATE_BYTES: u64 = 8;
const QUEUE_BYTES: u64 = 4;
/// Room for lists, for each block and light. Full lists of Sponza take a third of it on average. Blocks that find no
/// room are traced ray by ray.
const LIST_BYTES: u64 = 128;
/// Smallest buffer, where a kernel needs none.
const UNUSED_BYTES: u64 = 64;
/// Offset of the counts in the host's buffer.
const COUNTS_AT: u64 = 0;
const COUNTS_SIZE: usize = size_of::<TracedCounts>();
const COUNTS_BYTES: u64 = COUNTS_SIZE as u64;
/// Offset of the timestamps.
const TIMES_AT: u64 = COUNTS_AT + COUNTS_BYTES;
/// Offset of the mask's words.
const MASK_AT: u64 = (TIMES_AT + QUERY_BYTES).next_multiple_of(64);

const PENDING: u8 = 0;
const MAPPED: u8 = 1;
const FAILED: u8 = 2;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Capacity {
    surface_bytes: u64,
    pub(super) mask_bytes: u64,
    /// Blocks times lights.
    shafts: u64,
}

impl Capacity {
    /// Sizes that fit every one of these shapes.
    pub(super) fn of(shapes: impl IntoIterator<Item = MaskShape>) -> Self {
        shapes.into_iter().fold(Self::default(), |sum, shape| Self {
            surface_bytes: sum.surface_bytes.max(shape.tiles() as u64 * TILE_PIXELS * SURFACE_BYTES),
            mask_bytes: sum.mask_bytes.max(mask_bytes(shape)),
            shafts: sum.shafts.max(shafts(shape)),
        })
    }

    pub(super) fn holds(self, shape: MaskShape) -> bool {
        let needed = Self::of([shape]);
        needed.surface_bytes <= self.surface_bytes
            && needed.mask_bytes <= self.mask_bytes
            && needed.shafts <= self.shafts
    }

    /// Size of the largest buffer. A block's surfaces take 4 KiB, and its states and lists for up to 32 lights no more.
    pub(super) fn largest_bytes(self) -> u64 {
        self.surface_bytes.max(self.mask_bytes + MASK_AT)
    }
}

/// Blocks of a picture in each direction.
pub(super) fn blocks(tiles_x: u32, tiles_y: u32) -> (u32, u32) {
    (tiles_x.div_ceil(BLOCK_TILES), tiles_y.div_ceil(BLOCK_TILES))
}

fn shafts(shape: MaskShape) -> u64 {
    let (x, y) = blocks(shape.tiles_x(), shape.tiles_y());
    u64::from(x) * u64::from(y) * u64::from(shape.lights())
}

fn mask_bytes(shape: MaskShape) -> u64 {
    shape.words() as u64 * 8
}

#[derive(Debug)]
pub(super) struct Ring {
    pub(super) capacity: Capacity,
    pub(super) slots: [Slot; SLOTS],
}

#[derive(Debug)]
pub(super) struct Slot {
    pub(super) group: wgpu::BindGroup,
    mask: wgpu::Buffer,
    counts: wgpu::Buffer,
    timestamps: wgpu::Buffer,
    host: wgpu::Buffer,
    state: Arc<AtomicU8>,
    taken: Arc<AtomicBool>,
}

/// A leased slot, freed on drop.
#[derive(Debug)]
pub(super) struct Lease {
    slot: usize,
    taken: Arc<AtomicBool>,
}

impl Lease {
    pub(super) fn slot(&self) -> usize {
        self.slot
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        self.taken.store(false, Ordering::Release);
    }
}

impl Ring {
    pub(super) fn new(device: &wgpu::Device, kernels: &Kernels, capacity: Capacity) -> Self {
        use wgpu::BufferUsages as Usage;
        let buffer = |label: &str, size: u64, usage: Usage| {
            device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false })
        };
        let surfaces = buffer("surfaces", capacity.surface_bytes, Usage::STORAGE);
        let for_lists = |bytes: u64| if kernels.lists.is_some() { bytes } else { UNUSED_BYTES };
        let states = buffer("states of blocks", for_lists(capacity.shafts * STATE_BYTES), Usage::STORAGE);
        let lists = buffer("lists of blocks", for_lists(capacity.shafts * LIST_BYTES), Usage::STORAGE);
        let queue = buffer("queue of blocks", for_lists(capacity.shafts * QUEUE_BYTES), Usage::STORAGE);
        let slots = std::array::from_fn(|_| {
            let mask = buffer("mask", capacity.mask_bytes, Usage::STORAGE | Usage::COPY_SRC);
            let counts = buffer("counts", COUNTS_BYTES, Usage::STORAGE | Usage::COPY_SRC | Usage::COPY_DST);
            let lists = [&states, &lists, &queue];
            let buffers = FrameBuffers { surfaces: &surfaces, mask: &mask, counts: &counts, lists };
            Slot {
                group: kernels.bind_frame(device, buffers),
                mask,
                counts,
                timestamps: buffer("timestamps", QUERY_BYTES, Usage::QUERY_RESOLVE | Usage::COPY_SRC),
                host: buffer("host mask", MASK_AT + capacity.mask_bytes, Usage::MAP_READ | Usage::COPY_DST),
                state: Arc::new(AtomicU8::new(PENDING)),
                taken: Arc::default(),
            }
        });
        Self { capacity, slots }
    }

    /// Leases a slot, if one is free.
    pub(super) fn lease(&self) -> Option<Lease> {
        let (index, slot) = self.slots.iter().enumerate().find(|(_, slot)| slot.is_free())?;
        slot.taken.store(true, Ordering::Release);
        Some(Lease { slot: index, taken: Arc::clone(&slot.taken) })
    }
}

impl Slot {
    pub(super) fn is_free(&self) -> bool {
        !self.taken.load(Ordering::Acquire)
    }

    /// Size of a mask's words.
    pub(super) fn mask_bytes(&self, shape: MaskShape) -> u64 {
        mask_bytes(shape).min(self.mask.size())
    }

    /// Resets the counts. Encode before the first part.
    pub(super) fn clear(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.clear_buffer(&self.counts, 0, None);
    }

    /// Copies up to `most` bytes of the mask from byte `from` on, and returns their number. Encode after the kernels.
    pub(super) fn copy_mask(&self, encoder: &mut wgpu::CommandEncoder, shape: MaskShape, from: u64, most: u64) -> u64 {
        let bytes = self.mask_bytes(shape).saturating_sub(from).min(most);
        encoder.copy_buffer_to_buffer(&self.mask, from, &self.host, MASK_AT + from, bytes);
        bytes
    }

    /// Encode after all kernels.
    pub(super) fn copy_counts(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.copy_buffer_to_buffer(&self.counts, 0, &self.host, COUNTS_AT, COUNTS_BYTES);
    }

    /// Encode last.
    pub(super) fn copy_timestamps(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        queries: &wgpu::QuerySet,
        of_frame: Range<u32>,
    ) {
        let bytes = 8 * of_frame.len() as u64;
        encoder.resolve_query_set(queries, of_frame, &self.timestamps, 0);
        encoder.copy_buffer_to_buffer(&self.timestamps, 0, &self.host, TIMES_AT, bytes);
    }

    /// Maps the host's buffer; see [`Self::is_ready`]. Call after submission.
    pub(super) fn map(&self, shape: MaskShape) {
        self.state.store(PENDING, Ordering::Release);
        let state = Arc::clone(&self.state);
        self.host.map_async(wgpu::MapMode::Read, ..MASK_AT + mask_bytes(shape), move |result| {
            state.store(if result.is_ok() { MAPPED } else { FAILED }, Ordering::Release);
        });
    }

    /// Returns whether the frame is in the host's memory. Errors if the device failed to copy it there.
    pub(super) fn is_ready(&self) -> Result<bool, String> {
        match self.state.load(Ordering::Acquire) {
            FAILED => Err("a mask could not be read back".to_owned()),
            state => Ok(state == MAPPED),
        }
    }

    /// Copies these words of a ready frame into `mask`, of the frame's shape. Errors if the buffer is not mapped.
    pub(super) fn read(&self, mask: &mut Mask, words: Range<usize>) -> Result<(), String> {
        let bytes = MASK_AT + 8 * words.start as u64..MASK_AT + 8 * words.end as u64;
        let view = self.host.get_mapped_range(bytes).map_err(|error| error.to_string())?;
        let places = mask.words_mut().get_mut(words).unwrap_or_default();
        for (word, bytes) in places.iter_mut().zip(view.as_chunks().0) {
            *word = u64::from_le_bytes(*bytes);
        }
        Ok(())
    }

    /// Returns the timestamps of `parts` parts and the counts, and unmaps the buffer. Errors if it is not mapped.
    pub(super) fn finish(&self, parts: u32) -> Result<(Vec<u64>, TracedCounts), String> {
        let view = self.host.get_mapped_range(..MASK_AT).map_err(|error| error.to_string())?;
        let (counts, times) = view.split_at(COUNTS_SIZE);
        let counts = bytemuck::pod_read_unaligned(counts);
        let times = times.as_chunks().0.iter().copied().map(u64::from_le_bytes);
        let times = times.take(PART_QUERIES as usize * parts as usize + 1).collect();
        drop(view);
        self.host.unmap();
        Ok((times, counts))
    }
}
