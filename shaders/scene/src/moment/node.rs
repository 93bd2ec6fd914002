//! A node at one time, for those who edit it.

use glam::{DMat4, DQuat, DVec3};

use super::{When, parts, shown, worlds};
use crate::{Scene, SceneAt};

/// Where a node of the animation is, and how.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NodeAt {
    /// Transform to the world from the space that the node's own transform leads to.
    pub world_from_parent: DMat4,
    /// In metres.
    pub translation_m: DVec3,
    /// A unit quaternion.
    pub rotation: DQuat,
    pub scale: DVec3,
    /// Whether the node itself is shown. Nothing of it is seen if one above is hidden.
    pub shown: bool,
    /// Whether the node and all above it are shown.
    pub visible: bool,
}

impl NodeAt {
    #[must_use]
    pub fn world_from_node(&self) -> DMat4 {
        let own = DMat4::from_scale_rotation_translation(self.scale, self.rotation, self.translation_m);
        self.world_from_parent * own
    }
}

impl Scene {
    /// Returns a node of the animation at a time, by its number. `None` if there is no such node.
    #[must_use]
    pub fn node_at(&self, node: u32, at: &SceneAt) -> Option<NodeAt> {
        let animation = self.animation.as_deref()?;
        let own = animation.nodes.get(node as usize)?;
        let when = When::At(at);
        let worlds = worlds(animation, when);
        let above = own.parent.and_then(|parent| worlds.get(parent as usize));
        let edit = at.edits.node(node);
        let (scale, rotation, translation_m) = parts(own, &edit, when);
        Some(NodeAt {
            world_from_parent: above.map_or(DMat4::IDENTITY, |above| above.world_from_node) * own.above,
            translation_m,
            rotation,
            scale,
            shown: edit.shown.unwrap_or_else(|| shown(own, when)),
            visible: worlds.get(node as usize)?.visible,
        })
    }
}
