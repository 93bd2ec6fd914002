//! The part of glTF's JSON that Gnomon reads, as serde types.
//!
//! Own types, because transforms must be read as f64 (a scene may lie kilometres from its origin), because every list is
//! bounded while it is parsed, and because indices must not be truncated. Unknown properties are ignored, as §3.12 asks.

use serde::{Deserialize, de::IgnoredAny};

use super::parse::{Text, count, list, object, optional, strings};
use crate::limits::{
    MAX_ACCESSORS, MAX_BUFFER_VIEWS, MAX_BUFFERS, MAX_IMAGES, MAX_LIGHT_DEFINITIONS, MAX_MATERIALS, MAX_MESHES,
    MAX_NODES, MAX_SCENES, MAX_TEXTURES,
};

/// The root (§5.17).
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Document<'a> {
    #[serde(deserialize_with = "object")]
    pub(crate) asset: Asset,
    #[serde(default, deserialize_with = "strings")]
    pub(crate) extensions_required: Vec<String>,
    pub(crate) scene: Option<u32>,
    #[serde(default, deserialize_with = "list::<_, _, MAX_SCENES>")]
    pub(crate) scenes: Vec<SceneRoots>,
    #[serde(default, deserialize_with = "list::<_, _, MAX_NODES>")]
    pub(crate) nodes: Vec<Node>,
    #[serde(default, deserialize_with = "list::<_, _, MAX_MESHES>")]
    pub(crate) meshes: Vec<Mesh>,
    #[serde(default, deserialize_with = "list::<_, _, MAX_ACCESSORS>")]
    pub(crate) accessors: Vec<Accessor>,
    #[serde(default, deserialize_with = "list::<_, _, MAX_BUFFER_VIEWS>")]
    pub(crate) buffer_views: Vec<BufferView>,
    #[serde(borrow, default, deserialize_with = "list::<_, _, MAX_BUFFERS>")]
    pub(crate) buffers: Vec<Buffer<'a>>,
    #[serde(default, deserialize_with = "list::<_, _, MAX_MATERIALS>")]
    pub(crate) materials: Vec<Material>,
    #[serde(default, deserialize_with = "list::<_, _, MAX_TEXTURES>")]
    pub(crate) textures: Vec<Texture>,
    #[serde(default, deserialize_with = "list::<_, _, MAX_TEXTURES>")]
    pub(crate) samplers: Vec<Sampler>,
    #[serde(borrow, default, deserialize_with = "list::<_, _, MAX_IMAGES>")]
    pub(crate) images: Vec<Image<'a>>,
    #[serde(default, deserialize_with = "object")]
    pub(crate) extensions: RootExtensions,
}

/// §5.3.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Asset {
    pub(crate) version: String,
    pub(crate) min_version: Option<String>,
}

/// Extensions of the root.
#[derive(Default, Deserialize)]
pub(crate) struct RootExtensions {
    #[serde(rename = "KHR_lights_punctual", default, deserialize_with = "optional")]
    pub(crate) lights: Option<Lights>,
}

/// KHR_lights_punctual at the root.
#[derive(Deserialize)]
pub(crate) struct Lights {
    #[serde(deserialize_with = "list::<_, _, MAX_LIGHT_DEFINITIONS>")]
    pub(crate) lights: Vec<Light>,
}

/// KHR_lights_punctual, one light.
#[derive(Deserialize)]
pub(crate) struct Light {
    pub(crate) name: Option<String>,
    #[serde(rename = "type")]
    pub(crate) kind: String,
    pub(crate) color: Option<[f64; 3]>,
    pub(crate) intensity: Option<f64>,
    pub(crate) range: Option<f64>,
    #[serde(default, deserialize_with = "optional")]
    pub(crate) spot: Option<Spot>,
}

/// KHR_lights_punctual, a spot's cone.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Spot {
    pub(crate) inner_cone_angle: Option<f64>,
    pub(crate) outer_cone_angle: Option<f64>,
}

/// §5.26.
#[derive(Deserialize)]
pub(crate) struct SceneRoots {
    #[serde(default)]
    pub(crate) nodes: Vec<u32>,
}

/// §5.25.
#[derive(Deserialize)]
pub(crate) struct Node {
    pub(crate) name: Option<String>,
    #[serde(default)]
    pub(crate) children: Vec<u32>,
    pub(crate) mesh: Option<u32>,
    pub(crate) skin: Option<u32>,
    pub(crate) matrix: Option<[f64; 16]>,
    pub(crate) translation: Option<[f64; 3]>,
    pub(crate) rotation: Option<[f64; 4]>,
    pub(crate) scale: Option<[f64; 3]>,
    pub(crate) weights: Option<Vec<f64>>,
    #[serde(default, deserialize_with = "object")]
    pub(crate) extensions: NodeExtensions,
}

