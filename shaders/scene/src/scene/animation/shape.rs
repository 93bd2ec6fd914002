//! Pieces that change their shape: by the joints of a skin, by morph targets, or by both.

use glam::{DMat4, Vec3, Vec4};
use serde::{Deserialize, Serialize};

use super::track::Track;
use crate::scene::aabb::Aabb;

/// How a piece changes its shape: morph targets first, then joints (glTF 2.0, §3.7.2.2 and §3.7.3).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Shape {
    /// Index into the animation's pieces.
    pub piece: u32,
    /// Transform from the space of the piece's vertices to its node's. Where there are joints, they count instead.
    pub node_from_own: DMat4,
    /// Empty without a skin. Then the node alone says whether the piece is visible.
    pub joints: Vec<Joint>,
    /// How many [`Influence`]s each vertex has.
    pub sets: u32,
    pub targets: Vec<Target>,
    /// Weights of the targets over time.
    pub weights_track: Option<Track>,
    /// Normals are those of the moved triangles. Each three vertices are one.
    pub flat: bool,
}

/// A joint, as one piece sees it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Joint {
    /// The animated node that moves it. `None`: it rests in the world.
    pub node: Option<u32>,
    /// Transform from the space of the piece's vertices to the node's, or to the world's.
    pub node_from_own: DMat4,
    /// Bounds of the vertices that follow it, before morph targets move them, in metres.
    pub bounds: Aabb,
}

/// A morph target of a piece.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Target {
    /// In the file's pose.
    pub weight: f32,
    /// Bounds of how far it moves a vertex, in metres.
    pub bounds: Aabb,
}

/// Four joints that a vertex follows.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Influence {
    /// Indices into the shape's joints.
    pub joints: [u16; 4],
    /// From 0 on. A vertex's weights need not add up to 1.
    pub weights: [f32; 4],
}

/// What one morph target changes of a vertex at weight 1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Delta {
    pub position: Vec3,
    pub normal: Vec3,
    pub tangent: Vec3,
}

/// A piece's vertices in their own space, and what gives them another shape.
#[derive(Debug, Clone, Copy)]
pub struct OwnVertices<'a> {
    pub positions: &'a [Vec3],
    /// Unit vectors.
    pub normals: &'a [Vec3],
    /// Empty if the scene has none.
    pub tangents: &'a [Vec4],
    pub shape: Option<&'a Shape>,
    /// Those of a vertex follow each other.
    pub influences: &'a [Influence],
    /// Target by target, as many as there are vertices.
    pub deltas: &'a [Delta],
}

impl Shape {
    /// Returns how many influences a piece of so many vertices has.
    pub(crate) fn influences(&self, vertices: u32) -> u64 {
        u64::from(self.sets) * u64::from(vertices)
    }

    /// Its track, with the number of its components.
    pub(crate) fn track(&self) -> Option<(&Track, usize)> {
        self.weights_track.as_ref().map(|track| (track, self.targets.len()))
    }

    /// Returns how many changes of a vertex by a target a piece of so many vertices has.
    pub(crate) fn deltas(&self, vertices: u32) -> u64 {
        self.targets.len() as u64 * u64::from(vertices)
    }
}

impl<'a> OwnVertices<'a> {
    /// What joints a vertex follows.
    pub(crate) fn influences_of(&self, vertex: usize) -> &'a [Influence] {
        let sets = self.shape.map_or(0, |shape| shape.sets as usize);
        self.influences.get(vertex * sets..(vertex + 1) * sets).unwrap_or_default()
    }

    /// What a target changes of a vertex.
    pub(crate) fn delta(&self, target: usize, vertex: usize) -> Delta {
        self.deltas.get(target * self.positions.len() + vertex).copied().unwrap_or_default()
    }
}

impl Influence {
    /// The joints that count, with their weights.
    pub fn each(&self) -> impl Iterator<Item = (usize, f64)> + use<> {
        let pairs = self.joints.into_iter().zip(self.weights);
        pairs.filter(|(_, weight)| *weight != 0.0).map(|(joint, weight)| (usize::from(joint), f64::from(weight)))
    }
}

/// Returns a vertex's transform: the mean of its joints', by weight. `None` if it follows none.
pub(crate) fn blended(joints: &[DMat4], influences: &[Influence]) -> Option<DMat4> {
    let (mut sum, mut weights) = (DMat4::ZERO, 0.0);
    for (joint, weight) in influences.iter().flat_map(Influence::each) {
        sum += *joints.get(joint)? * weight;
        weights += weight;
    }
    (weights > 0.0).then(|| sum * (1.0 / weights))
}
