//! Checks that the nodes form a forest, and walks it with f64 transforms (glTF 2.0, §3.5).

use glam::{DMat4, DQuat, DVec3, DVec4};

use gltf::json::{Index, Node};
use serde_json::Value;

use super::{
    channels::{Channels, NodeTracks},
    materials::choose,
};
use crate::{
    AnimatedNode, LoadReport, Place, Track,
    error::{SceneError, place, within},
    light::short_name,
    limits::{MAX_DEPTH, MAX_MOVING},
    moment::orthonormal,
    reader::json::{Document, Transform},
};

/// Largest difference of a rotation's length from 1 that is no fault. Exporters round to f32, some to a few digits.
const ROTATION_TOLERANCE: f64 = 1e-2;

/// Largest difference of a matrix's last row from 0 0 0 1 that is no fault: f32 rounding.
const ROW_TOLERANCE: f64 = 1e-6;

pub(crate) struct Placed {
    pub(crate) node: usize,
    /// Transform from its own space to the world's.
    pub(crate) world_from_node: DMat4,
    /// The rotation alone, which a scale of 0 does not lose.
    pub(crate) rotation: DQuat,
    /// The animated node that moves it.
    pub(crate) place: Option<Place>,
}

/// The nodes of a scene.
pub(crate) struct Walk {
    pub(crate) placed: Vec<Placed>,
    /// World transform of each node of the file, in the scene or not. Joints may lie outside it. May overflow.
    pub(crate) worlds: Vec<DMat4>,
    /// Where each node of the file hangs on one that moves.
    pub(crate) places: Vec<Option<Place>>,
    /// Nodes that move, parents first.
    pub(crate) animated: Vec<AnimatedNode>,
}

impl Placed {
    /// Returns the rotation of the node's axes, made orthonormal: −Z stays, +Y as far as it can.
    pub(crate) fn orientation(&self) -> DQuat {
        let [y, z] = [self.world_from_node.y_axis, self.world_from_node.z_axis].map(DVec4::truncate);
        orthonormal(y, z).unwrap_or(self.rotation)
    }
}

/// Returns the nodes of the wanted scene, parents first, in file order, except those that KHR_node_visibility always
/// hides.
/// Without a wish it is the default scene, or else the first; without scenes, all nodes.
/// Errors if there is no such scene, or the nodes are not a forest, lie too deep, or have transforms that overflow.
pub(crate) fn walk(
    document: &Document,
    channels: &Channels,
    wanted: Option<&str>,
    report: &mut LoadReport,
) -> Result<Walk, SceneError> {
    let parents = parents(document)?;
    let locals = document.json.nodes.iter().zip(&document.transforms).enumerate();
    let locals: Vec<Local> =
        locals.map(|(index, (node, transform))| local_transform(index, node, transform, channels, report)).collect();
    let roots = roots(document, &parents, wanted, report)?;

    let (mut placed, mut animated) = (Vec::new(), Vec::new());
    let mut seen = vec![false; document.json.nodes.len()];
    let mut places = vec![None; document.json.nodes.len()];
    let at_root = |root: usize| (root, DMat4::IDENTITY, DQuat::IDENTITY, None, false);
    let mut stack: Vec<(usize, DMat4, DQuat, Option<Place>, bool)> = roots.into_iter().rev().map(at_root).collect();
    while let Some((index, world_from_parent, rotation, above, hidden)) = stack.pop() {
        let (Some(node), Some(local), Some(seen)) =
            (document.json.nodes.get(index), locals.get(index), seen.get_mut(index))
        else {
            continue;
        };
        // A scene may list a root twice, although the schema forbids it. It is shown once.
        let tracks = channels.nodes.get(&index);
        let hidden = hidden || is_hidden(node, tracks) == Hidden::Always;
        // Joints move skins even if they are hidden.
        if std::mem::replace(seen, true) || hidden && document.skins.is_empty() {
            continue;
        }
        let world_from_node = world_from_parent * local.matrix;
        if !world_from_node.is_finite() {
            let fault = "its transform, times its parents', overflows";
            return Err(SceneError::invalid(place("node", index, node.name.as_deref()), fault));
        }
        let rotation = (rotation * local.rotation).normalize();
        let place = match tracks.filter(|tracks| !tracks.rest()) {
            Some(tracks) => {
                let visible = is_hidden(node, None) == Hidden::Never;
                let number = u32::try_from(animated.len()).unwrap_or(u32::MAX);
                let name = node.name.as_deref();
                animated.push(animated_node((above, world_from_parent), local, (name, visible), tracks));
                Some(Place { node: number, node_from_own: DMat4::IDENTITY })
            }
            None => above.map(|above| Place { node_from_own: above.node_from_own * local.matrix, ..above }),
        };
        places.get_mut(index).into_iter().for_each(|known| *known = place);
        if !hidden {
            placed.push(Placed { node: index, world_from_node, rotation, place });
        }
        let below = |child: &Index<Node>| (child.value(), world_from_node, rotation, place, hidden);
        stack.extend(node.children.iter().flatten().rev().map(below));
    }
    within("animated nodes", animated.len() as u64, MAX_MOVING)?;
    Ok(Walk { placed, worlds: worlds(document, &parents, &locals), places, animated })
}

