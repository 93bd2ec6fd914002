//! Moves pieces on the device: their vertices, triangles and planes, bit by bit as the host does, and the boxes of
//! their trees. The host says where pieces and joints are, and makes the small top above the trees.
//!
//! The kernels have f64 made of whole numbers (`wgsl/shared/double.wgsl`), since bits decide where a shadow begins.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use gnomon_scene::{Animation, Influence, OwnVertices, Placement, Scene, Shape};
use gnomon_shaders::gpu::Gpu;
use obvhs::cwbvh::node::CwBvhNode;
use wgpu::util::DeviceExt as _;

use super::{
    geometry::PieceGeometry,
    kernels::{self, Posers, Traversal},
    limit::binding_limit,
    regions::RegionBuffers,
    ring::SLOTS,
};
use crate::visibility::backend::BackendError;

/// The device feature that the kernels need.
pub(super) const NEEDED: wgpu::Features = wgpu::Features::SHADER_INT64;

/// Invocations in a workgroup.
const GROUP: usize = 64;

/// Largest number of workgroups in a row that every adapter takes.
const ROW: u32 = 65_535;

/// Largest number in a transform that the kernels take, and largest weight of a morph target. A normal is at most a
/// product of two such numbers and a weighted f32, and its square is still an f64: the kernels have no infinity.
const MOST: f64 = 1e30;
const MOST_WEIGHT: f64 = 1e12;

/// The kernels and buffers that move pieces.
#[derive(Debug)]
pub(super) struct Posing {
    /// Vertices, of rigid pieces and of shapes; triangles; nodes from the leaves up.
    steps: Vec<Step>,
    group: wgpu::BindGroup,
    /// [`SLOTS`] times one [`PlacementWords`] for each piece, and words for all forms.
    placements: wgpu::Buffer,
    forms: wgpu::Buffer,
    form_words: usize,
    /// `None` for one that the host moves.
    pieces: Vec<Option<Own>>,
    bytes: u64,
}

#[derive(Debug)]
struct Step {
    kernel: wgpu::ComputePipeline,
    of: Range<u32>,
}

/// What is here of a piece, besides what moves it.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Own {
    firsts: Firsts,
    first_vertex: u32,
    vertices: u32,
    shape: OwnShape,
}

