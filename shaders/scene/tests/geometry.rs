//! Transforms, winding, normals, origins, UVs, alpha and lights of scenes made for each test.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

mod common;

use base64::{Engine as _, prelude::BASE64_STANDARD};
use glam::{DVec3, Vec2, Vec3};
use gnomon_scene::{AlphaMode, LightKind, LoadOptions, Scene, SceneError, triangle_normal};
use serde_json::{Value, json};

/// A scene of one triangle (0,0,0), (1,0,0), (0,1,0) with the normal `normal` in node 0, and a point light in node 1.
fn document(normal: Option<[f32; 3]>) -> Value {
    let mut floats: Vec<f32> = vec![0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    floats.extend([0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    floats.extend(normal.unwrap_or([0.0; 3]).repeat(3));
    let bytes: Vec<u8> = floats.iter().flat_map(|v| v.to_le_bytes()).collect();
    let mut attributes = json!({"POSITION": 0, "TEXCOORD_0": 1});
    if normal.is_some() {
        attributes["NORMAL"] = json!(2);
    }
    json!({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0}, {"extensions": {"KHR_lights_punctual": {"light": 0}}}],
        "meshes": [{"primitives": [{"attributes": attributes}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 0, "byteOffset": 36, "componentType": 5126, "count": 3, "type": "VEC2"},
            {"bufferView": 0, "byteOffset": 60, "componentType": 5126, "count": 3, "type": "VEC3"},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 96}],
        "buffers": [{
            "byteLength": 96,
            "uri": format!("data:application/octet-stream;base64,{}", BASE64_STANDARD.encode(bytes)),
        }],
        "extensions": {"KHR_lights_punctual": {"lights": [{"type": "point"}]}},
    })
}

fn load(document: &Value) -> Result<Scene, SceneError> {
    load_with(document, &LoadOptions::default())
}

fn load_with(document: &Value, options: &LoadOptions) -> Result<Scene, SceneError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.gltf");
    std::fs::write(&path, document.to_string()).unwrap();
    Scene::load(&path, options)
}

/// Loads a scene, and returns what was mended, left out or not drawn.
fn report(document: &Value) -> (Scene, String) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.gltf");
    std::fs::write(&path, document.to_string()).unwrap();
    let (scene, report) = Scene::load_with_report(&path, &LoadOptions::default()).unwrap();
    assert_eq!(scene.check(), Ok(()));
    (scene, report.to_string())
}

/// World positions of triangle `number`.
fn world(scene: &Scene, number: usize) -> [DVec3; 3] {
    scene.triangles[number].map(|corner| scene.origin_m + scene.positions[corner as usize].as_dvec3())
}

fn geometric_normal(scene: &Scene, number: usize) -> Vec3 {
    let [a, b, c] = scene.triangles[number].map(|corner| scene.positions[corner as usize]);
    triangle_normal(a, b, c).unwrap().as_vec3()
}

fn close(a: Vec3, b: Vec3) -> bool {
    (a - b).length() < 1e-6
}

