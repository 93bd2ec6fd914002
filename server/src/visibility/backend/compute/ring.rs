//! The buffers of the frames that have begun, so that one is traced while an earlier one is copied, and others are interrupted.
//!
//! Buffers are made when a session needs larger ones, never for a frame. What lies between the two kernels is shared by
//! all frames: the queue runs their parts one after the other, and nothing there outlives a part.

use std::{
    ops::Range,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU8, Ordering},
    },
};

use gnomon_protocol::mask::{Mask, MaskShape};

use super::{
    kernels::{FrameBuffers, Kernels},
    timing::{PART_QUERIES, QUERY_BYTES},
};

/// Whole frames in flight on the device: one is traced, one copied, one waits.
pub const RING_FRAMES: usize = 3;

/// Frames that have buffers: those in flight, and as many that have begun and are interrupted.
pub const SLOTS: usize = 2 * RING_FRAMES;

/// Bytes of a pixel's surface between the kernels: a position, and a bit for each light.
const SURFACE_BYTES: u64 = 16;
/// Pixels of a tile.
const TILE_PIXELS: u64 = 64;
/// Place of the counts in the host's buffer; the timestamps follow them.
const WORK_AT: u64 = 0;
/// Bytes of the counts: `wgsl/visibility/work.wgsl`.
const WORK_BYTES: u64 = 16;
/// Place of the timestamps there.
const TIMES_AT: u64 = WORK_AT + WORK_BYTES;
/// Place of the mask's words there.
const MASK_AT: u64 = (TIMES_AT + QUERY_BYTES).next_multiple_of(64);

const PENDING: u8 = 0;
const MAPPED: u8 = 1;
const FAILED: u8 = 2;

/// What the buffers must hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Capacity {
    surface_bytes: u64,
    pub(super) mask_bytes: u64,
}

impl Capacity {
    /// Enough for every one of these shapes.
    pub(super) fn of(shapes: impl IntoIterator<Item = MaskShape>) -> Self {
        shapes.into_iter().fold(Self::default(), |sum, shape| Self {
            surface_bytes: sum.surface_bytes.max(shape.tiles() as u64 * TILE_PIXELS * SURFACE_BYTES),
            mask_bytes: sum.mask_bytes.max(mask_bytes(shape)),
        })
    }

    pub(super) fn holds(self, shape: MaskShape) -> bool {
        let needed = Self::of([shape]);
        needed.surface_bytes <= self.surface_bytes && needed.mask_bytes <= self.mask_bytes
    }

    /// Its largest buffer, in bytes.
    pub(super) fn largest_bytes(self) -> u64 {
        self.surface_bytes.max(self.mask_bytes + MASK_AT)
    }
}

fn mask_bytes(shape: MaskShape) -> u64 {
    shape.words() as u64 * 8
}

/// Buffers of all frames in flight.
#[derive(Debug)]
pub(super) struct Ring {
    pub(super) capacity: Capacity,
    pub(super) slots: [Slot; SLOTS],
}

/// What the kernels counted of one frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Work {
    /// Shadow rays that pixels want.
    pub(super) wanted: u64,
    /// Nodes that rays visited, when they are counted.
    pub(super) nodes: u64,
    /// Shadow rays traced, when not every pixel that wants one has its own.
    pub(super) traced: u64,
}

/// Buffers of one frame.
#[derive(Debug)]
pub(super) struct Slot {
    pub(super) group: wgpu::BindGroup,
    mask: wgpu::Buffer,
    work: wgpu::Buffer,
    timestamps: wgpu::Buffer,
    host: wgpu::Buffer,
    state: Arc<AtomicU8>,
    taken: Arc<AtomicBool>,
}

