//! The part of glTF's JSON that Gnomon reads, as serde types.
//!
//! Own types, because transforms must be read as f64 (a scene may lie kilometres from its origin), because every list is
//! bounded while it is parsed, and because indices must not be truncated. Unknown properties are ignored, as §3.12 asks.

use serde::{Deserialize, de::IgnoredAny};

use super::json::{Text, count, list, object, optional, strings};
use crate::limits::{
    MAX_ACCESSORS, MAX_BUFFER_VIEWS, MAX_BUFFERS, MAX_IMAGES, MAX_LIGHT_DEFINITIONS, MAX_MATERIALS, MAX_MESHES,
    MAX_NODES, MAX_SCENES, MAX_TEXTURES,
};

/// The root (§5.17).
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Document<'a> {
    #[serde(deserialize_with = "object")]
    pub(super) asset: Asset,
    #[serde(default, deserialize_with = "strings")]
    pub(super) extensions_required: Vec<String>,
    pub(super) scene: Option<u32>,
    #[serde(default, deserialize_with = "list::<_, _, MAX_SCENES>")]
    pub(super) scenes: Vec<SceneRoots>,
    #[serde(default, deserialize_with = "list::<_, _, MAX_NODES>")]
    pub(super) nodes: Vec<Node>,
    #[serde(default, deserialize_with = "list::<_, _, MAX_MESHES>")]
    pub(super) meshes: Vec<Mesh>,
    #[serde(default, deserialize_with = "list::<_, _, MAX_ACCESSORS>")]
    pub(super) accessors: Vec<Accessor>,
    #[serde(default, deserialize_with = "list::<_, _, MAX_BUFFER_VIEWS>")]
    pub(super) buffer_views: Vec<BufferView>,
    #[serde(borrow, default, deserialize_with = "list::<_, _, MAX_BUFFERS>")]
    pub(super) buffers: Vec<Buffer<'a>>,
    #[serde(default, deserialize_with = "list::<_, _, MAX_MATERIALS>")]
    pub(super) materials: Vec<Material>,
    #[serde(default, deserialize_with = "list::<_, _, MAX_TEXTURES>")]
    pub(super) textures: Vec<Texture>,
    #[serde(default, deserialize_with = "list::<_, _, MAX_TEXTURES>")]
    pub(super) samplers: Vec<Sampler>,
    #[serde(borrow, default, deserialize_with = "list::<_, _, MAX_IMAGES>")]
    pub(super) images: Vec<Image<'a>>,
    #[serde(default, deserialize_with = "object")]
    pub(super) extensions: RootExtensions,
}

/// §5.3.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Asset {
    pub(super) version: String,
    pub(super) min_version: Option<String>,
}

/// Extensions of the root.
#[derive(Default, Deserialize)]
pub(super) struct RootExtensions {
    #[serde(rename = "KHR_lights_punctual", default, deserialize_with = "optional")]
    pub(super) lights: Option<Lights>,
}

/// KHR_lights_punctual at the root.
#[derive(Deserialize)]
pub(super) struct Lights {
    #[serde(deserialize_with = "list::<_, _, MAX_LIGHT_DEFINITIONS>")]
    pub(super) lights: Vec<Light>,
}

/// KHR_lights_punctual, one light.
#[derive(Deserialize)]
pub(super) struct Light {
    pub(super) name: Option<String>,
    #[serde(rename = "type")]
    pub(super) kind: String,
    pub(super) color: Option<[f64; 3]>,
    pub(super) intensity: Option<f64>,
    pub(super) range: Option<f64>,
    #[serde(default, deserialize_with = "optional")]
    pub(super) spot: Option<Spot>,
}

/// KHR_lights_punctual, a spot's cone.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Spot {
    pub(super) inner_cone_angle: Option<f64>,
    pub(super) outer_cone_angle: Option<f64>,
}

/// §5.26.
#[derive(Deserialize)]
pub(super) struct SceneRoots {
    #[serde(default)]
    pub(super) nodes: Vec<u32>,
}

