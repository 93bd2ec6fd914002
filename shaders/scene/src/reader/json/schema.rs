//! The properties that the reader reads, with the type and the bound of each. Everything else in a file is skipped.
//!
//! `gltf::json` alone does not do. It truncates indices to 32 bits, takes arrays for objects, and refuses `24.0` as an
//! integer. It refuses flaws in parts that nothing reads, and does not miss a buffer's length. Its lists have no bounds.

use std::fmt;

use Kind::{Flag, Index, List, Number, Object, Presence, Size, Text, Vector};
use Property::{May, Must};

use crate::limits::{
    MAX_ACCESSORS, MAX_BUFFER_VIEWS, MAX_BUFFERS, MAX_EXTENSIONS, MAX_IMAGES, MAX_LIGHT_DEFINITIONS, MAX_MATERIALS,
    MAX_MESHES, MAX_NODES, MAX_SCENES, MAX_TEXTURES,
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
    /// An array of so many numbers.
    Vector(usize),
    /// An array of at most so many elements. [`UNBOUNDED`] leaves the bound to `MAX_ELEMENT_VALUES`.
    List(usize, &'static Kind),
    Object(&'static [Property]),
    /// Anything: its value is skipped.
    Presence,
}

/// A property that an object must have, or may have.
pub(super) enum Property {
    Must(&'static str, Kind),
    May(&'static str, Kind),
}

impl Property {
    pub(super) fn name(&self) -> &'static str {
        match self {
            Must(name, _) | May(name, _) => name,
        }
    }

    pub(super) fn kind(&self) -> &Kind {
        match self {
            Must(_, kind) | May(_, kind) => kind,
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
    Must("asset", Object(&[Must("version", Text), May("minVersion", Text)])),
    May("extensionsRequired", List(MAX_EXTENSIONS, &Text)),
    May("scene", Index),
    May("scenes", List(MAX_SCENES, &Object(&[May("nodes", INDICES)]))),
    May("nodes", List(MAX_NODES, &NODE)),
    May("meshes", List(MAX_MESHES, &MESH)),
    May("accessors", List(MAX_ACCESSORS, &ACCESSOR)),
    May("bufferViews", List(MAX_BUFFER_VIEWS, &BUFFER_VIEW)),
    May("buffers", List(MAX_BUFFERS, &Object(&[May("uri", Text), Must("byteLength", Size)]))),
    May("materials", List(MAX_MATERIALS, &MATERIAL)),
    May("textures", List(MAX_TEXTURES, &TEXTURE)),
    May("samplers", List(MAX_TEXTURES, &Object(&[May("wrapS", Index), May("wrapT", Index)]))),
    May("images", List(MAX_IMAGES, &Object(&[May("name", Text), May("uri", Text), May("bufferView", Index)]))),
    May("extensions", Object(&[May("KHR_lights_punctual", LIGHTS)])),
];

const LIGHTS: Kind = Object(&[Must("lights", List(MAX_LIGHT_DEFINITIONS, &LIGHT))]);

const LIGHT: Kind = Object(&[
    May("name", Text),
    Must("type", Text),
    May("color", Vector(3)),
    May("intensity", Number),
    May("range", Number),
    May("spot", Object(&[May("innerConeAngle", Number), May("outerConeAngle", Number)])),
]);

const NODE: Kind = Object(&[
    May("name", Text),
    May("children", INDICES),
    May("mesh", Index),
    May("skin", Index),
    May("matrix", Vector(16)),
    May("translation", Vector(3)),
    May("rotation", Vector(4)),
    May("scale", Vector(3)),
    May("weights", WEIGHTS),
    May(
        "extensions",
        Object(&[
            May("KHR_lights_punctual", Object(&[Must("light", Index)])),
            May("KHR_node_visibility", Object(&[May("visible", Flag)])),
            May("EXT_mesh_gpu_instancing", Presence),
        ]),
    ),
]);

const MESH: Kind =
    Object(&[May("name", Text), Must("primitives", List(MAX_MESHES, &PRIMITIVE)), May("weights", WEIGHTS)]);

const PRIMITIVE: Kind = Object(&[
    Must("attributes", ATTRIBUTES),
    May("indices", Index),
    May("material", Index),
    May("mode", Index),
    May("targets", List(UNBOUNDED, &Object(&[]))),
    May("extensions", Object(&[May("KHR_draco_mesh_compression", Presence), May("KHR_gaussian_splatting", Presence)])),
]);

/// Texture coordinate sets beyond the fourth are an error where a material uses them.
const ATTRIBUTES: Kind = Object(&[
    May("POSITION", Index),
    May("NORMAL", Index),
    May("TEXCOORD_0", Index),
    May("TEXCOORD_1", Index),
    May("TEXCOORD_2", Index),
    May("TEXCOORD_3", Index),
]);

const ACCESSOR: Kind = Object(&[
    May("bufferView", Index),
    May("byteOffset", Size),
    Must("componentType", Index),
    May("normalized", Flag),
    Must("count", Size),
    Must("type", Text),
    May("sparse", SPARSE),
]);

const SPARSE: Kind = Object(&[
    Must("count", Size),
    Must("indices", Object(&[Must("bufferView", Index), May("byteOffset", Size), Must("componentType", Index)])),
    Must("values", Object(&[Must("bufferView", Index), May("byteOffset", Size)])),
]);

const BUFFER_VIEW: Kind = Object(&[
    Must("buffer", Index),
    May("byteOffset", Size),
    Must("byteLength", Size),
    May("byteStride", Size),
    May("extensions", Object(&[May("EXT_meshopt_compression", Presence), May("KHR_meshopt_compression", Presence)])),
]);

const MATERIAL: Kind = Object(&[
    May("name", Text),
    May(
        "pbrMetallicRoughness",
        Object(&[May("baseColorFactor", Vector(4)), May("baseColorTexture", BASE_COLOR_TEXTURE)]),
    ),
    May("emissiveFactor", Vector(3)),
    May("emissiveTexture", Presence),
    May("alphaMode", Text),
    May("alphaCutoff", Number),
    May("doubleSided", Flag),
    May(
        "extensions",
        Object(&[
            May("KHR_materials_emissive_strength", Object(&[May("emissiveStrength", Number)])),
            May("KHR_materials_pbrSpecularGlossiness", Presence),
        ]),
    ),
]);

const BASE_COLOR_TEXTURE: Kind = Object(&[
    Must("index", Index),
    May("texCoord", Index),
    May("extensions", Object(&[May("KHR_texture_transform", TEXTURE_TRANSFORM)])),
]);

const TEXTURE_TRANSFORM: Kind =
    Object(&[May("offset", Vector(2)), May("rotation", Number), May("scale", Vector(2)), May("texCoord", Index)]);

const TEXTURE: Kind = Object(&[
    May("sampler", Index),
    May("source", Index),
    May(
        "extensions",
        Object(&[
            May("KHR_texture_basisu", Presence),
            May("EXT_texture_webp", Presence),
            May("EXT_texture_avif", Presence),
            May("MSFT_texture_dds", Presence),
        ]),
    ),
]);
