//! Properties that hold for any scene bytes, for the fuzz targets (`tests/fuzz`) and the smoke test
//! (`tests/fuzz_smoke.rs`) only. Each panics if its property does not hold.

use std::path::Path;

use crate::{LoadOptions, Scene, limits::MAX_IMAGE_SIDE_PX, pack, picture, reader::decoders};

/// A packed scene that is accepted survives packing and unpacking again. The bytes are tried unchanged, and again as
/// the content of the Zstandard frame, which mutations do not reach.
pub fn packed(bytes: &[u8]) {
    for sent in [Ok(bytes.to_vec()), pack::seal(bytes, false), pack::seal(bytes, true)].into_iter().flatten() {
        if let Ok(scene) = Scene::unpack(&sent) {
            travels(&scene);
        }
    }
}

/// A file accepted as glTF survives packing and unpacking, at rest and with all its animations. The bytes are written
/// to `file`.
pub fn gltf(bytes: &[u8], file: &Path) {
    if std::fs::write(file, bytes).is_err() {
        return;
    }
    for animation in ["off", "all"] {
        let options = LoadOptions { animation: Some(animation.to_owned()), ..LoadOptions::default() };
        if let Ok(scene) = Scene::load(file, &options) {
            travels(&scene);
        }
    }
}

/// A picture that is accepted is as large as its head says, and what is sent of it decodes to the same texels. A longer
/// side than a sent picture may have is halved before by all who decode it.
pub fn picture(bytes: &[u8]) {
    for halvings in 0..2 {
        // Larger ones take the same way, only longer.
        let source = picture::Source::new(bytes.to_vec()).ok();
        let Some(source) = source.filter(|source| picture::area(source.width, source.height) <= 1 << 20) else {
            return;
        };
        let (width, height) = ((source.width >> halvings).max(1), (source.height >> halvings).max(1));
        if width.max(height) > MAX_IMAGE_SIDE_PX {
            continue;
        }
        let Ok(image) = source.decode(halvings) else { return };
        assert!((image.width, image.height) == (width, height), "a picture has another size than its head says");
        let again = picture::decode(image.encoded.clone(), picture::area(width, height));
        assert!(again.is_ok_and(|again| again == image), "a picture does not survive travel");
    }
}

/// Draco data give an error, or a mesh of as many values as it says.
pub fn draco(bytes: &[u8]) {
    decoders::draco(bytes);
}

/// Data of meshopt's codecs give an error, or as many bytes as were asked for. The first four bytes say what to ask
/// for.
pub fn meshopt(bytes: &[u8]) {
    decoders::meshopt(bytes);
}

fn travels(scene: &Scene) {
    // Only scenes that are too large to travel cannot be packed.
    let Ok(packed) = scene.pack() else { return };
    assert!(Scene::unpack(&packed).is_ok_and(|again| again == *scene), "a scene does not survive packing");
    if scene.animation.is_some() {
        for still in [scene.at_rest(), scene.still_at(0.25), scene.still_at(1e300)] {
            // Everything may be hidden.
            let fault = still.check().err().filter(|_| !still.triangles.is_empty());
            assert_eq!(fault, None, "a scene is not legal at some time");
        }
    }
}
