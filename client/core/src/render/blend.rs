//! BLEND surfaces, drawn over the shaded picture from far to near and tested against its depth.
//!
//! They are sorted by the centre of each run of triangles, which is right unless runs overlap in depth. Back faces of a
//! double-sided surface are drawn first. The server traces no BLEND surface, so they use the visibility of what lies
//! behind them (`blend.wgsl`).

use glam::Vec3;
use gnomon_scene::AlphaMode;
use gnomon_shaders::gpu::Gpu;

use super::{
    error::RenderError,
    pipeline::shader,
    scene_upload::{Batch, SceneUpload, VERTEX_LAYOUT},
    targets::{DEPTH, LIGHT, Targets},
};

#[derive(Debug)]
pub(crate) struct BlendPass {
    back_faces: wgpu::RenderPipeline,
    front_faces: wgpu::RenderPipeline,
}

impl BlendPass {
    pub(crate) fn new(
        gpu: &Gpu,
        shade_layout: &wgpu::BindGroupLayout,
        scene: &SceneUpload,
    ) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("blending"),
            bind_group_layouts: &[Some(shade_layout), Some(&scene.material_layout)],
            immediate_size: 0,
        });
        let module = shader(gpu, "shading/blend.wgsl")?;
        let pipeline = |culled| {
            device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some("blending"),
                layout: Some(&layout),
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some("transform"),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    buffers: &[Some(VERTEX_LAYOUT)],
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
                    module: &module,
                    entry_point: Some("blend"),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    targets: &[Some(wgpu::ColorTargetState {
                        format: LIGHT,
                        blend: Some(wgpu::BlendState::ALPHA_BLENDING),
                        write_mask: wgpu::ColorWrites::ALL,
                    })],
                }),
                multiview_mask: None,
                cache: None,
            })
        };
        Ok(Self { back_faces: pipeline(wgpu::Face::Front), front_faces: pipeline(wgpu::Face::Back) })
    }

    /// Does nothing, and starts no pass, in a scene without BLEND materials.
    pub(crate) fn encode(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        (targets, depth): (&Targets, &wgpu::TextureView),
        scene: &SceneUpload,
        shade_group: &wgpu::BindGroup,
        eye: Vec3,
    ) {
        let mut batches: Vec<&Batch> =
            scene.batches.iter().filter(|batch| matches!(batch.alpha, AlphaMode::Blend)).collect();
        if batches.is_empty() {
            return;
        }
        let distance = |batch: &Batch| batch.centre.distance_squared(eye);
        batches.sort_by(|one, other| distance(other).total_cmp(&distance(one)));
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("blending"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &targets.light,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store },
            })],
            // Read-only: depth is both tested and read by the shader.
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: depth,
                depth_ops: None,
                stencil_ops: None,
            }),
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_bind_group(0, shade_group, &[]);
        pass.set_vertex_buffer(0, scene.vertices.slice(..));
        pass.set_index_buffer(scene.indices.slice(..), wgpu::IndexFormat::Uint32);
        for batch in batches {
            pass.set_bind_group(1, &scene.materials[batch.material], &[]);
            if batch.double_sided {
                pass.set_pipeline(&self.back_faces);
                pass.draw_indexed(batch.indices.clone(), 0, 0..1);
            }
            pass.set_pipeline(&self.front_faces);
            pass.draw_indexed(batch.indices.clone(), 0, 0..1);
        }
    }
}
