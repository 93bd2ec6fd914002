//! Parses a file's JSON into `gltf::json`'s types.
//!
//! The crate's importer, validation and iterators are not used: they panic on broken files.

use std::fmt;

use gltf::json::{Accessor, Image, Index, Root, Texture, mesh, validation::Checked};
use serde::{
    Deserialize, Deserializer as _,
    de::{Error, IgnoredAny, MapAccess, Visitor},
};
use serde_json::{Value, from_value};

use super::{
    material::Material,
    numbers::{Animation, Camera, Light, Skin, Target, Transform, Variant},
    schema::ROOT,
    value::{PropertyName, list, property},
};

/// The parts of a file's JSON that are read.
#[derive(Default)]
pub(crate) struct Document {
    /// All but what follows. Its numbers are rounded to f32: use those below.
    pub(crate) json: Root,
    /// One for each node.
    pub(crate) transforms: Vec<Transform>,
    /// Morph targets of each mesh's primitives.
    pub(crate) targets: Vec<Vec<Vec<Target>>>,
    pub(crate) materials: Vec<Material>,
    pub(crate) cameras: Vec<Camera>,
    pub(crate) skins: Vec<Skin>,
    /// Definitions of KHR_lights_punctual.
    pub(crate) lights: Vec<Light>,
    /// Of KHR_materials_variants.
    pub(crate) variants: Vec<Variant>,
    pub(crate) animations: Vec<Animation>,
}

/// Errors with a sentence if the JSON breaks the schema, or is for another version of glTF.
pub(crate) fn parse(json: &[u8]) -> Result<Document, String> {
    // Some exporters write a byte order mark, which the specification forbids.
    let json = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json);
    let mut deserializer = serde_json::Deserializer::from_slice(json);
    let document = deserializer.deserialize_map(DocumentVisitor).map_err(|error| error.to_string())?;
    deserializer.end().map_err(|error| error.to_string())?;
    let asset = &document.json.asset;
    // Minor versions are compatible, unless the file asks for a newer reader (§2.5).
    if asset.version.split_once('.').map(|(major, _)| major) != Some("2") {
        return Err(format!("its asset version is {:.32?}, not 2.0", asset.version));
    }
    if let Some(least) = asset.min_version.as_deref().filter(|least| *least != "2.0") {
        return Err(format!("it asks for a reader of version {least:.32?}; this one reads 2.0"));
    }
    Ok(document)
}

/// Sets of texture coordinates that are read.
pub(crate) const TEXCOORDS: std::ops::Range<u32> = 0..8;

/// Sets of joints and weights that are read.
pub(crate) const JOINTS: std::ops::Range<u32> = 0..4;

/// Extensions that bring a texture's picture in a format that is read, and in one that is not.
const PICTURES: [[&str; 2]; 2] = [["KHR_texture_basisu", "EXT_texture_webp"], ["EXT_texture_avif", "MSFT_texture_dds"]];

/// Returns a texture's image: one that an extension brings and that is read, else its own. An image that is not read
/// tells why there is none. `gltf::json` gives the largest index to a texture without an image.
pub(crate) fn source(texture: &Texture) -> Option<Index<Image>> {
    let others = texture.extensions.as_ref().map(|extensions| &extensions.others);
    let brought = |names: [&str; 2]| {
        let index = names.iter().find_map(|name| others?.get(*name)?.get("source")?.as_u64());
        index.and_then(|index| u32::try_from(index).ok()).map(Index::new)
    };
    let [read, unread] = PICTURES.map(brought);
    read.or(Some(texture.source).filter(|source| *source != Index::new(u32::MAX))).or(unread)
}

/// Returns the accessor of a vertex attribute.
pub(crate) fn attribute(primitive: &mesh::Primitive, semantic: mesh::Semantic) -> Option<Index<Accessor>> {
    primitive.attributes.get(&Checked::Valid(semantic)).copied()
}

struct DocumentVisitor;

impl<'de> Visitor<'de> for DocumentVisitor {
    type Value = Document;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Document, A::Error> {
        let mut document = Document::default();
        let Document { json, transforms, targets, materials, cameras, skins, lights, variants, animations } =
            &mut document;
        let mut seen: Vec<&str> = Vec::new();
        while let Some(known) = map.next_key_seed(PropertyName(ROOT))? {
            let Some(known) = known else {
                map.next_value::<IgnoredAny>()?;
                continue;
            };
            let name = known.name();
            if seen.contains(&name) {
                return Err(A::Error::duplicate_field(name));
            }
            seen.push(name);
            match name {
                "asset" => json.asset = property(&mut map, known)?,
                "extensionsUsed" => json.extensions_used = property(&mut map, known)?,
                "animations" => *animations = list(&mut map, known, from_value)?,
                "extensionsRequired" => json.extensions_required = property(&mut map, known)?,
                "scene" => json.scene = property(&mut map, known)?,
                "scenes" => json.scenes = list(&mut map, known, scene)?,
                "nodes" => {
                    json.nodes = list(&mut map, known, |value| {
                        transforms.push(Transform::deserialize(&value)?);
                        from_value(value)
                    })?;
                }
                "meshes" => {
                    json.meshes = list(&mut map, known, |mut value| {
                        targets.push(take_targets(&mut value)?);
                        from_value(value)
                    })?;
                }
                "accessors" => json.accessors = list(&mut map, known, from_value)?,
                "bufferViews" => json.buffer_views = list(&mut map, known, from_value)?,
                "buffers" => json.buffers = list(&mut map, known, from_value)?,
                "materials" => *materials = list(&mut map, known, from_value)?,
                "cameras" => *cameras = list(&mut map, known, from_value)?,
                "skins" => *skins = list(&mut map, known, from_value)?,
                "textures" => json.textures = list(&mut map, known, from_value)?,
                "samplers" => json.samplers = list(&mut map, known, from_value)?,
                "images" => json.images = list(&mut map, known, from_value)?,
                "extensions" => {
                    let extensions: RootExtensions = property(&mut map, known)?;
                    *lights = extensions.lights.map(|extension| extension.lights).unwrap_or_default();
                    *variants = extensions.variants.map(|extension| extension.variants).unwrap_or_default();
                }
                _ => {}
            }
        }
        if seen.contains(&"asset") { Ok(document) } else { Err(A::Error::missing_field("asset")) }
    }
}

#[derive(Deserialize)]
struct RootExtensions {
    #[serde(rename = "KHR_lights_punctual")]
    lights: Option<Lights>,
    #[serde(rename = "KHR_materials_variants")]
    variants: Option<Variants>,
}

#[derive(Deserialize)]
struct Variants {
    variants: Vec<Variant>,
}

#[derive(Deserialize)]
struct Lights {
    lights: Vec<Light>,
}

/// Adds the list of nodes, which glTF makes optional and `gltf::json` does not.
fn scene(mut value: Value) -> Result<gltf::json::Scene, serde_json::Error> {
    if let Some(scene) = value.as_object_mut() {
        scene.entry("nodes").or_insert_with(|| Value::Array(Vec::new()));
    }
    from_value(value)
}

/// Takes the morph targets out of a mesh's primitives: `gltf::json` does not know those of colours.
fn take_targets(mesh: &mut Value) -> Result<Vec<Vec<Target>>, serde_json::Error> {
    let primitives = mesh.get_mut("primitives").and_then(Value::as_array_mut);
    let take = |primitive: &mut Value| match primitive.as_object_mut().and_then(|object| object.remove("targets")) {
        Some(targets) => from_value(targets),
        None => Ok(Vec::new()),
    };
    primitives.into_iter().flatten().map(take).collect()
}
