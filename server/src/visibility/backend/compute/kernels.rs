//! The kernels as pipelines, and the layouts of their bindings.

use gnomon_shaders::{
    gpu::Gpu,
    host::{AlphaMaterial, TracedView},
    splice::{splice, splice_ray_query, splice_subgroups},
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

/// Device features that only faster kernels need.
pub(super) const SUBGROUPS: wgpu::Features = wgpu::Features::SUBGROUP;

/// Storage buffers that hold the scene.
pub(super) const SCENE_BUFFERS: usize = 7;
/// Storage buffers that hold a frame without lists, and with lists.
const FRAME_BUFFERS: usize = 3;
const LISTED_FRAME_BUFFERS: usize = 6;
/// Storage buffers that a kernel reads or writes, without lists and with them.
const BUFFERS: u32 = 10;
const LISTED_BUFFERS: u32 = 13;

#[derive(Debug)]
pub(super) struct Kernels {
    /// `visibility/primary.wgsl`.
    pub(super) primary: wgpu::ComputePipeline,
    /// `visibility/shadow.wgsl`.
    pub(super) shadow: wgpu::ComputePipeline,
    pub(super) lists: Option<ListKernels>,
    scene: wgpu::BindGroupLayout,
    frame: wgpu::BindGroupLayout,
}

/// Kernels for blocks of pixels that share lists of triangles.
#[derive(Debug)]
pub(super) struct ListKernels {
    pub(super) primary: Listed,
    pub(super) shadow: Listed,
    /// The smallest picture that they trace.
    pub(super) least_pixels: usize,
}

/// Kernels that answer rays by lists.
#[derive(Debug)]
pub(super) struct Listed {
    /// `visibility/…_lists.wgsl`: a workgroup a block (and light).
    pub(super) find: wgpu::ComputePipeline,
    /// `visibility/…_listed.wgsl`: the same, and as many for the queue.
    pub(super) test: wgpu::ComputePipeline,
    /// `visibility/…_rest.wgsl`: any number of workgroups.
    pub(super) rest: wgpu::ComputePipeline,
}

/// When blocks of pixels share lists of triangles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Lists {
    /// Where they were measured to be faster: on GPUs whose subgroups have 32 lanes, for large pictures.
    #[default]
    WherePaid,
    /// On every device that can. For tests: software adapters are slower with lists.
    Always,
    Never,
}

impl Lists {
    /// Pixels from which lists pay. The blocks of smaller pictures see more of the scene, and have no lists more often.
    const PAID_PIXELS: usize = 500_000;

    /// The smallest picture that uses lists; `None` if none does.
    fn least_pixels(self, gpu: &Gpu, traversal: Traversal) -> Option<usize> {
        let buffers = gpu.device.limits().max_storage_buffers_per_shader_stage;
        if traversal != Traversal::Hierarchy || buffers < LISTED_BUFFERS {
            return None;
        }
        match self {
            Self::WherePaid => (!gpu.is_software() && has_subgroups(gpu)).then_some(Self::PAID_PIXELS),
            Self::Always => Some(0),
            Self::Never => None,
        }
    }
}

/// Returns whether all subgroups have the 32 lanes of `visibility/lanes_subgroup.wgsl`.
fn has_subgroups(gpu: &Gpu) -> bool {
    let sizes = (gpu.info.subgroup_min_size, gpu.info.subgroup_max_size);
    gpu.device.features().contains(SUBGROUPS) && sizes == (32, 32)
}

/// Where things are moved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Posers {
    /// On the device where it is a GPU that can; software would take longer than the host.
    #[default]
    WherePaid,
    /// On every device that can.
    Device,
    Host,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct FrameBuffers<'a> {
    /// 16 bytes a pixel between the kernels.
    pub(super) surfaces: &'a wgpu::Buffer,
    pub(super) mask: &'a wgpu::Buffer,
    /// [`gnomon_shaders::host::TracedCounts`].
    pub(super) counts: &'a wgpu::Buffer,
    /// The blocks' states, lists and queue; unused by kernels without lists.
    pub(super) lists: [&'a wgpu::Buffer; 3],
}

