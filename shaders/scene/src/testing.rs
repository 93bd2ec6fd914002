//! A small scene file for tests of the programs that load scenes.

use std::{
    io,
    path::{Path, PathBuf},
};

/// Writes `scene.gltf` and `scene.bin` into `folder` and returns the path of the former: an 8 × 8 m floor, a 1 × 1 m
/// square above it, and two point lights.
///
/// # Errors
/// Errors if a file cannot be written.
pub fn write_scene(folder: &Path) -> io::Result<PathBuf> {
    let positions: [[f32; 3]; 8] = [
        [-4.0, 0.0, -4.0],
        [4.0, 0.0, -4.0],
        [4.0, 0.0, 4.0],
        [-4.0, 0.0, 4.0],
        [-0.5, 1.0, -0.5],
        [0.5, 1.0, -0.5],
        [0.5, 1.0, 0.5],
        [-0.5, 1.0, 0.5],
    ];
    let indices: [u16; 12] = [0, 2, 1, 0, 3, 2, 4, 6, 5, 4, 7, 6];
    let mut bytes: Vec<u8> = positions.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
    bytes.extend(indices.iter().flat_map(|index| index.to_le_bytes()));
    std::fs::write(folder.join("scene.bin"), &bytes)?;
    let gltf = serde_json::json!({
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_lights_punctual"],
        "extensions": {"KHR_lights_punctual": {"lights": [
            {"type": "point", "intensity": 100.0},
            {"type": "point", "intensity": 50.0, "color": [1.0, 0.5, 0.25]},
        ]}},
        "scene": 0,
        "scenes": [{"nodes": [0, 1, 2]}],
        "nodes": [
            {"mesh": 0},
            {"translation": [0.0, 2.0, 0.0], "extensions": {"KHR_lights_punctual": {"light": 0}}},
            {"translation": [2.0, 3.0, 1.0], "extensions": {"KHR_lights_punctual": {"light": 1}}},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"doubleSided": true}],
        "buffers": [{"uri": "scene.bin", "byteLength": bytes.len()}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 96},
            {"buffer": 0, "byteOffset": 96, "byteLength": 24},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3",
             "min": [-4.0, 0.0, -4.0], "max": [4.0, 1.0, 4.0]},
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
    });
    let path = folder.join("scene.gltf");
    std::fs::write(&path, gltf.to_string())?;
    Ok(path)
}
