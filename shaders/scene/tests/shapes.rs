//! Skins and morph targets that move: where vertices are at a time, as computed by hand, and what damaged ones become.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

mod common;

use std::f32::consts::FRAC_1_SQRT_2;

use common::gltf_file::{GltfFile, channel};
use glam::{DVec3, Vec3, Vec4};
use gnomon_scene::{LoadOptions, Scene};
use serde_json::json;

fn load(file: &GltfFile) -> (Scene, String) {
    let options = LoadOptions { animation: Some("all".to_owned()), ..LoadOptions::default() };
    let (scene, report) = file.load_with(&options).unwrap();
    let told = report.all().into_iter().map(|it| it.to_string()).filter(|line| !line.contains("default sun"));
    (scene, told.collect::<Vec<_>>().join("\n"))
}

fn whole(file: &GltfFile) -> Scene {
    let (scene, told) = load(file);
    assert_eq!(told, "");
    scene
}

/// World positions of the first triangle at a time.
fn world(scene: &Scene, time_s: f64) -> [DVec3; 3] {
    let still = scene.still_at(time_s);
    assert_eq!(still.check(), Ok(()));
    still.triangles[0].map(|corner| still.origin_m + still.positions[corner as usize].as_dvec3())
}

fn near(got: [DVec3; 3], expected: [[f64; 3]; 3]) {
    let close = got.iter().zip(expected).all(|(got, expected)| (*got - DVec3::from_array(expected)).length() < 1e-6);
    assert!(close, "{got:?} instead of {expected:?}");
}

/// The triangle with an animation that has no channels yet.
fn file() -> GltfFile {
    let mut file = GltfFile::triangle();
    file.json["animations"] = json!([{"channels": [], "samplers": []}]);
    file
}

/// The triangle, whose first two vertices follow joint 1 and whose third follows both, half and half. Joint 2 turns by
/// a quarter about +Z within a second, and back.
fn bending() -> GltfFile {
    let mut file = file();
    let names = file.accessor(5121, "VEC4", 3, &[0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0]);
    file.primitive()["attributes"]["JOINTS_0"] = json!(names);
    let weights = [[1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.5, 0.5, 0.0, 0.0]];
    file.attribute("WEIGHTS_0", weights.as_flattened());
    file.json["nodes"] = json!([{"mesh": 0, "skin": 0, "translation": [50, 0, 0]}, {"children": [2]}, {}]);
    file.json["scenes"][0]["nodes"] = json!([0, 1]);
    file.json["skins"] = json!([{"joints": [1, 2]}]);
    let turns = [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, FRAC_1_SQRT_2, FRAC_1_SQRT_2], [0.0, 0.0, 0.0, 1.0]];
    let target = json!({"node": 2, "path": "rotation"});
    channel(&mut file, &target, &[0.0, 1.0, 2.0], "VEC4", turns.as_flattened());
    file
}

#[test]
fn skins_bend_as_computed_by_hand() {
    let scene = whole(&bending());
    near(world(&scene, 0.0), [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    // Joint 2 has (0, 1, 0) at (−1, 0, 0); the vertex lies half way.
    near(world(&scene, 1.0), [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-0.5, 0.5, 0.0]]);
    let half = f64::from(FRAC_1_SQRT_2);
    near(world(&scene, 0.5), [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-half / 2.0, (1.0 + half) / 2.0, 0.0]]);
    assert_eq!(world(&scene, 4001.0), world(&scene, 1.0));
    // The pose of the file is the resting scene's.
    let (resting, _) = bending().load_with(&LoadOptions::default()).unwrap();
    assert_eq!(scene.at_rest().positions, resting.positions);
    assert_eq!((&scene.positions, &scene.triangles), (&resting.positions, &resting.triangles));
}