/// §5.25.
#[derive(Deserialize)]
pub(super) struct Node {
    pub(super) name: Option<String>,
    #[serde(default)]
    pub(super) children: Vec<u32>,
    pub(super) mesh: Option<u32>,
    pub(super) skin: Option<u32>,
    pub(super) matrix: Option<[f64; 16]>,
    pub(super) translation: Option<[f64; 3]>,
    pub(super) rotation: Option<[f64; 4]>,
    pub(super) scale: Option<[f64; 3]>,
    pub(super) weights: Option<Vec<f64>>,
    #[serde(default, deserialize_with = "object")]
    pub(super) extensions: NodeExtensions,
}

/// Extensions of a node.
#[derive(Default, Deserialize)]
pub(super) struct NodeExtensions {
    #[serde(rename = "KHR_lights_punctual", default, deserialize_with = "optional")]
    pub(super) light: Option<NodeLight>,
    #[serde(rename = "KHR_node_visibility", default, deserialize_with = "optional")]
    pub(super) visibility: Option<Visibility>,
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    pub(super) instancing: Option<IgnoredAny>,
}

/// KHR_lights_punctual on a node.
#[derive(Deserialize)]
pub(super) struct NodeLight {
    pub(super) light: u32,
}

/// KHR_node_visibility.
#[derive(Deserialize)]
pub(super) struct Visibility {
    pub(super) visible: Option<bool>,
}

/// §5.23.
#[derive(Deserialize)]
pub(super) struct Mesh {
    pub(super) name: Option<String>,
    #[serde(deserialize_with = "list::<_, _, MAX_MESHES>")]
    pub(super) primitives: Vec<Primitive>,
    pub(super) weights: Option<Vec<f64>>,
}

/// §5.24.
#[derive(Deserialize)]
pub(super) struct Primitive {
    #[serde(deserialize_with = "object")]
    pub(super) attributes: Attributes,
    pub(super) indices: Option<u32>,
    pub(super) material: Option<u32>,
    pub(super) mode: Option<u32>,
    #[serde(default, deserialize_with = "count")]
    pub(super) targets: usize,
    #[serde(default, deserialize_with = "object")]
    pub(super) extensions: PrimitiveExtensions,
}

/// Vertex attributes that are read. Texture coordinate sets beyond the fourth are an error where a material uses them.
#[derive(Deserialize)]
pub(super) struct Attributes {
    #[serde(rename = "POSITION")]
    pub(super) position: Option<u32>,
    #[serde(rename = "NORMAL")]
    pub(super) normal: Option<u32>,
    #[serde(rename = "TEXCOORD_0")]
    pub(super) texcoord_0: Option<u32>,
    #[serde(rename = "TEXCOORD_1")]
    pub(super) texcoord_1: Option<u32>,
    #[serde(rename = "TEXCOORD_2")]
    pub(super) texcoord_2: Option<u32>,
    #[serde(rename = "TEXCOORD_3")]
    pub(super) texcoord_3: Option<u32>,
}

impl Attributes {
    /// The accessor of a texture coordinate set, of which the first four are read.
    pub(super) fn texcoord(&self, set: u32) -> Option<u32> {
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
pub(super) struct PrimitiveExtensions {
    #[serde(rename = "KHR_draco_mesh_compression")]
    pub(super) draco: Option<IgnoredAny>,
    #[serde(rename = "KHR_gaussian_splatting")]
    pub(super) splats: Option<IgnoredAny>,
}

/// §5.1.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    pub(super) buffer_view: Option<u32>,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) component_type: u32,
    #[serde(default)]
    pub(super) normalized: bool,
    pub(super) count: u64,
    #[serde(rename = "type")]
    pub(super) shape: String,
    #[serde(default, deserialize_with = "optional")]
    pub(super) sparse: Option<Sparse>,
}

/// §5.2.
#[derive(Deserialize)]
pub(super) struct Sparse {
    pub(super) count: u64,
    #[serde(deserialize_with = "object")]
    pub(super) indices: SparseIndices,
    #[serde(deserialize_with = "object")]
    pub(super) values: SparseValues,
}

/// §5.3.1 of the schema: accessor.sparse.indices.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseIndices {
    pub(super) buffer_view: u32,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) component_type: u32,
}

/// accessor.sparse.values.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseValues {
    pub(super) buffer_view: u32,
    #[serde(default)]
    pub(super) byte_offset: u64,
}

/// §5.11.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    pub(super) buffer: u32,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) byte_length: u64,
    pub(super) byte_stride: Option<u64>,
    #[serde(default, deserialize_with = "object")]
    pub(super) extensions: BufferViewExtensions,
}

