//! The tone pass: maps exposed light to displayed values.

use gnomon_shaders::{gpu::Gpu, shading::Tone};

use super::{
    error::RenderError,
    exposure,
    pipeline::{bind_group, bind_group_layout, cleared, constant, covering_pipeline, picture, shader, uniform},
    targets::Targets,
};

#[derive(Debug)]
pub(crate) struct TonePass {
    layout: wgpu::BindGroupLayout,
    tone: wgpu::Buffer,
    group: wgpu::BindGroup,
    pipeline: wgpu::RenderPipeline,
}

impl TonePass {
    pub(crate) fn new(gpu: &Gpu, targets: &Targets, format: wgpu::TextureFormat) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let bindings = [uniform::<Tone>(gpu), picture(wgpu::TextureSampleType::Float { filterable: false })];
        let layout = bind_group_layout(device, "tone", wgpu::ShaderStages::FRAGMENT, &bindings);
        let tone = constant(gpu, "tone", &exposure::tone());
        let group = group(device, &layout, &tone, targets);
        let module = shader(gpu, "shading/tone.wgsl")?;
        let pipeline = covering_pipeline(device, &module, &[&layout], "show", format);
        Ok(Self { layout, tone, group, pipeline })
    }

    pub(crate) fn resize(&mut self, device: &wgpu::Device, targets: &Targets) {
        self.group = group(device, &self.layout, &self.tone, targets);
    }

    pub(crate) fn encode(&self, encoder: &mut wgpu::CommandEncoder, target: &wgpu::TextureView) {
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("tone"),
            color_attachments: &[cleared(target)],
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.group, &[]);
        pass.draw(0..3, 0..1);
    }
}

fn group(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    tone: &wgpu::Buffer,
    targets: &Targets,
) -> wgpu::BindGroup {
    let resources = [tone.as_entire_binding(), wgpu::BindingResource::TextureView(&targets.light)];
    bind_group(device, "tone", layout, &resources)
}
