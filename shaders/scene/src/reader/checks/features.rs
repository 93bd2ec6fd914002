//! Refuses features that Gnomon does not read, and names them.
//!
//! A required extension must be known. An optional one is ignored, unless that would show other geometry or another
//! base colour than intended.

use gltf::json::mesh::Primitive;
use serde_json::{Map, Value};

use crate::{
    error::{SceneError, place},
    reader::json::Document,
};

/// Extensions that are read, or that do not affect Gnomon's shading.
const KNOWN: [&str; 24] = [
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_draco_mesh_compression",
    "KHR_lights_punctual",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_diffuse_transmission",
    "KHR_materials_dispersion",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_node_visibility",
    "KHR_texture_basisu",
    "KHR_texture_transform",
    "KHR_xmp",
    "KHR_xmp_json_ld",
];

/// Errors with [`SceneError::Unsupported`] at the first feature that is not supported.
pub(crate) fn check(document: &Document) -> Result<(), SceneError> {
    let json = &document.json;
    for name in &json.extensions_required {
        if !KNOWN.contains(&name.as_str()) {
            return Err(SceneError::unsupported("the file", format!("the required extension {name:.100}")));
        }
    }
    for (index, mesh) in json.meshes.iter().enumerate() {
        for (number, primitive) in mesh.primitives.iter().enumerate() {
            let here = || format!("{}, primitive {number}", place("mesh", index, mesh.name.as_deref()));
            let others = primitive.extensions.as_ref().map(|extensions| &extensions.others);
            refuse(others, &["KHR_gaussian_splatting"], here)?;
            if morphs(primitive) && weighted(mesh.weights.as_ref()) {
                return Err(SceneError::unsupported(here(), "morph targets with weights other than 0"));
            }
        }
    }
    for (index, node) in json.nodes.iter().enumerate() {
        let here = || place("node", index, node.name.as_deref());
        let others = node.extensions.as_ref().map(|extensions| &extensions.others);
        refuse(others, &["EXT_mesh_gpu_instancing"], here)?;
        let Some(mesh) = node.mesh else { continue };
        if node.skin.is_some() {
            return Err(SceneError::unsupported(here(), "a skin"));
        }
        if weighted(node.weights.as_ref()) && json.get(mesh).is_some_and(|mesh| mesh.primitives.iter().any(morphs)) {
            return Err(SceneError::unsupported(here(), "morph targets with weights other than 0"));
        }
    }
    for (index, material) in json.materials.iter().enumerate() {
        let others = material.extensions.as_ref().map(|extensions| &extensions.others);
        let here = || place("material", index, material.name.as_deref());
        refuse(others, &["KHR_materials_pbrSpecularGlossiness"], here)?;
    }
    Ok(())
}

/// Errors at the first of the extensions `names` that an object has.
fn refuse(
    extensions: Option<&Map<String, Value>>,
    names: &[&str],
    here: impl Fn() -> String,
) -> Result<(), SceneError> {
    let there = |name: &&&str| extensions.is_some_and(|extensions| extensions.contains_key(**name));
    names.iter().find(there).map_or(Ok(()), |name| Err(SceneError::unsupported(here(), *name)))
}

fn morphs(primitive: &Primitive) -> bool {
    primitive.targets.as_ref().is_some_and(|targets| !targets.is_empty())
}

fn weighted(weights: Option<&Vec<f32>>) -> bool {
    weights.is_some_and(|weights| weights.iter().any(|weight| *weight != 0.0))
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;
    use crate::reader::json::parse;

    fn fault(properties: Value) -> Option<String> {
        let mut json = properties;
        json["asset"] = json!({"version": "2.0"});
        check(&parse(json.to_string().as_bytes()).unwrap()).err().map(|error| error.to_string())
    }

    #[test]
    fn required_extensions_must_be_known_and_optional_ones_need_not() {
        assert_eq!(fault(json!({"extensionsUsed": ["NEW_thing"], "extensions": {"NEW_thing": {}}})), None);
        assert!(fault(json!({"extensionsRequired": ["NEW_thing"]})).unwrap().contains("NEW_thing"));
        for name in KNOWN {
            assert_eq!(fault(json!({"extensionsRequired": [name]})), None);
        }
    }

    #[test]
    fn morph_targets_matter_only_where_they_have_weight() {
        let mesh = |weights: Value| json!({"primitives": [{"attributes": {}, "targets": [{}]}], "weights": weights});
        let with = |mesh: Value, node: Value| fault(json!({"meshes": [mesh], "nodes": [node]}));
        assert_eq!(with(mesh(json!([0])), json!({"mesh": 0})), None);
        assert!(with(mesh(json!([0.5])), json!({"mesh": 0})).unwrap().contains("mesh 0, primitive 0 uses morph"));
        assert!(with(mesh(json!([0])), json!({"mesh": 0, "weights": [1]})).unwrap().contains("node 0 uses morph"));
    }

    #[test]
    fn skins_matter_only_where_they_move_a_mesh() {
        assert_eq!(fault(json!({"skins": [{}], "nodes": [{"skin": 0}]})), None);
        let both = json!({"nodes": [{"mesh": 0, "skin": 0, "name": "fox"}]});
        assert_eq!(fault(both).unwrap(), "node 0 \"fox\" uses a skin, which is not supported");
    }
}
