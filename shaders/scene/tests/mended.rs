//! Files that are invalid in a detail load as other viewers show them, and say what was mended. Legal oddities load
//! without a word.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

mod common;

use common::gltf_file::GltfFile;
use glam::{DVec3, Vec2, Vec3};
use gnomon_scene::{LightKind, LoadOptions, Scene, SceneError, WarningKind};
use serde_json::{Value, json};

/// Changes the triangle, loads it, and expects one line that says so.
fn mended(says: &str, change: impl FnOnce(&mut GltfFile)) -> Scene {
    let mut file = GltfFile::triangle();
    change(&mut file);
    let (scene, told) = file.load();
    assert!(told.contains(says) && told.lines().count() == 1, "{told:?} does not say {says:?}");
    scene
}

/// Changes the triangle, loads it, and expects that there is nothing to say.
fn legal(change: impl FnOnce(&mut GltfFile)) -> Scene {
    let mut file = GltfFile::triangle();
    change(&mut file);
    let (scene, told) = file.load();
    assert_eq!(told, "");
    scene
}

fn with_light(file: &mut GltfFile, light: &Value, mut node: Value) {
    node["extensions"] = json!({"KHR_lights_punctual": {"light": 0}});
    file.json["nodes"].as_array_mut().unwrap().push(node);
    file.json["scenes"][0]["nodes"] = json!([0, 1]);
    file.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [light]}});
}

#[test]
fn factors_out_of_range_are_clamped() {
    let ulp = f64::from_bits(1.0_f64.to_bits() + 1);
    for (color, expected) in [([ulp, 1.0, 1.0, 1.0], 1.0), ([-0.5, 1.0, 1.0, 1.0], 0.0), ([7.0, 1.0, 1.0, 1.0], 1.0)] {
        let scene = mended("factor outside 0 to 1", |file| {
            file.json["materials"][0]["pbrMetallicRoughness"] = json!({"baseColorFactor": color});
        });
        assert_eq!(scene.materials[0].base_color.x, expected);
    }
    let scene = mended("factor outside 0 to 1: the nearest end (2×, first in material 0)", |file| {
        file.json["materials"][0]["pbrMetallicRoughness"] = json!({"metallicFactor": 1.5, "roughnessFactor": -1});
    });
    assert_eq!((scene.materials[0].metallic, scene.materials[0].roughness), (1.0, 0.0));
    let scene =
        mended("emissive factor above 1", |file| file.json["materials"][0]["emissiveFactor"] = json!([5, 1, 0]));
    assert_eq!(scene.materials[0].emissive, Vec3::new(5.0, 1.0, 0.0));
    let scene = mended("refraction below 1", |file| {
        file.json["materials"][0]["extensions"] = json!({"KHR_materials_ior": {"ior": 0.5}});
    });
    assert_eq!(scene.materials[0].ior, 1.0);
    mended("alpha mode that is not", |file| file.json["materials"][0]["alphaMode"] = json!("GLASS"));
    mended("negative or too large", |file| {
        file.json["materials"][0]["alphaMode"] = json!("MASK");
        file.json["materials"][0]["alphaCutoff"] = json!(-1);
    });
}

#[test]
fn broken_normals_are_replaced_and_tangents_dropped() {
    for broken in [f32::NAN, f32::INFINITY, 0.0] {
        let scene = mended("zero or broken normals", |file| {
            let normals = [0.0, 0.0, broken, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0];
            file.attribute("NORMAL", &normals);
        });
        assert_eq!(scene.normals, [Vec3::Z; 3], "{broken}");
    }
    let scene = legal(|file| {
        let texture = file.texture([128, 128, 255, 255]);
        file.json["materials"][0]["normalTexture"] = json!({"index": texture});
        file.attribute("TANGENT", &[f32::NAN, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 3.0, 0.0, 0.0, -1.0]);
    });
    assert_eq!(scene.tangents.iter().map(|tangent| tangent.w).collect::<Vec<_>>(), [0.0, 0.0, -1.0]);
    assert_eq!(scene.tangents[2].truncate(), Vec3::X);
}