/// Returns a node that moves. Constant values are in `local` already. `above` is where the node's parent hangs on an
/// animated node; without one, `world_from_parent` never changes.
fn animated_node(
    (above, world_from_parent): (Option<Place>, DMat4),
    local: &Local,
    (name, visible): (Option<&str>, bool),
    tracks: &NodeTracks,
) -> AnimatedNode {
    let animated_from_parent = above.map_or(world_from_parent, |above| above.node_from_own);
    // A matrix is taken apart only if something animates its parts.
    let (animated_from_own, (translation_m, rotation, scale)) = match local.parts {
        Some(parts) => (animated_from_parent, parts),
        None => (animated_from_parent * local.matrix, (DVec3::ZERO, DQuat::IDENTITY, DVec3::ONE)),
    };
    let changing = |track: &Option<Track>, width| track.clone().filter(|track| !track.is_constant(width));
    let shown = tracks.visible.as_ref().filter(|track| track.is_constant(1)).map(|track| track.sample::<1>(0.0));
    AnimatedNode {
        name: if tracks.editable { short_name(name) } else { String::new() },
        editable: tracks.editable,
        parent: above.map(|above| above.node),
        above: animated_from_own,
        translation_m,
        rotation,
        scale,
        visible: shown.map_or(visible, |[shown]| shown != 0.0),
        translation_track: changing(&tracks.translation, 3),
        rotation_track: changing(&tracks.rotation, 4),
        scale_track: changing(&tracks.scale, 3),
        visible_track: changing(&tracks.visible, 1),
    }
}

/// Returns the roots of the wanted scene.
fn roots(
    document: &Document,
    parents: &[Option<usize>],
    wanted: Option<&str>,
    report: &mut LoadReport,
) -> Result<Vec<usize>, SceneError> {
    let scenes = &document.json.scenes;
    let index = match wanted {
        Some(wanted) => {
            let names: Vec<&str> = scenes.iter().map(|scene| scene.name.as_deref().unwrap_or("")).collect();
            choose("scene", wanted, &names)?
        }
        None => document.json.scene.map_or(0, |scene| scene.value()),
    };
    let Some(scene) = scenes.get(index) else {
        return Ok((0..document.json.nodes.len()).filter(|node| parents.get(*node) == Some(&None)).collect());
    };
    let listed: Vec<usize> = scene.nodes.iter().map(Index::value).collect();
    if listed.iter().all(|root| parents.get(*root) == Some(&None)) {
        return Ok(listed);
    }
    // A child that is listed as a root stands there without its parents, unless they bring it themselves.
    report.mended("a scene that lists a child of a node as a root", &place("scene", index, scene.name.as_deref()));
    let mut is_listed = vec![false; document.json.nodes.len()];
    listed.iter().for_each(|root| is_listed.get_mut(*root).into_iter().for_each(|listed| *listed = true));
    let parent = |node: &usize| parents.get(*node).copied().flatten();
    let brought = |root: &usize| {
        std::iter::successors(parent(root), parent).any(|above| is_listed.get(above).copied().unwrap_or_default())
    };
    Ok(listed.into_iter().filter(|root| !brought(root)).collect())
}

