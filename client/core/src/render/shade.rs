//! The shading pass: lights every pixel's surface by its visibility, and draws the sky where there is none.

use gnomon_shaders::{
    edge_shares::edge_shares,
    gpu::Gpu,
    shading::{Lighting, View},
};

use wgpu::util::DeviceExt as _;

use super::{
    environment::Surroundings,
    error::RenderError,
    pipeline::{
        bind_group, bind_group_layout, cleared, covering_pipeline_with, kept, picture, shader, storage, uniform,
    },
    predict::depth_history::DepthHistory,
    quality::Quality,
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
    edge_shares: wgpu::Buffer,
    /// By the slot of the picture's depth in the history.
    groups: Vec<wgpu::BindGroup>,
    pipeline: wgpu::RenderPipeline,
    /// Some material has layers.
    layered: bool,
    /// Some material emits light, which is in the target already.
    emits: bool,
    quality: Quality,
}

impl ShadePass {
    pub(crate) fn new(
        gpu: &Gpu,
        (view, lighting): (&wgpu::Buffer, &wgpu::Buffer),
        targets: &Targets,
        history: &DepthHistory,
        surroundings: &Surroundings,
        scene: &SceneUpload,
    ) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let edge_shares = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("edge shares"),
            contents: bytemuck::cast_slice(&edge_shares()),
            usage: wgpu::BufferUsages::STORAGE,
        });
        let (layout, layered, emits, quality) = (layout(gpu), scene.layered, scene.emits, Quality::Low);
        let pipeline = pipeline(gpu, &layout, (layered, emits), quality)?;
        let (view, lighting, finishes) = (view.clone(), lighting.clone(), scene.finishes.clone());
        let groups = Vec::new();
        let mut pass =
            Self { layout, view, lighting, finishes, edge_shares, groups, pipeline, layered, emits, quality };
        pass.bind(device, targets, history, surroundings);
        Ok(pass)
    }

    /// Binds new targets or another environment.
    pub(crate) fn bind(
        &mut self,
        device: &wgpu::Device,
        targets: &Targets,
        history: &DepthHistory,
        surroundings: &Surroundings,
    ) {
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
                self.edge_shares.as_entire_binding(),
                view(&surroundings.view),
                wgpu::BindingResource::Sampler(&surroundings.sampler),
            ];
            bind_group(device, "shading", &self.layout, &resources)
        };
        self.groups = history.views().map(group).collect();
    }

    pub(crate) fn set_quality(&mut self, gpu: &Gpu, quality: Quality) -> Result<(), RenderError> {
        if quality != self.quality {
            self.pipeline = pipeline(gpu, &self.layout, (self.layered, self.emits), quality)?;
            self.quality = quality;
        }
        Ok(())
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
            color_attachments: &[if self.emits { kept(&targets.light) } else { cleared(&targets.light) }],
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, self.group(history), &[]);
        pass.draw(0..3, 0..1);
    }
}

fn pipeline(
    gpu: &Gpu,
    layout: &wgpu::BindGroupLayout,
    (layered, emits): (bool, bool),
    quality: Quality,
) -> Result<wgpu::RenderPipeline, RenderError> {
    let module = shader(gpu, "shading/shade.wgsl")?;
    let added = wgpu::BlendComponent {
        src_factor: wgpu::BlendFactor::One,
        dst_factor: wgpu::BlendFactor::One,
        operation: wgpu::BlendOperation::Add,
    };
    let target = wgpu::ColorTargetState {
        format: LIGHT,
        blend: emits.then_some(wgpu::BlendState { color: added, alpha: added }),
        write_mask: wgpu::ColorWrites::ALL,
    };
    let smooth = quality == Quality::High;
    let constants = [("LAYERED", layered), ("smooth_edges", smooth)].map(|(name, on)| (name, f64::from(u8::from(on))));
    Ok(covering_pipeline_with(&gpu.device, &module, &[layout], ("shade", &constants), target))
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
        storage(true),
        wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Float { filterable: true },
            view_dimension: wgpu::TextureViewDimension::Cube,
            multisampled: false,
        },
        wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering),
    ];
    bind_group_layout(&gpu.device, "shading", wgpu::ShaderStages::VERTEX_FRAGMENT, &bindings)
}
