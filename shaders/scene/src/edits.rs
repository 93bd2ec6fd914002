//! What people have changed in a scene. An edit is absolute: the last word about a node or a light is its state.

use std::{collections::BTreeMap, f64::consts::FRAC_PI_2};

use glam::{DQuat, DVec3, Vec3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::{
    Light, LightKind, Scene,
    limits::{MAX_EDITED, in_reach},
};

/// How far a rotation's length may be from 1: what a client rounds to f32 still passes.
const UNIT_TOLERANCE: f64 = 1e-5;

/// The largest scale, either way.
const MAX_SCALE: f64 = 1e9;

/// What is changed of a node. `None`: as in the file, or as the animation has it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct NodeEdit {
    /// In metres, in the space of the node's parent in the file.
    pub translation_m: Option<DVec3>,
    /// A unit quaternion.
    pub rotation: Option<DQuat>,
    pub scale: Option<DVec3>,
    /// Whether the node and all below it are shown.
    pub shown: Option<bool>,
}

/// What is changed of a light. `None`: as in the file, or as the animation has it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct LightEdit {
    /// In the world, in metres. A directional light has none.
    pub position_m: Option<DVec3>,
    /// Where it shines, in the world: a unit vector. A point light has none.
    pub direction: Option<DVec3>,
    /// Linear.
    pub color: Option<Vec3>,
    /// In candela, or in lux of a directional light.
    pub intensity: Option<f32>,
    /// In metres; may be infinite. A directional light has none.
    pub range_m: Option<f32>,
    /// Inner and outer angle of a spot's cone, in radians.
    pub cone_rad: Option<[f32; 2]>,
}

/// The new state of one node or light. One that changes nothing puts back what the file has.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Edit {
    /// Index into [`Animation::nodes`](crate::Animation::nodes).
    Node(u32, NodeEdit),
    /// Index into [`Scene::lights`].
    Light(u32, LightEdit),
}

/// Why an edit is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum EditError {
    #[error("there is no node {0} that may be edited")]
    Node(u32),
    #[error("there is no light {0}")]
    Light(u32),
    #[error("{0} is out of range")]
    Range(&'static str),
    #[error("more than {MAX_EDITED} nodes and lights are edited")]
    TooMany,
}

/// All that is changed in a scene.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Edits {
    nodes: BTreeMap<u32, NodeEdit>,
    lights: BTreeMap<u32, LightEdit>,
}

impl Edits {
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty() && self.lights.is_empty()
    }

    /// Number of nodes and lights that are changed.
    #[must_use]
    pub fn len(&self) -> usize {
        self.nodes.len() + self.lights.len()
    }

    #[must_use]
    pub fn node(&self, node: u32) -> NodeEdit {
        self.nodes.get(&node).copied().unwrap_or_default()
    }

    #[must_use]
    pub fn light(&self, light: u32) -> LightEdit {
        self.lights.get(&light).copied().unwrap_or_default()
    }

    /// Each node and light that is changed, once.
    pub fn iter(&self) -> impl Iterator<Item = Edit> {
        let nodes = self.nodes.iter().map(|(node, edit)| Edit::Node(*node, *edit));
        nodes.chain(self.lights.iter().map(|(light, edit)| Edit::Light(*light, *edit)))
    }

    /// Returns the edits that lead here from another state.
    #[must_use]
    pub fn since(&self, before: &Self) -> Vec<Edit> {
        let undone = before.iter().filter_map(|edit| match edit {
            Edit::Node(node, _) => (!self.nodes.contains_key(&node)).then(|| Edit::Node(node, NodeEdit::default())),
            Edit::Light(light, _) => {
                (!self.lights.contains_key(&light)).then(|| Edit::Light(light, LightEdit::default()))
            }
        });
        let changed = self.iter().filter(|edit| match edit {
            Edit::Node(node, edit) => before.nodes.get(node) != Some(edit),
            Edit::Light(light, edit) => before.lights.get(light) != Some(edit),
        });
        undone.chain(changed).collect()
    }

    /// The lights that are changed.
    pub(crate) fn lights(&self) -> impl Iterator<Item = (u32, LightEdit)> {
        self.lights.iter().map(|(light, edit)| (*light, *edit))
    }

    /// Takes an edit that was checked.
    ///
    /// # Errors
    /// If there would be more than [`MAX_EDITED`].
    pub fn apply(&mut self, edit: Edit) -> Result<(), EditError> {
        let full = self.len() >= MAX_EDITED;
        match edit {
            Edit::Node(node, edit) => put(&mut self.nodes, node, edit, full),
            Edit::Light(light, edit) => put(&mut self.lights, light, edit, full),
        }
    }
}

