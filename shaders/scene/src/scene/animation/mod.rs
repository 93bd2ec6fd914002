//! What moves in a scene: nodes, pieces of geometry, lights and cameras (`docs/living.md`).
//!
//! [`Scene::moment`](crate::Scene::moment) evaluates it. Everything that this does not name rests.

mod shape;
mod track;

use glam::{DMat4, DQuat, DVec3, Vec3, Vec4};
use serde::{Deserialize, Serialize};

pub(crate) use shape::blended;
pub use shape::{Delta, Influence, Joint, OwnVertices, Shape, Target};
pub use track::{Interpolation, Track};

use super::aabb::Aabb;

/// What moves. Only what has a part in the picture is kept.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Animation {
    /// Name in the file, or empty. Of several that are shown together, the first one's.
    pub name: String,
    /// Parents before children.
    pub nodes: Vec<AnimatedNode>,
    /// In the order of their vertices.
    pub pieces: Vec<Piece>,
    /// Positions of the pieces' vertices, in metres, piece by piece: in the space of the node, or of the shape.
    #[serde(skip)]
    pub positions: Vec<Vec3>,
    /// Their unit shading normals.
    #[serde(skip)]
    pub normals: Vec<Vec3>,
    /// Their tangents, as [`Scene::tangents`](crate::Scene::tangents). Empty if the scene has none.
    #[serde(skip)]
    pub tangents: Vec<Vec4>,
    /// Of the pieces that are not rigid, in their order.
    pub shapes: Vec<Shape>,
    /// The joints that their vertices follow, shape by shape, vertex by vertex.
    #[serde(skip)]
    pub influences: Vec<Influence>,
    /// What morph targets change of their vertices, shape by shape, target by target.
    #[serde(skip)]
    pub deltas: Vec<Delta>,
    pub lights: Vec<AnimatedLight>,
    pub cameras: Vec<AnimatedCamera>,
}

/// A node whose transform or visibility changes. What has no track keeps the file's value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AnimatedNode {
    /// Name in the file, or empty.
    pub name: String,
    /// Whether a person may move it: see [`Edits`](crate::Edits).
    pub editable: bool,
    /// Index of the nearest animated node above.
    pub parent: Option<u32>,
    /// Transform from the file's parent of this node to `parent`'s space, or to the world's.
    pub above: DMat4,
    pub translation_m: DVec3,
    /// A unit quaternion.
    pub rotation: DQuat,
    pub scale: DVec3,
    pub visible: bool,
    pub translation_track: Option<Track>,
    pub rotation_track: Option<Track>,
    pub scale_track: Option<Track>,
    /// Not 0: visible.
    pub visible_track: Option<Track>,
}

/// A node that stands where its parent does.
impl Default for AnimatedNode {
    fn default() -> Self {
        Self {
            name: String::new(),
            editable: false,
            parent: None,
            above: DMat4::IDENTITY,
            translation_m: DVec3::ZERO,
            rotation: DQuat::IDENTITY,
            scale: DVec3::ONE,
            visible: true,
            translation_track: None,
            rotation_track: None,
            scale_track: None,
            visible_track: None,
        }
    }
}

/// A run of vertices that move with a node, or as their [`Shape`] says. A triangle's vertices all belong to one piece,
/// or all rest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Piece {
    pub node: u32,
    pub first_vertex: u32,
    pub vertices: u32,
    /// Bounds of the vertices in their own space, in metres.
    pub bounds: Aabb,
    /// The file's pose mirrors the piece: its triangles' corners are swapped.
    pub mirrored: bool,
}

/// A light that moves or changes.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct AnimatedLight {
    /// Index into the scene's lights.
    pub light: u32,
    pub place: Option<Place>,
    pub color_track: Option<Track>,
    pub intensity_track: Option<Track>,
    pub range_track: Option<Track>,
    pub inner_cone_track: Option<Track>,
    pub outer_cone_track: Option<Track>,
}

/// A camera that moves or zooms.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AnimatedCamera {
    /// Index into the scene's cameras.
    pub camera: u32,
    pub place: Option<Place>,
    pub yfov_track: Option<Track>,
}

/// Where something hangs on an animated node.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Place {
    pub node: u32,
    /// Transform from its own space to the node's.
    pub node_from_own: DMat4,
}

