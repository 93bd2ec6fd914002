//! The adapter's own acceleration structures, for ray queries: a bottom level over the triangles that rest, another
//! over those that move, and a top level with an instance of each, in place: no transform rounds. Where nothing moves
//! there is one top level; else every slot has one, and a bottom level of what moves, both built for each frame.
//! Triangles are slightly enlarged ([`enlarge`]). They keep the scene's order, so a candidate's index is its
//! triangle's.

use glam::Vec3;
use gnomon_shaders::{gpu::Gpu, host::TracedTriangle};

use super::enlarge;
use crate::visibility::backend::BackendError;

/// The device feature that ray queries need.
pub(super) const NEEDED: wgpu::Features = wgpu::Features::EXPERIMENTAL_RAY_QUERY;

/// Marks the instance of what moves. Twin: `MOVES` in `wgsl/visibility/ray_query.wgsl`.
const MOVES: u32 = 1;
const RESTS: u32 = 0;

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

/// All structures of a scene.
#[derive(Debug)]
pub(super) struct Structures {
    /// One if nothing moves, else one a slot.
    tops: Vec<wgpu::Tlas>,
    /// One a slot, if anything moves.
    moving: Vec<Bottom>,
    /// The greatest coordinate of what rests, and of what moves in the pose of the file.
    greatest: f32,
}

/// A bottom level, and the corners that it is built over.
#[derive(Debug)]
struct Bottom {
    structure: wgpu::Blas,
    corners: wgpu::Buffer,
}

impl Structures {
    /// Builds the structure over the triangles that rest. Up to `most_moving` others move, in so many slots; in the
    /// file's pose their greatest coordinate is `greatest_moving`. Errors if the adapter cannot build structures over
    /// so many. The device's error handler gets what the device itself refuses.
    pub(super) fn new(
        gpu: &Gpu,
        resting: &[TracedTriangle],
        (most_moving, slots): (usize, usize),
        greatest_moving: f32,
    ) -> Result<Self, BackendError> {
        let (resting_count, most_moving) = (count(gpu, resting.len())?, count(gpu, most_moving)?);
        let slots = if most_moving > 0 { slots } else { 1 };
        let create_top = |_| {
            gpu.device.create_tlas(&wgpu::CreateTlasDescriptor {
                label: Some("scene"),
                max_instances: if most_moving > 0 { 2 } else { 1 },
                flags: FLAGS,
                update_mode: UPDATE_MODE,
            })
        };
        let mut tops: Vec<wgpu::Tlas> = (0..slots).map(create_top).collect();
        let moving = if most_moving > 0 {
            (0..slots).map(|_| Bottom::new(gpu, "what moves", most_moving)).collect()
        } else {
            Vec::new()
        };
        let greatest = enlarge::greatest(resting).max(greatest_moving);
        let bottom = (resting_count > 0).then(|| Bottom::new(gpu, "what rests", resting_count));
        if let Some(bottom) = &bottom {
            bottom.write(&gpu.queue, &enlarge::enlarged(resting, greatest));
            for top in &mut tops {
                top[0] = Some(wgpu::TlasInstance::new(&bottom.structure, IN_PLACE, RESTS, 0xff));
            }
        }
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        build(&mut encoder, bottom.as_ref().map(|bottom| (bottom, resting_count)), &tops);
        gpu.queue.submit([encoder.finish()]);
        Ok(Self { tops, moving, greatest })
    }

    /// The top levels: one, or one a slot.
    pub(super) fn tops(&self) -> &[wgpu::Tlas] {
        &self.tops
    }

    /// Uploads what moves for a slot's frame. [`Self::build`] must follow.
    pub(super) fn write(&mut self, queue: &wgpu::Queue, slot: usize, triangles: &[TracedTriangle]) {
        let (Some(bottom), Some(top)) = (self.moving.get(slot), self.tops.get_mut(slot)) else { return };
        bottom.write(queue, &enlarge::enlarged(triangles, enlarge::greatest(triangles).max(self.greatest)));
        top[1] = (!triangles.is_empty()).then(|| wgpu::TlasInstance::new(&bottom.structure, IN_PLACE, MOVES, 0xff));
    }

