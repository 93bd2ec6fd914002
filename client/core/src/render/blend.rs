//! BLEND surfaces, drawn over the shaded picture from far to near and tested against its depth.
//!
//! They are sorted by the centre of each run of triangles, which is right unless runs overlap in depth. Back faces of a
//! double-sided surface are drawn first. The server traces no BLEND surface, so they are lit by the client's shadow
//! maps, or by the visibility of what lies right behind them (`blend.wgsl`).

use std::{collections::HashMap, sync::OnceLock};

use glam::Vec3;
use gnomon_shaders::{gpu::Gpu, material::features};

use super::{
    error::RenderError,
    pipeline::{Variable, bind_group, bind_group_layout, kept, picture, shader, storage, uniform},
    predict::shadow_map::ShadowMap,
    scene_upload::{Batch, SceneUpload},
    targets::{DEPTH, LIGHT, Targets},
};
use crate::predictor::Predictor;

#[derive(Debug)]
pub(crate) struct BlendPass {
    device: wgpu::Device,
    module: wgpu::ShaderModule,
    layout: wgpu::PipelineLayout,
    /// Whether shadow maps are used.
    by_map: Variable<[u32; 4]>,
    shadow_group: wgpu::BindGroup,
    /// One for each kind of draw in the scene, compiled when it is first drawn with.
    pipelines: HashMap<Kind, OnceLock<wgpu::RenderPipeline>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Kind {
    back_faces: bool,
    features: u32,
    step: Step,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Step {
    /// Covers what lies behind by alpha.
    Cover,
    /// Multiplies what lies behind by what passes.
    Pass,
    /// Adds the surface's own light.
    Add,
}

impl Step {
    fn color(self) -> wgpu::BlendComponent {
        let (src_factor, dst_factor) = match self {
            Self::Cover => (wgpu::BlendFactor::SrcAlpha, wgpu::BlendFactor::OneMinusSrcAlpha),
            Self::Pass => (wgpu::BlendFactor::Zero, wgpu::BlendFactor::Src),
            Self::Add => (wgpu::BlendFactor::SrcAlpha, wgpu::BlendFactor::One),
        };
        wgpu::BlendComponent { src_factor, dst_factor, operation: wgpu::BlendOperation::Add }
    }
}

/// The draws of a batch, in their order.
fn draws(batch: &Batch) -> impl Iterator<Item = Kind> {
    let steps: &[Step] = if batch.transmissive { &[Step::Pass, Step::Add] } else { &[Step::Cover] };
    let sides: &[bool] = if batch.double_sided { &[true, false] } else { &[false] };
    let features = batch.features;
    sides.iter().flat_map(move |back_faces| {
        steps.iter().map(move |step| Kind { back_faces: *back_faces, features, step: *step })
    })
}

impl BlendPass {
    pub(crate) fn new(
        gpu: &Gpu,
        shade_layout: &wgpu::BindGroupLayout,
        scene: &SceneUpload,
        shadow_map: &ShadowMap,
    ) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let by_map = Variable::new(gpu, "blending by shadow maps");
        let bindings = [picture(wgpu::TextureSampleType::Depth), storage(true), uniform::<[u32; 4]>(gpu)];
        let shadow_layout = bind_group_layout(device, "blending", wgpu::ShaderStages::FRAGMENT, &bindings);
        let resources = [
            wgpu::BindingResource::TextureView(&shadow_map.texture),
            shadow_map.views.as_entire_binding(),
            by_map.buffer().as_entire_binding(),
        ];
        let shadow_group = bind_group(device, "blending", &shadow_layout, &resources);
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("blending"),
            bind_group_layouts: &[Some(shade_layout), Some(&scene.material_layout), Some(&shadow_layout)],
            immediate_size: 0,
        });
        let module = shader(gpu, "shading/blend.wgsl")?;
        let blended = scene.batches.iter().filter(|batch| batch.is_blended());
        let pipelines = blended.flat_map(draws).map(|kind| (kind, OnceLock::new())).collect();
        Ok(Self { device: device.clone(), module, layout, by_map, shadow_group, pipelines })
    }

    fn pipeline(&self, scene: &SceneUpload, kind: Kind) -> &wgpu::RenderPipeline {
        self.pipelines[&kind].get_or_init(|| {
            let constants = [("FEATURES", f64::from(kind.features)), ("LAYERED", f64::from(u8::from(scene.layered)))];
            let more = kind.features & features::OF_VERTICES != 0;
            let layouts = scene.vertex_layouts();
            let culled = if kind.back_faces { wgpu::Face::Front } else { wgpu::Face::Back };
            self.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some("blending"),
                layout: Some(&self.layout),
                vertex: wgpu::VertexState {
                    module: &self.module,
                    entry_point: Some(if more { "transform_more" } else { "transform" }),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    buffers: &layouts[..if more { 2 } else { 1 }],
                },
                primitive: wgpu::PrimitiveState { cull_mode: Some(culled), ..wgpu::PrimitiveState::default() },
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: DEPTH,
                    depth_write_enabled: Some(false),
                    depth_compare: Some(wgpu::CompareFunction::GreaterEqual),
                    stencil: wgpu::StencilState::default(),
                    bias: wgpu::DepthBiasState::default(),
                }),
                multisample: wgpu::MultisampleState::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &self.module,
                    entry_point: Some(match (kind.step == Step::Pass, more) {
                        (false, false) => "blend",
                        (false, true) => "blend_more",
                        (true, false) => "passed",
                        (true, true) => "passed_more",
                    }),
                    compilation_options: wgpu::PipelineCompilationOptions {
                        constants: &constants,
                        ..wgpu::PipelineCompilationOptions::default()
                    },
                    targets: &[Some(wgpu::ColorTargetState {
                        format: LIGHT,
                        blend: Some(wgpu::BlendState { color: kind.step.color(), alpha: wgpu::BlendComponent::OVER }),
                        write_mask: wgpu::ColorWrites::ALL,
                    })],
                }),
                multiview_mask: None,
                cache: None,
            })
        })
    }

    /// Whether the scene has BLEND surfaces.
    pub(crate) fn has_any(&self) -> bool {
        !self.pipelines.is_empty()
    }

    /// Compiles what drawing `scene` takes.
    pub(crate) fn compile(&self, scene: &SceneUpload) {
        for kind in self.pipelines.keys() {
            self.pipeline(scene, *kind);
        }
    }

    /// Sets the predictor from the next picture on: where it does not use the shadow maps, neither does blending.
    pub(crate) fn set_predictor(&mut self, queue: &wgpu::Queue, predictor: Predictor) {
        self.by_map.set(queue, [u32::from(predictor == Predictor::Surface), 0, 0, 0]);
    }

    /// Draws the BLEND surfaces of `scene`.
    pub(crate) fn encode(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        (targets, depth): (&Targets, &wgpu::TextureView),
        scene: &SceneUpload,
        shade_group: &wgpu::BindGroup,
        eye: Vec3,
    ) {
        let mut batches: Vec<&Batch> = scene.batches.iter().filter(|batch| batch.is_blended()).collect();
        let distance = |batch: &Batch| batch.centre.distance_squared(eye);
        batches.sort_by(|one, other| distance(other).total_cmp(&distance(one)));
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("blending"),
            color_attachments: &[kept(&targets.light)],
            // Read-only: depth is both tested and read by the shader.
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: depth,
                depth_ops: None,
                stencil_ops: None,
            }),
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_bind_group(0, shade_group, &[]);
        scene.bind(&mut pass);
        pass.set_bind_group(2, &self.shadow_group, &[]);
        for batch in batches {
            pass.set_bind_group(1, &scene.materials[batch.material], &[]);
            for kind in draws(batch) {
                pass.set_pipeline(self.pipeline(scene, kind));
                pass.draw_indexed(batch.indices.clone(), 0, 0..1);
            }
        }
    }
}