/// First words of a piece's shape; nothing if it is rigid.
#[derive(Debug, Clone, Copy, Default)]
struct OwnShape {
    sets: u32,
    influences: u32,
    deltas: u32,
    /// In a slot's forms.
    joints: u32,
    targets: u32,
    flat: bool,
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
struct PlacementWords {
    world_from_piece: [[f64; 3]; 4],
    normals: [[f64; 3]; 3],
    origin_m: [f64; 3],
    flags: u32,
    nodes_shift: u32,
    triangles_shift: u32,
    root: u32,
    first_node: u32,
    first_vertex: u32,
    vertices: u32,
    sets: u32,
    influences: u32,
    deltas: u32,
    joints: u32,
    targets: u32,
    target_count: u32,
    unused: [u32; 3],
}

const SHOWN: u32 = 1;
const TURNED: u32 = 2;
const FLAT: u32 = 4;

/// Words of a joint and of a target in the forms.
const JOINT_WORDS: usize = 24;
const TARGET_WORDS: usize = 4;

/// Storage buffers that the kernels read or write.
const BUFFERS: u32 = 12;

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
        pieces: &[PieceGeometry],
        regions: &RegionBuffers,
        (traversal, posers): (Traversal, Posers),
    ) -> Result<Option<Self>, BackendError> {
        let wanted = match posers {
            Posers::WherePaid => !gpu.is_software(),
            Posers::Device => true,
            Posers::Host => false,
        };
        let able = traversal == Traversal::Hierarchy
            && gpu.device.features().contains(NEEDED)
            && gpu.device.limits().max_storage_buffers_per_shader_stage >= BUFFERS;
        let Some(animation) = scene.animation.as_deref().filter(|_| wanted && able) else { return Ok(None) };
        let own = OwnGeometry::of(animation, pieces);
        let per_slot = own.pieces.len() * size_of::<PlacementWords>();
        let forms_bytes = SLOTS * own.form_words * size_of::<u32>();
        let most = own.largest_bytes().max(SLOTS * per_slot).max(forms_bytes) as u64;
        if own.triangles.is_empty() || most > binding_limit(gpu) {
            return Ok(None);
        }
        let buffer = |label: &str, contents: &[u8]| {
            // A binding must not be empty. Nothing reads this filler.
            let contents = if contents.is_empty() { &[0; 64] } else { contents };
            let usage = wgpu::BufferUsages::STORAGE;
            gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: Some(label), contents, usage })
        };
        let empty = |label: &str, size: usize, usage: wgpu::BufferUsages| {
            let (size, usage) = (size.max(64) as u64, usage | wgpu::BufferUsages::STORAGE);
            let descriptor = wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false };
            gpu.device.create_buffer(&descriptor)
        };
        let (none, written) = (wgpu::BufferUsages::empty(), wgpu::BufferUsages::COPY_DST);
        let order: Vec<[u32; 2]> = own.heights.iter().flatten().copied().collect();
        let buffers = [
            buffer("own vertices", bytemuck::cast_slice(&own.vertices)),
            buffer("own triangles", bytemuck::cast_slice(&own.triangles)),
            buffer("trees", bytemuck::cast_slice(&own.nodes)),
            buffer("order of nodes", bytemuck::cast_slice(&order)),
            empty("vertices", size_of_val(&*own.vertices), none),
            empty("bounds", own.nodes.len() * NODE_BOUNDS_BYTES, none),
            empty("placements", SLOTS * per_slot, written),
            buffer("shapes", bytemuck::cast_slice(&own.shapes)),
            empty("forms", forms_bytes, written),
        ];
        let bytes = buffers.iter().map(wgpu::Buffer::size).sum();
        let [own_vertices, own_triangles, trees, order, vertices, bounds, placements, shapes, forms] = buffers;
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
            (&shapes, true),
            (&forms, true),
        ];
        let layout = kernels::layout(&gpu.device, "posing", all.map(|(_, read_only)| kernels::buffer_type(read_only)));
        let entries = all.iter().map(|(buffer, _)| buffer.as_entire_binding());
        let group = kernels::bind(&gpu.device, "posing", &layout, entries);
        let kernel = |name| kernels::posing(gpu, name, &layout, word(size_of::<Dispatch>()));
        let (rigid, all_vertices) = (own.rigid_vertices, word(own.vertices.len() / 2));
        let mut steps = Vec::new();
        if rigid > 0 {
            steps.push(Step { kernel: kernel("pose_vertices")?, of: 0..rigid });
        }
        if rigid < all_vertices {
            steps.push(Step { kernel: kernel("pose_shapes")?, of: rigid..all_vertices });
        }
        steps.push(Step { kernel: kernel("pose_triangles")?, of: 0..word(own.triangles.len()) });
        let nodes_kernel = kernel("pose_nodes")?;
        let mut end = 0;
        for nodes in &own.heights {
            let first = end;
            end += word(nodes.len());
            steps.push(Step { kernel: nodes_kernel.clone(), of: first..end });
        }
        let (pieces, form_words) = (own.pieces, own.form_words);
        Ok(Some(Self { steps, group, placements, forms, form_words, pieces, bytes }))
    }

    /// Memory of the device.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Returns what is here of a piece, if the device can move it there.
    pub(super) fn takes(&self, piece: usize, placement: &Placement) -> Option<Own> {
        let own = self.pieces.get(piece).copied().flatten()?;
        let (world_from_piece, normals) = placement.transforms();
        let (joints, targets) = (placement.joints(), placement.targets());
        let fits = |number: &f64| number.abs() <= MOST;
        let numbers_fit = world_from_piece.to_cols_array().iter().all(fits)
            && normals.to_cols_array().iter().all(|number| number.abs() <= MOST * MOST)
            && placement.origin_m.to_array().iter().all(fits)
            && joints.iter().all(|joint| joint.to_cols_array().iter().all(fits))
            && targets.iter().all(|(_, weight)| weight.abs() <= MOST_WEIGHT);
        numbers_fit.then_some(own)
    }

    /// Writes where a slot's pieces are, by their numbers: those that the device moves.
    pub(super) fn write(&self, queue: &wgpu::Queue, slot: usize, placed: &[Placed<'_>]) {
        let mut words = vec![PlacementWords::zeroed(); self.pieces.len()];
        let mut forms = vec![0_u32; self.form_words];
        let first_form = word(slot * self.form_words);
        for placed in placed {
            words[placed.piece] = placed.words(first_form);
            let (joints, targets) = (placed.placement.joints(), placed.placement.targets());
            let columns = joints.iter().flat_map(|joint| [0, 1, 2, 3].map(|n| joint.col(n).truncate().to_array()));
            let numbers = columns.flatten().flat_map(halves);
            set(&mut forms, placed.own.shape.joints, numbers);
            let weights = targets.iter().flat_map(|(target, weight)| {
                let [low, high] = halves(*weight);
                [word(*target), 0, low, high]
            });
            set(&mut forms, placed.own.shape.targets, weights);
        }
        queue.write_buffer(&self.placements, (slot * size_of_val(&*words)) as u64, bytemuck::cast_slice(&words));
        if !forms.is_empty() {
            queue.write_buffer(&self.forms, (slot * size_of_val(&*forms)) as u64, bytemuck::cast_slice(&forms));
        }
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
        for Step { kernel, of } in &self.steps {
            let first_placement = word(slot * self.pieces.len());
            let dispatch = Dispatch { first_placement, first: of.start, end: of.end };
            pass.set_pipeline(kernel);
            pass.set_immediates(0, bytemuck::bytes_of(&dispatch));
            let groups = word(of.len().div_ceil(GROUP));
            pass.dispatch_workgroups(groups.min(ROW), groups.div_ceil(ROW), 1);
        }
    }
}