    /// Builds the structures of a slot over so many triangles that move. Encode before the kernels of its frame.
    pub(super) fn build(&self, encoder: &mut wgpu::CommandEncoder, slot: usize, moving: u32) {
        let (Some(bottom), Some(top)) = (self.moving.get(slot), self.tops.get(slot)) else { return };
        build(encoder, (moving > 0).then_some((bottom, moving)), std::slice::from_ref(top));
    }
}

const FLAGS: wgpu::AccelerationStructureFlags = wgpu::AccelerationStructureFlags::PREFER_FAST_TRACE;
const UPDATE_MODE: wgpu::AccelerationStructureUpdateMode = wgpu::AccelerationStructureUpdateMode::Build;

/// The identity.
const IN_PLACE: [f32; 12] = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];

/// Errors if the adapter cannot build a structure over so many triangles.
fn count(gpu: &Gpu, triangles: usize) -> Result<u32, BackendError> {
    let limit = gpu.device.limits().max_blas_primitive_count;
    u32::try_from(triangles).ok().filter(|&count| count <= limit).ok_or_else(|| {
        let missing = format!("acceleration structures of {triangles} triangles: {limit} are its most");
        BackendError::Feature { adapter: gpu.info.name.clone(), missing }
    })
}

fn geometry_size(triangles: u32) -> wgpu::BlasTriangleGeometrySizeDescriptor {
    wgpu::BlasTriangleGeometrySizeDescriptor {
        vertex_format: wgpu::VertexFormat::Float32x3,
        vertex_count: triangles.saturating_mul(3),
        index_format: None,
        index_count: None,
        // Not opaque, so that the kernels test every candidate themselves (wgsl/visibility/ray_query.wgsl).
        flags: wgpu::AccelerationStructureGeometryFlags::empty(),
    }
}

impl Bottom {
    /// Room for so many triangles, at least one.
    fn new(gpu: &Gpu, label: &'static str, triangles: u32) -> Self {
        let structure = gpu.device.create_blas(
            &wgpu::CreateBlasDescriptor { label: Some(label), flags: FLAGS, update_mode: UPDATE_MODE },
            wgpu::BlasGeometrySizeDescriptors::Triangles { descriptors: vec![geometry_size(triangles)] },
        );
        let corners = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("corners"),
            size: u64::from(triangles) * size_of::<[Vec3; 3]>() as u64,
            usage: wgpu::BufferUsages::BLAS_INPUT | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        Self { structure, corners }
    }

    fn write(&self, queue: &wgpu::Queue, corners: &[[Vec3; 3]]) {
        if !corners.is_empty() {
            queue.write_buffer(&self.corners, 0, bytemuck::cast_slice(corners));
        }
    }
}

/// Builds a bottom level over so many triangles, and top levels.
fn build(encoder: &mut wgpu::CommandEncoder, bottom: Option<(&Bottom, u32)>, tops: &[wgpu::Tlas]) {
    let size = geometry_size(bottom.map_or(0, |(_, triangles)| triangles));
    let entry = bottom.map(|(Bottom { structure, corners }, _)| {
        let geometry = wgpu::BlasTriangleGeometry {
            size: &size,
            vertex_buffer: corners,
            first_vertex: 0,
            vertex_stride: size_of::<Vec3>() as u64,
            index_buffer: None,
            first_index: None,
            transform_buffer: None,
            transform_buffer_offset: None,
        };
        wgpu::BlasBuildEntry { blas: structure, geometry: wgpu::BlasGeometries::TriangleGeometries(vec![geometry]) }
    });
    encoder.build_acceleration_structures(entry.iter(), tops.iter());
}