#[test]
fn nested_transforms_multiply_from_the_root_down() {
    let mut document = document(None);
    let quarter = std::f64::consts::FRAC_1_SQRT_2;
    document["nodes"] = json!([
        {"translation": [10, 0, 0], "children": [2]},
        {"extensions": {"KHR_lights_punctual": {"light": 0}}},
        // A quarter turn about +Z, after a scale.
        {"rotation": [0, 0, quarter, quarter], "scale": [2, 3, 4], "children": [3]},
        {"matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 1, 1], "mesh": 0},
    ]);
    let scene = load(&document).unwrap();
    let expected = [[10.0, 0.0, 4.0], [10.0, 2.0, 4.0], [7.0, 0.0, 4.0]].map(DVec3::from_array);
    for (got, expected) in world(&scene, 0).iter().zip(expected) {
        assert!((got - expected).length() < 1e-6, "{got} instead of {expected}");
    }
}

#[test]
fn mirrors_keep_front_faces_and_outward_normals() {
    for scale in [[-1.0, 1.0, 1.0], [1.0, -2.0, 1.0], [1.0, 1.0, -1.0], [-1.0, -1.0, -1.0], [-1.0, -1.0, 1.0]] {
        for normal in [None, Some([0.0, 0.0, 1.0])] {
            let mut document = document(normal);
            document["nodes"][0]["scale"] = json!(scale);
            let scene = load(&document).unwrap();
            // The front looks along +Z in the mesh's own space; mirrored in Z, along −Z in the world's.
            let front = Vec3::new(0.0, 0.0, if scale[2] < 0.0 { -1.0 } else { 1.0 });
            assert!(close(geometric_normal(&scene, 0), front), "{scale:?}");
            assert!(scene.normals.iter().all(|normal| close(*normal, front)), "{scale:?} {:?}", scene.normals);
        }
    }
}

#[test]
fn normals_turn_by_the_inverse_transpose() {
    // A plane x + y = const, seen from (1, 1, 0), stretched twofold along x: its normal leans towards y.
    let mut document = document(Some([1.0, 1.0, 0.0]));
    document["nodes"][0]["scale"] = json!([2, 1, 1]);
    let scene = load(&document).unwrap();
    let expected = Vec3::new(0.5, 1.0, 0.0).normalize();
    assert!(scene.normals.iter().all(|normal| close(*normal, expected)), "{:?}", scene.normals);
}

#[test]
fn a_mesh_flattened_to_a_plane_is_still_a_surface() {
    let mut document = document(Some([0.0, 0.0, 1.0]));
    document["nodes"][0]["scale"] = json!([1, 1, 0]);
    let scene = load(&document).unwrap();
    assert!(scene.normals.iter().all(|normal| close(*normal, Vec3::Z)));
    document["nodes"][0]["scale"] = json!([1, 0, 0]);
    assert!(matches!(load(&document), Err(SceneError::NoTriangles { dropped: 1, .. })));
}

#[test]
fn zero_normals_become_their_faces() {
    let scene = load(&document(Some([0.0; 3]))).unwrap();
    assert!(scene.normals.iter().all(|normal| close(*normal, Vec3::Z)));
}

#[test]
fn far_scenes_keep_f64_precision_and_near_ones_their_coordinates() {
    let mut far = document(None);
    far["nodes"][0]["translation"] = json!([6_378_137.125, -2_500_000.5, 123_456_789.062_5]);
    far["nodes"][1]["translation"] = json!([6_378_137.25, -2_500_000.5, 123_456_789.062_5]);
    let scene = load(&far).unwrap();
    let corner = DVec3::new(6_378_137.125, -2_500_000.5, 123_456_789.062_5);
    assert_eq!(world(&scene, 0), [corner, corner + DVec3::X, corner + DVec3::Y]);
    let light = scene.origin_m + scene.lights[0].position.as_dvec3();
    assert_eq!(light, corner + DVec3::X * 0.125);
    assert!(scene.bounds.max.max_element() <= 2.0, "{:?}", scene.bounds);

    let mut near = document(None);
    near["nodes"][0]["translation"] = json!([-0.4, -0.4, 0]);
    assert_eq!(load(&near).unwrap().origin_m, DVec3::ZERO);
    far["nodes"][0]["translation"] = json!([1.1e9, 0, 0]);
    assert!(load(&far).unwrap_err().to_string().contains("1000000000 m"));
}

#[test]
fn hidden_nodes_and_everything_below_them_are_left_out() {
    let mut document = document(None);
    document["nodes"] = json!([
        {"mesh": 0},
        {"extensions": {"KHR_node_visibility": {"visible": false}}, "children": [2]},
        {"mesh": 0, "extensions": {"KHR_lights_punctual": {"light": 0}}},
    ]);
    assert_eq!(load(&document).unwrap().lights[0].name, "default sun");
    document["nodes"][1]["extensions"]["KHR_node_visibility"]["visible"] = json!(true);
    assert_eq!(load(&document).unwrap().instances, 2);
}

#[test]
fn without_a_default_scene_the_first_or_everything_is_shown() {
    let mut document = document(None);
    document["scenes"] = json!([{"nodes": [0, 1]}, {"nodes": [1]}]);
    document.as_object_mut().unwrap().remove("scene");
    assert_eq!(load(&document).unwrap().instances, 1);
    document["scene"] = json!(1);
    assert!(matches!(load(&document), Err(SceneError::NoTriangles { .. })));
    document["scene"] = json!(2);
    assert!(matches!(load(&document), Err(SceneError::Reference { target: "default scene", index: 2, count: 2, .. })));
    document.as_object_mut().unwrap().remove("scene");
    document.as_object_mut().unwrap().remove("scenes");
    assert_eq!(load(&document).unwrap().instances, 1);
}

#[test]
fn loops_second_parents_and_deep_trees_are_errors() {
    let fault = |nodes: Value| {
        let mut document = document(None);
        document["scenes"] = json!([{"nodes": []}]);
        document["nodes"] = nodes;
        load(&document).unwrap_err().to_string()
    };
    assert!(fault(json!([{"children": [0]}, {}])).contains("loop"));
    assert!(fault(json!([{}, {"children": [2]}, {"children": [3]}, {"children": [1]}])).contains("loop"));
    assert!(fault(json!([{"children": [2]}, {"children": [2]}, {}])).contains("node 0's already"));
    assert!(fault(json!([{"children": [1, 1]}, {}])).contains("already"));
    let deep: Vec<Value> = (1..=5000).map(|child| json!({"children": [child]})).chain([json!({})]).collect();
    assert!(fault(json!(deep)).contains("at most 1024"));
}

#[test]
fn spots_and_suns_shine_along_their_nodes_minus_z() {
    let mut document = document(None);
    let quarter = std::f64::consts::FRAC_1_SQRT_2;
    // A quarter turn about +X takes −Z to +Y; the parent's mirror in Y takes that to −Y.
    document["nodes"][1] = json!({"scale": [1, -3, 1], "translation": [0, 1, 0], "children": [2]});
    document["nodes"].as_array_mut().unwrap().push(json!({
        "name": "lamp", "translation": [0, 2, 0], "rotation": [quarter, 0, 0, quarter],
        "extensions": {"KHR_lights_punctual": {"light": 0}},
    }));
    document["extensions"]["KHR_lights_punctual"]["lights"][0] = json!({
        "type": "spot", "color": [1, 0.5, 0], "intensity": 7, "range": 9,
        "spot": {"innerConeAngle": 0.25, "outerConeAngle": 0.5},
    });
    let scene = load(&document).unwrap();
    let light = &scene.lights[0];
    assert!(close(light.direction, Vec3::NEG_Y), "{}", light.direction);
    assert_eq!((scene.origin_m + light.position.as_dvec3()).round(), DVec3::new(0.0, -5.0, 0.0));
    assert_eq!(light.kind, LightKind::Spot { inner_cone_rad: 0.25, outer_cone_rad: 0.5 });
    assert_eq!((light.color, light.intensity, light.range_m), (Vec3::new(1.0, 0.5, 0.0), 7.0, 9.0));
    assert_eq!(light.name, "lamp");
}

#[test]
fn lights_are_counted() {
    let with_lights = |count: usize| {
        let mut document = document(None);
        document["nodes"] = json!([{"mesh": 0}]);
        document["scenes"] = json!([{"nodes": (0..=count).collect::<Vec<_>>()}]);
        for index in 0..count {
            let lamp = json!({"translation": [index, 0, 0], "extensions": {"KHR_lights_punctual": {"light": 0}}});
            document["nodes"].as_array_mut().unwrap().push(lamp);
        }
        document
    };
    let keep = |count, max_lights| {
        let options = LoadOptions { max_lights: Some(max_lights), ..LoadOptions::default() };
        load_with(&with_lights(count), &options)
    };
    assert_eq!(load(&with_lights(32)).unwrap().lights.len(), 32);
    let (scene, told) = report(&with_lights(33));
    assert_eq!(scene.lights.len(), 32);
    assert!(told.contains("the strongest are kept"), "{told}");
    assert_eq!(load(&with_lights(0)).unwrap().lights.len(), 1);
    let without = LoadOptions { default_light: false, ..LoadOptions::default() };
    let error = load_with(&with_lights(0), &without).unwrap_err().to_string();
    assert!(error.contains("--lights-from") && error.contains("--default-light"), "{error}");
    let kept = keep(33, 2).unwrap().lights;
    assert_eq!(kept.iter().map(|light| light.position.x).collect::<Vec<_>>(), [0.0, 1.0]);
    assert_eq!(keep(33, 32).unwrap().lights.len(), 32);
    assert!(matches!(keep(3, 0), Err(SceneError::LightCount { requested: 0, available: 3 })));
    assert!(matches!(keep(3, 4), Err(SceneError::LightCount { requested: 4, available: 3 })));
    assert!(matches!(keep(40, 33), Err(SceneError::LightCount { requested: 33, available: 40 })));
    assert_eq!(keep(0, 1).unwrap().lights.len(), 1);
    assert!(matches!(keep(0, 2), Err(SceneError::LightCount { requested: 2, available: 0 })));
}

#[test]
fn a_lights_file_replaces_the_scenes_lights() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("lights.json");
    let from = |text: &str| {
        std::fs::write(&file, text).unwrap();
        load_with(&document(None), &LoadOptions { lights_from: Some(file.clone()), ..LoadOptions::default() })
    };
    let scene = from(r#"{"lights":[{"type":"directional","direction":[0,-1,0]}]}"#).unwrap();
    assert_eq!(scene.lights.iter().map(|light| light.kind).collect::<Vec<_>>(), [LightKind::Directional]);
    assert_eq!(from(r#"{"lights":[]}"#).unwrap().lights[0].name, "default sun");
    let lamp = r#"{"type":"point","position":[0,0,0]},"#.repeat(33);
    let many = format!(r#"{{"lights":[{}]}}"#, lamp.trim_end_matches(','));
    assert_eq!(from(&many).unwrap().lights.len(), 32);
    let error = from(r#"{"lights":[{"type":"area","position":[0,0,0],"direction":[0,0,1]}]}"#).unwrap_err().to_string();
    assert!(error.contains("lights.json") && error.contains("area"), "{error}");
    std::fs::remove_file(&file).unwrap();
    let options = LoadOptions { lights_from: Some(file.clone()), ..LoadOptions::default() };
    assert!(matches!(load_with(&document(None), &options), Err(SceneError::Read { .. })));
}

/// A picture of 2 × 1 pixels with alpha 0 and 255.
fn png() -> Vec<u8> {
    let mut bytes = Vec::new();
    let picture = image::RgbaImage::from_raw(2, 1, vec![255, 0, 0, 0, 0, 255, 0, 255]).unwrap();
    picture.write_to(&mut std::io::Cursor::new(&mut bytes), image::ImageFormat::Png).unwrap();
    bytes
}

fn textured(picture: &[u8], info: Value) -> Value {
    let mut document = document(None);
    let mut info = info;
    info["index"] = json!(0);
    document["meshes"][0]["primitives"][0]["material"] = json!(0);
    document["materials"] = json!([{
        "name": "leaf", "alphaMode": "MASK", "alphaCutoff": 0.25, "doubleSided": true, "emissiveFactor": [0, 0.5, 1],
        "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 4}},
        "pbrMetallicRoughness": {"baseColorFactor": [1, 0.5, 0.25, 0.75], "baseColorTexture": info},
    }]);
    document["textures"] = json!([{"source": 0, "sampler": 0}]);
    document["samplers"] = json!([{"wrapS": 33071, "wrapT": 33648}]);
    document["images"] = json!([{
        "uri": format!("data:image/png;base64,{}", BASE64_STANDARD.encode(picture)),
    }]);
    document
}

#[test]
fn materials_and_their_alpha_pictures_are_read() {
    use gnomon_scene::Wrap;
    let scene = load(&textured(&png(), json!({}))).unwrap();
    let material = &scene.materials[0];
    assert_eq!(material.name, "leaf");
    assert_eq!(material.base_color.to_array(), [1.0, 0.5, 0.25, 0.75]);
    assert_eq!(material.emissive, Vec3::new(0.0, 2.0, 4.0));
    assert_eq!((material.alpha, material.double_sided), (AlphaMode::Mask { cutoff: 0.25 }, true));
    let texture = material.base_color_texture.unwrap();
    assert_eq!((texture.wrap_u, texture.wrap_v), (Wrap::ClampToEdge, Wrap::MirroredRepeat));
    let picture = scene.alpha_picture(0).unwrap();
    assert_eq!((picture.width, picture.height, picture.alpha), (2, 1, vec![0, 255]));
    assert_eq!(scene.alpha_picture(1), None);
    let unpacked = Scene::unpack(&scene.pack().unwrap()).unwrap();
    assert!(unpacked == scene);
}

#[test]
fn texture_transforms_are_baked() {
    let uvs = |info: Value| load(&textured(&png(), info)).unwrap().uvs;
    let near = |got: Vec<Vec2>, expected: [[f32; 2]; 3]| {
        let close = got.iter().zip(expected).all(|(got, expected)| (*got - Vec2::from_array(expected)).length() < 1e-6);
        assert!(close, "{got:?} instead of {expected:?}");
    };
    near(uvs(json!({})), [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]);
    let transform = |transform: Value| json!({"extensions": {"KHR_texture_transform": transform}});
    near(uvs(transform(json!({"offset": [0.5, 0.25], "scale": [2, 3]}))), [[0.5, 0.25], [2.5, 0.25], [0.5, 3.25]]);
    // Counter-clockwise, with v pointing down: u turns to −v.
    let quarter = std::f64::consts::FRAC_PI_2;
    near(uvs(transform(json!({"rotation": quarter}))), [[0.0, 0.0], [0.0, -1.0], [1.0, 0.0]]);
    near(uvs(transform(json!({"rotation": quarter, "scale": [2, 1]}))), [[0.0, 0.0], [0.0, -2.0], [1.0, 0.0]]);
    // The extension's own example: the lower left quadrant of the picture.
    let quadrant = transform(json!({"offset": [0, 1], "rotation": quarter, "scale": [0.5, 0.5]}));
    near(uvs(quadrant), [[0.0, 1.0], [0.0, 0.5], [0.5, 1.0]]);
    let (scene, told) = report(&textured(&png(), json!({"texCoord": 1})));
    assert!(told.contains("a texture without texture coordinates"), "{told}");
    assert!(scene.materials[0].base_color_texture.is_none() && scene.images.is_empty());
    let (scene, told) = report(&textured(&png(), transform(json!({"scale": [1e9, 1]}))));
    assert!(told.contains("65536"), "{told}");
    assert_eq!(scene.uvs[1], Vec2::new(65536.0, 0.0));
}

#[test]
fn faulty_pictures_are_left_out_and_named() {
    let left_out = |document: &Value| {
        let (scene, told) = report(document);
        assert!(scene.images.is_empty() && scene.materials[0].base_color_texture.is_none());
        assert!(told.starts_with("left out: a picture that cannot be read (image 0"), "{told}");
        told
    };
    let whole = png();
    left_out(&textured(&whole[..whole.len() / 2], json!({})));
    assert!(left_out(&textured(b"GIF89a", json!({}))).contains("none of PNG, JPEG, WebP and KTX2"));
    assert!(left_out(&textured(b"", json!({}))).contains("empty"));
    let mut document = textured(&whole, json!({}));
    for (uri, says) in [
        ("no%20such.png", "no such.png"),
        ("../secret.png", "leaves the scene's folder"),
        ("https://example.com/a.png", "is not local"),
    ] {
        document["images"][0]["uri"] = json!(uri);
        let told = left_out(&document);
        assert!(told.contains(says), "{told}");
    }
    document["images"][0].as_object_mut().unwrap().remove("uri");
    assert!(left_out(&document).contains("neither a uri nor a buffer view"));
}

#[test]
fn opaque_is_drawn_before_mask_before_blend() {
    let mut document = textured(&png(), json!({}));
    let leaf = document["materials"][0].clone();
    let glass = json!({"alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.5]}});
    document["materials"] = json!([glass, leaf, {}]);
    let primitive = |material: usize| json!({"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": material});
    let primitives = [0, 1, 2, 1, 0].map(primitive);
    document["meshes"][0]["primitives"] = json!(primitives);
    document["scenes"][0]["nodes"] = json!([0, 1, 2]);
    document["nodes"].as_array_mut().unwrap().push(json!({"mesh": 0}));
    let scene = load(&document).unwrap();
    let order: Vec<_> = scene.draws.iter().map(|draw| scene.materials[draw.material as usize].alpha).collect();
    let leaf = AlphaMode::Mask { cutoff: 0.25 };
    let (opaque, blend) = (AlphaMode::Opaque, AlphaMode::Blend);
    assert_eq!(order, [opaque, opaque, leaf, leaf, leaf, leaf, blend, blend, blend, blend]);
    assert_eq!(scene.tracing_triangles().len(), 6);
    assert_eq!(scene.instances, 2);
    // Nothing can be seen through the same glass with an alpha of 1.
    document["materials"][0]["pbrMetallicRoughness"] = json!({});
    let scene = load(&document).unwrap();
    let order: Vec<_> = scene.draws.iter().map(|draw| scene.materials[draw.material as usize].alpha).collect();
    assert_eq!(order, [[opaque; 6].as_slice(), &[leaf; 4]].concat());
}
