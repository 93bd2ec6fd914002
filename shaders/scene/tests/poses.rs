//! Skins, morph targets, instances, cameras and the choice of a scene.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

mod common;

use common::gltf_file::GltfFile;
use glam::{DVec3, Vec3};
use gnomon_scene::{LoadOptions, Scene, SceneError, triangle_normal};
use serde_json::{Value, json};

fn load(file: &GltfFile) -> Scene {
    let (scene, told) = file.load();
    assert_eq!(told, "");
    scene
}

/// World positions of the first triangle.
fn world(scene: &Scene) -> [DVec3; 3] {
    scene.triangles[0].map(|corner| scene.origin_m + scene.positions[corner as usize].as_dvec3())
}

fn near(got: [DVec3; 3], expected: [[f64; 3]; 3]) {
    let close = got.iter().zip(expected).all(|(got, expected)| (*got - DVec3::from_array(expected)).length() < 1e-5);
    assert!(close, "{got:?} instead of {expected:?}");
}

fn geometric_normal(scene: &Scene) -> Vec3 {
    let [a, b, c] = scene.triangles[0].map(|corner| scene.positions[corner as usize]);
    triangle_normal(a, b, c).unwrap().as_vec3()
}

/// The triangle, whose first two vertices follow joint 1 and whose third follows joint 2.
fn skinned(joints: [Value; 2]) -> GltfFile {
    let mut file = GltfFile::triangle();
    let names = file.accessor(5121, "VEC4", 3, &[0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0]);
    file.primitive()["attributes"]["JOINTS_0"] = json!(names);
    file.attribute("WEIGHTS_0", &[1.0, 0.0, 0.0, 0.0].repeat(3));
    let [first, second] = joints;
    // The node of the mesh has a transform, which a skin ignores.
    file.json["nodes"] = json!([{"mesh": 0, "skin": 0, "translation": [50, 0, 0]}, first, second]);
    file.json["scenes"][0]["nodes"] = json!([0, 1, 2]);
    file.json["skins"] = json!([{"joints": [1, 2]}]);
    file
}

#[test]
fn skins_follow_their_joints() {
    let file = skinned([json!({"translation": [0, 0, 5]}), json!({"translation": [0, 3, 5]})]);
    near(world(&load(&file)), [[0.0, 0.0, 5.0], [1.0, 0.0, 5.0], [0.0, 4.0, 5.0]]);

    // Inverse bind matrices come first.
    let mut file = skinned([json!({}), json!({})]);
    let mut bind = [0.0; 16];
    (bind[0], bind[5], bind[10], bind[15]) = (1.0, 1.0, 1.0, 1.0);
    let mut moved = bind;
    moved[14] = -2.0;
    let matrices = file.floats("MAT4", &[bind, moved].concat());
    file.json["skins"][0]["inverseBindMatrices"] = json!(matrices);
    near(world(&load(&file)), [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, -2.0]]);
}

#[test]
fn weights_are_normalised_and_sets_added_up() {
    let mut file = skinned([json!({"translation": [4, 0, 0]}), json!({"translation": [0, 0, 8]})]);
    // Half of each joint for every vertex: 0.25 in one set and 0.25 in another.
    let second = file.accessor(5121, "VEC4", 3, &[1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0]);
    file.primitive()["attributes"]["JOINTS_1"] = json!(second);
    file.attribute("WEIGHTS_0", &[0.25, 0.0, 0.0, 0.0].repeat(3));
    file.attribute("WEIGHTS_1", &[0.25, 0.0, 0.0, 0.0].repeat(3));
    near(world(&load(&file)), [[2.0, 0.0, 4.0], [3.0, 0.0, 4.0], [2.0, 1.0, 4.0]]);
    // A vertex without weights follows the first joint that it names.
    file.attribute("WEIGHTS_0", &[0.0; 12]);
    file.attribute("WEIGHTS_1", &[0.0; 12]);
    near(world(&load(&file)), [[4.0, 0.0, 0.0], [5.0, 0.0, 0.0], [0.0, 1.0, 8.0]]);
}

