//! Brings a finished picture to a screen, texel for texel where both are of one size.

use super::{RenderError, covering_pipeline, shader};

/// The pass.
#[derive(Debug)]
pub struct PresentPass {
    layout: wgpu::BindGroupLayout,
    between: wgpu::Sampler,
    screen_px: wgpu::Buffer,
    pipeline: wgpu::RenderPipeline,
}

impl PresentPass {
    /// For screens of `format`, which must not be an sRGB format: pictures are encoded already.
    pub fn new(device: &wgpu::Device, format: wgpu::TextureFormat) -> Result<Self, RenderError> {
        let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty,
            count: None,
        };
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("present"),
            entries: &[
                entry(
                    0,
                    wgpu::BindingType::Texture {
                        sample_type: wgpu::TextureSampleType::Float { filterable: true },
                        view_dimension: wgpu::TextureViewDimension::D2,
                        multisampled: false,
                    },
                ),
                entry(1, wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering)),
                entry(2, super::uniform::<[f32; 4]>()),
            ],
        });
        let between = device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("present"),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..wgpu::SamplerDescriptor::default()
        });
        let screen_px = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("screen"),
            size: size_of::<[f32; 4]>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let module = shader(device, "shading/present.wgsl")?;
        let pipeline = covering_pipeline(device, &module, &[&layout], "present", format);
        Ok(Self { layout, between, screen_px, pipeline })
    }

    /// Covers the screen that `pass` draws to, of this size in pixels, with `picture`.
    pub fn draw(
        &self,
        (device, queue): (&wgpu::Device, &wgpu::Queue),
        pass: &mut wgpu::RenderPass<'_>,
        picture: &wgpu::TextureView,
        (width, height): (u32, u32),
    ) {
        #[expect(clippy::cast_precision_loss, reason = "sides of pictures are far below 2²⁴")]
        let screen_px = [width as f32, height as f32, 0.0, 0.0];
        queue.write_buffer(&self.screen_px, 0, bytemuck::cast_slice(&screen_px));
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("present"),
            layout: &self.layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(picture) },
                wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::Sampler(&self.between) },
                wgpu::BindGroupEntry { binding: 2, resource: self.screen_px.as_entire_binding() },
            ],
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.draw(0..3, 0..1);
    }
}
