//! The shading pass: lights every pixel's surface by its visibility, and draws the sky where there is none.

use gnomon_shaders::{
    gpu::Gpu,
    shading::{Lighting, View},
};

use super::{
    error::RenderError,
    pipeline::{bind_group, bind_group_layout, covering_pipeline_with, kept, picture, shader, storage, uniform},
    predict::depth_history::DepthHistory,
    scene_upload::SceneUpload,
    targets::{LIGHT, Targets},
};

/// The pass, and the bindings that it shares with the blending pass.
#[derive(Debug)]
pub(crate) struct ShadePass {
    layout: wgpu::BindGroupLayout,
    view: wgpu::Buffer,
    lighting: wgpu::Buffer,
    /// Of each material.
    finishes: wgpu::Buffer,
    /// By the slot of the picture's depth in the history.
    groups: Vec<wgpu::BindGroup>,
    pipeline: wgpu::RenderPipeline,
}

impl ShadePass {
    pub(crate) fn new(
        gpu: &Gpu,
        (view, lighting): (&wgpu::Buffer, &wgpu::Buffer),
        targets: &Targets,
        history: &DepthHistory,
        scene: &SceneUpload,
    ) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let layout = layout(gpu);
        let module = shader(gpu, "shading/shade.wgsl")?;
        // What surfaces emit is there already.
        let added = wgpu::BlendComponent {
            src_factor: wgpu::BlendFactor::One,
            dst_factor: wgpu::BlendFactor::One,
            operation: wgpu::BlendOperation::Add,
        };
        let target = wgpu::ColorTargetState {
            format: LIGHT,
            blend: Some(wgpu::BlendState { color: added, alpha: added }),
            write_mask: wgpu::ColorWrites::ALL,
        };
        let constants = [("LAYERED", f64::from(u8::from(scene.layered)))];
        let pipeline = covering_pipeline_with(device, &module, &[&layout], ("shade", &constants), target);
        let (view, lighting, finishes) = (view.clone(), lighting.clone(), scene.finishes.clone());
        let mut pass = Self { layout, view, lighting, finishes, groups: Vec::new(), pipeline };
        pass.resize(device, targets, history);
        Ok(pass)
    }

    pub(crate) fn resize(&mut self, device: &wgpu::Device, targets: &Targets, history: &DepthHistory) {
        let view = wgpu::BindingResource::TextureView;
        let group = |depth| {
            let resources = [
                self.view.as_entire_binding(),
                self.lighting.as_entire_binding(),
                view(&targets.visibility),
                self.finishes.as_entire_binding(),
                view(depth),
                view(&targets.color),
                view(&targets.normal_material),
            ];
            bind_group(device, "shading", &self.layout, &resources)
        };
        self.groups = history.views().map(group).collect();
    }

    pub(crate) fn layout(&self) -> &wgpu::BindGroupLayout {
        &self.layout
    }

    pub(crate) fn group(&self, history: &DepthHistory) -> &wgpu::BindGroup {
        &self.groups[history.current()]
    }

    pub(crate) fn encode(&self, encoder: &mut wgpu::CommandEncoder, targets: &Targets, history: &DepthHistory) {
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shading"),
            color_attachments: &[kept(&targets.light)],
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, self.group(history), &[]);
        pass.draw(0..3, 0..1);
    }
}

fn layout(gpu: &Gpu) -> wgpu::BindGroupLayout {
    let bindings = [
        uniform::<View>(gpu),
        uniform::<Lighting>(gpu),
        picture(wgpu::TextureSampleType::Uint),
        storage(true),
        picture(wgpu::TextureSampleType::Depth),
        picture(wgpu::TextureSampleType::Float { filterable: false }),
        picture(wgpu::TextureSampleType::Uint),
    ];
    bind_group_layout(&gpu.device, "shading", wgpu::ShaderStages::VERTEX_FRAGMENT, &bindings)
}
