//! The G-buffer pass: depth, base colour, packed surface and emitted light of the nearest surface in every pixel.
//!
//! On GPUs depth comes first. So textures are read, and texels written, only for what is seen: once a pixel, however
//! many surfaces lie behind each other. Software pays more for triangles than for what they hide.

use std::collections::HashMap;

use gnomon_shaders::{gpu::Gpu, material::features, shading::View};

use super::{
    error::RenderError,
    pipeline::{bind_group, bind_group_layout, cleared, shader, uniform},
    predict::depth_pass::{self, DepthPass, Faces, Part},
    scene_upload::{Batch, SceneUpload},
    targets::{COLOR, DEPTH, LIGHT, NORMAL_MATERIAL, Targets},
};

#[derive(Debug)]
pub(crate) struct GbufferPass {
    depth_first: bool,
    group: wgpu::BindGroup,
    depth_group: wgpu::BindGroup,
    /// One for each kind of material in the scene.
    pipelines: HashMap<Kind, wgpu::RenderPipeline>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Kind {
    masked: bool,
    double_sided: bool,
    features: u32,
}

impl Kind {
    fn of(batch: &Batch) -> Self {
        Self { masked: batch.is_masked(), double_sided: batch.double_sided, features: batch.features }
    }
}

/// Leaves out the last target where nothing emits: what is written for each pixel is what a real GPU waits for.
fn emitted<'a, T>(scene: &SceneUpload, targets: &'a [T; 3]) -> &'a [T] {
    if scene.emits { targets } else { &targets[..2] }
}

impl GbufferPass {
    pub(crate) fn new(
        gpu: &Gpu,
        view: &wgpu::Buffer,
        (scene, depth_pass): (&SceneUpload, &DepthPass),
        depth_first: bool,
    ) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let layout =
            bind_group_layout(device, "G-buffer", wgpu::ShaderStages::VERTEX_FRAGMENT, &[uniform::<View>(gpu)]);
        let group = bind_group(device, "G-buffer", &layout, &[view.as_entire_binding()]);
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("G-buffer"),
            bind_group_layouts: &[Some(&layout), Some(&scene.material_layout)],
            immediate_size: 0,
        });
        let module = shader(gpu, "shading/gbuffer.wgsl")?;
        let pipeline = |kind: Kind| {
            let more = kind.features & features::OF_VERTICES != 0;
            let layouts = scene.vertex_layouts();
            let constants = [("FEATURES", f64::from(kind.features))];
            device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some("G-buffer"),
                layout: Some(&pipeline_layout),
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some(if more { "transform_more" } else { "transform" }),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    buffers: &layouts[..if more { 2 } else { 1 }],
                },
                primitive: wgpu::PrimitiveState {
                    cull_mode: (!kind.double_sided).then_some(wgpu::Face::Back),
                    ..wgpu::PrimitiveState::default()
                },
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: DEPTH,
                    depth_write_enabled: Some(!depth_first),
                    depth_compare: Some(if depth_first {
                        wgpu::CompareFunction::Equal
                    } else {
                        wgpu::CompareFunction::Greater
                    }),
                    stencil: wgpu::StencilState::default(),
                    bias: wgpu::DepthBiasState::default(),
                }),
                multisample: wgpu::MultisampleState::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &module,
                    entry_point: Some(match (kind.masked, more) {
                        (false, false) => "opaque",
                        (false, true) => "opaque_more",
                        (true, false) => "masked",
                        (true, true) => "masked_more",
                    }),
                    compilation_options: wgpu::PipelineCompilationOptions {
                        constants: &constants,
                        ..wgpu::PipelineCompilationOptions::default()
                    },
                    targets: emitted(scene, &[Some(COLOR.into()), Some(NORMAL_MATERIAL.into()), Some(LIGHT.into())]),
                }),
                multiview_mask: None,
                cache: None,
            })
        };
        let mut pipelines = HashMap::new();
        for batch in scene.batches.iter().filter(|batch| !batch.is_blended()) {
            let kind = Kind::of(batch);
            pipelines.entry(kind).or_insert_with(|| pipeline(kind));
        }
        let depth_group = depth_pass.group(device, view.as_entire_binding());
        Ok(Self { depth_first, group, depth_group, pipelines })
    }

    /// Draws depth. [`Self::encode`] is to follow.
    pub(crate) fn encode_depth(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        depth: &wgpu::TextureView,
        (scene, depth_pass): (&SceneUpload, &DepthPass),
    ) {
        if self.depth_first {
            let mut pass = depth_pass::begin(encoder, "depth first", depth);
            depth_pass.draw(&mut pass, &self.depth_group, scene, (Part::All, Faces::Seen));
        }
    }

    pub(crate) fn encode(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        (targets, depth): (&Targets, &wgpu::TextureView),
        scene: &SceneUpload,
    ) {
        let emitted_light = targets.emitted.as_ref().unwrap_or(&targets.light);
        let attachments = [cleared(&targets.color), cleared(&targets.normal_material), cleared(emitted_light)];
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("G-buffer"),
            color_attachments: emitted(scene, &attachments),
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: depth,
                // Read-only if it is there.
                depth_ops: (!self.depth_first)
                    .then_some(wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Store }),
                stencil_ops: None,
            }),
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_bind_group(0, &self.group, &[]);
        scene.bind(&mut pass);
        let mut current = None;
        let draw = |batch: &Batch| {
            let kind = Kind::of(batch);
            if current.replace(kind) != Some(kind) {
                pass.set_pipeline(&self.pipelines[&kind]);
            }
            pass.set_bind_group(1, &scene.materials[batch.material], &[]);
            pass.draw_indexed(batch.indices.clone(), 0, 0..1);
        };
        let batches = scene.batches.iter().filter(|batch| !batch.is_blended());
        if self.depth_first {
            // Backwards: of surfaces in one place the first one's depth came first, and it stays.
            batches.rev().for_each(draw);
        } else {
            batches.for_each(draw);
        }
    }
}