/// A slot that is taken until this is dropped.
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
        let slots = std::array::from_fn(|_| {
            let mask = buffer("mask", capacity.mask_bytes, Usage::STORAGE | Usage::COPY_SRC);
            let work = buffer("work", WORK_BYTES, Usage::STORAGE | Usage::COPY_SRC | Usage::COPY_DST);
            Slot {
                group: kernels.bind_frame(device, FrameBuffers { surfaces: &surfaces, mask: &mask, work: &work }),
                mask,
                work,
                timestamps: buffer("timestamps", QUERY_BYTES, Usage::QUERY_RESOLVE | Usage::COPY_SRC),
                host: buffer("host mask", MASK_AT + capacity.mask_bytes, Usage::MAP_READ | Usage::COPY_DST),
                state: Arc::new(AtomicU8::new(PENDING)),
                taken: Arc::default(),
            }
        });
        Self { capacity, slots }
    }

    /// Takes a slot, if one is free.
    pub(super) fn lease(&self) -> Option<Lease> {
        let (slot, taken) = self.slots.iter().enumerate().find(|(_, slot)| slot.is_free())?;
        taken.taken.store(true, Ordering::Release);
        Some(Lease { slot, taken: Arc::clone(&taken.taken) })
    }
}

impl Slot {
    /// Whether no frame has it.
    pub(super) fn is_free(&self) -> bool {
        !self.taken.load(Ordering::Acquire)
    }

    /// What the words of a mask take, in bytes.
    pub(super) fn mask_bytes(&self, shape: MaskShape) -> u64 {
        mask_bytes(shape).min(self.mask.size())
    }

    /// Before the first part: no ray is counted yet.
    pub(super) fn clear(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.clear_buffer(&self.work, 0, None);
    }

    /// Behind the kernels: copies at most so many bytes of the mask, from this one on, and says how many.
    pub(super) fn copy_mask(&self, encoder: &mut wgpu::CommandEncoder, shape: MaskShape, from: u64, most: u64) -> u64 {
        let bytes = self.mask_bytes(shape).saturating_sub(from).min(most);
        encoder.copy_buffer_to_buffer(&self.mask, from, &self.host, MASK_AT + from, bytes);
        bytes
    }

    /// Behind all kernels: copies what they counted.
    pub(super) fn copy_work(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.copy_buffer_to_buffer(&self.work, 0, &self.host, WORK_AT, WORK_BYTES);
    }

    /// At the very end: copies the timestamps.
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

    /// After submission: asks for the host's buffer. [`Self::is_ready`] tells when it is there.
    pub(super) fn map(&self, shape: MaskShape) {
        self.state.store(PENDING, Ordering::Release);
        let state = Arc::clone(&self.state);
        self.host.map_async(wgpu::MapMode::Read, ..MASK_AT + mask_bytes(shape), move |result| {
            state.store(if result.is_ok() { MAPPED } else { FAILED }, Ordering::Release);
        });
    }

    /// Whether the frame is in the host's memory.
    ///
    /// # Errors
    /// When the device failed to bring it there.
    pub(super) fn is_ready(&self) -> Result<bool, String> {
        match self.state.load(Ordering::Acquire) {
            FAILED => Err("a mask could not be read back".to_owned()),
            state => Ok(state == MAPPED),
        }
    }

    /// Copies these words of a frame that is ready into `mask`, whose shape it must have.
    ///
    /// # Errors
    /// When the buffer is not mapped after all.
    pub(super) fn read(&self, mask: &mut Mask, words: Range<usize>) -> Result<(), String> {
        let bytes = MASK_AT + 8 * words.start as u64..MASK_AT + 8 * words.end as u64;
        let view = self.host.get_mapped_range(bytes).map_err(|error| error.to_string())?;
        let places = mask.words_mut().get_mut(words).unwrap_or_default();
        for (word, bytes) in places.iter_mut().zip(view.as_chunks().0) {
            *word = u64::from_le_bytes(*bytes);
        }
        Ok(())
    }

    /// When all is read of a frame that was traced in so many parts: its timestamps and its counts. The buffer is the device's again.
    ///
    /// # Errors
    /// When the buffer is not mapped after all.
    pub(super) fn finish(&self, parts: u32) -> Result<(Vec<u64>, Work), String> {
        let view = self.host.get_mapped_range(..MASK_AT).map_err(|error| error.to_string())?;
        let mut head = view.as_chunks().0.iter().copied().map(u64::from_le_bytes);
        let [first, second] = std::array::from_fn(|_| head.next().unwrap_or_default());
        let times = head.take(PART_QUERIES as usize * parts as usize + 1).collect();
        let low = |word: u64| word & u64::from(u32::MAX);
        let work = Work { wanted: low(first), nodes: first >> 32, traced: low(second) };
        drop(view);
        self.host.unmap();
        Ok((times, work))
    }
}
