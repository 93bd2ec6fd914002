//! What moves, on the device: every slot has a region of its own behind what rests, in the buffers of the hierarchy, of
//! the triangles and of the lights. A region holds the scene's movers at the time of the slot's frame, and the node
//! where that frame's rays begin. So frames of different times may be under way at once, in any number of parts, and
//! the kernels are those of scenes in which nothing moves. Where nothing moves a region has only lights, for those that
//! are edited.

use bytemuck::Zeroable as _;
use glam::Vec3;
use gnomon_scene::{OwnVertices, Placement, Scene, SceneAt};
use gnomon_shaders::host::{TracedLight, TracedTriangle};
use obvhs::cwbvh::node::CwBvhNode;
use rayon::iter::{IndexedParallelIterator, IntoParallelIterator, IntoParallelRefMutIterator, ParallelIterator};

use super::{
    geometry::{Geometry, PieceGeometry, PieceTriangle, plane_normal},
    kernels::Traversal,
    posing::{Firsts, Placed, Posing},
    refit::{Moved, Root, join, most_joined, refit},
    regions::{RegionBuffers, Sizes},
    ring::SLOTS,
};
use crate::visibility::hierarchy::moving::{Bounds, NOTHING, joined};

/// Vertices or triangles that a thread takes at once.
const RUN: usize = 512;

/// What the kernels must know of a slot's region: see [`gnomon_shaders::host::TracedView`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Posed {
    pub(super) root: u32,
    pub(super) nodes: u32,
    pub(super) first_light: u32,
    /// Triangles that are shown.
    pub(super) triangles: u32,
    /// The device has pieces to move.
    pub(super) by_device: bool,
}

#[derive(Debug)]
pub(super) struct Movers {
    traversal: Traversal,
    /// The scene's animation, lights and origin, without geometry.
    stage: Scene,
    pieces: Vec<PieceGeometry>,
    /// The hierarchy of what rests. `None` if nothing that rests stops rays, or the adapter has its own.
    resting: Option<Root>,
    /// What rests.
    before: Sizes,
    /// A slot's region.
    region: Sizes,
    scratch: Scratch,
    /// What lies in each slot's region.
    posed: [Option<Posed>; SLOTS],
    /// Which state of the scene that is.
    scenes: [SceneAt; SLOTS],
}

/// A region's content before it is uploaded, and what is needed to make it.
#[derive(Debug, Default)]
struct Scratch {
    nodes: Vec<CwBvhNode>,
    triangles: Vec<TracedTriangle>,
    normals: Vec<[Vec3; 4]>,
    vertices: Vec<(Vec3, Vec3)>,
    bounds: Vec<Bounds>,
}

impl Movers {
    /// Takes the pieces of `geometry`.
    pub(super) fn new(scene: &Scene, geometry: &mut Geometry, traversal: Traversal) -> Self {
        let pieces = std::mem::take(&mut geometry.pieces);
        let sum = |of: fn(&PieceGeometry) -> usize| pieces.iter().map(of).sum::<usize>();
        let (nodes, triangles) = (sum(|piece| piece.nodes.len()), sum(|piece| piece.triangles.len()));
        let top = if nodes > 0 { most_joined(pieces.len()) } else { 0 };
        let region = Sizes { nodes: top + nodes, triangles, lights: scene.lights.len() };
        let corners = geometry.triangles.iter().flat_map(|triangle| [triangle.a, triangle.b, triangle.c]);
        let bounds = corners.map(Vec3::from_array).fold(NOTHING, |bounds, corner| joined(bounds, [corner; 2]));
        let (animation, lights, origin_m) = (scene.animation.clone(), scene.lights.clone(), scene.origin_m);
        Self {
            traversal,
            stage: Scene { animation, lights, origin_m, ..Scene::default() },
            resting: geometry.nodes.first().map(|node| Root { node: *node, bounds }),
            before: Sizes {
                nodes: geometry.nodes.len(),
                triangles: geometry.triangles.len(),
                lights: scene.lights.len(),
            },
            region,
            scratch: Scratch {
                nodes: vec![CwBvhNode::zeroed(); region.nodes],
                triangles: vec![TracedTriangle::zeroed(); triangles],
                normals: vec![[Vec3::ZERO; 4]; triangles],
                vertices: vec![(Vec3::ZERO, Vec3::ZERO); sum(|piece| piece.vertices.len())],
                bounds: vec![NOTHING; nodes],
            },
            pieces,
            posed: [None; SLOTS],
            scenes: Default::default(),
        }
    }

    /// Room behind what rests: all regions.
    pub(super) fn room(&self) -> Sizes {
        let Sizes { nodes, triangles, lights } = self.region;
        Sizes { nodes: nodes * SLOTS, triangles: triangles * SLOTS, lights: lights * SLOTS }
    }

