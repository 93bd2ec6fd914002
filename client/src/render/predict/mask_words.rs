//! The newest mask on the adapter: bit planes, as they came, and one word of all lights for each of its pixels.

use gnomon_protocol::mask::{Mask, MaskShape};

use crate::render::{RenderError, covering_pipeline, shader, targets::texture, uniform};

/// What a mask's words are kept in.
const WORDS: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;

/// Twin of `MaskSize` in `mask_words.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct MaskSize {
    width: u32,
    height: u32,
    lights: u32,
    unused: u32,
}

/// The pass from planes to words.
#[derive(Debug)]
pub(crate) struct WordsPass {
    layout: wgpu::BindGroupLayout,
    pipeline: wgpu::RenderPipeline,
}

/// Memory for masks of one shape, and what it holds.
#[derive(Debug)]
pub(crate) struct MaskWords {
    shape: MaskShape,
    planes: wgpu::Buffer,
    words: wgpu::TextureView,
    group: wgpu::BindGroup,
}

impl WordsPass {
    pub(crate) fn new(device: &wgpu::Device) -> Result<Self, RenderError> {
        let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty,
            count: None,
        };
        let planes = wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Storage { read_only: true },
            has_dynamic_offset: false,
            min_binding_size: None,
        };
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("mask"),
            entries: &[entry(0, uniform::<MaskSize>()), entry(1, planes)],
        });
        let module = shader(device, "shading/mask_words.wgsl")?;
        let pipeline = covering_pipeline(device, &module, &[&layout], "gather", WORDS);
        Ok(Self { layout, pipeline })
    }

    /// Memory for masks of this shape.
    ///
    /// # Errors
    /// When the adapter cannot bind that much.
    pub(crate) fn memory(&self, device: &wgpu::Device, shape: MaskShape) -> Result<MaskWords, RenderError> {
        let limits = device.limits();
        let (needed, limit) = (shape.words() as u64 * 8, limits.max_storage_buffer_binding_size);
        if needed > limit {
            return Err(RenderError::TooLarge { what: "visibility mask", needed, limit });
        }
        let (side, limit) = (shape.width().max(shape.height()), limits.max_texture_dimension_2d);
        if side > limit {
            return Err(RenderError::TooLarge { what: "mask side", needed: side.into(), limit: limit.into() });
        }
        let planes = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("visibility mask"),
            size: needed,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING;
        let words = texture(device, "mask words", (shape.width(), shape.height()), WORDS, usage)
            .create_view(&wgpu::TextureViewDescriptor::default());
        let size = MaskSize { width: shape.width(), height: shape.height(), lights: shape.lights(), unused: 0 };
        let size = crate::render::constant(device, "mask size", &size);
        let resources = [size.as_entire_binding(), planes.as_entire_binding()];
        let entries: Vec<_> =
            (0..).zip(resources).map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource }).collect();
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("mask"),
            layout: &self.layout,
            entries: &entries,
        });
        Ok(MaskWords { shape, planes, words, group })
    }
}

impl MaskWords {
    pub(crate) fn shape(&self) -> MaskShape {
        self.shape
    }

    pub(crate) fn words(&self) -> &wgpu::TextureView {
        &self.words
    }

    /// Sends a mask of [`Self::shape`] to the adapter; the commands in `encoder` make words of it.
    pub(crate) fn write(&self, pass: &WordsPass, queue: &wgpu::Queue, encoder: &mut wgpu::CommandEncoder, mask: &Mask) {
        // A u64 in little-endian order is the low u32 first, which is how the shader indexes it.
        #[cfg(target_endian = "big")]
        compile_error!("masks are uploaded as they lie in memory");
        queue.write_buffer(&self.planes, 0, bytemuck::cast_slice(mask.words()));
        let mut render = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("mask words"),
            color_attachments: &[crate::render::cleared(&self.words)],
            ..wgpu::RenderPassDescriptor::default()
        });
        render.set_pipeline(&pass.pipeline);
        render.set_bind_group(0, &self.group, &[]);
        render.draw(0..3, 0..1);
    }
}
