//! Draws which moving piece each pixel shows, and where that surface point was (`pieces.wgsl`): what moves, over the
//! picture's own depth.

use std::sync::OnceLock;

use gnomon_scene::Scene;
use gnomon_shaders::gpu::Gpu;
use wgpu::util::DeviceExt as _;

use super::depth_pass::DepthPass;
use crate::render::{
    error::RenderError,
    movers::Movers,
    pipeline::{cleared, shader},
    scene_upload::{Batch, SceneUpload},
    targets::DEPTH,
    vertex::Vertex,
};

/// Numbers of pieces; and with ways, if the shape of some changes.
pub(super) fn format(upload: &SceneUpload) -> wgpu::TextureFormat {
    let deforms = upload.movers().is_some_and(Movers::deforms);
    if deforms { wgpu::TextureFormat::Rgba32Uint } else { wgpu::TextureFormat::R32Uint }
}

const ATTRIBUTES: [wgpu::VertexAttribute; 1] = wgpu::vertex_attr_array![6 => Uint32];
const ATTRIBUTES_THEN: [wgpu::VertexAttribute; 1] = wgpu::vertex_attr_array![7 => Float32x3];

#[derive(Debug)]
pub(super) struct PiecesPass {
    module: wgpu::ShaderModule,
    layout: wgpu::PipelineLayout,
    /// Index + 1 of each vertex's piece, or 0.
    pieces: wgpu::Buffer,
    /// The scene's vertices as they were when a mask was traced. `None`: no shape changes, and none are read.
    pub(super) then: Option<wgpu::Buffer>,
    group: wgpu::BindGroup,
    /// OPAQUE or MASK, single-sided or not. Compiled when they are first drawn with.
    pipelines: [OnceLock<wgpu::RenderPipeline>; 4],
}

impl PiecesPass {
    pub(super) fn new(
        gpu: &Gpu,
        (scene, upload): (&Scene, &SceneUpload),
        (depth_pass, view): (&DepthPass, &wgpu::Buffer),
    ) -> Result<Self, RenderError> {
        let device = &gpu.device;
        // A binding cannot be empty.
        let mut pieces = vec![0_u32; scene.positions.len().max(1)];
        for (number, piece) in (1..).zip(scene.animation.iter().flat_map(|animation| &animation.pieces)) {
            let own = piece.first_vertex as usize..piece.first_vertex as usize + piece.vertices as usize;
            pieces.get_mut(own).unwrap_or_default().fill(number);
        }
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("pieces"),
            bind_group_layouts: &[Some(depth_pass.layout()), Some(&upload.material_layout)],
            immediate_size: 0,
        });
        let pieces = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("pieces of vertices"),
            contents: bytemuck::cast_slice(&pieces),
            usage: wgpu::BufferUsages::VERTEX,
        });
        let group = depth_pass.group(device, view.as_entire_binding());
        let module = shader(gpu, "shading/pieces.wgsl")?;
        let then = upload.room_for_vertices(device);
        Ok(Self { module, layout, pieces, then, group, pipelines: Default::default() })
    }

    fn pipeline(
        &self,
        device: &wgpu::Device,
        upload: &SceneUpload,
        (masked, double_sided): (bool, bool),
    ) -> &wgpu::RenderPipeline {
        self.pipelines[usize::from(masked) * 2 + usize::from(double_sided)].get_or_init(|| {
            let [vertices, more] = upload.vertex_layouts();
            let layout = |array_stride, attributes| {
                Some(wgpu::VertexBufferLayout { array_stride, step_mode: wgpu::VertexStepMode::Vertex, attributes })
            };
            let pieces = layout(size_of::<u32>() as u64, &ATTRIBUTES);
            let then = layout(size_of::<Vertex>() as u64, &ATTRIBUTES_THEN);
            device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some("pieces"),
                layout: Some(&self.layout),
                vertex: wgpu::VertexState {
                    module: &self.module,
                    entry_point: Some("transform"),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    buffers: &[vertices, more, pieces, then],
                },
                primitive: wgpu::PrimitiveState {
                    cull_mode: (!double_sided).then_some(wgpu::Face::Back),
                    ..wgpu::PrimitiveState::default()
                },
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: DEPTH,
                    depth_write_enabled: Some(false),
                    depth_compare: Some(wgpu::CompareFunction::Equal),
                    stencil: wgpu::StencilState::default(),
                    bias: wgpu::DepthBiasState::default(),
                }),
                multisample: wgpu::MultisampleState::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &self.module,
                    entry_point: Some(if masked { "masked" } else { "opaque" }),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    targets: &[Some(format(upload).into())],
                }),
                multiview_mask: None,
                cache: None,
            })
        })
    }

    /// Compiles what drawing the scene's pieces takes.
    pub(super) fn compile(&self, device: &wgpu::Device, upload: &SceneUpload) {
        for batch in drawn(upload) {
            self.pipeline(device, upload, (batch.is_masked(), batch.double_sided));
        }
    }

    /// Draws the pieces that a picture shows. `depth` is the picture's.
    pub(super) fn encode(
        &self,
        device: &wgpu::Device,
        encoder: &mut wgpu::CommandEncoder,
        (target, depth): (&wgpu::TextureView, &wgpu::TextureView),
        upload: &SceneUpload,
    ) {
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("pieces"),
            color_attachments: &[cleared(target)],
            // Read-only.
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: depth,
                depth_ops: None,
                stencil_ops: None,
            }),
            ..wgpu::RenderPassDescriptor::default()
        });
        if drawn(upload).next().is_none() {
            return;
        }
        pass.set_bind_group(0, &self.group, &[]);
        upload.bind(&mut pass);
        pass.set_vertex_buffer(2, self.pieces.slice(..));
        pass.set_vertex_buffer(3, self.then.as_ref().unwrap_or(upload.vertices()).slice(..));
        for batch in drawn(upload) {
            pass.set_pipeline(self.pipeline(device, upload, (batch.is_masked(), batch.double_sided)));
            pass.set_bind_group(1, &upload.materials[batch.material], &[]);
            pass.draw_indexed(batch.indices.clone(), 0, 0..1);
        }
    }
}

fn drawn(upload: &SceneUpload) -> impl Iterator<Item = &Batch> {
    upload.batches.iter().filter(|batch| batch.moves && !batch.is_blended())
}
