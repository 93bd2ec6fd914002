//! The shading pass: lights every pixel's surface by its visibility, and draws the sky where there is none. Pixels that
//! a shadow's edge crosses are put off to a second dispatch (`put_off.wgsl`).

use gnomon_shaders::{
    gpu::Gpu,
    shading::{Lighting, View},
};

use super::{
    environment::Surroundings,
    error::RenderError,
    pipeline::{bind_group, bind_group_layout, compute_pipeline, picture, shader, storage, uniform, written_picture},
    predict::depth_history::DepthHistory,
    put_off::PutOff,
    quality::Quality,
    scene_upload::SceneUpload,
    targets::{LIGHT, Targets},
};

/// The pass, and the bindings that it shares with the blending pass.
#[derive(Debug)]
pub(crate) struct ShadePass {
    layout: wgpu::BindGroupLayout,
    target_layout: wgpu::BindGroupLayout,
    view: wgpu::Buffer,
    lighting: wgpu::Buffer,
    /// Of each material.
    finishes: wgpu::Buffer,
    edge_shares: wgpu::Buffer,
    nearest: wgpu::Sampler,
    /// By the slot of the picture's depth in the history.
    groups: Vec<wgpu::BindGroup>,
    /// What is written.
    target: wgpu::BindGroup,
    module: wgpu::ShaderModule,
    /// `None` until the next picture.
    pipelines: Option<Pipelines>,
    /// Some material has layers.
    layered: bool,
    /// Some material emits light.
    emits: bool,
    quality: Quality,
}

#[derive(Debug, Clone)]
pub(crate) struct Pipelines {
    /// Does every pixel, or those put off.
    every: wgpu::ComputePipeline,
    /// Puts off those that a shadow's edge crosses. `None` if edges are not smooth.
    first: Option<wgpu::ComputePipeline>,
}

impl ShadePass {
    pub(crate) fn new(
        gpu: &Gpu,
        (view, lighting, edge_shares): (&wgpu::Buffer, &wgpu::Buffer, &wgpu::Buffer),
        targets: &Targets,
        history: &DepthHistory,
        surroundings: &Surroundings,
        scene: &SceneUpload,
    ) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let written =
            [written_picture(LIGHT), picture(wgpu::TextureSampleType::Float { filterable: false }), PutOff::layout()];
        let target_layout = bind_group_layout(device, "shaded light", wgpu::ShaderStages::COMPUTE, &written);
        let (layout, layered, emits, quality) = (layout(gpu), scene.layered, scene.emits, Quality::Low);
        let mut pass = Self {
            module: shader(gpu, "shading/shade.wgsl")?,
            pipelines: None,
            target: target(device, &target_layout, targets),
            layout,
            target_layout,
            view: view.clone(),
            lighting: lighting.clone(),
            finishes: scene.finishes.clone(),
            edge_shares: edge_shares.clone(),
            nearest: device.create_sampler(&wgpu::SamplerDescriptor::default()),
            groups: Vec::new(),
            layered,
            emits,
            quality,
        };
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
                wgpu::BindingResource::Sampler(&self.nearest),
            ];
            bind_group(device, "shading", &self.layout, &resources)
        };
        self.groups = history.views().map(group).collect();
        self.target = target(device, &self.target_layout, targets);
    }

    pub(crate) fn set_quality(&mut self, quality: Quality) {
        if self.quality != quality {
            (self.quality, self.pipelines) = (quality, None);
        }
    }

    /// Compiles what pictures of the chosen quality take.
    pub(crate) fn compile(&mut self, device: &wgpu::Device) -> &Pipelines {
        self.pipelines.get_or_insert_with(|| {
            let smooth = self.quality == Quality::High;
            let pipeline = |puts_off: bool| {
                let constants = [
                    ("LAYERED", self.layered),
                    ("EMITS", self.emits),
                    ("smooth_edges", smooth),
                    ("puts_off", puts_off),
                ]
                .map(|(name, on)| (name, f64::from(u8::from(on))));
                let layouts = [&self.layout, &self.target_layout];
                compute_pipeline(device, &self.module, &layouts, ("shade", &constants))
            };
            Pipelines { every: pipeline(false), first: smooth.then(|| pipeline(true)) }
        })
    }

    pub(crate) fn layout(&self) -> &wgpu::BindGroupLayout {
        &self.layout
    }

    pub(crate) fn group(&self, history: &DepthHistory) -> &wgpu::BindGroup {
        &self.groups[history.current()]
    }

    pub(crate) fn encode(
        &mut self,
        device: &wgpu::Device,
        encoder: &mut wgpu::CommandEncoder,
        targets: &Targets,
        history: &DepthHistory,
        visibility_share: f32,
    ) {
        // While one source of visibility fades into the other, edges of both count.
        let Pipelines { every, first } = self.compile(device).clone();
        let first = first.as_ref().filter(|_| visibility_share >= 1.0);
        targets.put_off.run(encoder, "shading", (first, &every), &[self.group(history), &self.target]);
    }
}

fn target(device: &wgpu::Device, layout: &wgpu::BindGroupLayout, targets: &Targets) -> wgpu::BindGroup {
    let resources = [
        wgpu::BindingResource::TextureView(&targets.light),
        // Where nothing is emitted, something must be bound.
        wgpu::BindingResource::TextureView(targets.emitted.as_ref().unwrap_or(&targets.color)),
        targets.put_off.binding(),
    ];
    bind_group(device, "shaded light", layout, &resources)
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
        wgpu::BindingType::Sampler(wgpu::SamplerBindingType::NonFiltering),
    ];
    let stages = wgpu::ShaderStages::VERTEX_FRAGMENT | wgpu::ShaderStages::COMPUTE;
    bind_group_layout(&gpu.device, "shading", stages, &bindings)
}
