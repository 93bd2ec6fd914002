//! The two kernels as pipelines, and the layouts of what they read and write.

use gnomon_shaders::{
    gpu::Gpu,
    host::TracedView,
    splice::{splice, splice_ray_query},
};

use super::{KernelOptions, Traversal};
use crate::visibility::backend::{BackendError, ray_query};

/// Device features without which the kernels cannot run: the camera travels inside the command buffer, so that a frame
/// creates no resource.
pub(super) const NEEDED: wgpu::Features = wgpu::Features::IMMEDIATES;

/// Device features that tell what a frame costs.
pub(super) const TIMING: wgpu::Features =
    wgpu::Features::TIMESTAMP_QUERY.union(wgpu::Features::TIMESTAMP_QUERY_INSIDE_ENCODERS);

/// Storage buffers that hold the scene.
pub(super) const SCENE_BUFFERS: usize = 7;
/// Storage buffers that hold a frame.
const FRAME_BUFFERS: usize = 3;
/// All of them.
const BUFFERS: u32 = 10;

/// Pipelines of both kernels.
#[derive(Debug)]
pub(super) struct Kernels {
    /// `visibility/primary.wgsl`.
    pub(super) primary: wgpu::ComputePipeline,
    /// `visibility/shadow.wgsl`.
    pub(super) shadow: wgpu::ComputePipeline,
    scene: wgpu::BindGroupLayout,
    frame: wgpu::BindGroupLayout,
}

/// One frame's buffers.
#[derive(Debug, Clone, Copy)]
pub(super) struct FrameBuffers<'a> {
    /// 16 bytes a pixel between the kernels.
    pub(super) surfaces: &'a wgpu::Buffer,
    /// The mask's words.
    pub(super) mask: &'a wgpu::Buffer,
    /// What is counted: `wgsl/visibility/work.wgsl`.
    pub(super) work: &'a wgpu::Buffer,
}

impl Kernels {
    /// Compiles the kernels; `has_alpha` for a scene whose triangles have holes.
    ///
    /// # Errors
    /// When the device lacks a feature or a limit that they need. What the device itself refuses, its error handler gets.
    pub(super) fn new(
        gpu: &Gpu,
        traversal: Traversal,
        options: KernelOptions,
        has_alpha: bool,
    ) -> Result<Self, BackendError> {
        if traversal == Traversal::RayQuery {
            ray_query::check(gpu)?;
        }
        let lacking = |missing: String| BackendError::Feature { adapter: gpu.info.name.clone(), missing };
        if !gpu.device.features().contains(NEEDED) {
            return Err(lacking("immediate data (push constants)".to_owned()));
        }
        let limits = gpu.device.limits();
        if limits.max_storage_buffers_per_shader_stage < BUFFERS {
            let there = limits.max_storage_buffers_per_shader_stage;
            return Err(lacking(format!("storage buffers: it has {there} where {BUFFERS} are needed")));
        }
        if limits.max_immediate_size < TracedView::BYTES {
            let (there, needed) = (limits.max_immediate_size, TracedView::BYTES);
            return Err(lacking(format!("immediate data: it has {there} bytes where {needed} are needed")));
        }
        let mut scene_types = [true; SCENE_BUFFERS].map(buffer_type).to_vec();
        if traversal == Traversal::RayQuery {
            scene_types.push(ray_query::structure_type());
        }
        let scene = layout(&gpu.device, "scene", scene_types);
        let frame = layout(&gpu.device, "frame", [false; FRAME_BUFFERS].map(buffer_type));
        let pipeline_layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("tracing"),
            bind_group_layouts: &[Some(&scene), Some(&frame)],
            immediate_size: TracedView::BYTES,
        });
        let (sampling, refine) = options.sampling.constants();
        let count = ("COUNT_NODES", f64::from(u8::from(options.count_nodes)));
        let alpha = ("HAS_ALPHA", f64::from(u8::from(has_alpha)));
        let shadow_constants =
            [count, alpha, ("SAMPLING", f64::from(sampling)), ("REFINE", f64::from(u8::from(refine)))];
        let offset = options.offset_roundings.map(|offset| ("OFFSET_ROUNDINGS", f64::from(offset)));
        let primary_constants: Vec<(&str, f64)> = [count, alpha].into_iter().chain(offset).collect();
        let pipeline = |name: &str, constants: &[(&str, f64)]| -> Result<wgpu::ComputePipeline, BackendError> {
            let path = format!("visibility/{name}.wgsl");
            let text = match traversal {
                Traversal::Hierarchy => splice(&path),
                Traversal::RayQuery => splice_ray_query(&path),
            };
            let text = text.map_err(|error| BackendError::Setup(format!("kernel {name}: {error}")))?;
            let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(name),
                source: wgpu::ShaderSource::Wgsl(text.into()),
            });
            Ok(gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(name),
                layout: Some(&pipeline_layout),
                module: &module,
                entry_point: Some(name),
                compilation_options: wgpu::PipelineCompilationOptions { constants, ..Default::default() },
                cache: None,
            }))
        };
        let (primary, shadow) = (pipeline("primary", &primary_constants)?, pipeline("shadow", &shadow_constants)?);
        Ok(Self { primary, shadow, scene, frame })
    }

    /// The scene's bind group. Buffers are in the order of `wgsl/shared/traced_scene.wgsl`; the structure is there when the
    /// kernels walk the adapter's own.
    pub(super) fn bind_scene(
        &self,
        device: &wgpu::Device,
        buffers: &[wgpu::Buffer; SCENE_BUFFERS],
        structure: Option<&wgpu::Tlas>,
    ) -> wgpu::BindGroup {
        let resources = buffers.iter().map(wgpu::Buffer::as_entire_binding);
        bind(device, "scene", &self.scene, resources.chain(structure.map(wgpu::Tlas::as_binding)))
    }

    /// A frame's bind group.
    pub(super) fn bind_frame(&self, device: &wgpu::Device, buffers: FrameBuffers<'_>) -> wgpu::BindGroup {
        let buffers = [buffers.surfaces, buffers.mask, buffers.work];
        bind(device, "frame", &self.frame, buffers.map(wgpu::Buffer::as_entire_binding))
    }
}

/// What a storage buffer is bound as.
fn buffer_type(read_only: bool) -> wgpu::BindingType {
    wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Storage { read_only },
        has_dynamic_offset: false,
        min_binding_size: None,
    }
}

/// A layout of these bindings, numbered from 0.
fn layout(
    device: &wgpu::Device,
    label: &str,
    types: impl IntoIterator<Item = wgpu::BindingType>,
) -> wgpu::BindGroupLayout {
    let entries: Vec<wgpu::BindGroupLayoutEntry> = (0..)
        .zip(types)
        .map(|(binding, ty)| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty,
            count: None,
        })
        .collect();
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries })
}

fn bind<'a>(
    device: &wgpu::Device,
    label: &str,
    layout: &wgpu::BindGroupLayout,
    resources: impl IntoIterator<Item = wgpu::BindingResource<'a>>,
) -> wgpu::BindGroup {
    let entries: Vec<wgpu::BindGroupEntry<'a>> =
        (0..).zip(resources).map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource }).collect();
    device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some(label), layout, entries: &entries })
}
