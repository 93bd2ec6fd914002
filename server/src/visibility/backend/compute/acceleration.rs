//! The adapter's own acceleration structure, for ray queries: one bottom level over the scene's triangles, and one
//! instance of it, since nothing moves. Its triangles are slightly enlarged ([`enlarge`]). They keep the scene's order,
//! so a candidate's index is its triangle's.

use glam::Vec3;
use gnomon_shaders::{gpu::Gpu, host::TracedTriangle};
use wgpu::util::DeviceExt as _;

use super::enlarge;
use crate::visibility::backend::BackendError;

/// The device feature that ray queries need.
pub(super) const NEEDED: wgpu::Features = wgpu::Features::EXPERIMENTAL_RAY_QUERY;

/// Errors if the device has no ray queries.
pub(super) fn check(gpu: &Gpu) -> Result<(), BackendError> {
    if gpu.device.features().contains(NEEDED) {
        return Ok(());
    }
    Err(BackendError::Feature { adapter: gpu.info.name.clone(), missing: "ray queries".to_owned() })
}

pub(super) fn structure_type() -> wgpu::BindingType {
    wgpu::BindingType::AccelerationStructure { vertex_return: false }
}

/// Builds the structure over `triangles`. Errors if the adapter cannot build one over so many. The device's error
/// handler gets what the device itself refuses.
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
        contents: bytemuck::cast_slice(&enlarge::enlarged(triangles)),
        usage: wgpu::BufferUsages::BLAS_INPUT,
    });
    let size = wgpu::BlasTriangleGeometrySizeDescriptor {
        vertex_format: wgpu::VertexFormat::Float32x3,
        vertex_count: count.saturating_mul(3),
        index_format: None,
        index_count: None,
        // Not opaque, so that the kernels test every candidate themselves (wgsl/visibility/ray_query.wgsl).
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
