//! Promise: `lab codec` has a row for every codec, no exact codec changes a bit, and ours are smaller than
//! general-purpose ones.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::collections::HashMap;

use gnomon_lab::{
    report::{
        codec::{CodecOptions, measure},
        scene_args::parse,
    },
    scenes::real,
};

const HEAD: &str =
    "scene,path,lights,codec,reference,mean_bytes,p99_bytes,packets_mean,encode_ms,decode_ms,wrong_relevant_bits";

#[test]
fn tiles_take_fewer_bytes_than_anything_else_and_change_no_bit() {
    let out = tempfile::tempdir().unwrap();
    let sponza = real::folder().unwrap().join("sponza");
    let (sponza, out_folder) = (sponza.display(), out.path().display());
    let path = format!("--scene {sponza}/sponza_lights.gltf --path {sponza}/lights_camera.json#A_atrium_dolly");
    let line = "--lights 4 --size 320x180 --frames 5 --rounds 1 --wrong-ppm 1000,5000";
    let mut options: CodecOptions = parse(&format!("{path} {line} --out {out_folder}")).unwrap();
    let table = measure(&options, |_| ()).unwrap();
    let csv = std::fs::read_to_string(out.path().join("codec.csv")).unwrap();
    assert_eq!(csv, table.csv());
    assert_eq!(csv.lines().next().unwrap(), HEAD);
    let column = |name: &str| HEAD.split(',').position(|column| column == name).unwrap();
    let (lossy, exact): (Vec<_>, Vec<_>) = table.rows.iter().partition(|row| row[column("codec")].ends_with("ppm"));
    assert!(exact.iter().all(|row| row[column("wrong_relevant_bits")] == "0"), "{csv}");
    let bytes: HashMap<(&str, &str), f64> = table
        .rows
        .iter()
        .map(|row| {
            let of = |name: &str| row[column(name)].as_str();
            ((of("codec"), of("reference")), of("mean_bytes").parse().unwrap())
        })
        .collect();
    let with = |codec, reference| bytes[&(codec, reference)];
    let of = |codec| with(codec, "none");
    assert!(with("tiles-small", "1") < with("tiles-small", "3"), "{bytes:?}");
    assert!(with("tiles-small", "3") < of("tiles-small"), "{bytes:?}");
    assert!(of("tiles-small") < 0.7 * of("planes-zstd-3"), "{bytes:?}");
    assert!(of("tiles-fast") < of("planes-zstd-3") && of("tiles-fast") < 2.0 * of("tiles-small"), "{bytes:?}");
    assert!(of("planes-zstd-3") < of("planes-lz4") && of("planes-lz4") < of("words-lz4"), "{bytes:?}");

    // Wrong bits save bytes, and do not exceed the limit.
    assert_eq!(lossy.len(), 8, "{csv}");
    for row in lossy {
        let [codec, reference, wrong] =
            ["codec", "reference", "wrong_relevant_bits"].map(|name| row[column(name)].as_str());
        let (exact, wrong_ppm) = codec.strip_suffix("ppm").unwrap().rsplit_once('-').unwrap();
        assert!(with(codec, reference) < with(exact, reference), "{bytes:?}");
        let most = u64::from(options.scene.frames) * 320 * 180 * 4 * wrong_ppm.parse::<u64>().unwrap() / 1_000_000;
        assert!((1..=most).contains(&wrong.parse().unwrap()), "{row:?}");
    }

    options.append = true;
    options.scene.file.lights = Some(1);
    measure(&options, |_| ()).unwrap();
    let both = std::fs::read_to_string(out.path().join("codec.csv")).unwrap();
    assert!(both.starts_with(&csv));
    assert_eq!(both.lines().count(), 1 + 2 * table.rows.len());
    assert!(both.lines().last().unwrap().starts_with("sponza_lights,A_atrium_dolly,1,planes-zstd-3,none,"));
}
