//! Small scene files for tests of the programs that load scenes.

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

/// Writes `living.gltf` and `living.bin` into `folder` and returns the path of the former: an 8 × 8 m floor, a square
/// that slides over it and turns, a lamp that stands, one that travels, and a camera that rises. Their animations, of
/// four seconds each, are called `slide`, `travel` and `rise`.
///
/// # Errors
/// Errors if a file cannot be written.
pub fn write_living_scene(folder: &Path) -> io::Result<PathBuf> {
    let corners: [[f32; 3]; 8] = [
        [-4.0, 0.0, -4.0],
        [4.0, 0.0, -4.0],
        [4.0, 0.0, 4.0],
        [-4.0, 0.0, 4.0],
        [-0.5, 0.0, -0.5],
        [0.5, 0.0, -0.5],
        [0.5, 0.0, 0.5],
        [-0.5, 0.0, 0.5],
    ];
    let indices: [u16; 6] = [0, 2, 1, 0, 3, 2];
    let times: [f32; 3] = [0.0, 2.0, 4.0];
    let slide: [[f32; 3]; 3] = [[-1.5, 0.8, 0.0], [1.0, 1.2, 0.8], [-1.5, 0.8, 0.0]];
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let turn: [[f32; 4]; 3] = [[0.0, 0.0, 0.0, 1.0], [0.0, half, 0.0, half], [0.0, 0.0, 0.0, 1.0]];
    let travel: [[f32; 3]; 3] = [[2.0, 3.0, 1.0], [-2.0, 3.5, -1.0], [2.0, 3.0, 1.0]];
    let rise: [[f32; 3]; 3] = [[0.0, 2.0, 6.0], [0.5, 3.0, 5.5], [0.0, 2.0, 6.0]];
    let floats = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let parts = [
        floats(corners.as_flattened()),
        indices.iter().flat_map(|index| index.to_le_bytes()).collect(),
        floats(&times),
        floats(slide.as_flattened()),
        floats(turn.as_flattened()),
        floats(travel.as_flattened()),
        floats(rise.as_flattened()),
    ];
    let mut offset = 0;
    let views: Vec<_> = parts
        .iter()
        .map(|part| {
            let view = serde_json::json!({"buffer": 0, "byteOffset": offset, "byteLength": part.len()});
            offset += part.len();
            view
        })
        .collect();
    std::fs::write(folder.join("living.bin"), parts.concat())?;
    let square = |first: usize, side: f32| {
        serde_json::json!({
            "bufferView": 0, "byteOffset": first * 12, "componentType": 5126, "count": 4, "type": "VEC3",
            "min": [-side, 0.0, -side], "max": [side, 0.0, side],
        })
    };
    let keys = |view: usize, kind: &str| {
        let float = 5126;
        serde_json::json!({"bufferView": view, "componentType": float, "count": 3, "type": kind})
    };
    let animation = |name: &str, channels: &[(usize, usize, &str)]| {
        let samplers = channels.iter().map(|(_, output, _)| serde_json::json!({"input": 3, "output": output}));
        let channel = |(sampler, (node, _, path)): (usize, &(usize, usize, &str))| {
            let target = serde_json::json!({"node": node, "path": path});
            serde_json::json!({"sampler": sampler, "target": target})
        };
        serde_json::json!({
            "name": name,
            "samplers": samplers.collect::<Vec<_>>(),
            "channels": channels.iter().enumerate().map(channel).collect::<Vec<_>>(),
        })
    };
    let gltf = serde_json::json!({
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_lights_punctual"],
        "extensions": {"KHR_lights_punctual": {"lights": [
            {"type": "point", "intensity": 100.0},
            {"type": "point", "intensity": 50.0, "color": [1.0, 0.5, 0.25]},
        ]}},
        "scene": 0,
        "scenes": [{"nodes": [0, 1, 2, 3, 4]}],
        "nodes": [
            {"mesh": 0},
            {"mesh": 1, "translation": slide[0]},
            {"translation": [0.0, 3.0, 0.0], "extensions": {"KHR_lights_punctual": {"light": 0}}},
            {"translation": travel[0], "extensions": {"KHR_lights_punctual": {"light": 1}}},
            {"camera": 0, "name": "eye", "translation": rise[0], "rotation": [-0.19, 0.0, 0.0, 0.98]},
        ],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0}, "indices": 2, "material": 0}]},
            {"primitives": [{"attributes": {"POSITION": 1}, "indices": 2, "material": 0}]},
        ],
        "materials": [{"doubleSided": true}],
        "animations": [
            animation("slide", &[(1, 4, "translation"), (1, 5, "rotation")]),
            animation("travel", &[(3, 6, "translation")]),
            animation("rise", &[(4, 7, "translation")]),
        ],
        "buffers": [{"uri": "living.bin", "byteLength": offset}],
        "bufferViews": views,
        "accessors": [
            square(0, 4.0),
            square(4, 0.5),
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
            {"bufferView": 2, "componentType": 5126, "count": 3, "type": "SCALAR", "min": [0.0], "max": [4.0]},
            keys(3, "VEC3"),
            keys(4, "VEC4"),
            keys(5, "VEC3"),
            keys(6, "VEC3"),
        ],
    });
    let path = folder.join("living.gltf");
    std::fs::write(&path, gltf.to_string())?;
    Ok(path)
}
