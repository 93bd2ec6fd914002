//! The two kernels as pipelines, and the layouts of their bindings.

use gnomon_shaders::{
    gpu::Gpu,
    host::{AlphaMaterial, TracedView},
    splice::{splice, splice_ray_query},
};

use super::acceleration;
use crate::visibility::backend::BackendError;

/// How the kernels find the triangles along a ray.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in super::super) enum Traversal {
    /// Walk obvhs' compressed hierarchy: the `compute` back end.
    Hierarchy,
    /// Query the adapter's own structure: the `ray-query` back end.
    RayQuery,
}

impl Traversal {
    pub(super) fn features(self) -> wgpu::Features {
        match self {
            Self::Hierarchy => wgpu::Features::empty(),
            Self::RayQuery => acceleration::NEEDED,
        }
    }
}

/// Device features that the kernels need. The camera travels in the command buffer, so a frame creates no resources.
pub(super) const NEEDED: wgpu::Features = wgpu::Features::IMMEDIATES;

/// Device features for measuring the cost of a frame.
pub(super) const TIMING: wgpu::Features =
    wgpu::Features::TIMESTAMP_QUERY.union(wgpu::Features::TIMESTAMP_QUERY_INSIDE_ENCODERS);

/// Storage buffers that hold the scene.
pub(super) const SCENE_BUFFERS: usize = 7;
/// Storage buffers that hold a frame.
const FRAME_BUFFERS: usize = 3;
/// Storage buffers that a kernel reads or writes.
const BUFFERS: u32 = 10;

#[derive(Debug)]
pub(super) struct Kernels {
    /// `visibility/primary.wgsl`.
    pub(super) primary: wgpu::ComputePipeline,
    /// `visibility/shadow.wgsl`.
    pub(super) shadow: wgpu::ComputePipeline,
    scene: wgpu::BindGroupLayout,
    frame: wgpu::BindGroupLayout,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct FrameBuffers<'a> {
    /// 16 bytes a pixel between the kernels.
    pub(super) surfaces: &'a wgpu::Buffer,
    pub(super) mask: &'a wgpu::Buffer,
    /// The number of shadow rays.
    pub(super) ray_count: &'a wgpu::Buffer,
}

impl Kernels {
    /// Compiles the kernels for the scene's `alpha_materials`. `offset_roundings` replaces
    /// `OFFSET_ROUNDINGS` of `visibility/primary.wgsl`. Errors if the device lacks a feature or a limit. The device's
    /// error handler gets what the device itself refuses.
    pub(super) fn new(
        gpu: &Gpu,
        traversal: Traversal,
        alpha_materials: &[AlphaMaterial],
        offset_roundings: Option<u16>,
    ) -> Result<Self, BackendError> {
        if traversal == Traversal::RayQuery {
            acceleration::check(gpu)?;
        }
        let lacking = |missing: String| BackendError::Feature { adapter: gpu.info.name.clone(), missing };
        if !gpu.device.features().contains(NEEDED) {
            return Err(lacking("immediate data (push constants)".to_owned()));
        }
        let limits = gpu.device.limits();
        if limits.max_storage_buffers_per_shader_stage < BUFFERS {
            let found = limits.max_storage_buffers_per_shader_stage;
            return Err(lacking(format!("storage buffers: it has {found} where {BUFFERS} are needed")));
        }
        if limits.max_immediate_size < TracedView::BYTES {
            let (found, needed) = (limits.max_immediate_size, TracedView::BYTES);
            return Err(lacking(format!("immediate data: it has {found} bytes where {needed} are needed")));
        }
        let mut scene_types = [true; SCENE_BUFFERS].map(buffer_type).to_vec();
        if traversal == Traversal::RayQuery {
            scene_types.push(acceleration::structure_type());
        }
        let scene = layout(&gpu.device, "scene", scene_types);
        let frame = layout(&gpu.device, "frame", [false; FRAME_BUFFERS].map(buffer_type));
        let pipeline_layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("tracing"),
            bind_group_layouts: &[Some(&scene), Some(&frame)],
            immediate_size: TracedView::BYTES,
        });
        let flag = |name, set| (name, f64::from(u8::from(set)));
        let alpha = [
            flag("HAS_ALPHA", !alpha_materials.is_empty()),
            flag("HAS_VERTEX_ALPHA", alpha_materials.iter().any(|material| material.vertex_alpha != 0)),
        ];
        let offset = offset_roundings.map(|offset| ("OFFSET_ROUNDINGS", f64::from(offset)));
        let primary_constants: Vec<(&str, f64)> = alpha.into_iter().chain(offset).collect();
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
        let (primary, shadow) = (pipeline("primary", &primary_constants)?, pipeline("shadow", &alpha)?);
        Ok(Self { primary, shadow, scene, frame })
    }

    /// The scene's bind group, in the order of `wgsl/shared/traced_scene.wgsl`. Ray queries need `structure`.
    pub(super) fn bind_scene(
        &self,
        device: &wgpu::Device,
        buffers: &[wgpu::Buffer; SCENE_BUFFERS],
        structure: Option<&wgpu::Tlas>,
    ) -> wgpu::BindGroup {
        let resources = buffers.iter().map(wgpu::Buffer::as_entire_binding);
        bind(device, "scene", &self.scene, resources.chain(structure.map(wgpu::Tlas::as_binding)))
    }

    pub(super) fn bind_frame(&self, device: &wgpu::Device, buffers: FrameBuffers<'_>) -> wgpu::BindGroup {
        let buffers = [buffers.surfaces, buffers.mask, buffers.ray_count];
        bind(device, "frame", &self.frame, buffers.map(wgpu::Buffer::as_entire_binding))
    }
}

fn buffer_type(read_only: bool) -> wgpu::BindingType {
    wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Storage { read_only },
        has_dynamic_offset: false,
        min_binding_size: None,
    }
}

/// A layout of bindings of these types, numbered from 0.
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
