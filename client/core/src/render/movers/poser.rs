//! Puts the vertices of what moves where they are in a state of the scene, on the adapter (`pose.wgsl`).

use glam::{DMat3, DMat4, DVec3, DVec4, Vec3};
use gnomon_scene::{Animation, Moment, Placement, Scene};
use gnomon_shaders::gpu::Gpu;
use wgpu::util::DeviceExt as _;

use super::own::{Own, Room, Run, runs, word};
use crate::render::{
    error::RenderError,
    pipeline::{bind_group, bind_group_layout, compute_pipeline, shader, storage},
    vertex::{MoreOfVertex, Vertex},
};

/// Largest number of workgroups in a row that every adapter takes.
const ROW: u32 = 65_535;

/// Twins: `pose.wgsl`.
const GROUP: u32 = 64;
const MOVED: u32 = 1;
const TURNED: u32 = 2;
const FLAT: u32 = 4;
const MIRRORED: u32 = 8;
const PLACED_QUADS: usize = 9;

/// The scene's buffers that vertices lie in.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Buffers<'a> {
    pub(crate) vertices: &'a wgpu::Buffer,
    pub(crate) more: &'a wgpu::Buffer,
}

#[derive(Debug)]
pub(super) struct Poser {
    kernel: wgpu::ComputePipeline,
    state_layout: wgpu::BindGroupLayout,
    parts: Vec<Part>,
    runs: Vec<Run>,
    /// Length of what [`Self::state`] makes.
    quads: usize,
}

/// As many vertices as the adapter's bindings hold.
#[derive(Debug)]
struct Part {
    group: wgpu::BindGroup,
    vertices: u32,
}

impl Poser {
    /// # Errors
    /// If the adapter's bindings do not hold where everything is in one state.
    pub(super) fn new(
        gpu: &Gpu,
        scene: &Scene,
        animation: &Animation,
        buffers: Buffers<'_>,
    ) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let tangents = !scene.tangents.is_empty();
        let [read, written] = [true, false].map(storage);
        let layout = |label, bindings: &[wgpu::BindingType]| {
            bind_group_layout(device, label, wgpu::ShaderStages::COMPUTE, bindings)
        };
        let own_layout = layout("what moves", &[read, read, read, written, written]);
        let state_layout = layout("where it is", &[read]);
        let module = shader(gpu, "shading/pose.wgsl")?;
        let constants = [("TANGENTS", f64::from(u8::from(tangents)))];
        let kernel = compute_pipeline(device, &module, &[&own_layout, &state_layout], ("pose", &constants));
        let limits = device.limits();
        let room = Room {
            bytes: limits.max_storage_buffer_binding_size,
            // Vertices are whole words.
            aligned: (limits.min_storage_buffer_offset_alignment / 4).max(1),
            tangents,
        };
        let own_runs = runs(animation, room);
        let mut quads = own_runs.len() * PLACED_QUADS;
        let (mut runs, mut parts, mut part) = (Vec::new(), Vec::new(), Own::default());
        for (number, own) in (0..).zip(&own_runs) {
            if !part.fits(own, room) && !part.vertices.is_empty() {
                parts.push(bind(device, &own_layout, &std::mem::take(&mut part), buffers, tangents));
            }
            runs.push(part.add(number, own, room, &mut quads));
        }
        if !part.vertices.is_empty() {
            parts.push(bind(device, &own_layout, &part, buffers, tangents));
        }
        let needed = (quads * size_of::<[u32; 4]>()) as u64;
        if needed > room.bytes {
            return Err(RenderError::TooLarge { what: "where things are", needed, limit: room.bytes });
        }
        Ok(Self { kernel, state_layout, parts, runs, quads })
    }

    /// Returns where everything is at a moment, as [`Self::encode`] reads it, and the bytes that takes. Pieces that are
    /// not `moved` keep the vertices that they have.
    pub(super) fn state(&self, device: &wgpu::Device, moment: &Moment, moved: &[bool]) -> (wgpu::BindGroup, u64) {
        let mut quads = vec![[0_u32; 4]; self.quads];
        for (number, run) in self.runs.iter().enumerate() {
            let placement = moment.pieces.get(run.piece).and_then(Option::as_ref);
            let Some(placement) = placement.filter(|_| moved.get(run.piece) == Some(&true)) else { continue };
            set(&mut quads, number * PLACED_QUADS, run.placed(placement));
            let local = |joint: &DMat4| rows_of_points(joint, run.middle, placement.origin_m);
            set(&mut quads, run.joints, placement.joints().iter().flat_map(local));
            let target =
                |(number, weight): &(usize, f64)| bits(DVec4::new(f64::from(word(*number)), *weight, 0.0, 0.0));
            set(&mut quads, run.targets, placement.targets().iter().map(target));
        }
        let buffer = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("where it is"),
            contents: bytemuck::cast_slice(&quads),
            usage: wgpu::BufferUsages::STORAGE,
        });
        (bind_group(device, "where it is", &self.state_layout, &[buffer.as_entire_binding()]), buffer.size())
    }

    /// Moves what is moved in a state.
    pub(super) fn encode(&self, encoder: &mut wgpu::CommandEncoder, state: &wgpu::BindGroup) {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&self.kernel);
        pass.set_bind_group(1, state, &[]);
        for Part { group, vertices } in &self.parts {
            pass.set_bind_group(0, group, &[]);
            let groups = vertices.div_ceil(GROUP);
            pass.dispatch_workgroups(groups.min(ROW), groups.div_ceil(ROW), 1);
        }
    }
}