#[test]
fn skins_turn_normals_and_keep_faces_and_far_scenes_exact() {
    let quarter = std::f64::consts::FRAC_1_SQRT_2;
    // A quarter turn about +X takes +Z to −Y.
    let turned = json!({"rotation": [quarter, 0, 0, quarter], "translation": [6_378_137.125, 0, 0]});
    let scene = load(&skinned([turned.clone(), turned]));
    assert!(scene.normals.iter().all(|normal| (*normal - Vec3::NEG_Y).length() < 1e-6), "{:?}", scene.normals);
    assert!((geometric_normal(&scene) - Vec3::NEG_Y).length() < 1e-6);
    let edge = world(&scene)[1] - world(&scene)[0];
    assert!((edge - DVec3::X).length() < 1e-6 && (world(&scene)[0].x - 6_378_137.125).abs() < 1e-6);
    let mirrored = json!({"scale": [-1, 1, 1]});
    let scene = load(&skinned([mirrored.clone(), mirrored]));
    assert_eq!(geometric_normal(&scene), Vec3::Z);
    assert_eq!(scene.normals, [Vec3::Z; 3]);
}

#[test]
fn broken_skins_leave_the_mesh_where_its_node_is() {
    let told = |change: &dyn Fn(&mut GltfFile)| {
        let mut file = skinned([json!({"translation": [0, 0, 5]}), json!({})]);
        change(&mut file);
        let (scene, told) = file.load();
        (world(&scene)[0], told)
    };
    let (at, what) = told(&|file| file.json["skins"][0]["joints"] = json!([]));
    assert!(at == DVec3::X * 50.0 && what.contains("a skin without joints"), "{at} {what}");
    let (at, what) = told(&|file| {
        file.primitive()["attributes"].as_object_mut().unwrap().remove("WEIGHTS_0");
    });
    assert!(at == DVec3::X * 50.0 && what.contains("joints or weights at the vertices"), "{at} {what}");
    // Its second joint is gone: that vertex follows nothing, and stays where the mesh has it.
    let (at, what) = told(&|file| file.json["skins"][0]["joints"] = json!([1]));
    assert!(at == DVec3::Z * 5.0 && what.contains("joints that a skin has not"), "{at} {what}");
    let mut file = skinned([json!({}), json!({})]);
    file.json["skins"][0]["joints"] = json!([1, 9]);
    let error = file.load_with(&LoadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("skin 0 names node 9"), "{error}");
}