fn put<T: Default + PartialEq>(all: &mut BTreeMap<u32, T>, target: u32, edit: T, full: bool) -> Result<(), EditError> {
    if edit == T::default() {
        all.remove(&target);
    } else if full && !all.contains_key(&target) {
        return Err(EditError::TooMany);
    } else {
        all.insert(target, edit);
    }
    Ok(())
}

impl Edit {
    /// Checks that the scene has what is edited, and that every value is one that it may have.
    ///
    /// # Errors
    /// What is wrong first.
    pub fn check(&self, scene: &Scene) -> Result<(), EditError> {
        match self {
            Self::Node(node, edit) => {
                let nodes = scene.animation.as_ref().map_or(&[][..], |animation| &animation.nodes);
                let known = nodes.get(*node as usize).is_some_and(|node| node.editable);
                if known { edit.check() } else { Err(EditError::Node(*node)) }
            }
            Self::Light(light, edit) => {
                let known = (*light as usize) < scene.lights.len();
                if known { edit.check() } else { Err(EditError::Light(*light)) }
            }
        }
    }
}

fn holds<T>(value: Option<T>, rule: impl Fn(T) -> bool, what: &'static str) -> Result<(), EditError> {
    if value.is_none_or(rule) { Ok(()) } else { Err(EditError::Range(what)) }
}

impl NodeEdit {
    fn check(&self) -> Result<(), EditError> {
        holds(self.translation_m, in_reach, "the translation")?;
        holds(self.rotation, |rotation| (rotation.length() - 1.0).abs() <= UNIT_TOLERANCE, "the rotation")?;
        holds(self.scale, |scale| scale.is_finite() && scale.abs().max_element() <= MAX_SCALE, "the scale")
    }
}

impl LightEdit {
    fn check(&self) -> Result<(), EditError> {
        let positive = |value: f32| value.is_finite() && value >= 0.0;
        holds(self.position_m, in_reach, "the position")?;
        holds(self.direction, |direction| (direction.length() - 1.0).abs() <= UNIT_TOLERANCE, "the direction")?;
        holds(self.color, |color| color.to_array().into_iter().all(positive), "the colour")?;
        holds(self.intensity, positive, "the intensity")?;
        holds(self.range_m, |range_m| range_m > 0.0, "the range")?;
        let fits = |[inner, outer]: [f32; 2]| inner >= 0.0 && inner <= outer && f64::from(outer) <= FRAC_PI_2;
        holds(self.cone_rad, fits, "the cone")
    }

    /// Changes a light whose kind has what is edited.
    pub(crate) fn apply(&self, light: &mut Light, origin_m: DVec3) {
        light.color = self.color.unwrap_or(light.color);
        light.intensity = self.intensity.unwrap_or(light.intensity);
        if light.kind != LightKind::Directional {
            light.range_m = self.range_m.unwrap_or(light.range_m);
            light.position = self.position_m.map_or(light.position, |there| (there - origin_m).as_vec3());
        }
        if light.kind != LightKind::Point {
            light.direction =
                self.direction.map_or(light.direction, |direction| direction.normalize().as_vec3().normalize());
        }
        if let (LightKind::Spot { inner_cone_rad, outer_cone_rad }, Some(cone_rad)) = (&mut light.kind, self.cone_rad) {
            [*inner_cone_rad, *outer_cone_rad] = cone_rad;
        }
    }
}
