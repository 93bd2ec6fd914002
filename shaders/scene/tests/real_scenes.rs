//! Real scenes load, match an independent reader's counts of triangles and lights, and survive packing.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

mod common;

use std::path::Path;

use common::scenes;
use gnomon_scene::{LoadOptions, Scene};

fn options(folder: &Path, lights: usize) -> LoadOptions {
    LoadOptions { lights_from: (lights == 0).then(|| folder.join("lights_camera.json")), ..LoadOptions::default() }
}

/// File, triangles, zero-area triangles among them, lights of its own.
const SCENES: [(&str, u64, u64, usize); 7] = [
    ("sponza/sponza.gltf", 262_267, 1, 0),
    ("sponza/sponza_lights.gltf", 262_267, 1, 8),
    ("sponza-dabrovic/sponza-dabrovic.glb", 66_973, 0, 1),
    ("grey-white-room/grey-white-room.glb", 143_163, 190, 0),
    ("pink-room-partial/pink-room-partial.glb", 295_906, 256, 1),
    ("modern-hall/modern-hall.glb", 31_047, 2_432, 13),
    ("breakfast-room/breakfast-room.glb", 269_538, 0, 0),
];

#[test]
fn real_scenes_load_and_survive_packing() {
    for (file, triangles, degenerate, lights) in SCENES {
        let path = scenes().join(file);
        let loaded = Scene::load_with_report(&path, &options(path.parent().unwrap(), lights));
        let (scene, report) = loaded.unwrap_or_else(|error| panic!("{file}: {error}"));
        scene.check().unwrap();
        let packed = scene.pack().unwrap();
        let unpacked = Scene::unpack(&packed).unwrap();
        assert!(unpacked == scene, "{file} did not survive packing");
        assert_eq!(scene.triangles.len() as u64 + report.dropped_triangles, triangles, "{file}");
        assert_eq!(report.dropped_triangles, degenerate, "{file}");
        if lights > 0 {
            assert_eq!(scene.lights.len(), lights, "{file}");
        }
    }
}