/// Extensions of a node.
#[derive(Default, Deserialize)]
pub(crate) struct NodeExtensions {
    #[serde(rename = "KHR_lights_punctual", default, deserialize_with = "optional")]
    pub(crate) light: Option<NodeLight>,
    #[serde(rename = "KHR_node_visibility", default, deserialize_with = "optional")]
    pub(crate) visibility: Option<Visibility>,
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    pub(crate) instancing: Option<IgnoredAny>,
}

/// KHR_lights_punctual on a node.
#[derive(Deserialize)]
pub(crate) struct NodeLight {
    pub(crate) light: u32,
}

/// KHR_node_visibility.
#[derive(Deserialize)]
pub(crate) struct Visibility {
    pub(crate) visible: Option<bool>,
}

/// §5.23.
#[derive(Deserialize)]
pub(crate) struct Mesh {
    pub(crate) name: Option<String>,
    #[serde(deserialize_with = "list::<_, _, MAX_MESHES>")]
    pub(crate) primitives: Vec<Primitive>,
    pub(crate) weights: Option<Vec<f64>>,
}

/// §5.24.
#[derive(Deserialize)]
pub(crate) struct Primitive {
    #[serde(deserialize_with = "object")]
    pub(crate) attributes: Attributes,
    pub(crate) indices: Option<u32>,
    pub(crate) material: Option<u32>,
    pub(crate) mode: Option<u32>,
    #[serde(default, deserialize_with = "count")]
    pub(crate) targets: usize,
    #[serde(default, deserialize_with = "object")]
    pub(crate) extensions: PrimitiveExtensions,
}

/// Vertex attributes that are read. Texture coordinate sets beyond the fourth are an error where a material uses them.
#[derive(Deserialize)]
pub(crate) struct Attributes {
    #[serde(rename = "POSITION")]
    pub(crate) position: Option<u32>,
    #[serde(rename = "NORMAL")]
    pub(crate) normal: Option<u32>,
    #[serde(rename = "TEXCOORD_0")]
    pub(crate) texcoord_0: Option<u32>,
    #[serde(rename = "TEXCOORD_1")]
    pub(crate) texcoord_1: Option<u32>,
    #[serde(rename = "TEXCOORD_2")]
    pub(crate) texcoord_2: Option<u32>,
    #[serde(rename = "TEXCOORD_3")]
    pub(crate) texcoord_3: Option<u32>,
}

impl Attributes {
    /// The accessor of a texture coordinate set, of which the first four are read.
    pub(crate) fn texcoord(&self, set: u32) -> Option<u32> {
        match set {
            0 => self.texcoord_0,
            1 => self.texcoord_1,
            2 => self.texcoord_2,
            3 => self.texcoord_3,
            _ => None,
        }
    }
}

/// Extensions of a primitive.
#[derive(Default, Deserialize)]
pub(crate) struct PrimitiveExtensions {
    #[serde(rename = "KHR_draco_mesh_compression")]
    pub(crate) draco: Option<IgnoredAny>,
    #[serde(rename = "KHR_gaussian_splatting")]
    pub(crate) splats: Option<IgnoredAny>,
}

/// §5.1.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Accessor {
    pub(crate) buffer_view: Option<u32>,
    #[serde(default)]
    pub(crate) byte_offset: u64,
    pub(crate) component_type: u32,
    #[serde(default)]
    pub(crate) normalized: bool,
    pub(crate) count: u64,
    #[serde(rename = "type")]
    pub(crate) shape: String,
    #[serde(default, deserialize_with = "optional")]
    pub(crate) sparse: Option<Sparse>,
}

/// §5.2.
#[derive(Deserialize)]
pub(crate) struct Sparse {
    pub(crate) count: u64,
    #[serde(deserialize_with = "object")]
    pub(crate) indices: SparseIndices,
    #[serde(deserialize_with = "object")]
    pub(crate) values: SparseValues,
}

/// §5.3.1 of the schema: accessor.sparse.indices.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct SparseIndices {
    pub(crate) buffer_view: u32,
    #[serde(default)]
    pub(crate) byte_offset: u64,
    pub(crate) component_type: u32,
}

/// accessor.sparse.values.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct SparseValues {
    pub(crate) buffer_view: u32,
    #[serde(default)]
    pub(crate) byte_offset: u64,
}

/// §5.11.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct BufferView {
    pub(crate) buffer: u32,
    #[serde(default)]
    pub(crate) byte_offset: u64,
    pub(crate) byte_length: u64,
    pub(crate) byte_stride: Option<u64>,
    #[serde(default, deserialize_with = "object")]
    pub(crate) extensions: BufferViewExtensions,
}

