//! Tells what a file uses and Gnomon does not draw.
//!
//! A required extension must be drawn, or not be visible; otherwise the file is refused. An optional one is ignored and
//! said to be, as the specification asks.

use crate::{LoadReport, error::SceneError, reader::json::Document};

/// Extensions that are drawn.
const DRAWN: [&str; 20] = [
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_animation_pointer",
    "KHR_draco_mesh_compression",
    "KHR_lights_punctual",
    "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_node_visibility",
    "KHR_texture_basisu",
    "KHR_texture_transform",
];

/// Extensions that say something about a file and change no picture.
const INVISIBLE: [&str; 2] = ["KHR_xmp", "KHR_xmp_json_ld"];

/// Extensions of materials that are not drawn: each material that has one is counted where it is read.
const COUNTED: [&str; 5] = [
    "KHR_materials_anisotropy",
    "KHR_materials_diffuse_transmission",
    "KHR_materials_dispersion",
    "KHR_materials_iridescence",
    "KHR_materials_volume",
];

/// Errors with [`SceneError::Unsupported`] at the first feature without which the file cannot be drawn.
pub(crate) fn check(document: &Document, report: &mut LoadReport) -> Result<(), SceneError> {
    let json = &document.json;
    for name in &json.extensions_required {
        if !DRAWN.contains(&name.as_str()) && !INVISIBLE.contains(&name.as_str()) {
            return Err(SceneError::unsupported("the file", format!("the required extension {name:.100}")));
        }
    }
    for name in &json.extensions_used {
        let known = [&DRAWN[..], &INVISIBLE[..], &COUNTED[..]].iter().any(|names| names.contains(&name.as_str()));
        if !known {
            report.not_drawn(format!("the extension {name:.100}"), "");
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;
    use crate::reader::json::parse;

    fn checked(properties: Value) -> Result<LoadReport, String> {
        let mut json = properties;
        json["asset"] = json!({"version": "2.0"});
        let mut report = LoadReport::default();
        let document = parse(json.to_string().as_bytes()).unwrap();
        check(&document, &mut report).map(|()| report).map_err(|error| error.to_string())
    }

    #[test]
    fn required_extensions_must_be_drawn_and_optional_ones_are_said_to_be_ignored() {
        let used = checked(json!({"extensionsUsed": ["NEW_thing"], "extensions": {"NEW_thing": {}}})).unwrap();
        assert_eq!(used.to_string(), "not drawn: the extension NEW_thing");
        for name in ["NEW_thing"].iter().chain(&COUNTED) {
            assert!(checked(json!({"extensionsRequired": [name]})).unwrap_err().contains(name));
        }
        for name in DRAWN.iter().chain(&INVISIBLE) {
            let report = checked(json!({"extensionsRequired": [name], "extensionsUsed": [name]})).unwrap();
            assert!(report.is_empty(), "{report}");
        }
    }
}