impl Animation {
    /// Returns the piece of a vertex. `None` if it rests.
    #[must_use]
    pub fn piece_of(&self, vertex: u32) -> Option<usize> {
        let after = self.pieces.partition_point(|piece| piece.first_vertex <= vertex);
        let at = after.checked_sub(1)?;
        let piece = self.pieces.get(at)?;
        (vertex - piece.first_vertex < piece.vertices).then_some(at)
    }

    /// Returns where each piece's vertices begin in [`Self::positions`].
    #[must_use]
    pub fn first_positions(&self) -> Vec<usize> {
        let mut end = 0;
        let mut first = |piece: &Piece| {
            end += piece.vertices as usize;
            end - piece.vertices as usize
        };
        self.pieces.iter().map(&mut first).collect()
    }

    /// Returns the shape of a piece. `None` if it is rigid.
    #[must_use]
    pub fn shape_of(&self, piece: usize) -> Option<&Shape> {
        let at = self.shapes.binary_search_by_key(&piece, |shape| shape.piece as usize).ok()?;
        self.shapes.get(at)
    }

    /// Returns the vertices of each piece. Lists that are too short give short pieces.
    #[must_use]
    pub fn own_vertices(&self) -> Vec<OwnVertices<'_>> {
        let (mut positions, mut normals, mut tangents) = (&*self.positions, &*self.normals, &*self.tangents);
        let (mut influences, mut deltas) = (&*self.influences, &*self.deltas);
        let mut shapes = self.shapes.iter().peekable();
        let mut own = |(number, piece): (usize, &Piece)| {
            let shape = shapes.next_if(|shape| shape.piece as usize == number);
            let vertices = piece.vertices as usize;
            OwnVertices {
                positions: take(&mut positions, vertices),
                normals: take(&mut normals, vertices),
                tangents: take(&mut tangents, vertices),
                shape,
                influences: take(&mut influences, shape.map_or(0, |shape| shape.sets as usize) * vertices),
                deltas: take(&mut deltas, shape.map_or(0, |shape| shape.targets.len()) * vertices),
            }
        };
        self.pieces.iter().enumerate().map(&mut own).collect()
    }

    /// Returns whether nothing moves or may be moved.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        !self.has_parts() && self.cameras.is_empty()
    }

    /// Returns whether more than cameras may move.
    #[must_use]
    pub fn has_parts(&self) -> bool {
        !self.pieces.is_empty() || !self.lights.is_empty()
    }

    /// Returns whether more than cameras changes with time, so that a camera that stands still sees it.
    #[must_use]
    pub fn moves_scene(&self) -> bool {
        let nodes = self.nodes.iter().any(|node| node.tracks().next().is_some());
        let lights = self.lights.iter().any(|light| light.tracks().next().is_some());
        self.has_parts() && (nodes || lights || self.shapes.iter().any(|shape| shape.weights_track.is_some()))
    }
}

/// Takes the first elements of a list, or all.
fn take<'a, T>(list: &mut &'a [T], count: usize) -> &'a [T] {
    let (taken, left) = list.split_at(count.min(list.len()));
    *list = left;
    taken
}

impl AnimatedNode {
    /// Its tracks, with the number of components of each.
    pub(crate) fn tracks(&self) -> impl Iterator<Item = (&Track, usize)> {
        let Self { translation_track, rotation_track, scale_track, visible_track, .. } = self;
        let tracks = [(translation_track, 3), (rotation_track, 4), (scale_track, 3), (visible_track, 1)];
        tracks.into_iter().filter_map(|(track, width)| track.as_ref().map(|track| (track, width)))
    }
}

impl AnimatedLight {
    /// Its tracks, with the number of components of each.
    pub(crate) fn tracks(&self) -> impl Iterator<Item = (&Track, usize)> {
        let Self { color_track, intensity_track, range_track, inner_cone_track, outer_cone_track, .. } = self;
        let single = [intensity_track, range_track, inner_cone_track, outer_cone_track].map(|track| (track, 1));
        let tracks = std::iter::once((color_track, 3)).chain(single);
        tracks.filter_map(|(track, width)| track.as_ref().map(|track| (track, width)))
    }
}
