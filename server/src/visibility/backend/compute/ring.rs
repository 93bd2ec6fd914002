//! The read-back ring: buffers of the frames in flight, so that one is traced while an earlier one is copied.
//!
//! Buffers are made when a session needs larger ones, never for a frame. What lies between the two kernels is shared by
//! all frames: the queue runs them one after the other.

use std::sync::{
    Arc,
    atomic::{AtomicU8, Ordering},
};

use gnomon_protocol::mask::{Mask, MaskShape};

use super::{
    kernels::{FrameBuffers, Kernels},
    timing::{QUERIES, QUERY_BYTES},
};

/// Frames in flight on the device: one is traced, one copied, one waits.
pub const RING_FRAMES: usize = 3;

/// Bytes of a pixel's surface between the kernels: a position, and a bit for each light.
const SURFACE_BYTES: u64 = 16;
/// Pixels of a tile.
const TILE_PIXELS: u64 = 64;
/// Place of the counts in the host's buffer, behind the timestamps.
const WORK_AT: u64 = QUERY_BYTES;
/// Bytes of the counts: `wgsl/visibility/work.wgsl`.
const WORK_BYTES: u64 = 16;
/// Place of the mask's words there, in words and in bytes.
const MASK_WORDS_AT: usize = 8;
const MASK_AT: u64 = 8 * MASK_WORDS_AT as u64;
const _: () = assert!(WORK_AT + WORK_BYTES <= MASK_AT);

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
    pub(super) slots: [Slot; RING_FRAMES],
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
            }
        });
        Self { capacity, slots }
    }
}

impl Slot {
    /// Before the kernels: no ray is counted yet.
    pub(super) fn clear(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.clear_buffer(&self.work, 0, None);
    }

    /// Behind the kernels: copies what they wrote.
    pub(super) fn copy_mask(&self, encoder: &mut wgpu::CommandEncoder, shape: MaskShape) {
        encoder.copy_buffer_to_buffer(&self.mask, 0, &self.host, MASK_AT, mask_bytes(shape));
        encoder.copy_buffer_to_buffer(&self.work, 0, &self.host, WORK_AT, WORK_BYTES);
    }

    /// At the very end: copies the timestamps.
    pub(super) fn copy_timestamps(&self, encoder: &mut wgpu::CommandEncoder, queries: &wgpu::QuerySet, first: u32) {
        encoder.resolve_query_set(queries, first..first + QUERIES, &self.timestamps, 0);
        encoder.copy_buffer_to_buffer(&self.timestamps, 0, &self.host, 0, QUERY_BYTES);
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

    /// Copies a frame that is ready into `mask`, whose shape it must have, and gives the timestamps and the counts.
    ///
    /// # Errors
    /// When the buffer is not mapped after all.
    pub(super) fn read(&self, mask: &mut Mask) -> Result<([u64; QUERIES as usize], Work), String> {
        let bytes = MASK_AT + mask_bytes(mask.shape());
        let view = self.host.get_mapped_range(..bytes).map_err(|error| error.to_string())?;
        let (head, words) = view.split_at(MASK_WORDS_AT * 8);
        let mut head = head.as_chunks().0.iter().copied().map(u64::from_le_bytes);
        let timestamps = std::array::from_fn(|_| head.next().unwrap_or_default());
        let [first, second] = std::array::from_fn(|_| head.next().unwrap_or_default());
        let low = |word: u64| word & u64::from(u32::MAX);
        let work = Work { wanted: low(first), nodes: first >> 32, traced: low(second) };
        for (word, bytes) in mask.words_mut().iter_mut().zip(words.as_chunks().0) {
            *word = u64::from_le_bytes(*bytes);
        }
        drop(view);
        self.host.unmap();
        Ok((timestamps, work))
    }
}
