//! Moves rigid pieces on the device: their vertices, triangles and planes, bit by bit as the host does, and the boxes of
//! their trees. The host says where pieces are, and makes the small top above them.
//!
//! The kernels have f64 made of whole numbers (`wgsl/shared/double.wgsl`), since bits decide where a shadow begins.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use glam::{DMat3, DMat4, DVec3};
use gnomon_scene::{Animation, Placement, Scene};
use gnomon_shaders::gpu::Gpu;
use wgpu::util::DeviceExt as _;

use super::{
    kernels::{self, Traversal},
    limit::binding_limit,
    movers::{Movers, RegionBuffers},
    ring::SLOTS,
};
use crate::visibility::backend::BackendError;

/// The device feature that the kernels need.
pub(super) const NEEDED: wgpu::Features = wgpu::Features::SHADER_INT64;

/// Invocations in a workgroup.
const GROUP: usize = 64;

/// Largest number of workgroups in a row that every adapter takes.
const ROW: u32 = 65_535;

/// What a placement's numbers may be: 2^±200, or 0. So nothing that is computed leaves the f64's exponents, which the
/// kernels do not bound: at most squares of products of two such numbers and an f32.
const EXPONENTS: Range<i32> = -200..200;

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

/// The kernels and buffers that move pieces.
#[derive(Debug)]
pub(super) struct Posing {
    vertices: Step,
    triangles: Step,
    /// From the leaves up.
    nodes: Vec<Step>,
    group: wgpu::BindGroup,
    /// [`SLOTS`] times one [`PlacementWords`] for each piece.
    placements: wgpu::Buffer,
    /// First node and triangle of each piece among those here. `None` for one that the host moves.
    pieces: Vec<Option<Firsts>>,
    bytes: u64,
}

#[derive(Debug)]
struct Step {
    kernel: wgpu::ComputePipeline,
    of: Range<u32>,
}

/// A first node and triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Firsts {
    pub(super) node: u32,
    pub(super) triangle: u32,
}

/// Twin: `wgsl/visibility/pose.wgsl`.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct PlacementWords {
    world_from_piece: [[f64; 3]; 4],
    normals: [[f64; 3]; 3],
    origin_m: [f64; 3],
    flags: u32,
    nodes_shift: u32,
    triangles_shift: u32,
    root: u32,
    first_node: u32,
    unused: [u32; 3],
}

const SHOWN: u32 = 1;
const TURNED: u32 = 2;

/// Twin: `wgsl/visibility/pose.wgsl`.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Dispatch {
    first_placement: u32,
    first: u32,
    end: u32,
}

