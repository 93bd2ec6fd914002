//! Reads pictures back through a ring of buffers, so that one is copied while the next is drawn.

use std::collections::VecDeque;

use gnomon_shaders::gpu::Gpu;

use super::{
    error::RenderError,
    targets::{self, PICTURE_FORMAT},
};

/// Bytes of a texel of [`PICTURE_FORMAT`].
const TEXEL_BYTES: u32 = 4;

/// Textures to draw into, and their way back to the host.
#[derive(Debug)]
pub struct PictureReader {
    gpu: Gpu,
    width: u32,
    height: u32,
    /// One texture and one buffer for each picture under way.
    slots: Vec<Slot>,
    next: usize,
    under_way: VecDeque<(u64, usize, wgpu::SubmissionIndex)>,
}

#[derive(Debug)]
struct Slot {
    texture: wgpu::Texture,
    view: wgpu::TextureView,
    buffer: wgpu::Buffer,
}

/// A picture on the host.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// The number given to [`PictureReader::submitted`].
    pub frame: u64,
    pub width: u32,
    pub height: u32,
    /// sRGB-encoded RGBA, 8 bits a channel, row by row from the top.
    pub rgba: Vec<u8>,
}

impl PictureReader {
    /// For pictures of this size, with at most `ahead` under way.
    #[must_use]
    pub fn new(gpu: &Gpu, width: u32, height: u32, ahead: usize) -> Self {
        let slot = || {
            // A window shows the same texture that can be copied.
            let usage = wgpu::TextureUsages::RENDER_ATTACHMENT
                | wgpu::TextureUsages::STORAGE_BINDING
                | wgpu::TextureUsages::COPY_SRC
                | wgpu::TextureUsages::COPY_DST
                | wgpu::TextureUsages::TEXTURE_BINDING;
            let texture = targets::texture(&gpu.device, "picture", (width, height), PICTURE_FORMAT, usage);
            let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("picture"),
                size: u64::from(row_bytes(width)) * u64::from(height),
                usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
                mapped_at_creation: false,
            });
            Slot { view: texture.create_view(&wgpu::TextureViewDescriptor::default()), texture, buffer }
        };
        let slots = (0..ahead.max(1)).map(|_| slot()).collect();
        Self { gpu: gpu.clone(), width, height, slots, next: 0, under_way: VecDeque::new() }
    }

    /// In pixels.
    #[must_use]
    pub fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// Returns the texture for the next picture. [`Self::is_full`] must be false.
    #[must_use]
    pub fn target(&self) -> wgpu::TextureView {
        self.slots[self.next].view.clone()
    }

    /// Copies `other`'s columns from `first_px` on into [`Self::target`]. Both have the same size.
    pub fn replace_from(&self, encoder: &mut wgpu::CommandEncoder, other: &wgpu::Texture, first_px: u32) {
        let origin = wgpu::Origin3d { x: first_px, ..wgpu::Origin3d::ZERO };
        let place = |texture| wgpu::TexelCopyTextureInfo { origin, ..wgpu::Texture::as_image_copy(texture) };
        let size = wgpu::Extent3d {
            width: self.width.saturating_sub(first_px),
            height: self.height,
            depth_or_array_layers: 1,
        };
        encoder.copy_texture_to_texture(place(other), place(&self.slots[self.next].texture), size);
    }

    /// Returns whether every slot holds a picture that has not been taken.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.under_way.len() == self.slots.len()
    }

    /// Adds the copy of [`Self::target`] to the commands that draw it.
    pub fn copy(&self, encoder: &mut wgpu::CommandEncoder) {
        let slot = &self.slots[self.next];
        encoder.copy_texture_to_buffer(
            slot.texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer: &slot.buffer,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(row_bytes(self.width)),
                    rows_per_image: None,
                },
            },
            slot.texture.size(),
        );
    }

    /// Records that picture `frame` was submitted. If `copied` is false, it is waited for but not read back.
    pub fn submitted(&mut self, frame: u64, submission: wgpu::SubmissionIndex, copied: bool) {
        if copied {
            // No callback: reading the range fails if the mapping did.
            self.slots[self.next].buffer.map_async(wgpu::MapMode::Read, .., |_| ());
        }
        self.under_way.push_back((frame, if copied { self.next } else { usize::MAX }, submission));
        self.next = (self.next + 1) % self.slots.len();
    }

    /// Waits for the oldest picture under way. Returns `None` if there is none, `Some(None)` if it is not read back.
    ///
    /// # Errors
    /// If the adapter failed.
    pub fn take_oldest(&mut self) -> Result<Option<Option<Picture>>, RenderError> {
        let Some((frame, slot, submission)) = self.under_way.pop_front() else { return Ok(None) };
        let failed = |reason: &dyn std::fmt::Display| RenderError::Device(reason.to_string());
        self.gpu
            .device
            .poll(wgpu::PollType::Wait { submission_index: Some(submission), timeout: None })
            .map_err(|error| failed(&error))?;
        let Some(slot) = self.slots.get(slot) else { return Ok(Some(None)) };
        let row = (self.width * TEXEL_BYTES) as usize;
        let mut rgba = Vec::with_capacity(row * self.height as usize);
        {
            let mapped = slot.buffer.get_mapped_range(..).map_err(|error| failed(&error))?;
            for line in mapped.chunks_exact(row_bytes(self.width) as usize) {
                rgba.extend_from_slice(&line[..row]);
            }
        }
        slot.buffer.unmap();
        Ok(Some(Some(Picture { frame, width: self.width, height: self.height, rgba })))
    }
}

/// Returns a texture's rows without their padding. Waits for the adapter.
///
/// # Errors
/// If the adapter failed.
pub fn texels(gpu: &Gpu, view: &wgpu::TextureView, aspect: wgpu::TextureAspect) -> Result<Vec<u8>, RenderError> {
    let texture = view.texture();
    let row = texture.width() * texture.format().block_copy_size(Some(aspect)).unwrap_or(TEXEL_BYTES);
    let padded = row.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
    let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("texels"),
        size: u64::from(padded) * u64::from(texture.height()),
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_texture_to_buffer(
        wgpu::TexelCopyTextureInfo { texture, mip_level: 0, origin: wgpu::Origin3d::ZERO, aspect },
        wgpu::TexelCopyBufferInfo {
            buffer: &buffer,
            layout: wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(padded), rows_per_image: None },
        },
        texture.size(),
    );
    gpu.queue.submit([encoder.finish()]);
    buffer.map_async(wgpu::MapMode::Read, .., |_| ());
    let failed = |reason: &dyn std::fmt::Display| RenderError::Device(reason.to_string());
    gpu.device.poll(wgpu::PollType::wait_indefinitely()).map_err(|error| failed(&error))?;
    let mapped = buffer.get_mapped_range(..).map_err(|error| failed(&error))?;
    Ok(mapped.chunks_exact(padded as usize).flat_map(|line| line[..row as usize].to_vec()).collect())
}

/// Stride of a copied picture's rows.
fn row_bytes(width: u32) -> u32 {
    (width * TEXEL_BYTES).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT)
}