    pub(super) fn room_bytes(&self) -> u64 {
        self.room().bytes()
    }

    /// All pieces.
    pub(super) fn pieces(&self) -> &[PieceGeometry] {
        &self.pieces
    }

    /// Most triangles that move.
    pub(super) fn most_triangles(&self) -> usize {
        self.region.triangles
    }

    /// Returns whether this state of the scene is not what the file has.
    pub(super) fn needs_region(&self, scene: &SceneAt) -> bool {
        self.stage.animation.is_some() || !scene.edits.is_empty()
    }

    /// Returns what is in a slot's region if that is this state of the scene.
    pub(super) fn at(&self, slot: usize, scene: &SceneAt) -> Option<Posed> {
        self.posed.get(slot).copied().flatten().filter(|_| self.scenes.get(slot) == Some(scene))
    }

    /// Notes what the device will have in a slot's region, once it has done all that is submitted.
    pub(super) fn set(&mut self, slot: usize, posed: Option<Posed>) {
        if let Some(place) = self.posed.get_mut(slot) {
            *place = posed;
        }
    }

    /// The triangles of the region that was posed last, as many as are shown.
    pub(super) fn triangles(&self, posed: Posed) -> &[TracedTriangle] {
        self.scratch.triangles.get(..posed.triangles as usize).unwrap_or_default()
    }

    /// Puts what moves or was edited where it is, and writes it into a slot's region, or what `posing` needs to do so.
    /// No frame of the slot may be under way. Runs on the current rayon pool.
    pub(super) fn pose(
        &mut self,
        queue: &wgpu::Queue,
        buffers: &RegionBuffers,
        posing: Option<&Posing>,
        slot: usize,
        scene: &SceneAt,
    ) -> Posed {
        let Self { traversal, stage, pieces, resting, before, region, scratch, scenes, .. } = self;
        if let Some(known) = scenes.get_mut(slot) {
            known.clone_from(scene);
        }
        let moment = stage.moment(scene);
        let (placements, lights) = moment.map(|moment| (moment.pieces, moment.lights)).unwrap_or_default();
        let first = |before: usize, region: usize| before + slot * region;
        let first_node = first(before.nodes, region.nodes);
        let first_triangle = first(before.triangles, region.triangles);
        let first_light = first(before.lights, region.lights);

        let animation = stage.animation.as_ref();
        let own_vertices = animation.map(|animation| animation.own_vertices()).unwrap_or_default();
        let top = most_joined(pieces.len()).min(scratch.nodes.len());
        let (top, blocks) = scratch.nodes.split_at_mut(top);
        let mut left = Left {
            nodes: blocks,
            triangles: &mut scratch.triangles,
            normals: &mut scratch.normals,
            vertices: &mut scratch.vertices,
            bounds: &mut scratch.bounds,
        };
        let (mut nodes, mut triangles) = (top.len(), 0);
        let mut take = |piece: &PieceGeometry| {
            let firsts = Firsts { node: index(first_node + nodes), triangle: index(first_triangle + triangles) };
            nodes += piece.nodes.len();
            triangles += piece.triangles.len();
            firsts
        };
        // What the host moves lies in front, so that it is uploaded in one piece.
        let (mut tasks, mut posed) = (Vec::with_capacity(pieces.len()), Vec::new());
        for (number, ((piece, own), placement)) in pieces.iter().zip(own_vertices).zip(&placements).enumerate() {
            let Some(placement) = placement.as_ref().filter(|_| !piece.triangles.is_empty()) else { continue };
            if let Some(own) = posing.and_then(|posing| posing.takes(number, placement)) {
                posed.push(Placed { piece: number, placement, own, firsts: Firsts::default(), root: 0 });
            } else {
                tasks.push(Task { piece, placement, own, firsts: take(piece), room: left.take(piece) });
            }
        }
        for placed in &mut posed {
            placed.firsts = take(&pieces[placed.piece]);
        }
        let uploaded = tasks.iter().map(|task| task.piece).fold(Sizes::default(), |sum, piece| Sizes {
            nodes: sum.nodes + piece.nodes.len(),
            triangles: sum.triangles + piece.triangles.len(),
            lights: 0,
        });
        let roots: Vec<Root> = tasks.into_par_iter().map(Task::run).collect();
        // What has no area has no bounds, and nothing hits it.
        let mut roots: Vec<Root> =
            roots.into_iter().filter(|root| root.bounds[0].cmple(root.bounds[1]).all()).collect();
        let moved_by_host = roots.len();
        roots.extend(posed.iter().map(|placed| Root { node: CwBvhNode::zeroed(), bounds: around(placed.placement) }));

        write(queue, &buffers.triangles, first_triangle, &scratch.triangles[..uploaded.triangles]);
        write(queue, &buffers.normals, first_triangle, &scratch.normals[..uploaded.triangles]);
        let lights: Vec<TracedLight> = lights.iter().map(TracedLight::new).collect();
        write(queue, &buffers.lights, first_light, &lights);
        let (root, all_nodes) = match traversal {
            Traversal::Hierarchy if roots.is_empty() => (0, before.nodes),
            Traversal::Hierarchy => {
                let places = join(resting.as_ref(), &roots, index(first_node), top);
                for (placed, place) in posed.iter_mut().zip(places.into_iter().skip(moved_by_host)) {
                    placed.root = index(first_node + place);
                }
                if let Some(posing) = posing {
                    posing.write(queue, slot, &posed);
                }
                let uploaded = top.len() + uploaded.nodes;
                write(queue, &buffers.nodes, first_node, &scratch.nodes[..uploaded]);
                (first_node, before.nodes + nodes)
            }
            Traversal::RayQuery => (first_triangle, before.triangles + triangles),
        };
        Posed {
            root: index(root),
            nodes: index(all_nodes),
            first_light: index(first_light),
            triangles: index(triangles),
            by_device: !posed.is_empty(),
        }
    }
}

