//! Vertices of what moves in their own spaces, and their shapes, as `pose.wgsl` reads them.

use std::{collections::HashMap, ops::Range};

use glam::{DVec4, Vec3, Vec4};
use gnomon_scene::{Aabb, Animation, Influence, OwnVertices, Piece};

use crate::render::vertex::{MoreOfVertex, Vertex};

/// Twins: `pose.wgsl`.
const INFLUENCE_WORDS: usize = 6;
const JOINT_QUADS: usize = 3;
const _: () = assert!(size_of::<Vertex>() == 7 * size_of::<u32>() && size_of::<MoreOfVertex>() == 6 * size_of::<u32>());

/// What a binding holds.
#[derive(Debug, Clone, Copy)]
pub(super) struct Room {
    pub(super) bytes: u64,
    /// A binding of the scene's vertices begins at multiples of this.
    pub(super) aligned: u32,
    pub(super) tangents: bool,
}

impl Room {
    fn delta_words(self) -> usize {
        if self.tangents { 9 } else { 6 }
    }

    /// Words of a vertex's shape.
    fn shape_words(self, own: &OwnVertices<'_>) -> usize {
        let (sets, targets) = own.shape.map_or((0, 0), |shape| (shape.sets as usize, shape.targets.len()));
        sets * INFLUENCE_WORDS + targets * self.delta_words()
    }

    /// Most vertices of a piece that surely find room in an empty part: whole triangles.
    fn most_vertices(self, own: &OwnVertices<'_>) -> usize {
        let bytes = size_of::<OwnVertex>().max(self.shape_words(own) * size_of::<u32>());
        let most = usize::try_from(self.bytes / bytes as u64).unwrap_or(usize::MAX);
        let most = most.saturating_sub(self.aligned as usize);
        (most - most % 3).max(3)
    }
}

/// Vertices of a piece that are moved together: all, unless a binding is too small for them.
pub(super) struct OwnRun<'a> {
    piece: usize,
    middle: Vec3,
    own: OwnVertices<'a>,
    of_piece: Range<usize>,
    /// In the scene.
    first_vertex: u32,
}

/// Returns the runs of all pieces.
pub(super) fn runs(animation: &Animation, room: Room) -> Vec<OwnRun<'_>> {
    let pieces = animation.pieces.iter().zip(animation.own_vertices()).zip(middles(animation));
    let mut runs = Vec::new();
    for (piece, ((of, own), middle)) in pieces.enumerate() {
        let (all, most) = (own.positions.len(), room.most_vertices(&own));
        runs.extend((0..all).step_by(most).map(|first| {
            let of_piece = first..all.min(first.saturating_add(most));
            OwnRun { piece, middle, own, of_piece, first_vertex: of.first_vertex + word(first) }
        }));
    }
    runs
}

/// The middle of all that moves as each piece does, in f32: with one node, or as the joints of skins say.
pub(super) fn middles(animation: &Animation) -> Vec<Vec3> {
    let mut all: HashMap<Option<(u32, bool)>, Aabb> = HashMap::new();
    let key = |number: usize, piece: &Piece| {
        let shape = animation.shape_of(number);
        let follows_joints = shape.is_some_and(|shape| !shape.joints.is_empty());
        (!follows_joints).then_some((piece.node, shape.is_some()))
    };
    for (number, piece) in animation.pieces.iter().enumerate() {
        let bounds = all.entry(key(number, piece)).or_insert(piece.bounds);
        *bounds = Aabb { min: bounds.min.min(piece.bounds.min), max: bounds.max.max(piece.bounds.max) };
    }
    let middle = |(number, piece)| all.get(&key(number, piece)).map_or(Vec3::ZERO, |it| it.min.midpoint(it.max));
    animation.pieces.iter().enumerate().map(middle).collect()
}

/// Twin: `OwnVertex` in `pose.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
pub(super) struct OwnVertex {
    position: Vec3,
    run: u32,
    normal: Vec3,
    unused: u32,
}

/// As many vertices as the adapter's bindings hold, and their shapes.
#[derive(Debug, Default)]
pub(super) struct Own {
    pub(super) vertices: Vec<OwnVertex>,
    pub(super) tangents: Vec<Vec4>,
    pub(super) shapes: Vec<u32>,
    /// The scene's vertices that are written.
    pub(super) scene: Range<u64>,
}

/// What does not change of a run: see `Placed` in `pose.wgsl`.
#[derive(Debug)]
pub(super) struct Run {
    pub(super) piece: usize,
    /// In the piece's space. Vertices are kept as they lie from there, since f32 has more digits for what is small.
    /// Pieces that move alike share it: where they meet, their vertices stay together.
    pub(super) middle: Vec3,
    pub(super) first_vertex: u32,
    pub(super) vertices: u32,
    pub(super) sets: u32,
    pub(super) influences: u32,
    pub(super) deltas: u32,
    pub(super) joints: usize,
    pub(super) targets: usize,
    pub(super) flat: bool,
    pub(super) vertices_to: u32,
    pub(super) more_to: u32,
}