/// Returns every node's world transform.
fn worlds(document: &Document, parents: &[Option<usize>], locals: &[Local]) -> Vec<DMat4> {
    // Only joints are looked up.
    if document.skins.is_empty() {
        return Vec::new();
    }
    let mut worlds = vec![DMat4::IDENTITY; locals.len()];
    let roots = parents.iter().enumerate().filter(|(_, parent)| parent.is_none());
    let mut stack: Vec<(usize, DMat4)> = roots.map(|(root, _)| (root, DMat4::IDENTITY)).collect();
    while let Some((index, above)) = stack.pop() {
        let (Some(node), Some(local), Some(world)) =
            (document.json.nodes.get(index), locals.get(index), worlds.get_mut(index))
        else {
            continue;
        };
        *world = above * local.matrix;
        let world = *world;
        stack.extend(node.children.iter().flatten().map(|child| (child.value(), world)));
    }
    worlds
}

/// When KHR_node_visibility hides a node, and with it everything below.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Hidden {
    Never,
    Always,
    Sometimes,
}

fn is_hidden(node: &Node, tracks: Option<&NodeTracks>) -> Hidden {
    let visibility = node.extensions.as_ref().and_then(|extensions| extensions.others.get("KHR_node_visibility"));
    let visible = visibility.and_then(|visibility| visibility.get("visible")).and_then(Value::as_bool) != Some(false);
    let visible = match tracks.and_then(|tracks| tracks.visible.as_ref()) {
        Some(track) if !track.is_constant(1) => return Hidden::Sometimes,
        Some(track) => track.sample::<1>(0.0) != [0.0],
        None => visible,
    };
    if visible {
        Hidden::Never
    } else if tracks.is_some_and(|tracks| tracks.editable) {
        Hidden::Sometimes
    } else {
        Hidden::Always
    }
}

/// Errors if a node has two parents, is its own ancestor, or lies too deep.
fn parents(document: &Document) -> Result<Vec<Option<usize>>, SceneError> {
    let here = |index: usize| {
        place("node", index, document.json.nodes.get(index).and_then(|node: &Node| node.name.as_deref()))
    };
    let mut parents: Vec<Option<usize>> = vec![None; document.json.nodes.len()];
    for (index, node) in document.json.nodes.iter().enumerate() {
        for child in node.children.iter().flatten() {
            let Some(parent) = parents.get_mut(child.value()) else { continue };
            if let Some(other) = parent.replace(index) {
                return Err(SceneError::invalid(here(index), format!("its child {child} is node {other}'s already")));
            }
        }
    }
    // Each node has at most one parent, so every node that is not below a root is part of a cycle, or below one.
    let mut depths = vec![0_usize; document.json.nodes.len()];
    let mut stack: Vec<usize> =
        parents.iter().enumerate().filter(|(_, parent)| parent.is_none()).map(|(node, _)| node).collect();
    for root in &stack {
        if let Some(depth) = depths.get_mut(*root) {
            *depth = 1;
        }
    }
    while let Some(index) = stack.pop() {
        let below = depths.get(index).map_or(0, |depth| depth + 1);
        let children = document.json.nodes.get(index).and_then(|node| node.children.as_ref());
        for child in children.into_iter().flatten() {
            let child = child.value();
            if below > MAX_DEPTH {
                return Err(SceneError::Limit {
                    what: format!("depth of {}", here(child)),
                    count: below as u64,
                    limit: MAX_DEPTH as u64,
                });
            }
            if let Some(depth) = depths.get_mut(child) {
                *depth = below;
                stack.push(child);
            }
        }
    }
    match depths.iter().position(|depth| *depth == 0) {
        Some(index) => Err(SceneError::invalid(here(index), "it is part of a loop of nodes, or below one")),
        None => Ok(parents),
    }
}

