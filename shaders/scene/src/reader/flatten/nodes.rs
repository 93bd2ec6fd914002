//! Checks that the nodes form a forest, and walks it with f64 transforms (glTF 2.0, §3.5).

use glam::{DMat4, DQuat, DVec3};

use gltf::json::{Index, Node};
use serde_json::Value;

use crate::{
    error::{SceneError, place},
    limits::MAX_DEPTH,
    reader::json::{Document, Transform},
};

/// Largest difference of a rotation's length from 1. Exporters round to f32, some to a few digits.
const ROTATION_TOLERANCE: f64 = 1e-2;

pub(crate) struct Placed {
    pub(crate) node: usize,
    /// Transform from its own space to the world's.
    pub(crate) world_from_node: DMat4,
}

/// Returns the default scene's nodes, parents first, in file order, except those that KHR_node_visibility hides.
/// Without a default, the first scene is used; without scenes, all nodes.
/// Errors if the nodes are not a forest, lie too deep, or have malformed transforms.
pub(crate) fn walk(document: &Document) -> Result<Vec<Placed>, SceneError> {
    let parents = parents(document)?;
    for (index, scene) in document.json.scenes.iter().enumerate() {
        for root in &scene.nodes {
            if let Some(Some(parent)) = parents.get(root.value()) {
                let fault = format!("node {root} is a child of node {parent}, not a root");
                return Err(SceneError::invalid(place("scene", index, None), fault));
            }
        }
    }
    let locals = document.json.nodes.iter().zip(&document.transforms).enumerate();
    let locals = locals.map(|(index, (node, transform))| local_transform(index, node, transform));
    let locals = locals.collect::<Result<Vec<_>, _>>()?;

    let scene = document.json.scenes.get(document.json.scene.map_or(0, |scene| scene.value()));
    let roots: Vec<usize> = match scene {
        Some(scene) => scene.nodes.iter().map(Index::value).collect(),
        None => (0..document.json.nodes.len()).filter(|node| parents.get(*node) == Some(&None)).collect(),
    };
    let mut placed = Vec::new();
    let mut seen = vec![false; document.json.nodes.len()];
    let mut stack: Vec<(usize, DMat4)> = roots.into_iter().rev().map(|root| (root, DMat4::IDENTITY)).collect();
    while let Some((index, world_from_parent)) = stack.pop() {
        let (Some(node), Some(local), Some(seen)) =
            (document.json.nodes.get(index), locals.get(index), seen.get_mut(index))
        else {
            continue;
        };
        // A scene may list a root twice, although the schema forbids it. It is shown once.
        if std::mem::replace(seen, true) || is_hidden(node) {
            continue;
        }
        let world_from_node = world_from_parent * *local;
        if !world_from_node.is_finite() {
            let fault = "its transform, times its parents', overflows";
            return Err(SceneError::invalid(place("node", index, node.name.as_deref()), fault));
        }
        placed.push(Placed { node: index, world_from_node });
        stack.extend(node.children.iter().flatten().rev().map(|child| (child.value(), world_from_node)));
    }
    Ok(placed)
}

/// Returns whether KHR_node_visibility hides a node, and with it everything below.
fn is_hidden(node: &Node) -> bool {
    let visibility = node.extensions.as_ref().and_then(|extensions| extensions.others.get("KHR_node_visibility"));
    visibility.and_then(|visibility| visibility.get("visible")).and_then(Value::as_bool) == Some(false)
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

fn local_transform(index: usize, node: &Node, transform: &Transform) -> Result<DMat4, SceneError> {
    let invalid = |fault: String| SceneError::invalid(place("node", index, node.name.as_deref()), fault);
    let Some(matrix) = &transform.matrix else {
        let rotation = transform.rotation.map_or(DQuat::IDENTITY, DQuat::from_array);
        let length = rotation.length();
        if length.is_nan() || (length - 1.0).abs() > ROTATION_TOLERANCE {
            return Err(invalid(format!("its rotation has length {length}, not 1")));
        }
        let translation = transform.translation.map_or(DVec3::ZERO, DVec3::from_array);
        let scale = transform.scale.map_or(DVec3::ONE, DVec3::from_array);
        return Ok(DMat4::from_scale_rotation_translation(scale, rotation.normalize(), translation));
    };
    if transform.translation.is_some() || transform.rotation.is_some() || transform.scale.is_some() {
        return Err(invalid("it has a matrix and also a translation, rotation or scale".to_owned()));
    }
    let matrix = DMat4::from_cols_array(matrix);
    let last = matrix.row(3);
    if last.to_array() != [0.0, 0.0, 0.0, 1.0] {
        return Err(invalid(format!("its matrix ends in the row {last}, not 0 0 0 1")));
    }
    Ok(matrix)
}
