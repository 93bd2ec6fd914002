//! Keeps what gives a primitive another shape at other times: the joints of its skin, and its morph targets.

use glam::{DMat4, Vec3};
use gltf::json::Index;

use super::{
    channels::Channels,
    nodes::Walk,
    pose::{Pose, Posed, Skin},
    primitive::{Geometry, Source},
};
use crate::{
    Aabb, AnimatedNode, Animation, Delta, Influence, Joint, LoadReport, OwnVertices, Place, Shape, Target,
    error::SceneError,
    limits::{MAX_DELTAS, MAX_JOINTS, MAX_MOVING, in_reach},
    reader::json,
    scene::check_shape::{around, joint_bounds, target_bounds},
};

/// What moves an instance of a primitive.
pub(crate) enum Motion {
    Rigid(Place),
    Deformed(Box<Deformed>),
}

/// An instance of a primitive that changes its shape.
pub(crate) struct Deformed {
    /// In its mesh's space.
    pub(crate) geometry: Geometry,
    /// The skin mirrors it in the pose of the file, so that its triangles are the other way round there.
    pub(crate) mirrored: bool,
    /// The animated node that it hangs on. `None`: one that rests.
    node: Option<u32>,
    /// Without the piece, and without bounds.
    shape: Shape,
    influences: Vec<Influence>,
    deltas: Vec<Delta>,
}

