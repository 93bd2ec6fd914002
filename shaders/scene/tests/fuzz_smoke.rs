//! The fuzz targets' properties on the stable toolchain, for valid scenes and damaged ones. The damage is seeded, so
//! that failures repeat. With `GNOMON_FUZZ_SEEDS=FOLDER` the valid ones are written there as the targets' seeds.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod common;

use std::fs;

use gnomon_scene::{LoadOptions, Scene, fuzzing, testing::write_scene};

/// Runs a property on the seed cut at every byte.
fn every_start(seed: &[u8], entry: impl Fn(&[u8])) {
    for end in 0..seed.len() {
        entry(&seed[..end]);
    }
}

/// Runs a property on the seed, and on damaged copies of it.
fn drive(target: &str, seed: &[u8], rounds: u32, mut entry: impl FnMut(&[u8])) {
    if let Some(folder) = std::env::var_os("GNOMON_FUZZ_SEEDS") {
        let (target, variant) = target.split_once('-').unwrap_or((target, "seed"));
        let folder = std::path::Path::new(&folder).join(target);
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join(variant), seed).unwrap();
    }
    let mut state = 7_u32;
    let mut below = |most: usize| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as usize % most.max(1)
    };
    entry(seed);
    for _ in 0..rounds {
        let mut bytes = seed.to_vec();
        for _ in 0..=below(3) {
            let place = below(bytes.len());
            match below(4) {
                0 => bytes.truncate(place),
                1 => bytes.insert(place, below(256).to_le_bytes()[0]),
                2 => bytes[place..].rotate_left(1),
                _ => bytes[place] ^= 1 << below(8),
            }
            if bytes.is_empty() {
                break;
            }
        }
        entry(&bytes);
    }
}

/// The test scene with its buffer as a data URI.
fn whole_file(folder: &std::path::Path) -> Vec<u8> {
    let text = fs::read_to_string(write_scene(folder).unwrap()).unwrap();
    let mut gltf: serde_json::Value = serde_json::from_str(&text).unwrap();
    let bytes = fs::read(folder.join("scene.bin")).unwrap();
    let inside = format!(
        "data:application/octet-stream;base64,{}",
        base64::Engine::encode(&base64::prelude::BASE64_STANDARD, bytes)
    );
    gltf["buffers"][0]["uri"] = inside.into();
    gltf.to_string().into_bytes()
}

#[test]
fn gltf() {
    let folder = tempfile::tempdir().unwrap();
    let seed = whole_file(folder.path());
    let file = folder.path().join("damaged.gltf");
    drive("gltf", &seed, 3_000, |bytes| fuzzing::gltf(bytes, &file));
    assert!(Scene::load(&folder.path().join("scene.gltf"), &LoadOptions::default()).is_ok(), "the seed does not load");
}

#[test]
fn gltf_of_every_kind() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("damaged.gltf");
    let rich = common::gltf_file::GltfFile::of_every_kind();
    let told = "not drawn: animations: everything stands as the file has it (2×)\n\
         note: material variants, shown with --variant NAME: \"other\"";
    assert_eq!(rich.load().1, told);
    let options = LoadOptions { animation: Some("all".to_owned()), ..LoadOptions::default() };
    assert!(rich.load_with(&options).unwrap().0.animation.is_some(), "nothing moves in the seed");
    let seed = rich.text();
    drive("gltf-every_kind", seed.as_bytes(), 3_000, |bytes| fuzzing::gltf(bytes, &file));
    // Most files with one other number still parse: wrong counts, indices and factors.
    let digits: Vec<usize> =
        seed.bytes().enumerate().filter(|(_, byte)| byte.is_ascii_digit()).map(|(at, _)| at).collect();
    let mut loaded = 0;
    for at in digits.into_iter().step_by(3) {
        for digit in [b'0', b'2', b'9'] {
            let mut bytes = seed.clone().into_bytes();
            bytes[at] = digit;
            fuzzing::gltf(&bytes, &file);
            loaded += usize::from(Scene::load(&file, &LoadOptions::default()).is_ok());
        }
    }
    assert!(loaded > 100, "{loaded} files load");
}

#[test]
fn glb() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path()).unwrap();
    let mut json = fs::read(folder.path().join("scene.gltf")).unwrap();
    let mut gltf: serde_json::Value = serde_json::from_slice(&json).unwrap();
    gltf["buffers"][0].as_object_mut().unwrap().remove("uri");
    json = gltf.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let binary = fs::read(folder.path().join("scene.bin")).unwrap();
    let word = |value: usize| u32::try_from(value).unwrap().to_le_bytes();
    let length = 12 + 8 + json.len() + 8 + binary.len();
    let seed = [
        &b"glTF"[..],
        &word(2),
        &word(length),
        &word(json.len()),
        b"JSON",
        &json,
        &word(binary.len()),
        b"BIN\0",
        &binary,
    ];
    let file = folder.path().join("damaged.glb");
    drive("glb", &seed.concat(), 3_000, |bytes| fuzzing::gltf(bytes, &file));
    fs::write(&file, seed.concat()).unwrap();
    assert!(Scene::load(&file, &LoadOptions::default()).is_ok(), "the seed does not load");
}

#[test]
fn pictures() {
    for (name, seed) in common::formats::pictures() {
        every_start(&seed, fuzzing::picture);
        drive(&format!("picture-{name}"), &seed, 2_000, fuzzing::picture);
    }
}

#[test]
fn draco() {
    let seed = common::formats::draco();
    every_start(&seed, fuzzing::draco);
    drive("draco", &seed, 5_000, fuzzing::draco);
}

#[test]
fn meshopt() {
    for (name, seed) in common::formats::meshopt() {
        every_start(&seed, fuzzing::meshopt);
        drive(&format!("meshopt-{name}"), &seed, 5_000, fuzzing::meshopt);
    }
}

#[test]
fn packed() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene::load(&write_scene(folder.path()).unwrap(), &LoadOptions::default()).unwrap();
    drive("packed", &scene.pack().unwrap(), 10_000, fuzzing::packed);
    let options = LoadOptions { animation: Some("all".to_owned()), ..LoadOptions::default() };
    let (moving, _) = common::gltf_file::GltfFile::of_every_kind().load_with(&options).unwrap();
    drive("packed-moving", &moving.pack().unwrap(), 3_000, fuzzing::packed);
}