#[test]
fn morph_targets_have_the_files_weights() {
    let mut file = GltfFile::triangle();
    let up = file.floats("VEC3", &[0.0, 0.0, 2.0].repeat(3));
    let aside = file.floats("VEC3", &[4.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let lean = file.floats("VEC3", &[2.0, 0.0, 0.0].repeat(3));
    let dark = file.floats("VEC4", &[-1.0, 0.0, 0.0, -1.0].repeat(3));
    file.attribute("COLOR_0", &[1.0; 12]);
    file.primitive()["targets"] = json!([{"POSITION": up, "NORMAL": lean, "COLOR_0": dark}, {"POSITION": aside}]);
    // Without weights a target counts for nothing.
    near(world(&load(&file)), [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    file.json["meshes"][0]["weights"] = json!([0.5, 0]);
    let scene = load(&file);
    near(world(&scene), [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]]);
    assert!(scene.normals.iter().all(|normal| (*normal - Vec3::new(1.0, 0.0, 1.0).normalize()).length() < 1e-6));
    assert_eq!(scene.colors, [[32768, 65535, 65535, 32768]; 3]);
    // A node's own weights replace its mesh's, for this node alone.
    file.json["nodes"] = json!([{"mesh": 0, "weights": [0, 0.125]}, {"mesh": 0, "translation": [0, 0, 10]}]);
    file.json["scenes"][0]["nodes"] = json!([0, 1]);
    let scene = load(&file);
    near(world(&scene), [[0.5, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    assert_eq!(scene.origin_m.z + f64::from(scene.bounds.max.z), 11.0);
}

#[test]
fn posing_is_bounded() {
    let mut file = GltfFile::triangle();
    let zeros = json!({"componentType": 5126, "type": "VEC3", "count": 1 << 22});
    file.json["accessors"].as_array_mut().unwrap().push(zeros);
    let corners = file.accessor(5121, "SCALAR", 3, &[0, 1, 2]);
    *file.primitive() = json!({
        "attributes": {"POSITION": 3, "NORMAL": 3}, "indices": corners, "targets": vec![json!({"POSITION": 3}); 65],
    });
    file.json["meshes"][0]["weights"] = json!(vec![1; 65]);
    let error = file.load_with(&LoadOptions::default()).unwrap_err();
    assert!(error.to_string().contains("morph targets and skins"), "{error}");
}

#[test]
fn instances_are_repeated_within_their_node() {
    let mut file = GltfFile::triangle();
    let translations = file.floats("VEC3", &[0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 2.0]);
    let scales = file.floats("VEC3", &[1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 3.0, 3.0, 3.0]);
    // A quarter turn about +Z, in normalised bytes.
    let turn = [0, 0, 90, 90];
    let rotations = file.accessor(5120, "VEC4", 3, &turn.repeat(3));
    file.json["accessors"][rotations]["normalized"] = json!(true);
    file.json["nodes"][0] = json!({"mesh": 0, "translation": [5, 0, 0], "extensions": {"EXT_mesh_gpu_instancing": {
        "attributes": {"TRANSLATION": translations, "ROTATION": rotations, "SCALE": scales, "_ID": 0},
    }}});
    file.json["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    let scene = load(&file);
    assert_eq!((scene.instances, scene.draws.len()), (3, 3));
    near(world(&scene), [[5.0, 0.0, 0.0], [5.0, 1.0, 0.0], [4.0, 0.0, 0.0]]);
    let last = scene.triangles[2].map(|corner| scene.origin_m + scene.positions[corner as usize].as_dvec3());
    near(last, [[5.0, 0.0, 2.0], [5.0, 3.0, 2.0], [2.0, 0.0, 2.0]]);

    file.json["accessors"][scales]["count"] = json!(2);
    let error = file.load_with(&LoadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("different counts"), "{error}");
    // Zeros that no buffer backs would take memory for millions of transforms.
    let accessors = file.json["accessors"].as_array_mut().unwrap();
    accessors.push(json!({"componentType": 5126, "type": "VEC3", "count": 16_000_000}));
    let many = accessors.len() - 1;
    file.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"] = json!({"SCALE": many});
    let error = file.load_with(&LoadOptions::default()).unwrap_err();
    assert!(matches!(error, SceneError::Limit { count: 16_000_000, .. }), "{error}");
}

#[test]
fn cameras_stand_at_their_nodes() {
    let mut file = GltfFile::triangle();
    let quarter = std::f64::consts::FRAC_1_SQRT_2;
    file.json["cameras"] = json!([
        {"type": "perspective", "name": "wide", "perspective": {"yfov": 0.7, "znear": 0.1}},
        {"type": "perspective", "perspective": {"yfov": 0}},
    ]);
    file.json["nodes"] = json!([
        {"mesh": 0, "camera": 1},
        {"translation": [1e6, 2, 3], "scale": [2, 2, 2], "children": [2]},
        {
            "name": "door", "camera": 0, "translation": [0, 1, 0], "rotation": [0, quarter, 0, quarter],
            "scale": [1, 9, -1],
        },
        {"camera": 0},
    ]);
    file.json["scenes"][0]["nodes"] = json!([0, 1, 3]);
    let (scene, told) = file.load();
    assert!(told.contains("cameras without a vertical field of view") && told.contains("node 0"), "{told}");
    assert_eq!(scene.cameras.iter().map(|camera| camera.name.as_str()).collect::<Vec<_>>(), ["door", "wide"]);
    let camera = &scene.cameras[0];
    assert_eq!((camera.position_m, camera.yfov_rad), (DVec3::new(1e6, 4.0, 3.0), 0.7));
    // A quarter turn about +Y takes −Z to −X, and the mirror turns it round; up stays.
    assert!((camera.orientation * DVec3::NEG_Z - DVec3::X).length() < 1e-9, "{}", camera.orientation);
    assert!((camera.orientation * DVec3::Y - DVec3::Y).length() < 1e-9);
}

#[test]
fn scenes_are_chosen_by_name_or_number() {
    let mut file = GltfFile::triangle();
    file.json["nodes"] = json!([{"mesh": 0}, {"mesh": 0, "translation": [3, 0, 0]}]);
    file.json["scenes"] = json!([{"name": "hall", "nodes": [0]}, {"name": "1st", "nodes": [1]}, {"nodes": [0, 1]}]);
    let shown = |scene: Option<&str>| {
        let options = LoadOptions { scene: scene.map(str::to_owned), ..LoadOptions::default() };
        file.load_with(&options).map(|(scene, _)| (world(&scene)[0].x, scene.instances))
    };
    for (wanted, expected) in [
        (None, (0.0, 1)),
        (Some("hall"), (0.0, 1)),
        (Some("1st"), (3.0, 1)),
        (Some("1"), (3.0, 1)),
        (Some("2"), (0.0, 2)),
    ] {
        assert_eq!(shown(wanted).unwrap(), expected, "{wanted:?}");
    }
    let error = shown(Some("cellar")).unwrap_err().to_string();
    assert_eq!(error, "there is no scene \"cellar\"; the file has: \"hall\", \"1st\", \"\"");
}
