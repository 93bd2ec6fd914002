//! Properties that hold for any scene bytes, for the fuzz targets (`tests/fuzz`) and the smoke test
//! (`tests/fuzz_smoke.rs`) only. Each panics if its property does not hold.

use std::path::Path;

use crate::{LoadOptions, Scene, pack};

/// A packed scene that is accepted survives packing and unpacking again. The bytes are tried unchanged, and again as
/// the content of the LZ4 block, which mutations do not reach.
pub fn packed(bytes: &[u8]) {
    for sent in [bytes.to_vec(), pack::seal(bytes)] {
        if let Ok(scene) = Scene::unpack(&sent) {
            travels(&scene);
        }
    }
}

/// A file accepted as glTF survives packing and unpacking. The bytes are written to `file`.
pub fn gltf(bytes: &[u8], file: &Path) {
    if std::fs::write(file, bytes).is_err() {
        return;
    }
    if let Ok(scene) = Scene::load(file, &LoadOptions::default()) {
        travels(&scene);
    }
}

fn travels(scene: &Scene) {
    // Only scenes that are too large to travel cannot be packed.
    if let Ok(packed) = scene.pack() {
        assert!(Scene::unpack(&packed).is_ok_and(|again| again == *scene), "a scene does not survive packing");
    }
}
