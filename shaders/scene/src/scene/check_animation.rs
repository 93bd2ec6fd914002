//! Checks an animation's guarantees against its scene.

use glam::Vec4;

use super::{
    aabb::Aabb,
    animation::{AnimatedLight, AnimatedNode, Animation, Place, Shape, Track},
    check::{CheckError, all, at_most, ensure, is_unit},
    normals::triangle_normal,
    types::Scene,
};
use crate::limits::{MAX_MOVING, MAX_NAME_BYTES, MAX_TRACK_VALUES, in_reach};

/// Largest factor of a matrix or a scale. Products along 1024 nodes may overflow; what they place is not shown then.
pub(super) const MAX_FACTOR: f64 = 1e30;

impl Scene {
    /// Checks what moves.
    pub(crate) fn check_animation(&self) -> Result<(), CheckError> {
        self.animation.as_ref().map_or(Ok(()), |animation| animation.check(self))
    }
}

impl Animation {
    /// Errors at the first guarantee that is broken.
    fn check(&self, scene: &Scene) -> Result<(), CheckError> {
        let [nodes, pieces] = [self.nodes.len(), self.pieces.len()];
        at_most("animated nodes", nodes, MAX_MOVING)?;
        at_most("moving pieces", pieces, MAX_MOVING)?;
        ensure(self.name.len() <= MAX_NAME_BYTES, || "the animation's name is too long".to_owned())?;
        ensure(!self.is_empty(), || "an animation of nothing".to_owned())?;
        for (index, node) in self.nodes.iter().enumerate() {
            ensure(is_legal_node(node, index), || format!("animated node {index} is {node:?}"))?;
        }
        let lights = self.lights.iter().flat_map(AnimatedLight::tracks);
        let zooms = self.cameras.iter().filter_map(|camera| camera.yfov_track.as_ref()).map(|track| (track, 1));
        let weights = self.shapes.iter().filter_map(Shape::track);
        let tracks = self.nodes.iter().flat_map(AnimatedNode::tracks).chain(lights).chain(zooms).chain(weights);
        let mut values = 0;
        for (track, width) in tracks {
            ensure(is_legal_track(track, width), || "a track of an animation is broken".to_owned())?;
            values += track.times_s.len() + track.values.len();
        }
        at_most("times and values of tracks", values, MAX_TRACK_VALUES)?;
        let places = self.lights.iter().map(|light| light.place).chain(self.cameras.iter().map(|camera| camera.place));
        let legal = places.flatten().all(|place| is_legal_place(&place, nodes));
        ensure(legal, || "a light or a camera hangs on an animated node that is not there".to_owned())?;
        let ascending = |indices: Vec<u32>, count: usize| {
            indices.is_sorted_by(|one, other| one < other) && indices.last().is_none_or(|last| (*last as usize) < count)
        };
        let legal = ascending(self.lights.iter().map(|light| light.light).collect(), scene.lights.len())
            && ascending(self.cameras.iter().map(|camera| camera.camera).collect(), scene.cameras.len());
        ensure(legal, || "an animation names a light or a camera that is not there, or twice".to_owned())?;
        self.check_pieces(scene)
    }

    fn check_pieces(&self, scene: &Scene) -> Result<(), CheckError> {
        let mut next = 0_u64;
        for (index, piece) in self.pieces.iter().enumerate() {
            let first = u64::from(piece.first_vertex);
            let follows = first >= next && piece.vertices > 0 && (piece.node as usize) < self.nodes.len();
            next = first + u64::from(piece.vertices);
            let legal = follows && next <= scene.positions.len() as u64;
            ensure(legal, || format!("moving piece {index} is {piece:?}"))?;
        }
        let vertices = self.pieces.iter().map(|piece| piece.vertices as usize).sum::<usize>();
        let tangents = if scene.tangents.is_empty() { 0 } else { vertices };
        let counts = [self.positions.len(), self.normals.len(), self.tangents.len()];
        ensure(counts == [vertices, vertices, tangents], || {
            format!("{counts:?} positions, normals and tangents of {vertices} moving vertices")
        })?;
        all("moving position", &self.positions, |position| in_reach(position.as_dvec3()))?;
        all("moving normal", &self.normals, |normal| is_unit(*normal))?;
        all("moving tangent", &self.tangents, |tangent| {
            *tangent == Vec4::ZERO || (is_unit(tangent.truncate()) && tangent.w.abs() == 1.0)
        })?;
        let mut first = 0;
        for (index, piece) in self.pieces.iter().enumerate() {
            let positions = self.positions.get(first..first + piece.vertices as usize).unwrap_or_default();
            first += positions.len();
            let legal = Aabb::around(positions) == piece.bounds;
            ensure(legal, || format!("moving piece {index} has other bounds than it says"))?;
        }
        self.check_shapes()?;
        let firsts = self.first_positions();
        all("triangle", &scene.triangles, |corners| {
            let [a, b, c] = corners.map(|corner| self.piece_of(corner));
            let Some(piece) = a.filter(|_| a == b && a == c) else { return a == b && a == c };
            // Another shape may give it an area.
            if self.shape_of(piece).is_some() {
                return true;
            }
            let corner = |corner: u32| {
                let (piece, first) = (self.pieces.get(piece)?, firsts.get(piece)?);
                self.positions.get(first + (corner - piece.first_vertex) as usize).copied()
            };
            let [a, b, c] = corners.map(corner);
            a.zip(b).zip(c).is_some_and(|((a, b), c)| triangle_normal(a, b, c).is_some())
        })
    }
}

fn is_legal_node(node: &AnimatedNode, index: usize) -> bool {
    let numbers = [node.translation_m, node.scale];
    node.name.len() <= MAX_NAME_BYTES
        && node.parent.is_none_or(|parent| (parent as usize) < index)
        && node.above.to_cols_array().iter().all(|v| v.abs() <= MAX_FACTOR)
        && numbers.iter().all(|vector| vector.to_array().iter().all(|v| v.abs() <= MAX_FACTOR))
        && (node.rotation.length_squared() - 1.0).abs() <= 1e-6
}

fn is_legal_place(place: &Place, nodes: usize) -> bool {
    (place.node as usize) < nodes && place.node_from_own.to_cols_array().iter().all(|v| v.abs() <= MAX_FACTOR)
}

pub(super) fn is_legal_track(track: &Track, width: usize) -> bool {
    let keys = track.times_s.len();
    keys > 0
        && track.values.len() == keys * width * track.interpolation.elements()
        && track.times_s.iter().chain(&track.values).all(|v| v.is_finite())
        && track.times_s.is_sorted()
        && track.period_s >= 0.0
        && track.period_s <= f64::from(f32::MAX)
}