/// A node's own transform.
struct Local {
    matrix: DMat4,
    rotation: DQuat,
    /// Translation, rotation and scale, if the matrix is made of them.
    parts: Option<(DVec3, DQuat, DVec3)>,
}

impl Local {
    /// Tracks that never change take the places of the file's values.
    fn new(translation: DVec3, rotation: DQuat, scale: DVec3, tracks: Option<&NodeTracks>) -> Self {
        let vector = |track: Option<&Track>| {
            track.filter(|track| track.is_constant(3)).map(|track| DVec3::from_array(track.sample(0.0)))
        };
        let translation = vector(tracks.and_then(|tracks| tracks.translation.as_ref())).unwrap_or(translation);
        let scale = vector(tracks.and_then(|tracks| tracks.scale.as_ref())).unwrap_or(scale);
        let turned = tracks.and_then(|tracks| tracks.rotation.as_ref()).filter(|track| track.is_constant(4));
        let rotation = turned.map_or(rotation, |track| track.rotation(0.0));
        let matrix = DMat4::from_scale_rotation_translation(scale, rotation, translation);
        Self { matrix, rotation, parts: Some((translation, rotation, scale)) }
    }
}

/// Returns a node's own transform. What is not legal is read as other viewers do.
fn local_transform(
    index: usize,
    node: &Node,
    transform: &Transform,
    channels: &Channels,
    report: &mut LoadReport,
) -> Local {
    let here = || place("node", index, node.name.as_deref());
    let tracks = channels.nodes.get(&index).filter(|tracks| tracks.transforms());
    let Some(matrix) = &transform.matrix else {
        let rotation = transform.rotation.map_or(DQuat::IDENTITY, DQuat::from_array);
        if (rotation.length() - 1.0).abs() > ROTATION_TOLERANCE {
            report.mended("a rotation whose length is not 1: normalised", &here());
        }
        let rotation = if rotation.length_squared().is_normal() { rotation.normalize() } else { DQuat::IDENTITY };
        let rotation = if rotation.is_finite() { rotation } else { DQuat::IDENTITY };
        let translation = transform.translation.map_or(DVec3::ZERO, DVec3::from_array);
        return Local::new(translation, rotation, transform.scale.map_or(DVec3::ONE, DVec3::from_array), tracks);
    };
    if transform.translation.is_some() || transform.rotation.is_some() || transform.scale.is_some() {
        report.mended("a matrix beside a translation, rotation or scale: the matrix counts", &here());
    }
    let mut matrix = DMat4::from_cols_array(matrix);
    if (matrix.row(3) - DVec4::W).abs().max_element() > ROW_TOLERANCE {
        report.mended("a matrix whose last row is not 0 0 0 1: taken for it", &here());
    }
    for (column, last) in
        [(&mut matrix.x_axis, 0.0), (&mut matrix.y_axis, 0.0), (&mut matrix.z_axis, 0.0), (&mut matrix.w_axis, 1.0)]
    {
        column.w = last;
    }
    if tracks.is_some() {
        report.mended("an animated node with a matrix: taken apart", &here());
        let (scale, rotation, translation) = matrix.to_scale_rotation_translation();
        let whole = scale.is_finite() && rotation.is_finite();
        let (scale, rotation) = if whole { (scale, rotation.normalize()) } else { (DVec3::ONE, DQuat::IDENTITY) };
        return Local::new(translation, rotation, scale, tracks);
    }
    let rotation = orthonormal(matrix.y_axis.truncate(), matrix.z_axis.truncate()).unwrap_or(DQuat::IDENTITY);
    Local { matrix, rotation, parts: None }
}
