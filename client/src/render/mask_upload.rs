//! The newest visibility mask, in a buffer that the shading passes read.

use gnomon_protocol::mask::{Mask, MaskShape};

/// The buffer, as large as the picture's mask can be, and what is in it.
#[derive(Debug)]
pub(crate) struct MaskUpload {
    buffer: wgpu::Buffer,
    shape: MaskShape,
    /// Planes in the buffer: 0 while there is no mask that fits.
    lights: u32,
}

impl MaskUpload {
    pub(crate) fn new(device: &wgpu::Device, shape: MaskShape) -> Self {
        let buffer = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("visibility mask"),
            size: Self::bytes(shape),
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        Self { buffer, shape, lights: 0 }
    }

    /// Bytes of a mask of this shape.
    pub(crate) fn bytes(shape: MaskShape) -> u64 {
        shape.words() as u64 * 8
    }

    /// Sends a mask to the adapter. One of another shape than the picture's counts as none, and the answer is false.
    pub(crate) fn write(&mut self, queue: &wgpu::Queue, mask: Option<&Mask>) -> bool {
        let Some(mask) = mask.filter(|mask| mask.shape() == self.shape) else {
            self.lights = 0;
            return false;
        };
        // A u64 in little-endian order is the low u32 first, which is how the shaders index it.
        #[cfg(target_endian = "big")]
        compile_error!("masks are uploaded as they lie in memory");
        queue.write_buffer(&self.buffer, 0, bytemuck::cast_slice(mask.words()));
        self.lights = self.shape.lights();
        true
    }

    pub(crate) fn lights(&self) -> u32 {
        self.lights
    }

    pub(crate) fn binding(&self) -> wgpu::BindingResource<'_> {
        self.buffer.as_entire_binding()
    }
}
