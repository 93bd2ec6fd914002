//! Properties that hold for any bytes that a scene is read from. The fuzz targets (`tests/fuzz`) and the stable smoke test
//! (`tests/fuzz_smoke.rs`) call these; nothing else should. Each panics when its property does not hold.

use std::path::Path;

use crate::{LoadOptions, Scene, pack};

/// A packed scene that is accepted keeps its guarantees, and comes back from another journey as it is. The bytes are taken for what was
/// sent, and again for what was compressed: no mutation finds its way through LZ4.
pub fn packed(bytes: &[u8]) {
    for sent in [bytes.to_vec(), pack::seal(bytes)] {
        if let Ok(scene) = Scene::unpack(&sent) {
            travels(&scene);
        }
    }
}

/// A file that is accepted as glTF is a scene that can travel. `file` is where to write it: its name says which of the two kinds it is.
pub fn gltf(bytes: &[u8], file: &Path) {
    if std::fs::write(file, bytes).is_err() {
        return;
    }
    if let Ok(scene) = Scene::load(file, &LoadOptions::default()) {
        travels(&scene);
    }
}

fn travels(scene: &Scene) {
    // More than may travel is refused, and nothing else.
    if let Ok(packed) = scene.pack() {
        assert!(Scene::unpack(&packed).is_ok_and(|again| again == *scene), "a scene changes on its way");
    }
}
