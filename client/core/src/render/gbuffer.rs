//! The G-buffer pass: depth, base colour, packed normal and material of the nearest surface in every pixel.

use gnomon_scene::AlphaMode;
use gnomon_shaders::{gpu::Gpu, shading::View};

use super::{
    error::RenderError,
    pipeline::{bind_group, bind_group_layout, cleared, shader, uniform},
    scene_upload::{Batch, SceneUpload, VERTEX_LAYOUT},
    targets::{COLOR, DEPTH, NORMAL_MATERIAL, Targets},
};

#[derive(Debug)]
pub(crate) struct GbufferPass {
    group: wgpu::BindGroup,
    /// By [`pipeline_of`]: OPAQUE or MASK, one side or both.
    pipelines: [wgpu::RenderPipeline; 4],
}

fn pipeline_of(batch: &Batch) -> usize {
    usize::from(matches!(batch.alpha, AlphaMode::Mask { .. })) * 2 + usize::from(batch.double_sided)
}

impl GbufferPass {
    pub(crate) fn new(
        gpu: &Gpu,
        view: &wgpu::Buffer,
        material_layout: &wgpu::BindGroupLayout,
    ) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let layout =
            bind_group_layout(device, "G-buffer", wgpu::ShaderStages::VERTEX_FRAGMENT, &[uniform::<View>(gpu)]);
        let group = bind_group(device, "G-buffer", &layout, &[view.as_entire_binding()]);
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("G-buffer"),
            bind_group_layouts: &[Some(&layout), Some(material_layout)],
            immediate_size: 0,
        });
        let module = shader(gpu, "shading/gbuffer.wgsl")?;
        let pipeline = |fragment, cull_mode| {
            device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some("G-buffer"),
                layout: Some(&pipeline_layout),
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some("transform"),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    buffers: &[Some(VERTEX_LAYOUT)],
                },
                primitive: wgpu::PrimitiveState { cull_mode, ..wgpu::PrimitiveState::default() },
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: DEPTH,
                    depth_write_enabled: Some(true),
                    depth_compare: Some(wgpu::CompareFunction::Greater),
                    stencil: wgpu::StencilState::default(),
                    bias: wgpu::DepthBiasState::default(),
                }),
                multisample: wgpu::MultisampleState::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &module,
                    entry_point: Some(fragment),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    targets: &[Some(COLOR.into()), Some(NORMAL_MATERIAL.into())],
                }),
                multiview_mask: None,
                cache: None,
            })
        };
        let back = Some(wgpu::Face::Back);
        let pipelines =
            [pipeline("opaque", back), pipeline("opaque", None), pipeline("masked", back), pipeline("masked", None)];
        Ok(Self { group, pipelines })
    }

    pub(crate) fn encode(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        (targets, depth): (&Targets, &wgpu::TextureView),
        scene: &SceneUpload,
    ) {
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("G-buffer"),
            color_attachments: &[cleared(&targets.color), cleared(&targets.normal_material)],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: depth,
                depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Store }),
                stencil_ops: None,
            }),
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_bind_group(0, &self.group, &[]);
        pass.set_vertex_buffer(0, scene.vertices.slice(..));
        pass.set_index_buffer(scene.indices.slice(..), wgpu::IndexFormat::Uint32);
        let mut current = None;
        for batch in scene.batches.iter().filter(|batch| !matches!(batch.alpha, AlphaMode::Blend)) {
            let pipeline = pipeline_of(batch);
            if current.replace(pipeline) != Some(pipeline) {
                pass.set_pipeline(&self.pipelines[pipeline]);
            }
            pass.set_bind_group(1, &scene.materials[batch.material], &[]);
            pass.draw_indexed(batch.indices.clone(), 0, 0..1);
        }
    }
}
