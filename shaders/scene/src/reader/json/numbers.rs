//! The numbers of a file, as f64.
//!
//! `gltf::json` rounds every number to f32, which moves a node 6,000 km from the origin by up to 25 cm, and reports
//! 1e39 as infinity. So all numbers of transforms, materials and lights are read here, from the same JSON.

use serde::Deserialize;
use serde_json::{Error, Value};

/// A node's transform (§5.25), unchecked.
#[derive(Deserialize)]
pub(crate) struct Transform {
    pub(crate) matrix: Option<[f64; 16]>,
    pub(crate) translation: Option<[f64; 3]>,
    pub(crate) rotation: Option<[f64; 4]>,
    pub(crate) scale: Option<[f64; 3]>,
}

/// A material's numbers (§5.19), with the defaults filled in.
pub(crate) struct Factors {
    pub(crate) base_color: [f64; 4],
    pub(crate) texture_transform: Option<TextureTransform>,
    pub(crate) emissive: [f64; 3],
    pub(crate) emissive_strength: f64,
    /// True if there is an emissive texture. Its properties are not read.
    pub(crate) has_emissive_texture: bool,
    pub(crate) alpha_cutoff: f64,
}

/// KHR_texture_transform, without its `texCoord`.
#[derive(Deserialize)]
pub(crate) struct TextureTransform {
    #[serde(default)]
    pub(crate) offset: [f64; 2],
    /// In radians, counter-clockwise with v pointing down.
    #[serde(default)]
    pub(crate) rotation: f64,
    #[serde(default = "unscaled")]
    pub(crate) scale: [f64; 2],
}

fn unscaled() -> [f64; 2] {
    [1.0; 2]
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

impl Default for Factors {
    fn default() -> Self {
        Self {
            base_color: [1.0; 4],
            texture_transform: None,
            emissive: [0.0; 3],
            emissive_strength: 1.0,
            has_emissive_texture: false,
            alpha_cutoff: 0.5,
        }
    }
}

impl Factors {
    /// Reads a material's numbers, and removes an emissive texture's marker, which `gltf::json` would refuse. Errors if
    /// the material breaks the schema.
    pub(super) fn take(material: &mut Value) -> Result<Self, Error> {
        let has_emissive_texture = material.as_object_mut().and_then(|m| m.remove("emissiveTexture")).is_some();
        let texture = "/pbrMetallicRoughness/baseColorTexture/extensions/KHR_texture_transform";
        let strength = "/extensions/KHR_materials_emissive_strength/emissiveStrength";
        let default = Self::default();
        Ok(Self {
            base_color: read(material, "/pbrMetallicRoughness/baseColorFactor")?.unwrap_or(default.base_color),
            texture_transform: read(material, texture)?,
            emissive: read(material, "/emissiveFactor")?.unwrap_or(default.emissive),
            emissive_strength: read(material, strength)?.unwrap_or(default.emissive_strength),
            has_emissive_texture,
            alpha_cutoff: read(material, "/alphaCutoff")?.unwrap_or(default.alpha_cutoff),
        })
    }
}

/// Reads the value at a JSON pointer.
fn read<'a, T: Deserialize<'a>>(value: &'a Value, pointer: &str) -> Result<Option<T>, Error> {
    let read = value.pointer(pointer).map(T::deserialize).transpose();
    read.map_err(|error| serde::de::Error::custom(format_args!("{pointer}: {error}")))
}
