//! The node tree: checked to be one, then walked with f64 transforms (glTF 2.0, §3.5).

use glam::{DMat4, DQuat, DVec3};

use crate::reader::json::document::{Document, Node};
use crate::{
    error::{SceneError, place},
    limits::MAX_DEPTH,
};

/// How far a rotation's length may lie from 1: exporters round to f32, some to a few digits.
const ROTATION_TOLERANCE: f64 = 1e-2;

/// A node of the scene that is shown, and where it stands.
pub(crate) struct Placed {
    /// Its index.
    pub(crate) node: usize,
    /// From its own space to the world's.
    pub(crate) world_from_node: DMat4,
}

/// Nodes of the file's default scene (else its first; else everything), parents first, in the file's order, without
/// those that KHR_node_visibility hides.
///
/// # Errors
/// When the nodes are not a forest, lie too deep, or have transforms that are no such thing.
pub(crate) fn walk(document: &Document<'_>) -> Result<Vec<Placed>, SceneError> {
    let parents = parents(document)?;
    for (index, scene) in document.scenes.iter().enumerate() {
        for root in &scene.nodes {
            if let Some(Some(parent)) = parents.get(*root as usize) {
                let fault = format!("node {root} is a child of node {parent}, not a root");
                return Err(SceneError::invalid(place("scene", index, None), fault));
            }
        }
    }
    let locals = document.nodes.iter().enumerate().map(|(index, node)| transform(index, node));
    let locals = locals.collect::<Result<Vec<_>, _>>()?;

    let scene = document.scenes.get(document.scene.unwrap_or(0) as usize);
    let roots: Vec<usize> = match scene {
        Some(scene) => scene.nodes.iter().map(|node| *node as usize).collect(),
        None => (0..document.nodes.len()).filter(|node| parents.get(*node) == Some(&None)).collect(),
    };
    let mut placed = Vec::new();
    let mut seen = vec![false; document.nodes.len()];
    let mut stack: Vec<(usize, DMat4)> = roots.into_iter().rev().map(|root| (root, DMat4::IDENTITY)).collect();
    while let Some((index, world_from_parent)) = stack.pop() {
        let (Some(node), Some(local), Some(seen)) = (document.nodes.get(index), locals.get(index), seen.get_mut(index))
        else {
            continue;
        };
        // A scene may list a root twice (the schema forbids it): shown once.
        if std::mem::replace(seen, true)
            || node.extensions.visibility.as_ref().is_some_and(|v| v.visible == Some(false))
        {
            continue;
        }
        let world_from_node = world_from_parent * *local;
        if !world_from_node.is_finite() {
            let fault = "its transform, times its parents', overflows";
            return Err(SceneError::invalid(place("node", index, node.name.as_deref()), fault));
        }
        placed.push(Placed { node: index, world_from_node });
        stack.extend(node.children.iter().rev().map(|child| (*child as usize, world_from_node)));
    }
    Ok(placed)
}

/// Each node's parent.
///
/// # Errors
/// When a node has two parents, is among its own ancestors, or lies too deep.
fn parents(document: &Document<'_>) -> Result<Vec<Option<usize>>, SceneError> {
    let here =
        |index: usize| place("node", index, document.nodes.get(index).and_then(|node: &Node| node.name.as_deref()));
    let mut parents: Vec<Option<usize>> = vec![None; document.nodes.len()];
    for (index, node) in document.nodes.iter().enumerate() {
        for child in &node.children {
            let Some(parent) = parents.get_mut(*child as usize) else { continue };
            if let Some(other) = parent.replace(index) {
                return Err(SceneError::invalid(here(index), format!("its child {child} is node {other}'s already")));
            }
        }
    }
    // One parent each, so every node that is not below a root is part of a cycle, or below one.
    let mut depths = vec![0_usize; document.nodes.len()];
    let mut stack: Vec<usize> =
        parents.iter().enumerate().filter(|(_, parent)| parent.is_none()).map(|(node, _)| node).collect();
    for root in &stack {
        if let Some(depth) = depths.get_mut(*root) {
            *depth = 1;
        }
    }
    while let Some(index) = stack.pop() {
        let below = depths.get(index).map_or(0, |depth| depth + 1);
        for child in document.nodes.get(index).map_or(&[][..], |node| &node.children) {
            let child = *child as usize;
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

fn transform(index: usize, node: &Node) -> Result<DMat4, SceneError> {
    let invalid = |fault: String| SceneError::invalid(place("node", index, node.name.as_deref()), fault);
    let Some(matrix) = &node.matrix else {
        let rotation = node.rotation.map_or(DQuat::IDENTITY, DQuat::from_array);
        let length = rotation.length();
        if length.is_nan() || (length - 1.0).abs() > ROTATION_TOLERANCE {
            return Err(invalid(format!("its rotation has length {length}, not 1")));
        }
        let translation = node.translation.map_or(DVec3::ZERO, DVec3::from_array);
        let scale = node.scale.map_or(DVec3::ONE, DVec3::from_array);
        return Ok(DMat4::from_scale_rotation_translation(scale, rotation.normalize(), translation));
    };
    if node.translation.is_some() || node.rotation.is_some() || node.scale.is_some() {
        return Err(invalid("it has a matrix and also a translation, rotation or scale".to_owned()));
    }
    let matrix = DMat4::from_cols_array(matrix);
    let last = matrix.row(3);
    if last.to_array() != [0.0, 0.0, 0.0, 1.0] {
        return Err(invalid(format!("its matrix ends in the row {last}, not 0 0 0 1")));
    }
    Ok(matrix)
}