/// Extensions of a buffer view.
#[derive(Default, Deserialize)]
pub(crate) struct BufferViewExtensions {
    #[serde(rename = "EXT_meshopt_compression")]
    pub(crate) ext_meshopt: Option<IgnoredAny>,
    #[serde(rename = "KHR_meshopt_compression")]
    pub(crate) khr_meshopt: Option<IgnoredAny>,
}

/// §5.10.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Buffer<'a> {
    #[serde(borrow)]
    pub(crate) uri: Option<Text<'a>>,
    pub(crate) byte_length: u64,
}

/// §5.19.
#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Material {
    pub(crate) name: Option<String>,
    #[serde(default, deserialize_with = "object")]
    pub(crate) pbr_metallic_roughness: MetallicRoughness,
    pub(crate) emissive_factor: Option<[f64; 3]>,
    pub(crate) emissive_texture: Option<IgnoredAny>,
    pub(crate) alpha_mode: Option<String>,
    pub(crate) alpha_cutoff: Option<f64>,
    #[serde(default)]
    pub(crate) double_sided: bool,
    #[serde(default, deserialize_with = "object")]
    pub(crate) extensions: MaterialExtensions,
}

/// §5.22.
#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct MetallicRoughness {
    pub(crate) base_color_factor: Option<[f64; 4]>,
    #[serde(default, deserialize_with = "optional")]
    pub(crate) base_color_texture: Option<TextureInfo>,
}

/// Extensions of a material.
#[derive(Default, Deserialize)]
pub(crate) struct MaterialExtensions {
    #[serde(rename = "KHR_materials_emissive_strength", default, deserialize_with = "optional")]
    pub(crate) emissive_strength: Option<EmissiveStrength>,
    #[serde(rename = "KHR_materials_pbrSpecularGlossiness")]
    pub(crate) specular_glossiness: Option<IgnoredAny>,
}

/// KHR_materials_emissive_strength.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct EmissiveStrength {
    pub(crate) emissive_strength: Option<f64>,
}

/// §5.30.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct TextureInfo {
    pub(crate) index: u32,
    #[serde(default)]
    pub(crate) tex_coord: u32,
    #[serde(default, deserialize_with = "object")]
    pub(crate) extensions: TextureInfoExtensions,
}

/// Extensions of a texture reference.
#[derive(Default, Deserialize)]
pub(crate) struct TextureInfoExtensions {
    #[serde(rename = "KHR_texture_transform", default, deserialize_with = "optional")]
    pub(crate) transform: Option<TextureTransform>,
}

/// KHR_texture_transform.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct TextureTransform {
    pub(crate) offset: Option<[f64; 2]>,
    pub(crate) rotation: Option<f64>,
    pub(crate) scale: Option<[f64; 2]>,
    pub(crate) tex_coord: Option<u32>,
}

/// §5.29.
#[derive(Deserialize)]
pub(crate) struct Texture {
    pub(crate) sampler: Option<u32>,
    pub(crate) source: Option<u32>,
    #[serde(default, deserialize_with = "object")]
    pub(crate) extensions: TextureExtensions,
}

/// Extensions of a texture: pictures in formats that are not read.
#[derive(Default, Deserialize)]
pub(crate) struct TextureExtensions {
    #[serde(rename = "KHR_texture_basisu")]
    pub(crate) basisu: Option<IgnoredAny>,
    #[serde(rename = "EXT_texture_webp")]
    pub(crate) webp: Option<IgnoredAny>,
    #[serde(rename = "EXT_texture_avif")]
    pub(crate) avif: Option<IgnoredAny>,
    #[serde(rename = "MSFT_texture_dds")]
    pub(crate) dds: Option<IgnoredAny>,
}

/// §5.27.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Sampler {
    pub(crate) wrap_s: Option<u32>,
    pub(crate) wrap_t: Option<u32>,
}

/// §5.18.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Image<'a> {
    pub(crate) name: Option<String>,
    #[serde(borrow)]
    pub(crate) uri: Option<Text<'a>>,
    pub(crate) buffer_view: Option<u32>,
}

/// Parses a file's JSON.
///
/// # Errors
/// A sentence: no such JSON, a list that is too long, or another version of glTF.
pub(crate) fn parse(json: &[u8]) -> Result<Document<'_>, String> {
    let mut deserializer = serde_json::Deserializer::from_slice(json);
    let document: Document<'_> = object(&mut deserializer).map_err(|error| error.to_string())?;
    deserializer.end().map_err(|error| error.to_string())?;
    let asset = &document.asset;
    // Minor versions are compatible, unless the file asks for a least one (§2.5).
    if asset.version.split_once('.').map(|(major, _)| major) != Some("2") {
        return Err(format!("its asset version is {:.32?}, not 2.0", asset.version));
    }
    if let Some(least) = asset.min_version.as_deref().filter(|least| *least != "2.0") {
        return Err(format!("it asks for a reader of version {least:.32?}; this one reads 2.0"));
    }
    Ok(document)
}
