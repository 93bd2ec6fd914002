//! Draws depth alone: before a picture's surfaces, and for views without a picture, those of masks and lights.

use std::{ops::Range, sync::OnceLock};

use gnomon_shaders::gpu::Gpu;

use crate::render::{
    error::RenderError,
    pipeline::{bind_group, bind_group_layout, shader, uniform},
    scene_upload::{Batch, SceneUpload},
    targets::DEPTH,
};

#[derive(Debug)]
pub(crate) struct DepthPass {
    device: wgpu::Device,
    module: wgpu::ShaderModule,
    layout: wgpu::BindGroupLayout,
    pipeline_layout: wgpu::PipelineLayout,
    /// By [`pipeline_of`]: OPAQUE or MASK, front faces or both. Compiled when they are first drawn with.
    pipelines: [OnceLock<wgpu::RenderPipeline>; 4],
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Faces {
    /// Those that a camera sees.
    Seen,
    /// Both, since either side stops light.
    Both,
}

/// Which part of a scene is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Part {
    All,
    Resting,
}

impl Part {
    fn has(self, batch: &Batch) -> bool {
        match self {
            Self::All => true,
            Self::Resting => !batch.moves,
        }
    }
}

fn pipeline_of(masked: bool, both: bool) -> usize {
    usize::from(masked) * 2 + usize::from(both)
}

impl DepthPass {
    pub(crate) fn new(gpu: &Gpu, scene: &SceneUpload) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let layout = bind_group_layout(device, "depth", wgpu::ShaderStages::VERTEX, &[uniform::<glam::Mat4>(gpu)]);
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("depth"),
            bind_group_layouts: &[Some(&layout), Some(&scene.material_layout)],
            immediate_size: 0,
        });
        let module = shader(gpu, "shading/depth.wgsl")?;
        Ok(Self { device: device.clone(), module, layout, pipeline_layout, pipelines: Default::default() })
    }

    fn pipeline(&self, scene: &SceneUpload, masked: bool, both: bool) -> &wgpu::RenderPipeline {
        self.pipelines[pipeline_of(masked, both)].get_or_init(|| {
            self.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some("depth"),
                layout: Some(&self.pipeline_layout),
                vertex: wgpu::VertexState {
                    module: &self.module,
                    entry_point: Some(if masked { "transform_masked" } else { "transform" }),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    buffers: &scene.vertex_layouts(),
                },
                primitive: wgpu::PrimitiveState {
                    cull_mode: (!both).then_some(wgpu::Face::Back),
                    ..wgpu::PrimitiveState::default()
                },
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: DEPTH,
                    depth_write_enabled: Some(true),
                    depth_compare: Some(wgpu::CompareFunction::Greater),
                    stencil: wgpu::StencilState::default(),
                    bias: wgpu::DepthBiasState::default(),
                }),
                multisample: wgpu::MultisampleState::default(),
                fragment: masked.then_some(wgpu::FragmentState {
                    module: &self.module,
                    entry_point: Some("masked"),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    targets: &[],
                }),
                multiview_mask: None,
                cache: None,
            })
        })
    }

    /// Compiles what drawing `scene` takes.
    pub(crate) fn compile(&self, scene: &SceneUpload, faces: Faces) {
        for batch in scene.batches.iter().filter(|batch| !batch.is_blended()) {
            self.pipeline(scene, batch.is_masked(), batch.double_sided || faces == Faces::Both);
        }
    }

    /// Layout of [`Self::group`].
    pub(crate) fn layout(&self) -> &wgpu::BindGroupLayout {
        &self.layout
    }

    /// Binds a buffer that begins with the view's matrix `clip_from_local`.
    pub(crate) fn group(&self, device: &wgpu::Device, view: wgpu::BindingResource<'_>) -> wgpu::BindGroup {
        bind_group(device, "depth", &self.layout, &[view])
    }

    /// Draws the OPAQUE and MASK surfaces into a pass with a depth attachment only. Returns the number of draws and of
    /// triangles.
    pub(crate) fn draw(
        &self,
        pass: &mut wgpu::RenderPass<'_>,
        view: &wgpu::BindGroup,
        scene: &SceneUpload,
        (part, faces): (Part, Faces),
    ) -> (u64, u64) {
        let batches = scene.batches.iter().filter(|batch| !batch.is_blended() && part.has(batch));
        let both = |batch: &Batch| batch.double_sided || faces == Faces::Both;
        let draws = batches.map(|batch| (batch.is_masked(), both(batch), batch.material, &batch.indices));
        self.draw_all(pass, view, scene, draws)
    }

    /// Draws, as [`Self::draw`] does, both faces of the pieces that are wanted.
    pub(crate) fn draw_pieces(
        &self,
        pass: &mut wgpu::RenderPass<'_>,
        view: &wgpu::BindGroup,
        scene: &SceneUpload,
        wanted: impl Fn(usize) -> bool,
    ) -> (u64, u64) {
        let draws = scene.piece_draws.iter().filter(|draw| wanted(draw.piece));
        self.draw_all(pass, view, scene, draws.map(|draw| (draw.has_holes, true, draw.material, &draw.indices)))
    }

    fn draw_all<'a>(
        &self,
        pass: &mut wgpu::RenderPass<'_>,
        view: &wgpu::BindGroup,
        scene: &SceneUpload,
        draws: impl Iterator<Item = (bool, bool, usize, &'a Range<u32>)>,
    ) -> (u64, u64) {
        pass.set_bind_group(0, view, &[]);
        scene.bind(pass);
        let (mut drawn, mut draws, mut set) = ((0, 0), draws.peekable(), None);
        while let Some((masked, both, material, first)) = draws.next() {
            let mut indices = first.clone();
            // What has no holes looks the same in any material.
            while let Some((.., more)) = draws.next_if(|next| {
                (next.0, next.1, next.3.start) == (masked, both, indices.end) && (!masked || next.2 == material)
            }) {
                indices.end = more.end;
            }
            // What has no holes reads nothing of its material.
            let wanted = Some((masked, both, masked.then_some(material)));
            if set != wanted {
                pass.set_pipeline(self.pipeline(scene, masked, both));
                pass.set_bind_group(1, &scene.materials[material], &[]);
                set = wanted;
            }
            drawn = (drawn.0 + 1, drawn.1 + u64::from(indices.end - indices.start) / 3);
            pass.draw_indexed(indices, 0, 0..1);
        }
        drawn
    }
}

/// Begins a pass that clears `view` and draws depth into it.
pub(crate) fn begin<'a>(
    encoder: &'a mut wgpu::CommandEncoder,
    label: &'static str,
    view: &wgpu::TextureView,
) -> wgpu::RenderPass<'a> {
    begin_with(encoder, label, view, wgpu::LoadOp::Clear(0.0))
}

/// Begins a pass that draws depth into `view`, over what `load` leaves there.
pub(crate) fn begin_with<'a>(
    encoder: &'a mut wgpu::CommandEncoder,
    label: &'static str,
    view: &wgpu::TextureView,
    load: wgpu::LoadOp<f32>,
) -> wgpu::RenderPass<'a> {
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some(label),
        depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
            view,
            depth_ops: Some(wgpu::Operations { load, store: wgpu::StoreOp::Store }),
            stencil_ops: None,
        }),
        ..wgpu::RenderPassDescriptor::default()
    })
}
