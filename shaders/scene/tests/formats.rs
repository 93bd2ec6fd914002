//! Compressed formats give what the same data give uncompressed.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod common;

use base64::{Engine as _, prelude::BASE64_STANDARD};
use common::formats;
use gnomon_scene::{LoadOptions, LoadReport, Scene, SceneError};
use image::ImageFormat;
use serde_json::{Value, json};

fn data_uri(bytes: &[u8]) -> String {
    format!("data:application/octet-stream;base64,{}", BASE64_STANDARD.encode(bytes))
}

/// A file of one mesh and one light. `parts` adds what the mesh needs.
fn load(parts: &Value) -> Result<(Scene, LoadReport), SceneError> {
    let folder = tempfile::tempdir().unwrap();
    let mut document = json!({
        "asset": {"version": "2.0"},
        "extensions": {"KHR_lights_punctual": {"lights": [{"type": "point"}]}},
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0}, {"extensions": {"KHR_lights_punctual": {"light": 0}}}],
    });
    for (name, value) in parts.as_object().unwrap() {
        document[name] = value.clone();
    }
    let path = folder.path().join("scene.gltf");
    std::fs::write(&path, document.to_string()).unwrap();
    let loaded = Scene::load_with_report(&path, &LoadOptions::default());
    if let Ok((scene, _)) = &loaded {
        assert!(Scene::unpack(&scene.pack().unwrap()).unwrap() == *scene, "it does not survive packing");
    }
    loaded
}

/// A triangle for each texture.
fn textured(textures: &Value, images: &Value) -> Value {
    let positions: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let bytes: Vec<u8> = positions.into_iter().flat_map(f32::to_le_bytes).collect();
    let count = textures.as_array().unwrap().len();
    let primitive = |number: usize| json!({"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": number});
    let material = |number: usize| json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": number}}});
    json!({
        "buffers": [{"uri": data_uri(&bytes), "byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC2"},
        ],
        "meshes": [{"primitives": (0..count).map(primitive).collect::<Vec<_>>()}],
        "materials": (0..count).map(material).collect::<Vec<_>>(),
        "textures": textures,
        "images": images,
    })
}

#[test]
fn webp_travels_as_it_is() {
    let file = formats::encoded(ImageFormat::WebP);
    let textures = json!([{"source": 0, "extensions": {"EXT_texture_webp": {"source": 1}}}]);
    let images = json!([{"uri": "no such.png"}, {"uri": data_uri(&file)}]);
    let mut parts = textured(&textures, &images);
    parts["extensionsRequired"] = json!(["EXT_texture_webp"]);
    let scene = load(&parts).unwrap().0;
    let image = &scene.images[0];
    assert_eq!((image.width, image.height), (9, 5));
    assert!(image.encoded == file && image.rgba == formats::texels(true).into_raw());
}

#[test]
fn basis_universal_becomes_webp() {
    let blocks = [[200, 100, 50, 255], [1, 2, 3, 128], [255, 0, 0, 0], [0, 255, 0, 255]];
    for zstandard in [false, true] {
        let file = formats::uastc(7, 8, &blocks, zstandard);
        let textures = json!([{"extensions": {"KHR_texture_basisu": {"source": 0}}}]);
        let mut parts = textured(&textures, &json!([{"uri": data_uri(&file)}]));
        parts["extensionsRequired"] = json!(["KHR_texture_basisu"]);
        let scene = load(&parts).unwrap().0;
        let image = &scene.images[0];
        assert_eq!((image.width, image.height), (7, 8));
        assert!(image.encoded.starts_with(b"RIFF"));
        for (at, texel) in image.rgba.chunks(4).enumerate() {
            let block = at % 7 / 4 + at / 7 / 4 * 2;
            assert_eq!(texel, blocks[block], "texel {at}");
        }
        // A size that the blocks do not make, and one that would take all memory.
        let mut other = file.clone();
        other[20] = 9;
        let fault = |file: &[u8]| {
            let (scene, report) = load(&textured(&textures, &json!([{"uri": data_uri(file)}]))).unwrap();
            assert!(scene.images.is_empty());
            report.to_string()
        };
        let says = if zstandard { "9×8 pixels do not make" } else { "broken" };
        assert!(fault(&other).contains(says), "{}", fault(&other));
        other[20..28].fill(0xff);
        assert!(fault(&other).contains("pixels"), "{}", fault(&other));
    }
}

#[test]
fn one_picture_is_counted_once_and_large_ones_are_halved() {
    let (wide, height) = (8200, 3);
    let texel = |x, y| image::Rgb([if x % 2 == 0 { 10 } else { 30 }, u8::try_from(y).unwrap(), 0]);
    let picture = image::RgbImage::from_fn(wide, height, texel);
    let mut file = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut file, ImageFormat::Png).unwrap();
    let uri = data_uri(file.get_ref());
    let textures = json!([{"source": 0}, {"source": 1}, {"source": 2}]);
    let images =
        json!([{"uri": uri}, {"uri": uri, "name": "again"}, {"uri": data_uri(&formats::encoded(ImageFormat::Png))}]);
    let (scene, report) = load(&textured(&textures, &images)).unwrap();
    assert_eq!((scene.images.len(), report.scaled_pictures), (2, 1));
    let image = &scene.images[0];
    assert_eq!((image.width, image.height), (4100, 1));
    assert!(image.rgba.chunks(4).all(|texel| texel == [20, 1, 0, 255]));
    let named: Vec<_> = scene.materials.iter().map(|it| it.base_color_texture.unwrap().image).collect();
    assert_eq!(named, [0, 0, 1]);
}

