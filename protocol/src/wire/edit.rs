//! What a client changes in a scene, as it travels. The scene has the same with its own types, and checks it.

use serde::{Deserialize, Serialize};

/// The new state of one node or light. One that changes nothing puts back what the file has.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Edit {
    Node(NodeEdit),
    Light(LightEdit),
}

/// `None`: as in the file, or as the animation has it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct NodeEdit {
    /// Index among the scene's nodes that move or may be edited.
    pub node: u32,
    /// In metres, in the space of the node's parent.
    pub translation_m: Option<[f64; 3]>,
    /// A unit quaternion (x, y, z, w).
    pub rotation: Option<[f64; 4]>,
    pub scale: Option<[f64; 3]>,
    /// Whether the node and all below it are shown.
    pub shown: Option<bool>,
}

/// `None`: as in the file, or as the animation has it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct LightEdit {
    /// Index among the scene's lights.
    pub light: u32,
    /// In the world, in metres.
    pub position_m: Option<[f64; 3]>,
    /// Unit vector in which it shines, in the world.
    pub direction: Option<[f64; 3]>,
    /// Linear RGB.
    pub color: Option<[f32; 3]>,
    /// Candela, or lux of a directional light.
    pub intensity: Option<f32>,
    /// In metres; may be infinite.
    pub range_m: Option<f32>,
    /// Inner and outer angle of a spot's cone, in radians.
    pub cone_rad: Option<[f32; 2]>,
}