/// Extensions of a buffer view.
#[derive(Default, Deserialize)]
pub(super) struct BufferViewExtensions {
    #[serde(rename = "EXT_meshopt_compression")]
    pub(super) ext_meshopt: Option<IgnoredAny>,
    #[serde(rename = "KHR_meshopt_compression")]
    pub(super) khr_meshopt: Option<IgnoredAny>,
}

/// §5.10.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Buffer<'a> {
    #[serde(borrow)]
    pub(super) uri: Option<Text<'a>>,
    pub(super) byte_length: u64,
}

/// §5.19.
#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Material {
    pub(super) name: Option<String>,
    #[serde(default, deserialize_with = "object")]
    pub(super) pbr_metallic_roughness: MetallicRoughness,
    pub(super) emissive_factor: Option<[f64; 3]>,
    pub(super) emissive_texture: Option<IgnoredAny>,
    pub(super) alpha_mode: Option<String>,
    pub(super) alpha_cutoff: Option<f64>,
    #[serde(default)]
    pub(super) double_sided: bool,
    #[serde(default, deserialize_with = "object")]
    pub(super) extensions: MaterialExtensions,
}

/// §5.22.
#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct MetallicRoughness {
    pub(super) base_color_factor: Option<[f64; 4]>,
    #[serde(default, deserialize_with = "optional")]
    pub(super) base_color_texture: Option<TextureInfo>,
}

/// Extensions of a material.
#[derive(Default, Deserialize)]
pub(super) struct MaterialExtensions {
    #[serde(rename = "KHR_materials_emissive_strength", default, deserialize_with = "optional")]
    pub(super) emissive_strength: Option<EmissiveStrength>,
    #[serde(rename = "KHR_materials_pbrSpecularGlossiness")]
    pub(super) specular_glossiness: Option<IgnoredAny>,
}

/// KHR_materials_emissive_strength.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct EmissiveStrength {
    pub(super) emissive_strength: Option<f64>,
}

/// §5.30.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct TextureInfo {
    pub(super) index: u32,
    #[serde(default)]
    pub(super) tex_coord: u32,
    #[serde(default, deserialize_with = "object")]
    pub(super) extensions: TextureInfoExtensions,
}

/// Extensions of a texture reference.
#[derive(Default, Deserialize)]
pub(super) struct TextureInfoExtensions {
    #[serde(rename = "KHR_texture_transform", default, deserialize_with = "optional")]
    pub(super) transform: Option<TextureTransform>,
}

/// KHR_texture_transform.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct TextureTransform {
    pub(super) offset: Option<[f64; 2]>,
    pub(super) rotation: Option<f64>,
    pub(super) scale: Option<[f64; 2]>,
    pub(super) tex_coord: Option<u32>,
}

/// §5.29.
#[derive(Deserialize)]
pub(super) struct Texture {
    pub(super) sampler: Option<u32>,
    pub(super) source: Option<u32>,
    #[serde(default, deserialize_with = "object")]
    pub(super) extensions: TextureExtensions,
}

/// Extensions of a texture: pictures in formats that are not read.
#[derive(Default, Deserialize)]
pub(super) struct TextureExtensions {
    #[serde(rename = "KHR_texture_basisu")]
    pub(super) basisu: Option<IgnoredAny>,
    #[serde(rename = "EXT_texture_webp")]
    pub(super) webp: Option<IgnoredAny>,
    #[serde(rename = "EXT_texture_avif")]
    pub(super) avif: Option<IgnoredAny>,
    #[serde(rename = "MSFT_texture_dds")]
    pub(super) dds: Option<IgnoredAny>,
}

/// §5.27.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Sampler {
    pub(super) wrap_s: Option<u32>,
    pub(super) wrap_t: Option<u32>,
}

/// §5.18.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Image<'a> {
    pub(super) name: Option<String>,
    #[serde(borrow)]
    pub(super) uri: Option<Text<'a>>,
    pub(super) buffer_view: Option<u32>,
}

/// Parses a file's JSON.
///
/// # Errors
/// A sentence: no such JSON, a list that is too long, or another version of glTF.
pub(super) fn parse(json: &[u8]) -> Result<Document<'_>, String> {
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