fn bind(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    own: &Own,
    buffers: Buffers<'_>,
    tangents: bool,
) -> Part {
    let buffer = |label, bytes: &[u8]| {
        // A binding cannot be empty.
        let contents = if bytes.is_empty() { &[0; 64] } else { bytes };
        let usage = wgpu::BufferUsages::STORAGE;
        device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: Some(label), contents, usage })
    };
    let [vertices, own_tangents, shapes, nothing] = [
        buffer("own vertices", bytemuck::cast_slice(&own.vertices)),
        buffer("own tangents", bytemuck::cast_slice(&own.tangents)),
        buffer("shapes", bytemuck::cast_slice(&own.shapes)),
        buffer("no tangents", &[]),
    ];
    let written = |buffer, stride: usize| {
        let [offset, end] = [own.scene.start, own.scene.end].map(|vertex| vertex * stride as u64);
        wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer, offset, size: wgpu::BufferSize::new(end - offset) })
    };
    let more = if tangents { written(buffers.more, size_of::<MoreOfVertex>()) } else { nothing.as_entire_binding() };
    let resources = [
        vertices.as_entire_binding(),
        own_tangents.as_entire_binding(),
        shapes.as_entire_binding(),
        written(buffers.vertices, size_of::<Vertex>()),
        more,
    ];
    Part { group: bind_group(device, "what moves", layout, &resources), vertices: word(own.vertices.len()) }
}

impl Run {
    /// As `Placed` in `pose.wgsl`.
    fn placed(&self, placement: &Placement) -> [[u32; 4]; PLACED_QUADS] {
        let (world_from_piece, normals) = placement.transforms();
        let flags = [(true, MOVED), (placement.turned, TURNED), (self.flat, FLAT), (placement.is_mirrored(), MIRRORED)];
        let flags = flags.iter().filter(|(is_so, _)| *is_so).map(|(_, flag)| flag).sum();
        let [joints, targets, target_count] = [self.joints, self.targets, placement.targets().len()].map(word);
        let [a, b, c] = rows_of_points(world_from_piece, self.middle, placement.origin_m);
        let [d, e, f] = rows_of_normals(normals);
        let words = [
            [flags, self.first_vertex, self.vertices, self.sets],
            [self.influences, self.deltas, joints, targets],
            [target_count, self.vertices_to, self.more_to, 0],
        ];
        [a, b, c, d, e, f, words[0], words[1], words[2]]
    }
}

/// The rows of a transform to the world, from around a middle and to the scene's local space.
fn rows_of_points(world_from_own: &DMat4, middle: Vec3, origin_m: DVec3) -> [[u32; 4]; 3] {
    let there = world_from_own.transform_point3(middle.as_dvec3()) - origin_m;
    let linear = DMat3::from_mat4(*world_from_own);
    [0, 1, 2].map(|row| bits(linear.row(row).extend(there[row])))
}

/// The rows of a transform of normals, whose lengths do not count: scaled, so that f32 has room for them.
fn rows_of_normals(normals: &DMat3) -> [[u32; 4]; 3] {
    let size = normals.to_cols_array().into_iter().fold(0.0, |most: f64, number| most.max(number.abs()));
    let scale = if size > 0.0 && size.is_finite() { 1.0 / size } else { 1.0 };
    [0, 1, 2].map(|row| bits((normals.row(row) * scale).extend(0.0)))
}

/// Four f32, as bits. None is infinite, which would make nothing of a zero.
fn bits(row: DVec4) -> [u32; 4] {
    let most = DVec4::splat(f64::from(f32::MAX));
    row.clamp(-most, most).as_vec4().to_array().map(f32::to_bits)
}

fn set(quads: &mut [[u32; 4]], first: usize, values: impl IntoIterator<Item = [u32; 4]>) {
    quads.iter_mut().skip(first).zip(values).for_each(|(quad, value)| *quad = value);
}