/// A piece that the device moves.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placed<'a> {
    pub(super) piece: usize,
    pub(super) placement: &'a Placement,
    pub(super) own: Own,
    /// In the scene's buffers.
    pub(super) firsts: Firsts,
    /// Where its first node goes.
    pub(super) root: u32,
}

/// Lowest and highest corner, each with a word of padding.
const NODE_BOUNDS_BYTES: usize = 32;

/// The geometry of all pieces, in their own spaces: see `wgsl/visibility/pose.wgsl`.
#[derive(Debug, Default)]
struct OwnGeometry {
    /// Those of rigid pieces first.
    vertices: Vec<[u32; 4]>,
    rigid_vertices: u32,
    triangles: Vec<[u32; 8]>,
    nodes: Vec<CwBvhNode>,
    /// Nodes of the same height above the leaves, each with its piece.
    heights: Vec<Vec<[u32; 2]>>,
    shapes: Vec<u32>,
    /// Words of a slot's forms.
    form_words: usize,
    pieces: Vec<Option<Own>>,
}

impl OwnGeometry {
    fn of(animation: &Animation, pieces: &[PieceGeometry]) -> Self {
        let mut all = Self { pieces: vec![None; pieces.len()], ..Self::default() };
        for shaped in [false, true] {
            for (number, (piece, own)) in pieces.iter().zip(animation.own_vertices()).enumerate() {
                if own.shape.is_some() == shaped && !piece.nodes.is_empty() && is_whole(&own) {
                    all.pieces[number] = Some(all.add(word(number), piece, &own));
                }
            }
            if !shaped {
                all.rigid_vertices = word(all.vertices.len() / 2);
            }
        }
        all
    }

    fn add(&mut self, number: u32, piece: &PieceGeometry, own: &OwnVertices<'_>) -> Own {
        let first_vertex = word(self.vertices.len() / 2);
        let firsts = Firsts { node: word(self.nodes.len()), triangle: word(self.triangles.len()) };
        for (position, normal) in own.positions.iter().zip(own.normals) {
            let [position, normal] = [position, normal].map(|v| v.to_array().map(f32::to_bits));
            self.vertices.push([position[0], position[1], position[2], number]);
            self.vertices.push([normal[0], normal[1], normal[2], 0]);
        }
        for triangle in &piece.triangles {
            let [a, b, c] = triangle.corners.map(|corner| corner + first_vertex);
            let [uv, turned_uv] = triangle.first_uvs;
            self.triangles.push([a, b, c, triangle.kind, uv, turned_uv, number, 0]);
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
            self.nodes.push(node);
            self.heights.resize(self.heights.len().max(height + 1), Vec::new());
            self.heights[height].push([firsts.node + word(n), number]);
        }
        let shape = own.shape.map(|shape| self.add_shape(shape, own)).unwrap_or_default();
        Own { firsts, first_vertex, vertices: word(own.positions.len()), shape }
    }