impl Kernels {
    /// Compiles the kernels for a scene. Errors if the device lacks a feature or a limit. The device's error handler
    /// gets what the device itself refuses.
    pub(super) fn new(
        gpu: &Gpu,
        alpha_materials: &[AlphaMaterial],
        options: KernelOptions,
    ) -> Result<Self, BackendError> {
        let KernelOptions { traversal, lists, offset_roundings, .. } = options;
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
        let least_pixels = lists.least_pixels(gpu, traversal);
        let frame_buffers = if least_pixels.is_some() { LISTED_FRAME_BUFFERS } else { FRAME_BUFFERS };
        let frame = layout(&gpu.device, "frame", (0..frame_buffers).map(|_| buffer_type(false)));
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
                Traversal::Hierarchy if has_subgroups(gpu) => splice_subgroups(&path),
                Traversal::Hierarchy => splice(&path),
                Traversal::RayQuery => splice_ray_query(&path),
            };
            let text = text.map_err(|error| BackendError::Setup(format!("kernel {name}: {error}")))?;
            let module = module(gpu, traversal, name, text);
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
        let listed = |rays: &str, constants: &[(&str, f64)]| -> Result<Listed, BackendError> {
            Ok(Listed {
                find: pipeline(&format!("{rays}_lists"), &[])?,
                test: pipeline(&format!("{rays}_listed"), constants)?,
                rest: pipeline(&format!("{rays}_rest"), constants)?,
            })
        };
        let lists = match least_pixels {
            Some(least_pixels) => Some(ListKernels {
                primary: listed("primary", &primary_constants)?,
                shadow: listed("shadow", &alpha)?,
                least_pixels,
            }),
            None => None,
        };
        Ok(Self { primary, shadow, lists, scene, frame })
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
        let FrameBuffers { surfaces, mask, counts, lists: [states, lists, queue] } = buffers;
        let used = if self.lists.is_some() { LISTED_FRAME_BUFFERS } else { FRAME_BUFFERS };
        let buffers = [surfaces, mask, counts, states, lists, queue].map(wgpu::Buffer::as_entire_binding);
        bind(device, "frame", &self.frame, buffers.into_iter().take(used))
    }
}

#[derive(Debug, Clone, Copy)]
pub(in super::super) struct KernelOptions {
    pub(in super::super) traversal: Traversal,
    pub(in super::super) lists: Lists,
    /// Replaces `OFFSET_ROUNDINGS` of `visibility/surface.wgsl`: a fault for tests.
    pub(in super::super) offset_roundings: Option<u16>,
    pub(in super::super) posers: Posers,
}

impl KernelOptions {
    pub(in super::super) fn new(traversal: Traversal) -> Self {
        Self { traversal, lists: Lists::default(), offset_roundings: None, posers: Posers::default() }
    }
}

/// Compiles a kernel that moves things, with immediate data of so many bytes. Errors if there is no such kernel.
pub(super) fn posing(
    gpu: &Gpu,
    name: &str,
    layout: &wgpu::BindGroupLayout,
    immediate_size: u32,
) -> Result<wgpu::ComputePipeline, BackendError> {
    let text = splice(&format!("visibility/{name}.wgsl"))
        .map_err(|error| BackendError::Setup(format!("kernel {name}: {error}")))?;
    let pipeline_layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("posing"),
        bind_group_layouts: &[Some(layout)],
        immediate_size,
    });
    Ok(gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some(name),
        layout: Some(&pipeline_layout),
        module: &module(gpu, Traversal::Hierarchy, name, text),
        entry_point: Some(name),
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    }))
}

/// Compiles a kernel without counters in its loops, which cost a tenth of the shadow rays' time. Every loop ends: those
/// over a tree by its depth, others by a count or a shrinking set of bits. All accesses stay checked.
fn module(gpu: &Gpu, traversal: Traversal, name: &str, text: String) -> wgpu::ShaderModule {
    let descriptor = wgpu::ShaderModuleDescriptor { label: Some(name), source: wgpu::ShaderSource::Wgsl(text.into()) };
    if traversal == Traversal::RayQuery {
        return gpu.device.create_shader_module(descriptor);
    }
    let checks = wgpu::ShaderRuntimeChecks { force_loop_bounding: false, ..wgpu::ShaderRuntimeChecks::checked() };
    // SAFETY: the only check that is left out bounds loops, and the text is ours, never a peer's.
    #[expect(unsafe_code, reason = "the only way to leave out one check")]
    unsafe {
        gpu.device.create_shader_module_trusted(descriptor, checks)
    }
}

pub(super) fn buffer_type(read_only: bool) -> wgpu::BindingType {
    wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Storage { read_only },
        has_dynamic_offset: false,
        min_binding_size: None,
    }
}

/// A layout of bindings of these types, numbered from 0.
pub(super) fn layout(
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

pub(super) fn bind<'a>(
    device: &wgpu::Device,
    label: &str,
    layout: &wgpu::BindGroupLayout,
    resources: impl IntoIterator<Item = wgpu::BindingResource<'a>>,
) -> wgpu::BindGroup {
    let entries: Vec<wgpu::BindGroupEntry<'a>> =
        (0..).zip(resources).map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource }).collect();
    device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some(label), layout, entries: &entries })
}
