//! Pieces that change their shape: morph targets and skins at one time (`docs/living.md`).
//!
//! From the nodes' transforms on, only +, −, ×, ÷ and √ are used, so that all machines get the same bits.

use glam::{DMat3, DMat4, DVec3};

use crate::{
    Aabb, Joint, OwnVertices, Shape,
    limits::in_reach,
    scene::{blended, normals::normal_matrix},
};

/// Largest number in a joint's transform. Beyond it, products overflow.
const MAX_FACTOR: f64 = 1e60;

/// How far a vertex may lie from a mean of the places where its joints would have it, as a share of what a joint's
/// products add up to: sums of 16 joints and of their weights, a reciprocal and the transform itself are rounded fewer
/// than 64 times, by 2⁻⁵³ each.
const BLEND_ROUNDING: f64 = 1.0 / (1_u64 << 47) as f64;

/// A shape at one time.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Form {
    /// World transforms of the joints.
    joints: Vec<DMat4>,
    /// Targets that count, with their weights.
    targets: Vec<(usize, f64)>,
}

/// A vertex in its own space, moved by morph targets.
struct Morphed {
    position: DVec3,
    normal: DVec3,
    tangent: DVec3,
}

impl Form {
    /// Takes the nodes' world transforms. Without a time it is that of the file's pose.
    pub(super) fn of(shape: &Shape, world: impl Fn(u32) -> Option<DMat4>, time_s: Option<f64>) -> Self {
        let joint = |joint: &Joint| {
            let world_from_node = joint.node.and_then(&world);
            world_from_node.map_or(joint.node_from_own, |world_from_node| world_from_node * joint.node_from_own)
        };
        let mut weights: Vec<f64> = shape.targets.iter().map(|target| f64::from(target.weight)).collect();
        if let (Some(time_s), Some(track)) = (time_s, &shape.weights_track) {
            track.sample_into(time_s, &mut weights);
        }
        Self {
            joints: shape.joints.iter().map(joint).collect(),
            targets: weights.into_iter().enumerate().filter(|(_, weight)| *weight != 0.0).collect(),
        }
    }

    pub(super) fn joints(&self) -> &[DMat4] {
        &self.joints
    }

    pub(super) fn targets(&self) -> &[(usize, f64)] {
        &self.targets
    }

    /// Returns bounds of what the morph targets make of vertices with these bounds, in their own space.
    fn morphed(&self, shape: &Shape, bounds: Aabb) -> [DVec3; 2] {
        let mut morphed = [bounds.min.as_dvec3(), bounds.max.as_dvec3()];
        for (target, weight) in &self.targets {
            let Some(target) = shape.targets.get(*target) else { continue };
            let [one, other] = [target.bounds.min, target.bounds.max].map(|side| side.as_dvec3() * *weight);
            morphed = [morphed[0] + one.min(other), morphed[1] + one.max(other)];
        }
        morphed
    }

    /// Returns bounds of the piece in the world. `None` if it may lie out of reach. A vertex is a mean of the places
    /// where its joints would have it, so it lies between them, but for what rounds their mean ([`BLEND_ROUNDING`]).
    pub(super) fn bounds(&self, shape: &Shape, own: Aabb, world_from_own: &DMat4) -> Option<[DVec3; 2]> {
        if self.joints.is_empty() {
            return bounds(self.morphed(shape, own), world_from_own);
        }
        let (mut all, mut size) = ([DVec3::INFINITY, DVec3::NEG_INFINITY], DVec3::ZERO);
        for (world, joint) in self.joints.iter().zip(&shape.joints) {
            let legal = world.to_cols_array().iter().all(|v| v.abs() <= MAX_FACTOR);
            let morphed = self.morphed(shape, joint.bounds);
            let there = bounds(morphed, world).filter(|_| legal)?;
            all = [all[0].min(there[0]), all[1].max(there[1])];
            let farthest = morphed[0].abs().max(morphed[1].abs());
            let [x, y, z, w] = [0, 1, 2, 3].map(|n| world.col(n).truncate().abs());
            size = size.max(x * farthest.x + y * farthest.y + z * farthest.z + w);
        }
        Some([all[0] - size * BLEND_ROUNDING, all[1] + size * BLEND_ROUNDING])
    }

    /// Returns whether the skin mirrors the piece: as its first vertex says. `None` without a skin.
    pub(super) fn mirrors(&self, own: &OwnVertices<'_>) -> Option<bool> {
        (!self.joints.is_empty()).then(|| DMat3::from_mat4(self.world_from_own(own, 0)).determinant() < 0.0)
    }

    /// Returns a vertex's position in the world, and its unit normal if it has one. Without a skin, the transforms of
    /// the piece and of its normals count.
    pub(super) fn vertex(
        &self,
        own: &OwnVertices<'_>,
        vertex: usize,
        piece: (&DMat4, &DMat3),
    ) -> (DVec3, Option<DVec3>) {
        let Morphed { position, normal, .. } = self.morph(own, vertex);
        if self.joints.is_empty() {
            return (piece.0.transform_point3(position), (*piece.1 * normal).try_normalize());
        }
        let world_from_own = self.world_from_own(own, vertex);
        let normals = normal_matrix(&DMat3::from_mat4(world_from_own));
        (world_from_own.transform_point3(position), (normals * normal).try_normalize())
    }

    /// Returns the direction of a vertex's tangent in the world.
    pub(super) fn tangent(&self, own: &OwnVertices<'_>, vertex: usize, world_from_piece: &DMat4) -> Option<DVec3> {
        let skinned = (!self.joints.is_empty()).then(|| self.world_from_own(own, vertex));
        let world_from_own = skinned.as_ref().unwrap_or(world_from_piece);
        world_from_own.transform_vector3(self.morph(own, vertex).tangent).try_normalize()
    }

    fn world_from_own(&self, own: &OwnVertices<'_>, vertex: usize) -> DMat4 {
        blended(&self.joints, own.influences_of(vertex)).unwrap_or(DMat4::IDENTITY)
    }

    fn morph(&self, own: &OwnVertices<'_>, vertex: usize) -> Morphed {
        let mut morphed = Morphed {
            position: own.positions.get(vertex).copied().unwrap_or_default().as_dvec3(),
            normal: own.normals.get(vertex).copied().unwrap_or_default().as_dvec3(),
            tangent: own.tangents.get(vertex).copied().unwrap_or_default().truncate().as_dvec3(),
        };
        for (target, weight) in &self.targets {
            let delta = own.delta(*target, vertex);
            morphed.position += delta.position.as_dvec3() * *weight;
            morphed.normal += delta.normal.as_dvec3() * *weight;
            morphed.tangent += delta.tangent.as_dvec3() * *weight;
        }
        morphed
    }
}

/// Returns bounds of a box in the world. `None` if it lies out of reach, or nowhere.
pub(super) fn bounds([min, max]: [DVec3; 2], world_from_own: &DMat4) -> Option<[DVec3; 2]> {
    let mut bounds = [DVec3::INFINITY, DVec3::NEG_INFINITY];
    for number in 0..8 {
        let pick = |bit: usize, low: f64, high: f64| if number >> bit & 1 == 1 { high } else { low };
        let corner = DVec3::new(pick(0, min.x, max.x), pick(1, min.y, max.y), pick(2, min.z, max.z));
        // A transform is affine, so the corners bound what lies within.
        let there = world_from_own.transform_point3(corner);
        if !in_reach(there) {
            return None;
        }
        bounds = [bounds[0].min(there), bounds[1].max(there)];
    }
    Some(bounds)
}