#[test]
fn positions_and_texture_coordinates_that_are_no_numbers() {
    let scene = mended("a position that is not finite", |file| {
        let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [f32::NAN, 0.0, 0.0], [1.0, 1.0, 0.0]];
        file.attribute("POSITION", positions.as_flattened());
        file.attribute("NORMAL", &[0.0, 0.0, 1.0].repeat(5));
        file.attribute("TEXCOORD_0", &[0.0; 10]);
        let indices = file.accessor(5121, "SCALAR", 6, &[0, 1, 2, 1, 3, 4]);
        file.primitive()["indices"] = json!(indices);
    });
    assert_eq!(scene.triangles, [[0, 1, 2]]);
    let scene = mended("NaN or beyond ±65536 (2×", |file| {
        let texture = file.texture([255; 4]);
        file.json["materials"][0]["pbrMetallicRoughness"] = json!({"baseColorTexture": {"index": texture}});
        file.attribute("TEXCOORD_0", &[f32::NAN, 0.5, f32::INFINITY, -1e9, 0.0, 1.0]);
    });
    assert_eq!(scene.uvs, [Vec2::new(0.0, 0.5), Vec2::new(65536.0, -65536.0), Vec2::Y]);
}

#[test]
fn primitives_are_cut_to_what_is_there() {
    let index = |corners: &[u8]| {
        let corners = corners.to_vec();
        move |file: &mut GltfFile| {
            let indices = file.accessor(5121, "SCALAR", corners.len(), &corners);
            file.primitive()["indices"] = json!(indices);
        }
    };
    assert_eq!(mended("no whole number of triangles", index(&[0, 1, 2, 0])).triangles.len(), 1);
    assert_eq!(mended("an index beyond the vertices", index(&[0, 1, 2, 0, 1, 3])).triangles.len(), 1);
    let scene = mended("another count than the positions", |file| {
        file.attribute("NORMAL", &[0.0, 0.0, 1.0].repeat(4));
    });
    assert_eq!(scene.normals.len(), 3);
    let empty = |file: &mut GltfFile| {
        let nothing = file.accessor(5126, "VEC3", 0, &[]);
        let primitive = json!({"attributes": {"POSITION": nothing}});
        file.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(primitive);
    };
    let mut file = GltfFile::triangle();
    empty(&mut file);
    let (scene, told) = file.load();
    assert!(told.contains("without vertices or triangles (mesh 0, primitive 1)"), "{told}");
    assert_eq!(scene.triangles.len(), 1);
    // Nothing is left: then it is an error, which says why.
    let mut file = GltfFile::triangle();
    index(&[9, 9, 9])(&mut file);
    let error = file.load_with(&LoadOptions::default()).unwrap_err();
    assert!(matches!(error, SceneError::NoTriangles { .. }) && error.to_string().contains("beyond the vertices"));
    mended("a mesh without primitives", |file| {
        file.json["meshes"].as_array_mut().unwrap().push(json!({"primitives": []}));
    });
}

