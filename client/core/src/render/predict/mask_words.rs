//! Converts a received mask's bit planes to one word of all lights for each pixel, on the adapter.

use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_shaders::gpu::Gpu;

use crate::render::{
    error::RenderError,
    pipeline::{
        bind_group, bind_group_layout, compute, compute_pipeline, constant, dispatch_pixels, shader, storage, uniform,
        written_picture,
    },
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
    target_layout: wgpu::BindGroupLayout,
    pipeline: wgpu::ComputePipeline,
}

/// Memory for the planes of masks of one shape.
#[derive(Debug)]
pub(crate) struct MaskPlanes {
    shape: MaskShape,
    planes: wgpu::Buffer,
    group: wgpu::BindGroup,
}

impl WordsPass {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let bindings = [uniform::<MaskSize>(gpu), storage(true)];
        let layout = bind_group_layout(device, "mask", wgpu::ShaderStages::COMPUTE, &bindings);
        let written = [written_picture(WORDS)];
        let target_layout = bind_group_layout(device, "mask words", wgpu::ShaderStages::COMPUTE, &written);
        let module = shader(gpu, "shading/mask_words.wgsl")?;
        let pipeline = compute_pipeline(device, &module, &[&layout, &target_layout], ("gather", &[]));
        Ok(Self { layout, target_layout, pipeline })
    }

    /// Binds a texture for [`Self::write`] to write.
    pub(crate) fn target(&self, device: &wgpu::Device, words: &wgpu::TextureView) -> wgpu::BindGroup {
        bind_group(device, "mask words", &self.target_layout, &[wgpu::BindingResource::TextureView(words)])
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
        Ok(MaskPlanes { shape, planes, group })
    }

    /// Uploads a mask; the commands in `encoder` convert it to `words`. `planes` has the mask's shape.
    pub(crate) fn write(
        &self,
        queue: &wgpu::Queue,
        encoder: &mut wgpu::CommandEncoder,
        (planes, mask): (&MaskPlanes, &Mask),
        words: &wgpu::BindGroup,
    ) {
        // A little-endian u64 has its low u32 first, as the shader indexes it.
        #[cfg(target_endian = "big")]
        compile_error!("masks are uploaded as they lie in memory");
        queue.write_buffer(&planes.planes, 0, bytemuck::cast_slice(mask.words()));
        let size = (planes.shape.width(), planes.shape.height());
        compute(encoder, "mask words", &self.pipeline, &[&planes.group, words], |pass| dispatch_pixels(pass, size));
    }
}
