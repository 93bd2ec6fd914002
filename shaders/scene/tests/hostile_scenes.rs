//! Files that promise more than they hold are refused before memory is taken, and mutated files never panic.
//!
//! The tests read the peak of their process's memory, so this file holds nothing else.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

mod common;

use std::{fmt::Write as _, path::Path};

use common::{one_light, peak_kib, scenes};
use gnomon_scene::{LoadOptions, Scene, SceneError};
use proptest::prelude::*;

/// Most memory that the process may ever have had, in KiB.
const MAX_PEAK_KIB: u64 = 1 << 20;

fn load(bytes: &[u8]) -> Result<Scene, SceneError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene");
    std::fs::write(&path, bytes).unwrap();
    Scene::load(&path, &one_light(folder.path()))
}

fn fault(json: &str) -> String {
    let fault = load(json.as_bytes()).unwrap_err().to_string();
    let peak = peak_kib();
    assert!(peak < MAX_PEAK_KIB, "peak of memory: {peak} KiB");
    fault
}

/// A file with these top-level properties.
fn file(properties: &str) -> String {
    format!(r#"{{"asset":{{"version":"2.0"}},{properties}}}"#)
}

/// A mesh with `count` zero positions that no buffer backs, shown by `nodes` nodes.
fn bomb(count: u64, nodes: usize) -> String {
    let nodes = vec![r#"{"mesh":0}"#; nodes].join(",");
    file(&format!(
        r#""nodes":[{nodes}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"mode":5}}]}}],
        "accessors":[{{"componentType":5126,"count":{count},"type":"VEC3"}}]"#
    ))
}

#[test]
fn counts_beyond_the_limits_are_refused_before_memory_is_taken() {
    assert!(fault(&bomb(u64::MAX, 1)).contains("18446744073709551615, but at most"));
    assert!(fault(&bomb(1 << 40, 1)).contains("1099511627776, but at most"));
    assert!(fault(&bomb((1 << 24) + 1, 1)).contains("16777217, but at most 16777216"));
    // Each instance is small, but all together are not. Flat normals take three vertices a triangle.
    assert!(fault(&bomb(1 << 20, 17)).contains("of the scene"));
    assert!(fault(&bomb(3, 262_145)).contains("more than 262144"));
    // Many primitives with few triangles each share many vertices, which each primitive would read again.
    let primitives = vec![r#"{"attributes":{"POSITION":0},"indices":1}"#; 1000].join(",");
    let shared = file(&format!(
        r#""nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{primitives}]}}],
        "accessors":[{{"componentType":5126,"count":16777216,"type":"VEC3"}},
        {{"componentType":5125,"count":3,"type":"SCALAR"}}]"#
    ));
    assert!(fault(&shared).contains("vertices of the scene"), "{}", fault(&shared));
    // Within the limits, but all in one point.
    assert!(matches!(load(bomb(1 << 20, 4).as_bytes()), Err(SceneError::NoTriangles { dropped: 4_194_296, .. })));
}

#[test]
fn lists_are_bounded_while_they_are_parsed() {
    let list =
        |name: &str, element: &str, count: usize| file(&format!(r#""{name}":[{}]"#, vec![element; count].join(",")));
    assert!(fault(&list("nodes", "{}", 3_000_000)).contains("more than 262144"));
    assert!(fault(&list("buffers", r#"{"byteLength":1}"#, 5000)).contains("more than 4096"));
    assert!(fault(&list("materials", "{}", 20_000)).contains("more than 16384"));
    assert!(fault(&list("images", "{}", 5000)).contains("more than 4096"));
    assert!(
        fault(&list("extensionsRequired", r#""""#, 20_000_000)).contains("/extensionsRequired: more than 256 elements")
    );
    let values = "0,".repeat(3_000_000);
    assert!(
        fault(&list("nodes", &format!(r#"{{"children":[{values}0]}}"#), 1)).contains("/nodes/0/children/2097150: more")
    );
    // Nested brackets take no stack, whether they are read or skipped.
    for name in ["extras", "nodes", "extensions"] {
        let nested = format!(r#""{name}":{}"#, r#"{"a":["#.repeat(1_000_000));
        assert!(fault(&file(&nested)).contains("not a glTF 2.0 file"));
    }
}

#[test]
fn buffers_and_views_must_be_where_they_say() {
    let huge = r#""buffers":[{"byteLength":18446744073709551615},{"byteLength":18446744073709551615}]"#;
    assert!(fault(&file(huge)).contains("bytes of all buffers"));
    let outside =
        r#""buffers":[{"byteLength":8}],"bufferViews":[{"buffer":0,"byteOffset":18446744073709551615,"byteLength":2}]"#;
    assert!(fault(&file(outside)).contains("do not lie in buffer 0"));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.gltf");
    // From a file longer than its buffers, only the bytes that they need are read.
    std::fs::File::create(folder.path().join("long.bin")).unwrap().set_len(64 << 20).unwrap();
    let buffers = vec![r#"{"byteLength":8,"uri":"long.bin"}"#; 32].join(",");
    std::fs::write(&path, file(&format!(r#""buffers":[{buffers}]"#))).unwrap();
    let error = Scene::load(&path, &LoadOptions::default()).unwrap_err();
    assert!(matches!(error, SceneError::NoTriangles { .. }), "{error}");
    assert!(peak_kib() < MAX_PEAK_KIB, "peak of memory: {} KiB", peak_kib());
    let uri = file(r#""buffers":[{"byteLength":8,"uri":"."}]"#);
    std::fs::write(&path, uri).unwrap();
    assert!(Scene::load(&path, &LoadOptions::default()).is_err());
    assert!(matches!(Scene::load(folder.path(), &LoadOptions::default()), Err(SceneError::Read { .. })));
    assert!(matches!(Scene::load(Path::new("/no/such/file"), &LoadOptions::default()), Err(SceneError::Read { .. })));
}

#[cfg(unix)]
#[test]
fn a_link_that_leaves_the_folder_of_the_scene_is_refused() {
    use std::os::unix::fs::symlink;

    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene");
    std::fs::create_dir(&scene).unwrap();
    let file = gnomon_scene::testing::write_scene(&scene).unwrap();
    let options = LoadOptions::default();
    Scene::load(&file, &options).unwrap();
    let links: Vec<_> = std::fs::read_dir(&scene).unwrap().map(|entry| entry.unwrap().path()).collect();
    let beside: Vec<_> = links.into_iter().filter(|path| *path != file).collect();
    assert!(!beside.is_empty(), "the scene has files of its own");
    for path in &beside {
        // Within the folder a link is fine, wherever the folder is reached from.
        let inside = scene.join("inside");
        std::fs::rename(path, &inside).unwrap();
        symlink("inside", path).unwrap();
        Scene::load(&file, &options).unwrap();
        let entry = folder.path().join("entry");
        symlink(&scene, &entry).unwrap();
        Scene::load(&entry.join(file.file_name().unwrap()), &options).unwrap();
        // Outside it would travel to every client.
        let secret = folder.path().join("identity.pem");
        std::fs::rename(&inside, &secret).unwrap();
        std::fs::remove_file(path).unwrap();
        symlink(&secret, path).unwrap();
        let error = Scene::load(&file, &options).unwrap_err();
        assert!(error.to_string().contains("leaves the scene's folder"), "{error}");
        std::fs::remove_file(path).unwrap();
        std::fs::rename(&secret, path).unwrap();
        std::fs::remove_file(&entry).unwrap();
    }
}

#[test]
fn indices_wider_than_32_bits_are_not_truncated() {
    let json = bomb(3, 1).replace(r#""POSITION":0"#, r#""POSITION":4294967296"#);
    assert!(fault(&json).contains("4294967296"), "{}", fault(&json));
}

/// A PNG whose header promises `side` × `side` pixels of 16 bits a channel.
fn png_head(side: u32) -> Vec<u8> {
    let mut bytes = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
    let start = bytes.len() - 4;
    bytes.extend(side.to_be_bytes().repeat(2));
    bytes.extend([16, 6, 0, 0, 0]);
    let crc = crc32(&bytes[start..]);
    bytes.extend(crc.to_be_bytes());
    bytes.extend(b"\0\0\0\x08IDAT\x78\x9c\x01\0\0\xff\xff\0");
    bytes.extend([0; 4]);
    bytes
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| (crc >> 1) ^ (0xedb8_8320 & 0_u32.wrapping_sub(crc & 1)))
    })
}

#[test]
fn pictures_that_promise_too_much_are_left_out_before_memory_is_taken() {
    use base64::{Engine as _, prelude::BASE64_STANDARD};
    let with_picture = |side: u32| {
        let mut floats = String::new();
        let positions = [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
        let bytes: Vec<u8> = positions.iter().flat_map(|v| v.to_le_bytes()).collect();
        write!(floats, "{}", BASE64_STANDARD.encode(bytes)).unwrap();
        file(&format!(
            r#""nodes":[{{"mesh":0}}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_0":1}},"material":0}}]}}],
            "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}},
            {{"bufferView":0,"componentType":5126,"count":3,"type":"VEC2"}}],
            "bufferViews":[{{"buffer":0,"byteLength":36}}],
            "buffers":[{{"byteLength":36,"uri":"data:;base64,{floats}"}}],
            "materials":[{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}}}}}}],
            "textures":[{{"source":0}}],"images":[{{"uri":"data:;base64,{}"}}]"#,
            BASE64_STANDARD.encode(png_head(side))
        ))
    };
    // The scene is shown without them.
    for side in [8193, u32::MAX / 2, 8192] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene");
        std::fs::write(&path, with_picture(side)).unwrap();
        let (scene, report) = Scene::load_with_report(&path, &one_light(folder.path())).unwrap();
        assert!(scene.images.is_empty() && report.to_string().contains("image 0"), "{side}: {report}");
        assert!(peak_kib() < MAX_PEAK_KIB, "peak of memory: {} KiB", peak_kib());
    }
}

fn cornell() -> Vec<u8> {
    std::fs::read(scenes().join("cornell/CornellBox.glb")).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1500, failure_persistence: None, ..ProptestConfig::default() })]

    /// Bytes overwritten anywhere, or the end cut off, give an error or a legal scene.
    #[test]
    fn mutated_files_never_panic(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let mut bytes = cornell();
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        if let Ok(scene) = load(&bytes) {
            prop_assert!(scene.check().is_ok(), "{:?}", scene.check());
        }
    }

    /// Changed digits in the JSON give an error or a legal scene. Most parse, with wrong counts, offsets and indices.
    #[test]
    fn mutated_numbers_never_panic(
        changes in prop::collection::vec((any::<prop::sample::Index>(), b'0'..=b'9'), 1..6),
    ) {
        let mut bytes = cornell();
        let json = 20 + u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let digits: Vec<usize> = (20..json).filter(|at| bytes[*at].is_ascii_digit()).collect();
        for (at, value) in changes {
            bytes[digits[at.index(digits.len())]] = value;
        }
        if let Ok(scene) = load(&bytes) {
            prop_assert!(scene.check().is_ok(), "{:?}", scene.check());
        }
    }

    /// Bytes of a packed scene overwritten, or the end cut off, give an error or a legal scene.
    #[test]
    fn mutated_packs_never_panic(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let mut bytes = load(&cornell()).unwrap().pack().unwrap();
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        if let Ok(scene) = Scene::unpack(&bytes) {
            prop_assert!(scene.check().is_ok(), "{:?}", scene.check());
        }
    }
}
