//! The buffers of a scene that have a region for each frame that may have begun.

use glam::Vec3;
use gnomon_shaders::host::{TracedLight, TracedTriangle};
use obvhs::cwbvh::node::CwBvhNode;

/// Entries of the scene's buffers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Sizes {
    pub(super) nodes: usize,
    pub(super) triangles: usize,
    pub(super) lights: usize,
}

impl Sizes {
    pub(super) fn bytes(self) -> u64 {
        let triangle = size_of::<TracedTriangle>() + size_of::<[Vec3; 4]>();
        let bytes = self.nodes * size_of::<CwBvhNode>() + self.triangles * triangle;
        (bytes + self.lights * size_of::<TracedLight>()) as u64
    }
}

/// The buffers that have regions.
#[derive(Debug, Clone)]
pub(super) struct RegionBuffers {
    pub(super) nodes: wgpu::Buffer,
    pub(super) triangles: wgpu::Buffer,
    pub(super) lights: wgpu::Buffer,
    pub(super) normals: wgpu::Buffer,
}
