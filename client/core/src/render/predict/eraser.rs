//! Takes what moves out of a shadow map again (`erase.wgsl`).

use gnomon_shaders::gpu::Gpu;

use super::texels::Texels;
use crate::render::{
    error::RenderError,
    pipeline::{bind_group, bind_group_layout, picture, shader},
    targets::DEPTH,
};

#[derive(Debug, Clone)]
pub(super) struct Eraser {
    layout: wgpu::BindGroupLayout,
    put_back: wgpu::RenderPipeline,
    clear: wgpu::RenderPipeline,
}

impl Eraser {
    pub(super) fn new(gpu: &Gpu) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let resting = [picture(wgpu::TextureSampleType::Depth)];
        let layout = bind_group_layout(device, "maps of what rests", wgpu::ShaderStages::FRAGMENT, &resting);
        let module = shader(gpu, "shading/erase.wgsl")?;
        let pipeline = |groups: &[Option<&wgpu::BindGroupLayout>], fragment: Option<&'static str>| {
            let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some("erase"),
                bind_group_layouts: groups,
                immediate_size: 0,
            });
            device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some("erase"),
                layout: Some(&layout),
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some("cover"),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    buffers: &[],
                },
                primitive: wgpu::PrimitiveState::default(),
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: DEPTH,
                    depth_write_enabled: Some(true),
                    depth_compare: Some(wgpu::CompareFunction::Always),
                    stencil: wgpu::StencilState::default(),
                    bias: wgpu::DepthBiasState::default(),
                }),
                multisample: wgpu::MultisampleState::default(),
                fragment: fragment.map(|entry| wgpu::FragmentState {
                    module: &module,
                    entry_point: Some(entry),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    targets: &[],
                }),
                multiview_mask: None,
                cache: None,
            })
        };
        let (put_back, clear) = (pipeline(&[Some(&layout)], Some("put_back")), pipeline(&[], None));
        Ok(Self { layout, put_back, clear })
    }

    /// Binds the maps of what rests for [`Self::put_back`].
    pub(super) fn group(&self, device: &wgpu::Device, resting: &wgpu::TextureView) -> wgpu::BindGroup {
        let resting = wgpu::BindingResource::TextureView(resting);
        bind_group(device, "maps of what rests", &self.layout, &[resting])
    }

    /// Makes texels those of what rests, in a pass that has drawn nothing yet. Returns their number.
    pub(super) fn put_back(
        &self,
        pass: &mut wgpu::RenderPass<'_>,
        resting: &wgpu::BindGroup,
        texels: impl Iterator<Item = Texels>,
    ) -> u64 {
        pass.set_pipeline(&self.put_back);
        pass.set_bind_group(0, resting, &[]);
        texels.map(|texels| cover(pass, texels)).sum()
    }

    /// Makes texels empty, in a pass that has drawn nothing yet. Returns their number.
    pub(super) fn clear(&self, pass: &mut wgpu::RenderPass<'_>, texels: impl Iterator<Item = Texels>) -> u64 {
        pass.set_pipeline(&self.clear);
        texels.map(|texels| cover(pass, texels)).sum()
    }
}

fn cover(pass: &mut wgpu::RenderPass<'_>, texels: Texels) -> u64 {
    pass.set_scissor_rect(texels.left, texels.top, texels.width, texels.height);
    pass.draw(0..3, 0..1);
    texels.count()
}