#[test]
fn inverse_bind_matrices_come_first_and_the_meshs_own_node_is_ignored() {
    let mut file = bending();
    let mut bind = [0.0; 16];
    (bind[0], bind[5], bind[10], bind[15]) = (1.0, 1.0, 1.0, 1.0);
    let mut below = bind;
    below[13] = -1.0;
    let matrices = file.floats("MAT4", &[bind, below].concat());
    file.json["skins"][0]["inverseBindMatrices"] = json!(matrices);
    file.json["nodes"][2]["translation"] = json!([0, 1, 0]);
    let target = json!({"node": 0, "path": "translation"});
    channel(&mut file, &target, &[0.0, 2.0], "VEC3", &[0.0, 0.0, 0.0, 9.0, 9.0, 9.0]);
    // Bound where it stands, the third vertex is the joint's own place, and does not move.
    let scene = whole(&file);
    for time_s in [0.0, 0.3, 1.0] {
        near(world(&scene, time_s), [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    }
    // Half of the linear part turns with it, and with it the normal of the bent surface, which stays +Z here.
    assert_eq!(scene.still_at(1.0).normals, [Vec3::Z; 3]);
}

#[test]
fn far_from_the_origin_nothing_is_lost() {
    let mut file = bending();
    file.json["nodes"][1]["translation"] = json!([6_378_137.125, 0, 0]);
    let scene = whole(&file);
    let [a, b, c] = world(&scene, 1.0);
    assert!((a.x - 6_378_137.125).abs() < 1e-6 && ((b - a) - DVec3::X).length() < 1e-6, "{a} {b}");
    assert!(((c - a) - DVec3::new(-0.5, 0.5, 0.0)).length() < 1e-6, "{c}");
}

#[test]
fn more_than_four_joints_count_and_weights_are_normalised() {
    let mut file = bending();
    // Five joints, the fifth in a second set; weights that add up to 1.5.
    let nodes = json!([
        {"mesh": 0, "skin": 0}, {}, {},
        {"translation": [0, 0, 1]}, {"translation": [0, 0, 2]}, {"translation": [0, 3, 0]},
    ]);
    file.json["nodes"] = nodes;
    file.json["scenes"][0]["nodes"] = json!([0, 1, 2, 3, 4, 5]);
    file.json["skins"][0]["joints"] = json!([1, 2, 3, 4, 5]);
    let names = file.accessor(5121, "VEC4", 3, &[0, 1, 2, 3].repeat(3));
    let more = file.accessor(5121, "VEC4", 3, &[4, 0, 0, 0].repeat(3));
    file.primitive()["attributes"]["JOINTS_0"] = json!(names);
    file.primitive()["attributes"]["JOINTS_1"] = json!(more);
    file.attribute("WEIGHTS_0", &[0.25; 4].repeat(3));
    file.attribute("WEIGHTS_1", &[0.5, 0.0, 0.0, 0.0].repeat(3));
    let scene = whole(&file);
    // (0 + 0 + 1 + 2) / 6 along z and 3 / 3 along y; at 1 s, joint 2 turns a sixth of each vertex.
    near(world(&scene, 0.0), [[0.0, 1.0, 0.5], [1.0, 1.0, 0.5], [0.0, 2.0, 0.5]]);
    let sixth = 1.0 / 6.0;
    near(world(&scene, 1.0), [[0.0, 1.0, 0.5], [1.0 - sixth, 1.0 + sixth, 0.5], [-sixth, 2.0 - sixth, 0.5]]);
}

#[test]
fn normals_and_faces_follow_a_turning_and_mirroring_skin() {
    let mut file = bending();
    // All follow joint 2, which turns by a quarter about +X, and mirrors in the second half.
    let names = file.accessor(5121, "VEC4", 3, &[1, 0, 0, 0].repeat(3));
    file.primitive()["attributes"]["JOINTS_0"] = json!(names);
    file.attribute("WEIGHTS_0", &[1.0, 0.0, 0.0, 0.0].repeat(3));
    file.json["animations"] = json!([{"channels": [], "samplers": []}]);
    let turns = [[0.0, 0.0, 0.0, 1.0], [FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2]];
    channel(&mut file, &json!({"node": 2, "path": "rotation"}), &[0.0, 1.0], "VEC4", turns.as_flattened());
    let scales = [1.0, 1.0, 1.0, -1.0, 1.0, 1.0, -1.0, 1.0, 1.0];
    channel(&mut file, &json!({"node": 1, "path": "scale"}), &[0.0, 2.0, 4.0], "VEC3", &scales);
    let scene = whole(&file);
    let turned = scene.still_at(1.0 - 1e-9);
    assert!(turned.normals.iter().all(|normal| (*normal - Vec3::NEG_Y).length() < 1e-6), "{:?}", turned.normals);
    for time_s in [0.2, 0.9, 2.5, 3.9] {
        let still = scene.still_at(time_s);
        let [a, b, c] = still.triangles[0].map(|corner| still.positions[corner as usize]);
        let face = gnomon_scene::triangle_normal(a, b, c).unwrap().as_vec3();
        assert!(still.normals.iter().all(|normal| normal.dot(face) > 0.999), "{time_s}: {face} {:?}", still.normals);
    }
}

#[test]
fn vertices_without_normals_are_flat_at_any_time() {
    let mut file = bending();
    file.primitive()["attributes"].as_object_mut().unwrap().remove("NORMAL");
    // Joint 2 leans out of the plane.
    file.json["animations"] = json!([{"channels": [], "samplers": []}]);
    let turns = [[0.0, 0.0, 0.0, 1.0], [FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2], [0.0, 0.0, 0.0, 1.0]];
    channel(&mut file, &json!({"node": 2, "path": "rotation"}), &[0.0, 1.0, 2.0], "VEC4", turns.as_flattened());
    let scene = whole(&file);
    // The third vertex is at (0, ½, ½).
    let still = scene.still_at(1.0);
    let expected = Vec3::new(0.0, -FRAC_1_SQRT_2, FRAC_1_SQRT_2);
    assert!(still.normals.iter().all(|normal| (*normal - expected).length() < 1e-6), "{:?}", still.normals);
    assert_eq!(scene.still_at(0.0).normals, [Vec3::Z; 3]);
}

/// The triangle with two targets: the first lifts it by 2 m and turns its normals and tangents, the second moves its
/// first vertex aside by 4 m.
fn morphing(interpolation: &str, times: &[f32], weights: &[f32]) -> GltfFile {
    let mut file = file();
    let up = file.floats("VEC3", &[0.0, 0.0, 2.0].repeat(3));
    let lean = file.floats("VEC3", &[2.0, 0.0, 0.0].repeat(3));
    let twist = file.floats("VEC3", &[-1.0, 1.0, 0.0].repeat(3));
    let aside = file.floats("VEC3", &[4.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    file.attribute("TANGENT", &[1.0, 0.0, 0.0, -1.0].repeat(3));
    let texture = file.texture([128, 128, 255, 255]);
    file.json["materials"][0]["normalTexture"] = json!({"index": texture});
    file.primitive()["targets"] = json!([{"POSITION": up, "NORMAL": lean, "TANGENT": twist}, {"POSITION": aside}]);
    file.json["meshes"][0]["weights"] = json!([0, 0.125]);
    channel(&mut file, &json!({"node": 0, "path": "weights"}), times, "SCALAR", weights);
    file.json["animations"][0]["samplers"][0]["interpolation"] = json!(interpolation);
    file
}

#[test]
fn weights_step_run_and_follow_splines() {
    let keys = [0.0, 0.0, 1.0, 0.5, 0.0, 0.25];
    let run = whole(&morphing("LINEAR", &[0.0, 1.0, 2.0], &keys));
    near(world(&run, 0.25), [[0.5, 0.0, 0.5], [1.0, 0.0, 0.5], [0.0, 1.0, 0.5]]);
    near(world(&run, 1.5), [[1.5, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]]);
    let step = whole(&morphing("STEP", &[0.0, 1.0, 2.0], &keys));
    near(world(&step, 0.9), [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    near(world(&step, 1.9), [[2.0, 0.0, 2.0], [1.0, 0.0, 2.0], [0.0, 1.0, 2.0]]);
    // Of each key all in-tangents, then all values, then all out-tangents. Target 0 goes from 0 to 1 within 2 s, leaves
    // at 1 and arrives at −1 per second; target 1 rests at ½: at the middle ½ + 2·⅛·1 + 2·⅛·1 = 1, and ½.
    let spline = [[9.0, 9.0], [0.0, 0.5], [1.0, 0.0], [-1.0, 0.0], [1.0, 0.5], [9.0, 9.0]];
    let spline = whole(&morphing("CUBICSPLINE", &[0.0, 2.0], spline.as_flattened()));
    near(world(&spline, 1.0), [[2.0, 0.0, 2.0], [1.0, 0.0, 2.0], [0.0, 1.0, 2.0]]);
    // In the pose of the file its own weights count.
    let rest = run.at_rest();
    assert_eq!(rest.positions[0].x - rest.positions[2].x, 0.5);
    let (resting, _) = morphing("LINEAR", &[0.0, 1.0, 2.0], &keys).load_with(&LoadOptions::default()).unwrap();
    assert_eq!(rest.positions, resting.positions);
}

#[test]
fn normals_and_tangents_morph_too() {
    let scene = whole(&morphing("LINEAR", &[0.0, 1.0], &[0.0, 0.0, 0.5, 0.0]));
    let still = scene.still_at(1.0 - 1e-12);
    let (normal, tangent) = (Vec3::new(1.0, 0.0, 1.0).normalize(), Vec3::new(1.0, 1.0, 0.0).normalize());
    assert!(still.normals.iter().all(|it| (*it - normal).length() < 1e-6), "{:?}", still.normals);
    assert!(still.tangents.iter().all(|it| (*it - tangent.extend(-1.0)).length() < 1e-6), "{:?}", still.tangents);
    assert_eq!(scene.still_at(0.0).tangents, [Vec4::new(1.0, 0.0, 0.0, -1.0); 3]);
}

#[test]
fn pointers_reach_the_weights_of_nodes_and_meshes() {
    let keys = [0.0, 0.0, 1.0, 0.5, 0.0, 0.25];
    let plain = morphing("LINEAR", &[0.0, 1.0, 2.0], &keys);
    let expected = world(&whole(&plain), 0.4);
    for pointer in ["/nodes/0/weights", "/meshes/0/weights"] {
        let mut file = morphing("LINEAR", &[0.0, 1.0, 2.0], &keys);
        let pointer = json!({"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": pointer}}});
        file.json["animations"][0]["channels"][0]["target"] = pointer;
        assert_eq!(world(&whole(&file), 0.4), expected);
    }
}

#[test]
fn morph_targets_come_before_joints() {
    let mut file = bending();
    let up = file.floats("VEC3", &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
    file.primitive()["targets"] = json!([{"POSITION": up}]);
    channel(&mut file, &json!({"node": 0, "path": "weights"}), &[0.0, 1.0, 2.0], "SCALAR", &[0.0, 1.0, 0.0]);
    // (0, 2, 0) is half there and half at (−2, 0, 0).
    near(world(&whole(&file), 1.0), [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 1.0, 0.0]]);
}

#[test]
fn what_does_not_change_its_shape_rests() {
    let packed = |file: &GltfFile| {
        let scene = whole(file);
        assert_eq!(scene.animation, None);
        scene.pack().unwrap()
    };
    // Joints that no vertex follows, joints that never turn, and weights that never change.
    let mut file = bending();
    file.attribute("WEIGHTS_0", &[1.0, 0.0, 0.0, 0.0].repeat(3));
    let still = file.load().0.pack().unwrap();
    assert_eq!(packed(&file), still);
    let mut file = bending();
    file.json["animations"] = json!([{"channels": [], "samplers": []}]);
    let still = file.load().0.pack().unwrap();
    let turns = [0.0, 0.0, 0.0, 1.0].repeat(2);
    channel(&mut file, &json!({"node": 2, "path": "rotation"}), &[0.0, 1.0], "VEC4", &turns);
    assert_eq!(packed(&file), still);
    let constant = morphing("LINEAR", &[0.0, 1.0], &[0.5, 0.0, 0.5, 0.0]);
    let mut own = morphing("LINEAR", &[0.0, 1.0], &[0.5, 0.0, 0.5, 0.0]);
    own.json["animations"] = json!([]);
    own.json["meshes"][0]["weights"] = json!([0.5, 0]);
    assert_eq!(packed(&constant), own.load().0.pack().unwrap());
}

#[test]
fn damaged_skins_and_weights_keep_the_pose_of_the_file() {
    let file_pose = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let mut file = bending();
    file.primitive()["attributes"].as_object_mut().unwrap().remove("WEIGHTS_0");
    let (scene, told) = load(&file);
    assert!(scene.animation.is_none() && told.contains("joints or weights at the vertices"), "{told}");
    // One joint is not there: its vertex keeps what it has of the others.
    let mut file = bending();
    file.json["skins"][0]["joints"] = json!([2]);
    let (scene, told) = load(&file);
    assert!(told.contains("joints that a skin has not"), "{told}");
    near(world(&scene, 0.0), file_pose);
    near(world(&scene, 1.0), [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]);
    let mut file = bending();
    file.attribute("WEIGHTS_0", &[f32::NAN; 12]);
    let (scene, told) = load(&file);
    assert!(scene.animation.is_none() && told.contains("weights below 0"), "{told}");
    let (scene, told) = load(&morphing("LINEAR", &[0.0, 1.0, 2.0], &[0.0, 0.0, 1.0]));
    assert!(told.contains("another number of values") && scene.animation.is_none(), "{told}");
    let mut file = morphing("LINEAR", &[0.0, 1.0], &[0.0, 0.0, 1.0, 0.0]);
    file.json["animations"][0]["channels"][0]["target"]["node"] = json!(7);
    let (scene, told) = load(&file);
    assert!(scene.animation.is_none() && told.contains("channel of nothing"), "{told}");
}

#[test]
fn what_leaves_all_reach_is_not_shown_then() {
    let mut file = bending();
    file.json["nodes"].as_array_mut().unwrap().push(json!({"mesh": 0}));
    file.json["scenes"][0]["nodes"] = json!([0, 1, 3]);
    let target = json!({"node": 1, "path": "translation"});
    channel(&mut file, &target, &[0.0, 2.0], "VEC3", &[0.0, 0.0, 0.0, 3e38, 0.0, 0.0]);
    let scene = whole(&file);
    assert_eq!([0.0, 1.0].map(|time_s| scene.still_at(time_s).triangles.len()), [2, 1]);
    // So is a mesh under a node that is hidden, though its joints are elsewhere.
    let mut file = bending();
    file.json["nodes"].as_array_mut().unwrap().push(json!({"mesh": 0}));
    file.json["scenes"][0]["nodes"] = json!([0, 1, 3]);
    let pointer = json!({"pointer": "/nodes/0/extensions/KHR_node_visibility/visible"});
    let target = json!({"path": "pointer", "extensions": {"KHR_animation_pointer": pointer}});
    channel(&mut file, &target, &[0.0, 1.0, 2.0], "SCALAR", &[1.0, 0.0, 1.0]);
    let scene = whole(&file);
    assert_eq!([0.5, 1.5].map(|time_s| scene.still_at(time_s).triangles.len()), [2, 1]);
    assert_eq!(scene.animation.as_ref().unwrap().shapes.len(), 1);
}

#[test]
fn bounds_hold_all_vertices_at_any_time() {
    let mut file = bending();
    let up = file.floats("VEC3", &[0.0, 1.0, 0.5, 0.0, -2.0, 0.0, 1.0, 1.0, 0.0]);
    file.primitive()["targets"] = json!([{"POSITION": up}]);
    let (times, weights) = ([0.0, 0.7, 2.0], [0.0, 1.5, -1.0]);
    channel(&mut file, &json!({"node": 0, "path": "weights"}), &times, "SCALAR", &weights);
    let scene = whole(&file);
    let animation = scene.animation.as_ref().unwrap();
    let own = animation.own_vertices();
    for step in 0..40_u8 {
        let moment = scene.moment(f64::from(step) * 0.13).unwrap();
        let placement = moment.pieces[0].as_ref().unwrap();
        for vertex in 0..3 {
            let (at, normal) = placement.vertex(&own[0], vertex);
            let bounds = placement.bounds;
            assert!(at.cmpge(bounds.min).all() && at.cmple(bounds.max).all(), "{step}: {at} in {bounds:?}");
            assert!((normal.length() - 1.0).abs() < 1e-6);
        }
    }
}