fn grid(extra: &Value, buffers: &Value, views: &Value) -> Value {
    let count = formats::GRID * formats::GRID;
    let mut primitive =
        json!({"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}, "indices": 3, "material": 0});
    primitive["extensions"] = extra.clone();
    json!({
        "buffers": buffers,
        "bufferViews": views,
        "accessors": [
            {"componentType": 5126, "count": count, "type": "VEC3"},
            {"componentType": 5126, "count": count, "type": "VEC3"},
            {"componentType": 5126, "count": count, "type": "VEC2"},
            {"componentType": 5123, "count": 96, "type": "SCALAR"},
        ],
        "meshes": [{"primitives": [primitive]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}],
        "images": [{"uri": data_uri(&formats::encoded(ImageFormat::Png))}],
    })
}

#[test]
fn draco_gives_the_mesh_that_was_encoded() {
    let data = formats::draco();
    let buffers = json!([{"uri": data_uri(&data), "byteLength": data.len()}]);
    let views = json!([{"buffer": 0, "byteLength": data.len()}]);
    let attributes = json!({"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2});
    let extension = json!({"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": attributes}});
    let mut parts = grid(&extension, &buffers, &views);
    parts["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
    let scene = load(&parts).unwrap().0;
    assert_eq!((scene.positions.len(), scene.triangles.len()), (25, 32));
    let area: f32 = scene
        .triangles
        .iter()
        .map(|corners| {
            let [a, b, c] = corners.map(|corner| scene.positions[corner as usize]);
            (b - a).cross(c - a).z / 2.0
        })
        .sum();
    // All triangles look along z: their areas add up. Each coordinate is within a step of 11 bits.
    let step = 1.0 / f32::from(1_u16 << 11);
    assert!((area - 1.0).abs() < 4.0 * step, "{area}");
    for ((position, normal), uv) in scene.positions.iter().zip(&scene.normals).zip(&scene.uvs) {
        let nearest = (*position * 4.0).round() / 4.0;
        assert!((*position - nearest).length() < 2.0 * step, "{position}");
        assert!((position.truncate() - *uv).length() < 4.0 * step && normal.z > 0.999, "{position} {uv} {normal}");
    }
    // A number that no attribute has, and broken data.
    parts["meshes"][0]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"]["attributes"]["NORMAL"] = json!(7);
    assert!(load(&parts).unwrap_err().to_string().contains("no attribute 7"));
    parts["bufferViews"][0]["byteLength"] = json!(data.len() / 2);
    assert!(load(&parts).unwrap_err().to_string().contains("mesh 0, primitive 0: its Draco data"));
}

#[test]
fn meshopt_fills_buffers_without_bytes() {
    let bytes = |digits: &str| -> Vec<u8> {
        (0..digits.len()).step_by(2).map(|at| u8::from_str_radix(&digits[at..at + 2], 16).unwrap()).collect()
    };
    let (vertices, triangles) = (bytes(formats::ATTRIBUTES), bytes(formats::TRIANGLES));
    for name in ["EXT_meshopt_compression", "KHR_meshopt_compression"] {
        let data = [&vertices[..], &triangles].concat();
        let view = |length: usize, it: Value| json!({"buffer": 1, "byteLength": length, "extensions": {name: it}});
        let mut views = json!([
            view(
                480,
                json!({"buffer": 0, "byteLength": vertices.len(), "byteStride": 12, "mode": "ATTRIBUTES", "count": 40})
            ),
            view(
                162,
                json!({"buffer": 0, "byteOffset": vertices.len(), "byteLength": triangles.len(), "byteStride": 2,
                "mode": "TRIANGLES", "count": 81})
            ),
        ]);
        views[0]["byteStride"] = json!(12);
        let mut parts = json!({
            "extensionsRequired": [name, "KHR_mesh_quantization"],
            "buffers": [
                {"uri": data_uri(&data), "byteLength": data.len()},
                {"byteLength": 480, "extensions": {name: {"fallback": true}}},
            ],
            "bufferViews": views,
            "accessors": [
                {"bufferView": 0, "componentType": 5123, "count": 40, "type": "VEC3"},
                {"bufferView": 1, "componentType": 5123, "count": 72, "type": "SCALAR"},
            ],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        });
        let scene = load(&parts).unwrap().0;
        // The first two components are i * 37 and 1000 - i², for vertices 0, 1 and 5.
        let corners: Vec<_> =
            scene.positions.iter().take(3).map(|it| (it.as_dvec3() + scene.origin_m).truncate()).collect();
        assert_eq!(corners, [[0.0, 1000.0], [37.0, 999.0], [185.0, 975.0]].map(glam::DVec2::from_array));
        // Broken data matter where they are read.
        parts["bufferViews"][0]["extensions"][name]["filter"] = json!("OCTAHEDRAL");
        let error = load(&parts).unwrap_err().to_string();
        assert!(error.contains("buffer view 0: its meshopt compression"), "{error}");
        parts["bufferViews"][0]["extensions"][name]["byteLength"] = json!(u32::MAX);
        assert!(load(&parts).unwrap_err().to_string().contains("all compressed geometry"));
    }
}
