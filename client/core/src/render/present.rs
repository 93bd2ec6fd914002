//! Draws a finished picture to a screen, texel for texel if the sizes match.

use gnomon_shaders::gpu::Gpu;

use super::{
    error::RenderError,
    pipeline::{self, Variable, bind_group, bind_group_layout, covering_pipeline, shader, uniform},
};

#[derive(Debug)]
pub struct PresentPass {
    layout: wgpu::BindGroupLayout,
    between: wgpu::Sampler,
    screen_px: Variable<[f32; 4]>,
    pipeline: wgpu::RenderPipeline,
}

impl PresentPass {
    /// `format` must not be an sRGB format: pictures are already encoded.
    pub fn new(gpu: &Gpu, format: wgpu::TextureFormat) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let bindings = [
            pipeline::picture(wgpu::TextureSampleType::Float { filterable: true }),
            wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering),
            uniform::<[f32; 4]>(gpu),
        ];
        let layout = bind_group_layout(device, "present", wgpu::ShaderStages::FRAGMENT, &bindings);
        let between = device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("present"),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..wgpu::SamplerDescriptor::default()
        });
        let screen_px = Variable::new(gpu, "screen");
        let module = shader(gpu, "shading/present.wgsl")?;
        let pipeline = covering_pipeline(device, &module, &[&layout], "present", format);
        Ok(Self { layout, between, screen_px, pipeline })
    }

    /// Fills the target of `pass`, of this size in pixels, with `picture`.
    pub fn draw(
        &mut self,
        (device, queue): (&wgpu::Device, &wgpu::Queue),
        pass: &mut wgpu::RenderPass<'_>,
        picture: &wgpu::TextureView,
        (width, height): (u32, u32),
    ) {
        #[expect(clippy::cast_precision_loss, reason = "sides of pictures are far below 2²⁴")]
        let screen_px = [width as f32, height as f32, 0.0, 0.0];
        self.screen_px.set(queue, screen_px);
        let resources = [
            wgpu::BindingResource::TextureView(picture),
            wgpu::BindingResource::Sampler(&self.between),
            self.screen_px.buffer().as_entire_binding(),
        ];
        let group = bind_group(device, "present", &self.layout, &resources);
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.draw(0..3, 0..1);
    }
}
