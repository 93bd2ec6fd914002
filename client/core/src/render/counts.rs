//! Numbers that the adapter counts; the host reads them without waiting.

use std::{
    collections::VecDeque,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use gnomon_shaders::gpu::Gpu;

use super::error::RenderError;

/// Readbacks in flight; while all are busy, frames are not counted.
const SLOTS: usize = 3;

#[derive(Debug)]
pub(crate) struct Counts<Tag> {
    counter: wgpu::Buffer,
    slots: Vec<Slot>,
    /// Slots in flight, oldest first, with what was known when they were counted.
    under_way: VecDeque<(usize, Tag)>,
}

#[derive(Debug)]
struct Slot {
    buffer: wgpu::Buffer,
    /// Set by the driver's callback once the buffer can be read.
    arrived: Arc<AtomicBool>,
}

impl<Tag: Copy> Counts<Tag> {
    pub(crate) fn new(device: &wgpu::Device, label: &'static str, words: u64) -> Self {
        let buffer = |usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: words * 4,
                usage,
                mapped_at_creation: false,
            })
        };
        let slot = |_| Slot {
            buffer: buffer(wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ),
            arrived: Arc::default(),
        };
        Self {
            counter: buffer(wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST),
            slots: (0..SLOTS).map(slot).collect(),
            under_way: VecDeque::new(),
        }
    }

    pub(crate) fn binding(&self) -> wgpu::BindingResource<'_> {
        self.counter.as_entire_binding()
    }

    pub(crate) fn has_free_slot(&self) -> bool {
        self.under_way.len() < SLOTS
    }

    /// Call before the pass that counts.
    pub(crate) fn clear(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.clear_buffer(&self.counter, 0, None);
    }

    /// Call after it: starts a readback if a slot is free.
    pub(crate) fn copy(&mut self, encoder: &mut wgpu::CommandEncoder, tag: Tag) {
        let is_free = |slot: &usize| !self.under_way.iter().any(|(taken, _)| taken == slot);
        let Some(free) = (0..SLOTS).find(is_free) else { return };
        let slot = &self.slots[free];
        encoder.copy_buffer_to_buffer(&self.counter, 0, &slot.buffer, 0, None);
        let arrived = Arc::clone(&slot.arrived);
        encoder.map_buffer_on_submit(&slot.buffer, wgpu::MapMode::Read, .., move |result| {
            // A failed mapping stays under way. It means that the device is lost, which is reported elsewhere.
            arrived.store(result.is_ok(), Ordering::Release);
        });
        self.under_way.push_back((free, tag));
    }

    /// Returns the newest counts that have arrived since the last call, if any.
    pub(crate) fn take_newest(&mut self) -> Option<(Vec<u32>, Tag)> {
        let mut newest = None;
        while let Some(&(oldest, tag)) = self.under_way.front() {
            let slot = &self.slots[oldest];
            if !slot.arrived.swap(false, Ordering::Acquire) {
                break;
            }
            if let Ok(mapped) = slot.buffer.get_mapped_range(..) {
                let words = mapped.as_chunks().0.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect();
                newest = Some((words, tag));
            }
            slot.buffer.unmap();
            self.under_way.pop_front();
        }
        newest
    }

    /// As [`Self::take_newest`], but waits for what is under way.
    ///
    /// # Errors
    /// If the adapter failed.
    pub(crate) fn wait(&mut self, gpu: &Gpu) -> Result<Option<(Vec<u32>, Tag)>, RenderError> {
        let polled = gpu.device.poll(wgpu::PollType::wait_indefinitely());
        polled.map_err(|error| RenderError::Device(error.to_string()))?;
        Ok(self.take_newest())
    }
}
