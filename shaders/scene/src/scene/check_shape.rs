//! Checks the guarantees of pieces that change their shape.

use glam::Vec3;

use super::{
    aabb::Aabb,
    animation::{Animation, Influence, Joint, OwnVertices, Shape},
    check::{CheckError, all, at_most, ensure},
    check_animation::{MAX_FACTOR, is_legal_track},
};
use crate::limits::{MAX_DELTAS, MAX_JOINT_SETS, MAX_JOINTS, MAX_MOVING, in_reach};

/// Largest weight of a joint: sums and products stay finite.
pub(crate) const MAX_WEIGHT: f32 = 1e30;

impl Animation {
    /// Checks the shapes against the pieces, which are legal.
    pub(super) fn check_shapes(&self) -> Result<(), CheckError> {
        at_most("shapes", self.shapes.len(), MAX_MOVING)?;
        at_most("joints", self.shapes.iter().map(|shape| shape.joints.len()).sum(), MAX_JOINTS)?;
        at_most("changes of vertices by morph targets", self.deltas.len(), MAX_DELTAS)?;
        let ascending = self.shapes.is_sorted_by(|one, other| one.piece < other.piece)
            && self.shapes.last().is_none_or(|last| (last.piece as usize) < self.pieces.len());
        ensure(ascending, || "a shape names a piece that is not there, or twice".to_owned())?;
        let (mut influences, mut deltas) = (0, 0);
        for shape in &self.shapes {
            let vertices = self.pieces.get(shape.piece as usize).map_or(0, |piece| piece.vertices);
            let whole = !shape.flat || vertices.is_multiple_of(3);
            ensure(whole && self.is_legal_shape(shape), || format!("the shape of piece {} is {shape:?}", shape.piece))?;
            influences += shape.influences(vertices);
            deltas += shape.deltas(vertices);
        }
        let counts = [self.influences.len() as u64, self.deltas.len() as u64];
        ensure(counts == [influences, deltas], || format!("{counts:?} influences and deltas of all shapes"))?;
        all("change by a morph target", &self.deltas, |delta| {
            [delta.position, delta.normal, delta.tangent].iter().all(|by| in_reach(by.as_dvec3()))
        })?;
        let pieces = self.own_vertices();
        let shaped = pieces.iter().filter_map(|own| Some((own, own.shape?)));
        for (own, shape) in shaped {
            let legal = check_influences(own, shape.joints.len());
            ensure(legal, || format!("vertices of piece {} follow joints that are not there", shape.piece))?;
            let joints = joint_bounds(own, shape.joints.len());
            let legal = shape.joints.iter().map(|joint| joint.bounds).eq(joints.into_iter().map(around))
                && shape.targets.iter().map(|target| target.bounds).eq(target_bounds(own, shape.targets.len()));
            ensure(legal, || format!("the shape of piece {} has other bounds than it says", shape.piece))?;
        }
        Ok(())
    }

    fn is_legal_shape(&self, shape: &Shape) -> bool {
        let small = |matrix: &glam::DMat4| matrix.to_cols_array().iter().all(|v| v.abs() <= MAX_FACTOR);
        let joint = |joint: &Joint| {
            joint.node.is_none_or(|node| (node as usize) < self.nodes.len()) && small(&joint.node_from_own)
        };
        (!shape.joints.is_empty() || !shape.targets.is_empty())
            && shape.sets <= MAX_JOINT_SETS
            && (shape.sets == 0) == shape.joints.is_empty()
            && small(&shape.node_from_own)
            && shape.joints.iter().all(joint)
            && shape.targets.iter().all(|target| target.weight.is_finite())
            && shape.track().is_none_or(|(track, width)| width > 0 && is_legal_track(track, width))
    }
}

fn check_influences(own: &OwnVertices<'_>, joints: usize) -> bool {
    let weight = |weight: f32| (0.0..=MAX_WEIGHT).contains(&weight);
    let legal = |it: &Influence| it.joints.iter().all(|joint| usize::from(*joint) < joints);
    (joints == 0
        || (0..own.positions.len()).all(|vertex| own.influences_of(vertex).iter().any(|it| it.each().next().is_some())))
        && own.influences.iter().all(|it| legal(it) && it.weights.into_iter().all(weight))
}

/// Returns bounds of the vertices that follow each joint. `None` if none does.
pub(crate) fn joint_bounds(own: &OwnVertices<'_>, joints: usize) -> Vec<Option<Aabb>> {
    let mut bounds = vec![None; joints];
    for (vertex, position) in own.positions.iter().enumerate() {
        for (joint, _) in own.influences_of(vertex).iter().flat_map(Influence::each) {
            let Some(bounds) = bounds.get_mut(joint) else { continue };
            let Aabb { min, max } = bounds.unwrap_or(Aabb { min: *position, max: *position });
            *bounds = Some(Aabb { min: min.min(*position), max: max.max(*position) });
        }
    }
    bounds
}

/// The bounds of a joint that nothing follows are all zeros.
pub(crate) fn around(bounds: Option<Aabb>) -> Aabb {
    bounds.unwrap_or(Aabb { min: Vec3::ZERO, max: Vec3::ZERO })
}

/// Returns bounds of how far each target moves a vertex.
pub(crate) fn target_bounds(own: &OwnVertices<'_>, targets: usize) -> impl Iterator<Item = Aabb> {
    let vertices = own.positions.len();
    (0..targets).map(move |target| {
        let deltas = own.deltas.get(target * vertices..(target + 1) * vertices).unwrap_or_default();
        Aabb::around(deltas.iter().map(|delta| &delta.position))
    })
}
