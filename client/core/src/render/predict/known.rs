//! Counts the pixels with unknown visibility on the adapter; the host reads the counter without waiting.

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

/// Readbacks in flight; while all are busy, frames are not counted.
const SLOTS: usize = 3;

#[derive(Debug)]
pub(crate) struct UnknownCount {
    counter: wgpu::Buffer,
    slots: Vec<Slot>,
    /// Slots in flight, oldest first.
    under_way: std::collections::VecDeque<usize>,
    newest: Option<u32>,
}

#[derive(Debug)]
struct Slot {
    buffer: wgpu::Buffer,
    /// Set by the driver's callback once the buffer can be read.
    arrived: Arc<AtomicBool>,
}

impl UnknownCount {
    pub(crate) fn new(device: &wgpu::Device) -> Self {
        let buffer = |label, usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: 4,
                usage,
                mapped_at_creation: false,
            })
        };
        let counter = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
        let slot = |_| Slot {
            buffer: buffer("unknown pixels, on the way", wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ),
            arrived: Arc::default(),
        };
        Self {
            counter: buffer("unknown pixels", counter),
            slots: (0..SLOTS).map(slot).collect(),
            under_way: std::collections::VecDeque::new(),
            newest: None,
        }
    }

    pub(crate) fn binding(&self) -> wgpu::BindingResource<'_> {
        self.counter.as_entire_binding()
    }

    /// Call before the pass that counts.
    pub(crate) fn clear(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.clear_buffer(&self.counter, 0, None);
    }

    /// Call after it: starts a readback if a slot is free.
    pub(crate) fn copy(&mut self, encoder: &mut wgpu::CommandEncoder) {
        let Some(free) = (0..SLOTS).find(|slot| !self.under_way.contains(slot)) else { return };
        let slot = &self.slots[free];
        encoder.copy_buffer_to_buffer(&self.counter, 0, &slot.buffer, 0, 4);
        let arrived = Arc::clone(&slot.arrived);
        encoder.map_buffer_on_submit(&slot.buffer, wgpu::MapMode::Read, .., move |result| {
            // A failed mapping stays under way. It means that the device is lost, which is reported elsewhere.
            arrived.store(result.is_ok(), Ordering::Release);
        });
        self.under_way.push_back(free);
    }

    /// Returns the newest count that was read back, in pixels.
    pub(crate) fn newest(&mut self) -> Option<u32> {
        while let Some(&oldest) = self.under_way.front() {
            let slot = &self.slots[oldest];
            if !slot.arrived.swap(false, Ordering::Acquire) {
                break;
            }
            if let Ok(mapped) = slot.buffer.get_mapped_range(..) {
                self.newest = mapped.first_chunk().map(|bytes| u32::from_le_bytes(*bytes));
            }
            slot.buffer.unmap();
            self.under_way.pop_front();
        }
        self.newest
    }
}
