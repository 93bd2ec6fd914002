//! The properties that the reader reads, with the type and the bound of each. Everything else in a file is skipped.
//!
//! `gltf::json` alone is too lax and too strict. It truncates indices to 32 bits, takes arrays for objects and a buffer
//! without a length, and does not bound lists. It refuses `24.0` as an integer, and flaws in properties that are not
//! read. Its errors have no place.

use std::fmt;

use Kind::{Flag, Index, List, Number, Object, Presence, Size, Text, Vector};
use Property::{Optional, Required};

use crate::limits::{
    MAX_ACCESSORS, MAX_ANIMATIONS, MAX_BUFFER_VIEWS, MAX_BUFFERS, MAX_CAMERA_DEFINITIONS, MAX_CHANNELS, MAX_EXTENSIONS,
    MAX_IMAGES, MAX_LIGHT_DEFINITIONS, MAX_MATERIALS, MAX_MESHES, MAX_NODES, MAX_SCENES, MAX_SKINS, MAX_TEXTURES,
    MAX_VARIANTS,
};

/// What a value must be.
pub(super) enum Kind {
    Flag,
    Text,
    Number,
    /// An integer of 32 bits: an index, or a code of OpenGL.
    Index,
    /// An integer of 64 bits: a number of bytes or of elements.
    Size,
    /// An array of exactly this many numbers.
    Vector(usize),
    /// An array of at most this many elements. [`UNBOUNDED`] leaves the bound to `MAX_ELEMENT_VALUES`.
    List(usize, &'static Kind),
    Object(&'static [Property]),
    /// Anything: its value is skipped.
    Presence,
}

/// A property's name and kind.
pub(super) enum Property {
    Required(&'static str, Kind),
    Optional(&'static str, Kind),
}

impl Property {
    pub(super) fn name(&self) -> &'static str {
        match self {
            Required(name, _) | Optional(name, _) => name,
        }
    }

    pub(super) fn kind(&self) -> &Kind {
        match self {
            Required(_, kind) | Optional(_, kind) => kind,
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Flag => f.write_str("true or false"),
            Text => f.write_str("a string"),
            Number => f.write_str("a number"),
            Index => write!(f, "an integer from 0 to {}", u32::MAX),
            Size => write!(f, "an integer from 0 to {}", u64::MAX),
            Vector(count) => write!(f, "an array of {count} numbers"),
            List(UNBOUNDED, _) => f.write_str("an array"),
            List(max, _) => write!(f, "an array of at most {max} elements"),
            Object(_) => f.write_str("an object"),
            Presence => f.write_str("anything"),
        }
    }
}

const UNBOUNDED: usize = usize::MAX;
const INDICES: Kind = List(UNBOUNDED, &Index);
const WEIGHTS: Kind = List(UNBOUNDED, &Number);

pub(super) const ROOT: &[Property] = &[
    Required("asset", Object(&[Required("version", Text), Optional("minVersion", Text)])),
    Optional("extensionsRequired", List(MAX_EXTENSIONS, &Text)),
    Optional("extensionsUsed", List(MAX_EXTENSIONS, &Text)),
    Optional("animations", List(MAX_ANIMATIONS, &ANIMATION)),
    Optional("scene", Index),
    Optional("scenes", List(MAX_SCENES, &Object(&[Optional("name", Text), Optional("nodes", INDICES)]))),
    Optional("nodes", List(MAX_NODES, &NODE)),
    Optional("meshes", List(MAX_MESHES, &MESH)),
    Optional("accessors", List(MAX_ACCESSORS, &ACCESSOR)),
    Optional("bufferViews", List(MAX_BUFFER_VIEWS, &BUFFER_VIEW)),
    Optional("buffers", List(MAX_BUFFERS, &Object(&[Optional("uri", Text), Required("byteLength", Size)]))),
    Optional("materials", List(MAX_MATERIALS, &MATERIAL)),
    Optional("textures", List(MAX_TEXTURES, &TEXTURE)),
    Optional("samplers", List(MAX_TEXTURES, &SAMPLER)),
    Optional(
        "images",
        List(MAX_IMAGES, &Object(&[Optional("name", Text), Optional("uri", Text), Optional("bufferView", Index)])),
    ),
    Optional("cameras", List(MAX_CAMERA_DEFINITIONS, &CAMERA)),
    Optional("skins", List(MAX_SKINS, &SKIN)),
    Optional(
        "extensions",
        Object(&[Optional("KHR_lights_punctual", LIGHTS), Optional("KHR_materials_variants", VARIANTS)]),
    ),
];

const SAMPLER: Kind = Object(&[
    Optional("magFilter", Index),
    Optional("minFilter", Index),
    Optional("wrapS", Index),
    Optional("wrapT", Index),
]);

const CAMERA: Kind = Object(&[
    Optional("name", Text),
    Optional("type", Text),
    Optional("perspective", Object(&[Optional("yfov", Number)])),
]);

const SKIN: Kind =
    Object(&[Optional("name", Text), Optional("inverseBindMatrices", Index), Required("joints", INDICES)]);

const ANIMATION: Kind = Object(&[
    Optional("name", Text),
    Optional("channels", List(MAX_CHANNELS, &Object(&[Optional("sampler", Index), Optional("target", ANIMATED)]))),
    Optional("samplers", List(MAX_CHANNELS, &ANIMATION_SAMPLER)),
]);

/// What an animation's channel changes.
const ANIMATED: Kind = Object(&[
    Optional("node", Index),
    Optional("path", Text),
    Optional("extensions", Object(&[Optional("KHR_animation_pointer", Object(&[Optional("pointer", Text)]))])),
]);

const ANIMATION_SAMPLER: Kind =
    Object(&[Optional("input", Index), Optional("output", Index), Optional("interpolation", Text)]);

const VARIANTS: Kind = Object(&[Required("variants", List(MAX_VARIANTS, &Object(&[Optional("name", Text)])))]);

const LIGHTS: Kind = Object(&[Required("lights", List(MAX_LIGHT_DEFINITIONS, &LIGHT))]);

const LIGHT: Kind = Object(&[
    Optional("name", Text),
    Required("type", Text),
    Optional("color", Vector(3)),
    Optional("intensity", Number),
    Optional("range", Number),
    Optional("spot", Object(&[Optional("innerConeAngle", Number), Optional("outerConeAngle", Number)])),
]);

const NODE: Kind = Object(&[
    Optional("name", Text),
    Optional("camera", Index),
    Optional("children", INDICES),
    Optional("mesh", Index),
    Optional("skin", Index),
    Optional("matrix", Vector(16)),
    Optional("translation", Vector(3)),
    Optional("rotation", Vector(4)),
    Optional("scale", Vector(3)),
    Optional("weights", WEIGHTS),
    Optional(
        "extensions",
        Object(&[
            Optional("KHR_lights_punctual", Object(&[Required("light", Index)])),
            Optional("KHR_node_visibility", Object(&[Optional("visible", Flag)])),
            Optional("EXT_mesh_gpu_instancing", Object(&[Optional("attributes", INSTANCE_ATTRIBUTES)])),
        ]),
    ),
]);

const INSTANCE_ATTRIBUTES: Kind =
    Object(&[Optional("TRANSLATION", Index), Optional("ROTATION", Index), Optional("SCALE", Index)]);

const MESH: Kind = Object(&[
    Optional("name", Text),
    Required("primitives", List(MAX_MESHES, &PRIMITIVE)),
    Optional("weights", WEIGHTS),
]);

const PRIMITIVE: Kind = Object(&[
    Required("attributes", ATTRIBUTES),
    Optional("indices", Index),
    Optional("material", Index),
    Optional("mode", Index),
    Optional("targets", List(UNBOUNDED, &TARGET)),
    Optional(
        "extensions",
        Object(&[Optional("KHR_draco_mesh_compression", DRACO), Optional("KHR_materials_variants", MAPPINGS)]),
    ),
]);

/// Of a morph target.
const TARGET: Kind = Object(&[
    Optional("POSITION", Index),
    Optional("NORMAL", Index),
    Optional("TANGENT", Index),
    Optional("COLOR_0", Index),
]);

/// Which variants of KHR_materials_variants give a primitive another material.
const MAPPINGS: Kind = Object(&[Required(
    "mappings",
    List(UNBOUNDED, &Object(&[Required("material", Index), Required("variants", INDICES)])),
)]);

const DRACO: Kind = Object(&[Required("bufferView", Index), Required("attributes", ATTRIBUTES)]);

/// Further sets of texture coordinates count as missing.
const ATTRIBUTES: Kind = Object(&[
    Optional("POSITION", Index),
    Optional("NORMAL", Index),
    Optional("TANGENT", Index),
    Optional("COLOR_0", Index),
    Optional("TEXCOORD_0", Index),
    Optional("TEXCOORD_1", Index),
    Optional("TEXCOORD_2", Index),
    Optional("TEXCOORD_3", Index),
    Optional("TEXCOORD_4", Index),
    Optional("TEXCOORD_5", Index),
    Optional("TEXCOORD_6", Index),
    Optional("TEXCOORD_7", Index),
    Optional("JOINTS_0", Index),
    Optional("JOINTS_1", Index),
    Optional("JOINTS_2", Index),
    Optional("JOINTS_3", Index),
    Optional("WEIGHTS_0", Index),
    Optional("WEIGHTS_1", Index),
    Optional("WEIGHTS_2", Index),
    Optional("WEIGHTS_3", Index),
]);

const ACCESSOR: Kind = Object(&[
    Optional("bufferView", Index),
    Optional("byteOffset", Size),
    Required("componentType", Index),
    Optional("normalized", Flag),
    Required("count", Size),
    Required("type", Text),
    Optional("sparse", SPARSE),
]);

const SPARSE: Kind = Object(&[
    Required("count", Size),
    Required(
        "indices",
        Object(&[Required("bufferView", Index), Optional("byteOffset", Size), Required("componentType", Index)]),
    ),
    Required("values", Object(&[Required("bufferView", Index), Optional("byteOffset", Size)])),
]);

const BUFFER_VIEW: Kind = Object(&[
    Required("buffer", Index),
    Optional("byteOffset", Size),
    Required("byteLength", Size),
    Optional("byteStride", Size),
    Optional(
        "extensions",
        Object(&[Optional("EXT_meshopt_compression", MESHOPT), Optional("KHR_meshopt_compression", MESHOPT)]),
    ),
]);

const MESHOPT: Kind = Object(&[
    Required("buffer", Index),
    Optional("byteOffset", Size),
    Required("byteLength", Size),
    Required("byteStride", Size),
    Required("mode", Text),
    Optional("filter", Text),
    Required("count", Size),
]);

const MATERIAL: Kind = Object(&[
    Optional("name", Text),
    Optional(
        "pbrMetallicRoughness",
        Object(&[
            Optional("baseColorFactor", Vector(4)),
            Optional("baseColorTexture", TEXTURE_INFO),
            Optional("metallicFactor", Number),
            Optional("roughnessFactor", Number),
            Optional("metallicRoughnessTexture", TEXTURE_INFO),
        ]),
    ),
    Optional("normalTexture", TEXTURE_INFO),
    Optional("occlusionTexture", TEXTURE_INFO),
    Optional("emissiveTexture", TEXTURE_INFO),
    Optional("emissiveFactor", Vector(3)),
    Optional("alphaMode", Text),
    Optional("alphaCutoff", Number),
    Optional("doubleSided", Flag),
    Optional("extensions", Object(MATERIAL_EXTENSIONS)),
]);

const MATERIAL_EXTENSIONS: &[Property] = &[
    Optional("KHR_materials_emissive_strength", Object(&[Optional("emissiveStrength", Number)])),
    Optional("KHR_materials_unlit", Presence),
    Optional("KHR_materials_ior", Object(&[Optional("ior", Number)])),
    Optional(
        "KHR_materials_specular",
        Object(&[
            Optional("specularFactor", Number),
            Optional("specularTexture", TEXTURE_INFO),
            Optional("specularColorFactor", Vector(3)),
            Optional("specularColorTexture", TEXTURE_INFO),
        ]),
    ),
    Optional(
        "KHR_materials_clearcoat",
        Object(&[
            Optional("clearcoatFactor", Number),
            Optional("clearcoatTexture", TEXTURE_INFO),
            Optional("clearcoatRoughnessFactor", Number),
            Optional("clearcoatRoughnessTexture", TEXTURE_INFO),
            Optional("clearcoatNormalTexture", TEXTURE_INFO),
        ]),
    ),
    Optional(
        "KHR_materials_sheen",
        Object(&[
            Optional("sheenColorFactor", Vector(3)),
            Optional("sheenColorTexture", TEXTURE_INFO),
            Optional("sheenRoughnessFactor", Number),
            Optional("sheenRoughnessTexture", TEXTURE_INFO),
        ]),
    ),
    Optional(
        "KHR_materials_transmission",
        Object(&[Optional("transmissionFactor", Number), Optional("transmissionTexture", TEXTURE_INFO)]),
    ),
    Optional(
        "KHR_materials_pbrSpecularGlossiness",
        Object(&[
            Optional("diffuseFactor", Vector(4)),
            Optional("diffuseTexture", TEXTURE_INFO),
            Optional("specularFactor", Vector(3)),
            Optional("glossinessFactor", Number),
            Optional("specularGlossinessTexture", TEXTURE_INFO),
        ]),
    ),
    Optional("KHR_materials_anisotropy", Presence),
    Optional("KHR_materials_diffuse_transmission", Presence),
    Optional("KHR_materials_dispersion", Presence),
    Optional("KHR_materials_iridescence", Presence),
    Optional("KHR_materials_volume", Presence),
];

/// A texture's use, with the strength that some uses have.
const TEXTURE_INFO: Kind = Object(&[
    Required("index", Index),
    Optional("texCoord", Index),
    Optional("scale", Number),
    Optional("strength", Number),
    Optional("extensions", Object(&[Optional("KHR_texture_transform", TEXTURE_TRANSFORM)])),
]);

const TEXTURE_TRANSFORM: Kind = Object(&[
    Optional("offset", Vector(2)),
    Optional("rotation", Number),
    Optional("scale", Vector(2)),
    Optional("texCoord", Index),
]);

const TEXTURE: Kind = Object(&[
    Optional("sampler", Index),
    Optional("source", Index),
    Optional(
        "extensions",
        Object(&[
            Optional("KHR_texture_basisu", SOURCE),
            Optional("EXT_texture_webp", SOURCE),
            Optional("EXT_texture_avif", SOURCE),
            Optional("MSFT_texture_dds", SOURCE),
        ]),
    ),
]);

/// An extension's picture in another format.
const SOURCE: Kind = Object(&[Optional("source", Index)]);