    fn add_shape(&mut self, shape: &Shape, own: &OwnVertices<'_>) -> OwnShape {
        let influences = word(self.shapes.len());
        for Influence { joints: [a, b, c, d], weights } in own.influences {
            let pair = |low: u16, high: u16| u32::from(low) | u32::from(high) << 16;
            self.shapes.extend([pair(*a, *b), pair(*c, *d)]);
            self.shapes.extend(weights.map(f32::to_bits));
        }
        let deltas = word(self.shapes.len());
        for delta in own.deltas {
            self.shapes.extend([delta.position, delta.normal].into_iter().flat_map(|v| v.to_array().map(f32::to_bits)));
        }
        let joints = word(self.form_words);
        let targets = word(self.form_words + JOINT_WORDS * shape.joints.len());
        self.form_words = targets as usize + TARGET_WORDS * shape.targets.len();
        OwnShape { sets: shape.sets, influences, deltas, joints, targets, flat: shape.flat }
    }

    fn largest_bytes(&self) -> usize {
        let bytes = [
            size_of_val(&*self.vertices),
            size_of_val(&*self.triangles),
            size_of_val(&*self.nodes),
            size_of_val(&*self.shapes),
            self.nodes.len() * NODE_BOUNDS_BYTES,
        ];
        bytes.into_iter().max().unwrap_or_default()
    }
}

/// Returns whether the kernels find all that they read of a shape.
fn is_whole(own: &OwnVertices<'_>) -> bool {
    let Some(shape) = own.shape else { return true };
    let (vertices, joints) = (own.positions.len(), shape.joints.len());
    (joints == 0) == (shape.sets == 0)
        && own.influences.len() == shape.sets as usize * vertices
        && own.influences.iter().flat_map(Influence::each).all(|(joint, _)| joint < joints)
        && own.deltas.len() == shape.targets.len() * vertices
        && (!shape.flat || vertices.is_multiple_of(3))
}

impl Placed<'_> {
    /// `first_form`: where the slot's forms begin.
    fn words(&self, first_form: u32) -> PlacementWords {
        let Self { placement, own, firsts, root, .. } = self;
        let Own { firsts: here, first_vertex, vertices, shape } = *own;
        let (world_from_piece, normals) = placement.transforms();
        PlacementWords {
            world_from_piece: [0, 1, 2, 3].map(|n| world_from_piece.col(n).truncate().to_array()),
            normals: [0, 1, 2].map(|n| normals.col(n).to_array()),
            origin_m: placement.origin_m.to_array(),
            flags: SHOWN | if placement.turned { TURNED } else { 0 } | if shape.flat { FLAT } else { 0 },
            nodes_shift: firsts.node.wrapping_sub(here.node),
            triangles_shift: firsts.triangle.wrapping_sub(here.triangle),
            root: *root,
            first_node: here.node,
            first_vertex,
            vertices,
            sets: shape.sets,
            influences: shape.influences,
            deltas: shape.deltas,
            joints: first_form + shape.joints,
            targets: first_form + shape.targets,
            target_count: word(placement.targets().len()),
            unused: [0; 3],
        }
    }
}

/// The low and the high word of a number.
fn halves(number: f64) -> [u32; 2] {
    bytemuck::cast(number)
}

/// Writes words from a place on.
fn set(words: &mut [u32], first: u32, values: impl Iterator<Item = u32>) {
    words.iter_mut().skip(first as usize).zip(values).for_each(|(word, value)| *word = value);
}

/// Buffers have fewer than 2³² entries.
fn word(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}