#[test]
fn layouts_that_break_only_a_rule_of_style() {
    mended("taken as they are", |file| file.json["accessors"][0]["normalized"] = json!(true));
    mended("an offset without a buffer view", |file| {
        let zeros = json!({"componentType": 5126, "count": 1, "type": "VEC3", "byteOffset": 4});
        file.json["accessors"].as_array_mut().unwrap().push(zeros);
    });
    // Strides that are no multiple of 4, and 0, which counts as none.
    let mut bytes = Vec::new();
    for (position, x) in [(0, 0.0_f32), (14, 1.0), (28, 2.0)] {
        bytes.resize(position, 0);
        bytes.extend([x, x * x, 0.0].iter().flat_map(|value| value.to_le_bytes()));
    }
    let scene = mended("a stride that is not a multiple of 4", |file| {
        let accessor = file.accessor(5126, "VEC3", 3, &bytes);
        let view = file.json["accessors"][accessor]["bufferView"].as_u64().unwrap();
        file.json["bufferViews"][usize::try_from(view).unwrap()]["byteStride"] = json!(14);
        file.primitive()["attributes"]["POSITION"] = json!(accessor);
    });
    assert_eq!(scene.positions[2], Vec3::new(2.0, 4.0, 0.0));
    mended("a stride that is not", |file| file.json["bufferViews"][0]["byteStride"] = json!(0));
    let mut file = GltfFile::triangle();
    file.json["bufferViews"][0]["byteLength"] = json!(35);
    assert!(file.load_with(&LoadOptions::default()).unwrap_err().to_string().contains("reach beyond"));
    // An unaligned offset, and a byte order mark.
    let scene = legal(|file| {
        let bytes: Vec<u8> =
            [0.0_f32, 0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        file.accessor(5121, "SCALAR", 1, &[7]);
        let accessor = file.accessor(5126, "VEC3", 3, &bytes);
        file.primitive()["attributes"]["POSITION"] = json!(accessor);
    });
    assert_eq!(scene.bounds.max.x, 5.0);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mark.gltf");
    std::fs::write(&path, format!("\u{feff}{}", GltfFile::triangle().text())).unwrap();
    Scene::load(&path, &LoadOptions::default()).unwrap();
}

#[test]
fn textures_that_cannot_be_shown_are_left_out() {
    let textured = |info: Value| {
        move |file: &mut GltfFile| {
            file.texture([1, 2, 3, 255]);
            file.json["materials"][0]["emissiveTexture"] = info;
            file.json["materials"][0]["emissiveFactor"] = json!([1, 1, 1]);
        }
    };
    let scene =
        mended("a texture without texture coordinates (material 0)", textured(json!({"index": 0, "texCoord": 3})));
    // The factor alone would make all of it glow.
    assert!(scene.images.is_empty() && scene.materials[0].emissive == Vec3::ZERO);
    mended("a texture without texture coordinates", textured(json!({"index": 0, "texCoord": 4_000_000_000_u32})));
    let scene = mended("a picture that cannot be read (image 0: ", |file| {
        textured(json!({"index": 0}))(file);
        file.json["images"][0]["uri"] = json!("nowhere.png");
    });
    assert!(scene.materials[0].emissive_texture.is_none() && scene.materials[0].emissive == Vec3::ZERO);
    mended("a texture without an image (texture 0)", |file| {
        textured(json!({"index": 0}))(file);
        file.json["textures"][0] = json!({});
    });
    mended("a picture that cannot be read", |file| {
        textured(json!({"index": 0}))(file);
        file.json["textures"][0] = json!({"extensions": {"MSFT_texture_dds": {"source": 0}}});
        file.json["images"][0]["uri"] = json!("data:;base64,RERTIA==");
    });
    let scene = mended("an unknown filter or wrap mode", |file| {
        textured(json!({"index": 0}))(file);
        file.json["textures"][0]["sampler"] = json!(0);
        file.json["samplers"] = json!([{"wrapS": 1, "wrapT": 33071, "magFilter": 9728, "minFilter": 7}]);
    });
    let texture = scene.materials[0].emissive_texture.unwrap();
    assert_eq!((texture.wrap_u, texture.wrap_v), (gnomon_scene::Wrap::Repeat, gnomon_scene::Wrap::ClampToEdge));
    mended("an image with a uri and a buffer view", |file| {
        file.json["images"] = json!([{"uri": "a", "bufferView": 0}]);
    });
    let mut file = GltfFile::triangle();
    file.json["materials"][0]["normalTexture"] = json!({"index": 7});
    let error = file.load_with(&LoadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("material 0 names texture 7, but there are 0"), "{error}");
}

#[test]
fn node_transforms_with_a_flaw() {
    let node = |node: Value| {
        move |file: &mut GltfFile| {
            file.json["nodes"][0] = node;
            file.json["nodes"][0]["mesh"] = json!(0);
        }
    };
    let translated = |last: Value| json!({"matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 3, 0, 0, last]});
    let ulp = f64::from_bits(1.0_f64.to_bits() + 1);
    let highest = |scene: &Scene| scene.origin_m + scene.bounds.max.as_dvec3();
    assert_eq!(highest(&legal(node(translated(json!(ulp))))).x, 4.0);
    mended("last row is not 0 0 0 1", node(translated(json!(2))));
    let scene = mended("the matrix counts", |file| {
        node(translated(json!(1)))(file);
        file.json["nodes"][0]["translation"] = json!([9, 9, 9]);
    });
    assert_eq!(highest(&scene), DVec3::new(4.0, 1.0, 0.0));
    let scene = mended("a rotation whose length is not 1", node(json!({"rotation": [0, 0, 2, 0]})));
    assert!((scene.bounds.min - Vec3::new(-1.0, -1.0, 0.0)).length() < 1e-6);
    mended("a rotation whose length is not 1", node(json!({"rotation": [0, 0, 0, 0]})));
    // The listed child stands there without its parent.
    let scene = mended("lists a child of a node as a root", |file| {
        file.json["nodes"] = json!([{"mesh": 0}, {"children": [0], "translation": [5, 0, 0]}]);
    });
    assert_eq!(highest(&scene).x, 1.0);
    let scene = mended("lists a child of a node as a root", |file| {
        file.json["nodes"] = json!([{"mesh": 0}, {"children": [0], "translation": [5, 0, 0]}]);
        file.json["scenes"][0]["nodes"] = json!([0, 1]);
    });
    assert_eq!((highest(&scene).x, scene.instances), (6.0, 1));
}

#[test]
fn lights_with_a_flaw() {
    let spot = json!({"type": "spot", "spot": {"innerConeAngle": 0.5, "outerConeAngle": 0.5}});
    let scene = mended("a sharp edge (node 1)", |file| with_light(file, &spot, json!({})));
    assert_eq!(scene.lights[0].kind, LightKind::Spot { inner_cone_rad: 0.5, outer_cone_rad: 0.5 });
    let scene = legal(|file| with_light(file, &json!({"type": "point", "range": f64::MAX}), json!({})));
    assert_eq!(scene.lights[0].range_m, f32::INFINITY);
    // A quarter turn about +X takes −Z to +Y, whatever the scale.
    let quarter = std::f64::consts::FRAC_1_SQRT_2;
    for scale in [[1, 1, 0], [0, 0, 0], [0, 1, 0]] {
        let node = json!({"rotation": [quarter, 0, 0, quarter], "scale": scale});
        let scene = legal(|file| with_light(file, &json!({"type": "directional"}), node));
        assert!((scene.lights[0].direction - Vec3::Y).length() < 1e-6, "{scale:?}");
    }
    let mut file = GltfFile::triangle();
    with_light(&mut file, &json!({"type": "spherical"}), json!({}));
    let (scene, told) = file.load();
    assert!(told.contains("lights of type \"spherical\""), "{told}");
    assert_eq!(scene.lights[0].name, "default sun");
}

#[test]
fn what_is_not_drawn_is_said_with_its_number() {
    let mut file = GltfFile::triangle();
    file.json["extensionsUsed"] = json!(["EXT_new", "KHR_materials_volume", "KHR_lights_punctual"]);
    file.json["animations"] = json!([{}, {}]);
    file.json["materials"][0]["extensions"] = json!({"KHR_materials_volume": {}, "KHR_materials_iridescence": {}});
    file.json["cameras"] = json!([{"type": "orthographic", "orthographic": {"xmag": 1}}]);
    file.json["nodes"][0]["camera"] = json!(0);
    let lines = json!({"attributes": {"POSITION": 0}, "mode": 1});
    file.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(lines);
    let (_, report) = file.load_with(&LoadOptions::default()).unwrap();
    let not_drawn: Vec<_> = report.all().into_iter().filter(|it| it.kind == WarningKind::NotDrawn).collect();
    let told: Vec<_> = not_drawn.iter().map(|it| (it.what.as_ref(), it.count)).collect();
    assert_eq!(
        told,
        [
            ("the extension EXT_new", 1),
            ("animations: everything stands as the file has it", 2),
            ("KHR_materials_iridescence", 1),
            ("KHR_materials_volume", 1),
            ("orthographic cameras", 1),
            ("points, lines and primitives without positions", 1),
        ]
    );
    file.json["extensionsRequired"] = json!(["KHR_materials_volume"]);
    let error = file.load_with(&LoadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("the required extension KHR_materials_volume"), "{error}");
}