/// Returns what changes an instance's shape. `None` if its shape rests, or there is too much of it.
/// Errors if bytes are not there.
pub(crate) fn read(
    source: &Source<'_>,
    (walk, channels): (&Walk, &Channels),
    (pose, place, world_from_node): (&Pose, Option<&Place>, DMat4),
    (targets, posed): (&[json::Target], &mut Posed<'_>),
    skin: Option<&Skin>,
    animation: &Animation,
    report: &mut LoadReport,
) -> Result<Option<Deformed>, SceneError> {
    let weights = channels.weights(source.document, pose.node);
    let skin = skin.filter(|_| posed.influences.is_some());
    let followed = posed.influences.iter().flat_map(|influences| &influences.list).flat_map(Influence::each);
    let moves = skin.is_some_and(|skin| {
        let moves = |joint: usize| skin.joints.get(joint).is_some_and(|joint| joint.node.is_some());
        followed.into_iter().any(|(joint, _)| moves(joint)) || blinks(walk, place)
    });
    let track = weights.track.filter(|_| pose.morphed && !targets.is_empty());
    if !moves && (track.is_none() || pose.skinned && skin.is_none()) {
        return Ok(None);
    }
    let Some(geometry) = posed.own.take() else { return Ok(None) };
    let vertices = geometry.positions.len();
    let count = track.map_or(0, |_| weights.count);
    // Flat triangles take three vertices each.
    let most = if geometry.normals.is_some() { vertices } else { vertices.max(3 * geometry.triangles.len()) };
    let before = animation.shapes.iter().map(|shape| shape.joints.len()).sum::<usize>();
    let joints = (before + skin.map_or(0, |skin| skin.joints.len())) as u64;
    let deltas = (most as u64).saturating_mul(count as u64).saturating_add(animation.deltas.len() as u64);
    if joints > MAX_JOINTS || deltas > MAX_DELTAS || animation.shapes.len() as u64 >= MAX_MOVING {
        report.left_out("animated skins and morph targets beyond the limits: they rest", source.place);
        return Ok(None);
    }
    let deltas = if count > 0 { read_deltas(source, targets, (vertices, count))? } else { Vec::new() };
    let target = |at: usize| {
        let weight = weights.values.get(at).copied().filter(|weight| weight.is_finite()).unwrap_or(0.0);
        Target { weight, bounds: around(None) }
    };
    let influences = posed.influences.take().filter(|_| skin.is_some()).unwrap_or_default();
    let node_from_own = match place {
        _ if skin.is_some() => DMat4::IDENTITY,
        Some(place) => place.node_from_own,
        None => world_from_node,
    };
    let shape = Shape {
        piece: 0,
        node_from_own,
        joints: skin.map(|skin| skin.joints.clone()).unwrap_or_default(),
        sets: influences.sets,
        targets: (0..count).map(target).collect(),
        weights_track: track.cloned(),
        flat: geometry.normals.is_none(),
    };
    let (mirrored, node) = (posed.mirrored, place.map(|place| place.node));
    Ok(Some(Deformed { geometry, mirrored, node, shape, influences: influences.list, deltas }))
}

/// Returns whether something hangs on a node that is not always visible.
fn blinks(walk: &Walk, place: Option<&Place>) -> bool {
    let node = |index: u32| walk.animated.get(index as usize);
    let mut above = std::iter::successors(place.and_then(|place| node(place.node)), |it| it.parent.and_then(node));
    above.any(|node| node.visible_track.is_some())
}

/// Returns what each target changes of each vertex: nothing where that is not there, or not finite.
fn read_deltas(
    source: &Source<'_>,
    targets: &[json::Target],
    (vertices, count): (usize, usize),
) -> Result<Vec<Delta>, SceneError> {
    let mut deltas = vec![Delta::default(); vertices * count];
    // What is wrong was told when the pose of the file was made.
    let mut told = LoadReport::default();
    let mut vectors = |accessor: Option<u32>| match accessor {
        Some(accessor) => source.elements::<3>(Index::new(accessor), vertices, &mut told),
        None => Ok(None),
    };
    let legal = |by: [f32; 3]| Some(Vec3::from_array(by)).filter(|by| in_reach(by.as_dvec3())).unwrap_or_default();
    for (target, deltas) in targets.iter().zip(deltas.chunks_mut(vertices.max(1))) {
        for (delta, by) in deltas.iter_mut().zip(vectors(target.position)?.into_iter().flatten()) {
            delta.position = legal(by);
        }
        for (delta, by) in deltas.iter_mut().zip(vectors(target.normal)?.into_iter().flatten()) {
            delta.normal = legal(by);
        }
        for (delta, by) in deltas.iter_mut().zip(vectors(target.tangent)?.into_iter().flatten()) {
            delta.tangent = legal(by);
        }
    }
    Ok(deltas)
}

impl Deformed {
    /// Returns the animated node that the piece hangs on: one that rests, if it has none of its own.
    pub(super) fn node(&self, animation: &mut Animation) -> u32 {
        self.node.unwrap_or_else(|| {
            let resting = AnimatedNode::default();
            // They follow all others, so it is the last one if there is one.
            if animation.nodes.last() != Some(&resting) {
                animation.nodes.push(resting);
            }
            u32::try_from(animation.nodes.len() - 1).unwrap_or(u32::MAX)
        })
    }

    /// Adds the shape of the animation's last piece. Its vertices are the geometry's with these numbers, or all.
    pub(super) fn append(self, numbers: Option<Vec<usize>>, animation: &mut Animation) {
        let Self { mut shape, influences, deltas, geometry, .. } = self;
        let vertices = geometry.positions.len();
        let sources = numbers.unwrap_or_else(|| (0..vertices).collect());
        shape.piece = u32::try_from(animation.pieces.len().saturating_sub(1)).unwrap_or(u32::MAX);
        let (sets, first) = (shape.sets as usize, [animation.influences.len(), animation.deltas.len()]);
        for source in &sources {
            let of_vertex = influences.get(source * sets..(source + 1) * sets).unwrap_or_default();
            animation.influences.extend_from_slice(of_vertex);
        }
        for of_target in deltas.chunks(vertices.max(1)) {
            animation.deltas.extend(sources.iter().map(|source| of_target.get(*source).copied().unwrap_or_default()));
        }
        keep_used(&mut shape, animation.influences.get_mut(first[0]..).unwrap_or_default());
        let before = animation.positions.len().saturating_sub(sources.len());
        let own = OwnVertices {
            positions: animation.positions.get(before..).unwrap_or_default(),
            normals: &[],
            tangents: &[],
            shape: Some(&shape),
            influences: animation.influences.get(first[0]..).unwrap_or_default(),
            deltas: animation.deltas.get(first[1]..).unwrap_or_default(),
        };
        let joints: Vec<Aabb> = joint_bounds(&own, shape.joints.len()).into_iter().map(around).collect();
        let targets: Vec<Aabb> = target_bounds(&own, shape.targets.len()).collect();
        shape.joints.iter_mut().zip(joints).for_each(|(joint, bounds)| joint.bounds = bounds);
        shape.targets.iter_mut().zip(targets).for_each(|(target, bounds)| target.bounds = bounds);
        animation.shapes.push(shape);
    }
}

/// Drops the joints that no vertex follows.
fn keep_used(shape: &mut Shape, influences: &mut [Influence]) {
    let mut places: Vec<Option<u16>> = vec![None; shape.joints.len()];
    let mut kept: Vec<Joint> = Vec::new();
    for influence in influences {
        for (joint, weight) in influence.joints.iter_mut().zip(influence.weights) {
            let Some(place) = places.get_mut(usize::from(*joint)).filter(|_| weight != 0.0) else {
                *joint = 0;
                continue;
            };
            let new = u16::try_from(kept.len()).unwrap_or(u16::MAX);
            let (index, is_new) = (place.unwrap_or(new), place.is_none());
            if is_new {
                kept.extend(shape.joints.get(usize::from(*joint)));
                *place = Some(new);
            }
            *joint = index;
        }
    }
    shape.joints = kept;
}
