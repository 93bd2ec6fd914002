//! Parts of a file with numbers that are kept as f64.
//!
//! `gltf::json` rounds every number to f32, which moves a node 6,000 km from the origin by up to 25 cm, and reports
//! 1e39 as infinity. So all numbers of transforms, lights and cameras are read here, from the same JSON.

use serde::Deserialize;

/// A node's transform (§5.25), unchecked.
#[derive(Deserialize)]
pub(crate) struct Transform {
    pub(crate) matrix: Option<[f64; 16]>,
    pub(crate) translation: Option<[f64; 3]>,
    pub(crate) rotation: Option<[f64; 4]>,
    pub(crate) scale: Option<[f64; 3]>,
}

/// A light of KHR_lights_punctual.
#[derive(Deserialize)]
pub(crate) struct Light {
    pub(crate) name: Option<String>,
    #[serde(rename = "type")]
    pub(crate) kind: String,
    pub(crate) color: Option<[f64; 3]>,
    pub(crate) intensity: Option<f64>,
    pub(crate) range: Option<f64>,
    pub(crate) spot: Option<Spot>,
}

/// A spot light's cone, in radians.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Spot {
    pub(crate) inner_cone_angle: Option<f64>,
    pub(crate) outer_cone_angle: Option<f64>,
}

/// A camera, perspective or orthographic.
#[derive(Deserialize)]
pub(crate) struct Camera {
    pub(crate) name: Option<String>,
    pub(crate) perspective: Option<Perspective>,
}

#[derive(Deserialize)]
pub(crate) struct Perspective {
    /// In radians.
    pub(crate) yfov: Option<f64>,
}

/// A skin: the nodes that move a mesh.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Skin {
    pub(crate) inverse_bind_matrices: Option<u32>,
    pub(crate) joints: Vec<u32>,
}

/// A morph target's accessors: differences from the primitive's own.
#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "UPPERCASE")]
pub(crate) struct Target {
    pub(crate) position: Option<u32>,
    pub(crate) normal: Option<u32>,
    pub(crate) tangent: Option<u32>,
    #[serde(rename = "COLOR_0")]
    pub(crate) color: Option<u32>,
}

/// An animation (§5.5), unchecked.
#[derive(Deserialize)]
pub(crate) struct Animation {
    pub(crate) name: Option<String>,
    #[serde(default)]
    pub(crate) channels: Vec<Channel>,
    #[serde(default)]
    pub(crate) samplers: Vec<AnimationSampler>,
}

#[derive(Deserialize)]
pub(crate) struct Channel {
    pub(crate) sampler: Option<u32>,
    pub(crate) target: Option<ChannelTarget>,
}

/// What a channel changes.
#[derive(Deserialize)]
pub(crate) struct ChannelTarget {
    pub(crate) node: Option<u32>,
    pub(crate) path: Option<String>,
    pub(crate) extensions: Option<ChannelExtensions>,
}

#[derive(Deserialize)]
pub(crate) struct ChannelExtensions {
    #[serde(rename = "KHR_animation_pointer")]
    pub(crate) pointer: Option<Pointer>,
}

#[derive(Deserialize)]
pub(crate) struct Pointer {
    pub(crate) pointer: Option<String>,
}

#[derive(Deserialize)]
pub(crate) struct AnimationSampler {
    /// Accessor of the keys' times.
    pub(crate) input: Option<u32>,
    /// Accessor of their values.
    pub(crate) output: Option<u32>,
    pub(crate) interpolation: Option<String>,
}

/// A material variant of KHR_materials_variants.
#[derive(Deserialize)]
pub(crate) struct Variant {
    pub(crate) name: Option<String>,
}