impl Own {
    /// The scene's vertices that are written once a run is added, from a place where a binding may begin.
    fn scene_with(&self, run: &OwnRun<'_>, room: Room) -> Range<u64> {
        let first = u64::from(run.first_vertex - run.first_vertex % room.aligned);
        let first = if self.vertices.is_empty() { first } else { self.scene.start };
        first..u64::from(run.first_vertex) + run.of_piece.len() as u64
    }

    /// Whether a run finds room in all bindings.
    pub(super) fn fits(&self, run: &OwnRun<'_>, room: Room) -> bool {
        let (scene, vertices) = (self.scene_with(run, room), run.of_piece.len());
        let own = (self.vertices.len() + vertices) * size_of::<OwnVertex>();
        let shapes = (self.shapes.len() + vertices * room.shape_words(&run.own)) * size_of::<u32>();
        let written = (scene.end - scene.start) * size_of::<Vertex>() as u64;
        written.max(own.max(shapes) as u64) <= room.bytes
    }

    /// Adds a run by its number. Its joints and targets come after so many quads of the state.
    pub(super) fn add(&mut self, number: u32, run: &OwnRun<'_>, room: Room, quads: &mut usize) -> Run {
        self.scene = self.scene_with(run, room);
        let OwnRun { piece, middle, own, of_piece, .. } = run;
        let first_vertex = word(self.vertices.len());
        for (position, normal) in own.positions.iter().zip(own.normals).take(of_piece.end).skip(of_piece.start) {
            let position = (position.as_dvec3() - middle.as_dvec3()).as_vec3();
            self.vertices.push(OwnVertex { position, run: number, normal: *normal, unused: 0 });
        }
        self.tangents.extend_from_slice(own.tangents.get(of_piece.clone()).unwrap_or_default());
        let sets = own.shape.map_or(0, |shape| shape.sets);
        let influences = word(self.shapes.len());
        let of_run = of_piece.start * sets as usize..of_piece.end * sets as usize;
        for of_vertex in own.influences.get(of_run).unwrap_or_default().chunks(sets.max(1) as usize) {
            let all: f64 = of_vertex.iter().flat_map(Influence::each).map(|(_, weight)| weight).sum();
            for influence in of_vertex {
                let [a, b, c, d] = influence.joints.map(u32::from);
                let shares = DVec4::from_array(influence.weights.map(f64::from)) / all.max(f64::MIN_POSITIVE);
                self.shapes.extend([a | b << 16, c | d << 16]);
                self.shapes.extend(shares.as_vec4().to_array().map(f32::to_bits));
            }
        }
        let deltas = word(self.shapes.len());
        for of_target in own.deltas.chunks(own.positions.len().max(1)) {
            for delta in of_target.get(of_piece.clone()).unwrap_or_default() {
                let changes = [delta.position, delta.normal, delta.tangent].map(|change| change.to_array());
                let words = changes.as_flattened().iter().take(room.delta_words());
                self.shapes.extend(words.map(|number| number.to_bits()));
            }
        }
        let joints = *quads;
        let targets = joints + own.shape.map_or(0, |shape| shape.joints.len()) * JOINT_QUADS;
        *quads = targets + own.shape.map_or(0, |shape| shape.targets.len());
        // All of a part lies within one binding, whose words can be counted.
        let words = |stride: usize| {
            let words = (u64::from(run.first_vertex) - self.scene.start) * (stride / size_of::<u32>()) as u64;
            u32::try_from(words).unwrap_or(u32::MAX)
        };
        Run {
            piece: *piece,
            middle: *middle,
            first_vertex,
            vertices: word(of_piece.len()),
            sets,
            influences,
            deltas,
            joints,
            targets,
            flat: own.shape.is_some_and(|shape| shape.flat),
            vertices_to: words(size_of::<Vertex>()),
            more_to: words(size_of::<MoreOfVertex>()),
        }
    }
}

/// Buffers have fewer than 2³² words.
pub(super) fn word(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::tests::{living::living, shapes::blade};

    /// Where bindings are small, each vertex is in one run of one part, and no part is larger than a binding.
    #[test]
    fn small_bindings_take_what_moves_in_parts() {
        for (scene, bytes, least_parts) in [(living(false), 500, 2), (blade(), 600, 4), (blade(), 1 << 27, 1)] {
            let animation = scene.animation.as_deref().unwrap();
            let room = Room { bytes, aligned: 4, tangents: false };
            let owns = runs(animation, room);
            let (mut parts, mut part, mut quads) = (Vec::new(), Own::default(), 0);
            for (number, own) in (0..).zip(&owns) {
                if !part.fits(own, room) {
                    parts.push(std::mem::take(&mut part));
                }
                assert!(part.fits(own, room), "{bytes}");
                let run = part.add(number, own, room, &mut quads);
                assert_eq!(u64::from(run.vertices_to), (u64::from(own.first_vertex) - part.scene.start) * 7);
                assert!(!run.flat || run.vertices % 3 == 0);
            }
            parts.push(part);
            assert!(parts.len() >= least_parts, "{}", parts.len());
            assert!(parts.iter().all(|part| part.scene.start % 4 == 0));
            let vertices: usize = parts.iter().map(|part| part.vertices.len()).sum();
            assert_eq!(vertices, animation.positions.len());
        }
    }
}