impl Posing {
    /// `None` if the host is to move everything, or nothing moves that the device can move.
    pub(super) fn new(
        gpu: &Gpu,
        scene: &Scene,
        movers: &Movers,
        regions: &RegionBuffers,
        (traversal, posers): (Traversal, Posers),
    ) -> Result<Option<Self>, BackendError> {
        let wanted = match posers {
            Posers::WherePaid => !gpu.is_software(),
            Posers::Device => true,
            Posers::Host => false,
        };
        let able = traversal == Traversal::Hierarchy && gpu.device.features().contains(NEEDED);
        let Some(animation) = scene.animation.as_deref().filter(|_| wanted && able) else { return Ok(None) };
        let own = OwnGeometry::of(animation, movers);
        let most = own.largest_bytes().max((SLOTS * movers.pieces().len() * size_of::<PlacementWords>()) as u64);
        if own.triangles.is_empty() || most > binding_limit(gpu) {
            return Ok(None);
        }
        let buffer = |label: &str, contents: &[u8]| {
            let usage = wgpu::BufferUsages::STORAGE;
            gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: Some(label), contents, usage })
        };
        let empty = |label: &str, size: usize, usage: wgpu::BufferUsages| {
            let usage = usage | wgpu::BufferUsages::STORAGE;
            let descriptor =
                wgpu::BufferDescriptor { label: Some(label), size: size as u64, usage, mapped_at_creation: false };
            gpu.device.create_buffer(&descriptor)
        };
        let none = wgpu::BufferUsages::empty();
        let order: Vec<[u32; 2]> = own.heights.iter().flatten().copied().collect();
        let placements = SLOTS * own.pieces.len() * size_of::<PlacementWords>();
        let buffers = [
            buffer("own vertices", bytemuck::cast_slice(&own.vertices)),
            buffer("own triangles", bytemuck::cast_slice(&own.triangles)),
            buffer("trees", bytemuck::cast_slice(&own.nodes)),
            buffer("order of nodes", bytemuck::cast_slice(&order)),
            empty("vertices", size_of_val(&*own.vertices), none),
            empty("bounds", own.nodes.len() * NODE_BOUNDS_BYTES, none),
            empty("placements", placements, wgpu::BufferUsages::COPY_DST),
        ];
        let bytes = buffers.iter().map(wgpu::Buffer::size).sum();
        let [own_vertices, own_triangles, trees, order, vertices, bounds, placements] = buffers;
        // In the order of `wgsl/visibility/pose.wgsl`.
        let all = [
            (&regions.nodes, false),
            (&regions.triangles, false),
            (&regions.normals, false),
            (&own_vertices, true),
            (&own_triangles, true),
            (&trees, true),
            (&order, true),
            (&vertices, false),
            (&bounds, false),
            (&placements, true),
        ];
        let layout = kernels::layout(&gpu.device, "posing", all.map(|(_, read_only)| kernels::buffer_type(read_only)));
        let group =
            kernels::bind(&gpu.device, "posing", &layout, all.iter().map(|(buffer, _)| buffer.as_entire_binding()));
        let kernel = |name| kernels::posing(gpu, name, &layout, word(size_of::<Dispatch>()));
        let nodes_kernel = kernel("pose_nodes")?;
        let mut end = 0;
        let nodes = own.heights.iter().map(|nodes| {
            let first = end;
            end += word(nodes.len());
            Step { kernel: nodes_kernel.clone(), of: first..end }
        });
        Ok(Some(Self {
            nodes: nodes.collect(),
            vertices: Step { kernel: kernel("pose_vertices")?, of: 0..word(own.vertices.len() / 2) },
            triangles: Step { kernel: kernel("pose_triangles")?, of: 0..word(own.triangles.len()) },
            group,
            placements,
            pieces: own.pieces,
            bytes,
        }))
    }

    /// Memory of the device.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Returns where a piece's nodes and triangles are here, if the device can move it there.
    pub(super) fn takes(&self, piece: usize, placement: &Placement) -> Option<Firsts> {
        let firsts = self.pieces.get(piece).copied().flatten()?;
        let (world_from_piece, normals) = placement.rigid()?;
        let origin_m = placement.origin_m;
        (world_from_piece.to_cols_array().iter().chain(&normals.to_cols_array()).chain(&origin_m.to_array()))
            .all(|number| *number == 0.0 || exponent(*number).is_some_and(|exponent| EXPONENTS.contains(&exponent)))
            .then_some(firsts)
    }

    /// Writes where a slot's pieces are: those that the device moves, by their numbers.
    pub(super) fn write(&self, queue: &wgpu::Queue, slot: usize, placed: &[(usize, PlacementWords)]) {
        let mut words = vec![PlacementWords::zeroed(); self.pieces.len()];
        for (piece, placement) in placed {
            words[*piece] = *placement;
        }
        let at = (slot * size_of_val(&*words)) as u64;
        queue.write_buffer(&self.placements, at, bytemuck::cast_slice(&words));
    }

    /// Moves a slot's pieces. Encode before the kernels of its frame. The pass writes these timestamps.
    pub(super) fn encode(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        slot: usize,
        timestamp_writes: Option<wgpu::ComputePassTimestampWrites<'_>>,
    ) {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: None, timestamp_writes });
        pass.set_bind_group(0, &self.group, &[]);
        for Step { kernel, of } in [&self.vertices, &self.triangles].into_iter().chain(&self.nodes) {
            let dispatch = Dispatch { first_placement: word(slot * self.pieces.len()), first: of.start, end: of.end };
            pass.set_pipeline(kernel);
            pass.set_immediates(0, bytemuck::bytes_of(&dispatch));
            let groups = word(of.len().div_ceil(GROUP));
            pass.dispatch_workgroups(groups.min(ROW), groups.div_ceil(ROW), 1);
        }
    }
}