/// A piece's bounds. They were rounded to f32 like its vertices, and grow by one unit for the roundings of f64.
fn around(placement: &Placement) -> Bounds {
    let [min, max] = [placement.bounds.min, placement.bounds.max].map(|corner| corner.to_array());
    [Vec3::from_array(min.map(f32::next_down)), Vec3::from_array(max.map(f32::next_up))]
}

/// The rest of the scratch memory.
struct Left<'a> {
    nodes: &'a mut [CwBvhNode],
    triangles: &'a mut [TracedTriangle],
    normals: &'a mut [[Vec3; 4]],
    vertices: &'a mut [(Vec3, Vec3)],
    bounds: &'a mut [Bounds],
}

impl<'a> Left<'a> {
    /// Takes what a piece needs.
    fn take(&mut self, piece: &PieceGeometry) -> Self {
        let (nodes, triangles) = (piece.nodes.len(), piece.triangles.len());
        Left {
            nodes: split_off(&mut self.nodes, nodes),
            triangles: split_off(&mut self.triangles, triangles),
            normals: split_off(&mut self.normals, triangles),
            vertices: split_off(&mut self.vertices, piece.vertices.len()),
            bounds: split_off(&mut self.bounds, nodes),
        }
    }
}

fn split_off<'a, T>(list: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    list.split_off_mut(..count).unwrap_or_default()
}

/// A piece to move.
struct Task<'a> {
    piece: &'a PieceGeometry,
    placement: &'a Placement,
    own: OwnVertices<'a>,
    /// In the scene's buffers.
    firsts: Firsts,
    room: Left<'a>,
}

impl Task<'_> {
    fn run(self) -> Root {
        let Self { piece, placement, own, firsts, room } = self;
        let Left { nodes, triangles, normals: triangle_normals, vertices, bounds } = room;
        let moved = vertices.par_iter_mut().with_min_len(RUN).enumerate();
        moved.for_each(|(at, vertex)| *vertex = placement.vertex(&own, at));
        let vertices = &*vertices;
        let placed = triangles.par_iter_mut().zip(triangle_normals.par_iter_mut()).zip(&piece.triangles);
        placed.with_min_len(RUN).for_each(|((triangle, normals), of)| {
            (*triangle, *normals) = place(of, placement, vertices);
        });
        let moved = Moved { triangles, normals: triangle_normals };
        refit(&piece.nodes, &moved, (firsts.node, firsts.triangle), nodes, bounds)
    }
}

fn place(of: &PieceTriangle, placement: &Placement, vertices: &[(Vec3, Vec3)]) -> (TracedTriangle, [Vec3; 4]) {
    let [a, b, c] = placement.corners(of.corners.map(|corner| vertices[corner as usize]));
    let first_uv = of.first_uvs[usize::from(placement.turned)];
    let plane = plane_normal([a.0, b.0, c.0]);
    let [pa, pb, pc] = [a.0, b.0, c.0].map(|corner| corner.to_array());
    (TracedTriangle { a: pa, kind: of.kind, b: pb, first_uv, c: pc, unused: 0 }, [a.1, b.1, c.1, plane])
}

fn write<T: bytemuck::Pod>(queue: &wgpu::Queue, buffer: &wgpu::Buffer, first: usize, entries: &[T]) {
    if !entries.is_empty() {
        queue.write_buffer(buffer, (first * size_of::<T>()) as u64, bytemuck::cast_slice(entries));
    }
}

/// The buffers' entries are fewer than 2³².
fn index(place: usize) -> u32 {
    u32::try_from(place).unwrap_or(u32::MAX)
}
