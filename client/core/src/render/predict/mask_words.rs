//! Converts a received mask's bit planes to one word of all lights for each pixel, on the adapter.

use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_shaders::gpu::Gpu;

use crate::render::{
    error::RenderError,
    pipeline::{bind_group, bind_group_layout, cleared, constant, covering_pipeline, shader, storage, uniform},
};

pub(crate) const WORDS: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;

/// Layout of `MaskSize` in `mask_words.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct MaskSize {
    width: u32,
    height: u32,
    lights: u32,
    unused: u32,
}

#[derive(Debug)]
pub(crate) struct WordsPass {
    layout: wgpu::BindGroupLayout,
    pipeline: wgpu::RenderPipeline,
}

/// Memory for the planes of masks of one shape.
#[derive(Debug)]
pub(crate) struct MaskPlanes {
    planes: wgpu::Buffer,
    group: wgpu::BindGroup,
}

impl WordsPass {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let bindings = [uniform::<MaskSize>(gpu), storage(true)];
        let layout = bind_group_layout(device, "mask", wgpu::ShaderStages::FRAGMENT, &bindings);
        let module = shader(gpu, "shading/mask_words.wgsl")?;
        let pipeline = covering_pipeline(device, &module, &[&layout], "gather", WORDS);
        Ok(Self { layout, pipeline })
    }

    /// Allocates memory for masks of this shape.
    ///
    /// # Errors
    /// If the adapter cannot bind that much.
    pub(crate) fn memory(&self, gpu: &Gpu, shape: MaskShape) -> Result<MaskPlanes, RenderError> {
        let device = &gpu.device;
        let (needed, limit) = (shape.words() as u64 * 8, device.limits().max_storage_buffer_binding_size);
        if needed > limit {
            return Err(RenderError::TooLarge { what: "visibility mask", needed, limit });
        }
        let planes = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("visibility mask"),
            size: needed,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let size = MaskSize { width: shape.width(), height: shape.height(), lights: shape.lights(), unused: 0 };
        let size = constant(gpu, "mask size", &size);
        let resources = [size.as_entire_binding(), planes.as_entire_binding()];
        let group = bind_group(device, "mask", &self.layout, &resources);
        Ok(MaskPlanes { planes, group })
    }

    /// Uploads a mask; the commands in `encoder` convert it to `words`. `planes` has the mask's shape.
    pub(crate) fn write(
        &self,
        queue: &wgpu::Queue,
        encoder: &mut wgpu::CommandEncoder,
        (planes, mask): (&MaskPlanes, &Mask),
        words: &wgpu::TextureView,
    ) {
        // A little-endian u64 has its low u32 first, as the shader indexes it.
        #[cfg(target_endian = "big")]
        compile_error!("masks are uploaded as they lie in memory");
        queue.write_buffer(&planes.planes, 0, bytemuck::cast_slice(mask.words()));
        let mut render = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("mask words"),
            color_attachments: &[cleared(words)],
            ..wgpu::RenderPassDescriptor::default()
        });
        render.set_pipeline(&self.pipeline);
        render.set_bind_group(0, &planes.group, &[]);
        render.draw(0..3, 0..1);
    }
}
