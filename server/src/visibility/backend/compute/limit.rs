//! The largest mask that a device can hold.

use gnomon_protocol::mask::MaskShape;
use gnomon_shaders::gpu::Gpu;

use super::ring::Capacity;
use crate::visibility::backend::BackendError;

/// A device's largest buffer. Usable without access to the device.
#[derive(Debug, Clone)]
pub struct PictureLimit {
    bytes: u64,
    adapter: String,
}

impl PictureLimit {
    pub(super) fn of(gpu: &Gpu) -> Self {
        Self::new(binding_limit(gpu), gpu.info.name.clone())
    }

    pub(super) fn new(bytes: u64, adapter: String) -> Self {
        Self { bytes, adapter }
    }

    /// Checks that masks of this shape can be traced.
    ///
    /// # Errors
    /// If they need a larger buffer than the device has. Names both sizes.
    pub fn check(&self, shape: MaskShape) -> Result<(), BackendError> {
        let bytes = Capacity::of([shape]).largest_bytes();
        if bytes <= self.bytes {
            return Ok(());
        }
        let (width, height, lights) = shape.into();
        Err(BackendError::PictureTooLarge {
            width,
            height,
            lights,
            bytes,
            limit: self.bytes,
            adapter: self.adapter.clone(),
        })
    }
}

/// The largest storage buffer that can be bound, in bytes.
pub(super) fn binding_limit(gpu: &Gpu) -> u64 {
    let limits = gpu.device.limits();
    limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
}
