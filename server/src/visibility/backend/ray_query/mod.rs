//! Tracing with the adapter's own ray queries: the `compute` back end's frames, rules and kernels, with the adapter's
//! acceleration structure in place of our hierarchy.
//!
//! wgpu calls ray queries experimental. An adapter that has no hardware for them does not offer them, except software Vulkan
//! of a recent kind, which is what tests run on. The structure holds one bottom level over the scene's triangles and one
//! instance of it, since nothing moves. Its triangles are a little larger than the scene's (`pad`), and in the scene's order,
//! so that a candidate's number is its triangle's.

mod pad;

use glam::Vec3;
use gnomon_scene::Scene;
use gnomon_shaders::{gpu::Gpu, host::TracedTriangle};
use wgpu::util::DeviceExt as _;

use super::{
    BackendError,
    compute::{ComputeBackend, KernelOptions, Traversal},
};

/// The device feature that sets this back end apart.
pub(super) const NEEDED: wgpu::Features = wgpu::Features::EXPERIMENTAL_RAY_QUERY;

/// Opens an adapter that has ray queries, and brings the scene to it. Takes as long as building the structure and compiling
/// the kernels.
///
/// # Errors
/// When there is no such adapter, it has no ray queries or lacks what else the kernels need, or the scene does not fit it.
pub fn open(scene: &Scene, adapter: Option<String>, allow_software: bool) -> Result<ComputeBackend, BackendError> {
    open_with(scene, adapter, allow_software, KernelOptions::default())
}

/// As [`open`], with other kernels. Nodes of the adapter's own structure cannot be counted.
///
/// # Errors
/// As [`open`].
pub fn open_with(
    scene: &Scene,
    adapter: Option<String>,
    allow_software: bool,
    options: KernelOptions,
) -> Result<ComputeBackend, BackendError> {
    ComputeBackend::open_traversing(scene, adapter, allow_software, (Traversal::RayQuery, options))
}

/// The best that an adapter can do: ray queries where it has them and the scene fits, `compute` otherwise.
///
/// # Errors
/// When there is no such adapter, or it can do neither.
pub fn open_preferred(
    scene: &Scene,
    adapter: Option<String>,
    allow_software: bool,
) -> Result<ComputeBackend, BackendError> {
    match open(scene, adapter.clone(), allow_software) {
        Err(BackendError::Gpu(error)) => Err(error.into()),
        Err(error) => {
            tracing::info!(reason = %error, "tracing without ray queries");
            ComputeBackend::open(scene, adapter, allow_software)
        }
        backend => backend,
    }
}

/// As [`open`], on a device that is already there.
///
/// # Errors
/// When the device lacks what the kernels need, or the scene does not fit it.
pub fn new(scene: &Scene, gpu: Gpu) -> Result<ComputeBackend, BackendError> {
    ComputeBackend::new_traversing(scene, gpu, (Traversal::RayQuery, KernelOptions::default()))
}

/// Whether the device has ray queries.
///
/// # Errors
/// When it has none.
pub(super) fn check(gpu: &Gpu) -> Result<(), BackendError> {
    if gpu.device.features().contains(NEEDED) {
        return Ok(());
    }
    Err(BackendError::Feature { adapter: gpu.info.name.clone(), missing: "ray queries".to_owned() })
}

/// What the structure is bound as.
pub(super) fn structure_type() -> wgpu::BindingType {
    wgpu::BindingType::AccelerationStructure { vertex_return: false }
}

/// Builds the structure over `triangles`.
///
/// # Errors
/// When there are more triangles than the adapter can build a structure of. What the device itself refuses, its error
/// handler gets.
pub(super) fn build_structure(gpu: &Gpu, triangles: &[TracedTriangle]) -> Result<wgpu::Tlas, BackendError> {
    let limit = gpu.device.limits().max_blas_primitive_count;
    let Some(count) = u32::try_from(triangles.len()).ok().filter(|&count| count <= limit) else {
        let missing = format!("acceleration structures of {} triangles: {limit} are its most", triangles.len());
        return Err(BackendError::Feature { adapter: gpu.info.name.clone(), missing });
    };
    let (flags, update_mode) =
        (wgpu::AccelerationStructureFlags::PREFER_FAST_TRACE, wgpu::AccelerationStructureUpdateMode::Build);
    let mut structure = gpu.device.create_tlas(&wgpu::CreateTlasDescriptor {
        label: Some("scene"),
        max_instances: 1,
        flags,
        update_mode,
    });
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    if triangles.is_empty() {
        encoder.build_acceleration_structures([], [&structure]);
        gpu.queue.submit([encoder.finish()]);
        return Ok(structure);
    }
    let vertices = gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
        label: Some("corners"),
        contents: bytemuck::cast_slice(&pad::padded(triangles)),
        usage: wgpu::BufferUsages::BLAS_INPUT,
    });
    let size = wgpu::BlasTriangleGeometrySizeDescriptor {
        vertex_format: wgpu::VertexFormat::Float32x3,
        vertex_count: count.saturating_mul(3),
        index_format: None,
        index_count: None,
        // Not opaque: every triangle is offered to the kernels, which decide (wgsl/visibility/ray_query.wgsl).
        flags: wgpu::AccelerationStructureGeometryFlags::empty(),
    };
    let bottom = gpu.device.create_blas(
        &wgpu::CreateBlasDescriptor { label: Some("triangles"), flags, update_mode },
        wgpu::BlasGeometrySizeDescriptors::Triangles { descriptors: vec![size.clone()] },
    );
    let geometry = wgpu::BlasTriangleGeometry {
        size: &size,
        vertex_buffer: &vertices,
        first_vertex: 0,
        vertex_stride: size_of::<Vec3>() as u64,
        index_buffer: None,
        first_index: None,
        transform_buffer: None,
        transform_buffer_offset: None,
    };
    let entry =
        wgpu::BlasBuildEntry { blas: &bottom, geometry: wgpu::BlasGeometries::TriangleGeometries(vec![geometry]) };
    let in_place = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    structure[0] = Some(wgpu::TlasInstance::new(&bottom, in_place, 0, 0xff));
    encoder.build_acceleration_structures([&entry], [&structure]);
    gpu.queue.submit([encoder.finish()]);
    Ok(structure)
}