/// Lowest and highest corner, each with a word of padding.
const NODE_BOUNDS_BYTES: usize = 32;

/// The geometry of all rigid pieces, in their own spaces: see `wgsl/visibility/pose.wgsl`.
#[derive(Debug, Default)]
struct OwnGeometry {
    vertices: Vec<[u32; 4]>,
    triangles: Vec<[u32; 8]>,
    nodes: Vec<obvhs::cwbvh::node::CwBvhNode>,
    /// Nodes of the same height above the leaves, each with its piece.
    heights: Vec<Vec<[u32; 2]>>,
    pieces: Vec<Option<Firsts>>,
}

impl OwnGeometry {
    fn of(animation: &Animation, movers: &Movers) -> Self {
        let mut all = Self::default();
        for (number, (piece, own)) in movers.pieces().iter().zip(animation.own_vertices()).enumerate() {
            if own.shape.is_some() || piece.nodes.is_empty() {
                all.pieces.push(None);
                continue;
            }
            let (first_vertex, number) = (word(all.vertices.len() / 2), word(number));
            let firsts = Firsts { node: word(all.nodes.len()), triangle: word(all.triangles.len()) };
            for (position, normal) in own.positions.iter().zip(own.normals) {
                let [position, normal] = [position, normal].map(|v| v.to_array().map(f32::to_bits));
                all.vertices.push([position[0], position[1], position[2], number]);
                all.vertices.push([normal[0], normal[1], normal[2], 0]);
            }
            for triangle in &piece.triangles {
                let [a, b, c] = triangle.corners.map(|corner| corner + first_vertex);
                let [uv, turned_uv] = triangle.first_uvs;
                all.triangles.push([a, b, c, triangle.kind, uv, turned_uv, number, 0]);
            }
            // Children come after their parents.
            let mut heights = vec![0; piece.nodes.len()];
            for (n, node) in piece.nodes.iter().enumerate().rev() {
                let first = node.child_base_idx as usize;
                let below = heights.get(first..first + node.imask.count_ones() as usize).unwrap_or_default();
                heights[n] = below.iter().max().map_or(0, |highest| highest + 1);
            }
            for (n, (node, height)) in piece.nodes.iter().zip(heights).enumerate() {
                let mut node = *node;
                node.child_base_idx += firsts.node;
                node.primitive_base_idx += firsts.triangle;
                all.nodes.push(node);
                all.heights.resize(all.heights.len().max(height + 1), Vec::new());
                all.heights[height].push([firsts.node + word(n), number]);
            }
            all.pieces.push(Some(firsts));
        }
        all
    }

    fn largest_bytes(&self) -> u64 {
        let bytes = [
            size_of_val(&*self.vertices),
            size_of_val(&*self.triangles),
            size_of_val(&*self.nodes),
            self.nodes.len() * NODE_BOUNDS_BYTES,
        ];
        bytes.into_iter().max().unwrap_or_default() as u64
    }
}

impl PlacementWords {
    /// Of a rigid piece whose nodes and triangles are at `here`, and go to `there`; its first node goes to `root`.
    pub(super) fn new(placement: &Placement, here: Firsts, there: Firsts, root: u32) -> Option<Self> {
        let (world_from_piece, normals): (&DMat4, &DMat3) = placement.rigid()?;
        let column = |v: DVec3| v.to_array();
        let [x, y, z, w] = [0, 1, 2, 3].map(|n| column(world_from_piece.col(n).truncate()));
        Some(Self {
            world_from_piece: [x, y, z, w],
            normals: [0, 1, 2].map(|n| column(normals.col(n))),
            origin_m: column(placement.origin_m),
            flags: SHOWN | if placement.turned { TURNED } else { 0 },
            nodes_shift: there.node.wrapping_sub(here.node),
            triangles_shift: there.triangle.wrapping_sub(here.triangle),
            root,
            first_node: here.node,
            unused: [0; 3],
        })
    }
}

/// The power of two of a number's first bit. `None` if it has none.
fn exponent(number: f64) -> Option<i32> {
    number.is_normal().then(|| i32::try_from(number.to_bits() >> 52 & 0x7ff).unwrap_or_default() - 1023)
}

/// Buffers have fewer than 2³² entries.
fn word(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}
