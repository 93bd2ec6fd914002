//! What moves: channels of every kind, rounds, hierarchies, lights, visibility, and what is mended or left out.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

mod common;

use std::borrow::Cow;

use common::{
    files,
    gltf_file::{GltfFile, channel},
    one_light, scenes,
};
use glam::{DQuat, DVec3, Vec3};
use gnomon_scene::{Image, LoadOptions, Scene, SceneError};
use serde_json::{Value, json};

fn options(animation: &str) -> LoadOptions {
    LoadOptions { animation: Some(animation.to_owned()), ..LoadOptions::default() }
}

/// The triangle beside a resting one, with an animation that has no channels yet. Node 0 is the moving one.
fn file() -> GltfFile {
    let mut file = GltfFile::triangle();
    file.json["nodes"] = json!([{"mesh": 0}, {"mesh": 0, "translation": [0, 0, -9]}]);
    file.json["scenes"][0]["nodes"] = json!([0, 1]);
    file.json["animations"] = json!([{"name": "first", "channels": [], "samplers": []}]);
    file
}

/// The file with node 0 on its way from (0, 0, 0) to (2, 0, 0) within 2 s.
fn rising() -> GltfFile {
    let mut file = file();
    channel(
        &mut file,
        &json!({"node": 0, "path": "translation"}),
        &[0.0, 2.0],
        "VEC3",
        &[0.0, 0.0, 0.0, 2.0, 0.0, 0.0],
    );
    file
}

fn load(file: &GltfFile, animation: &str) -> (Scene, String) {
    let (scene, report) = file.load_with(&options(animation)).unwrap();
    let told = report.all().into_iter().map(|it| it.to_string()).filter(|line| !line.contains("default sun"));
    (scene, told.collect::<Vec<_>>().join("\n"))
}

fn whole(file: &GltfFile) -> Scene {
    let (scene, told) = load(file, "0");
    assert_eq!(told, "");
    scene
}

/// World position of the moving triangle's first corner, if it is shown.
fn corner(scene: &Scene, time_s: f64) -> Option<DVec3> {
    let animation = scene.animation.as_ref().unwrap();
    let placement = scene.moment(time_s).unwrap().pieces[0].clone()?;
    Some(placement.vertex(&animation.own_vertices()[0], 0).0.as_dvec3() + scene.origin_m)
}

#[test]
fn one_of_several_animations_is_chosen_by_name_or_number() {
    let mut file = rising();
    let second = json!({"name": "second", "channels": [], "samplers": []});
    file.json["animations"].as_array_mut().unwrap().push(second);
    for (wanted, moves) in
        [("first", true), ("0", true), ("all", true), ("second", false), ("1", false), ("off", false)]
    {
        let (scene, told) = load(&file, wanted);
        assert_eq!(scene.animation.is_some(), moves, "{wanted}");
        assert_eq!(told.contains("animations: everything stands as the file has it (2×)"), wanted == "off", "{told}");
    }
    assert!(file.load().0.animation.is_none());
    let error = file.load_with(&options("third")).unwrap_err();
    assert!(matches!(&error, SceneError::NoSuch { kind: "animation", .. }), "{error}");
    assert!(error.to_string().contains("\"first\", \"second\""), "{error}");
}

#[test]
fn a_scene_at_rest_is_the_scene_without_its_animation() {
    let mut file = rising();
    // Not what the animation begins with.
    file.json["nodes"][0]["translation"] = json!([0, 5, 0]);
    let (resting, moving) = (load(&file, "off").0, whole(&file));
    assert_eq!(moving.at_rest(), resting);
    assert_ne!(moving.still_at(0.0), resting);
    assert_eq!(Scene { animation: None, ..moving.clone() }, resting);
    // For those who read no pictures, they are not copied.
    let picture = Image { encoded: vec![1], width: 1, height: 1, rgba: vec![0; 4] };
    let pictured = Scene { images: vec![picture], ..moving.clone() };
    let still = pictured.still_at(0.5);
    assert_eq!(still.images, pictured.images);
    assert_eq!(*pictured.bare_at(0.5), Scene { images: Vec::new(), ..still });
    assert!(matches!(resting.bare_at(0.5), Cow::Borrowed(_)));
    // Nothing that rests is written twice, and a scene that rests has the bytes that it had.
    assert_eq!(moving.animation.as_ref().unwrap().positions.len(), 3);
    assert_eq!(resting.pack().unwrap()[8..12], 3_u32.to_le_bytes());
    assert_eq!(moving.pack().unwrap()[8..12], 5_u32.to_le_bytes());
}

#[test]
fn a_moment_is_the_file_with_its_nodes_moved() {
    // Node 2 turns under node 0, which moves; between them stands node 3, mirrored and scaled.
    let mut file = rising();
    let nodes = |translation: Value, rotation: Value| {
        json!([
            {"translation": translation, "rotation": [0, 0.6, 0, 0.8], "children": [3]},
            {"mesh": 0, "translation": [0, 0, -9]},
            {"mesh": 0, "rotation": rotation, "children": [4]},
            {"scale": [-2, 1, 1], "translation": [0, 1, 0], "children": [2]},
            {"mesh": 0, "translation": [0, 0, 3], "scale": [1, -3, 1]},
        ])
    };
    file.json["nodes"] = nodes(json!([0, 0, 0]), json!([0, 0, 0, 1]));
    let (from, to) = (DQuat::IDENTITY, DQuat::from_rotation_x(1.0));
    let values = [from, to].map(|q| q.as_quat().to_array()).concat();
    channel(&mut file, &json!({"node": 2, "path": "rotation"}), &[0.0, 2.0], "VEC4", &values);
    let moving = whole(&file);
    assert_eq!(moving.animation.as_ref().unwrap().pieces.len(), 2);
    for time_s in [0.0, 0.5, 1.0, 1.75] {
        let turned = DQuat::from_rotation_x(time_s / 2.0);
        file.json["nodes"] = nodes(json!([time_s, 0, 0]), json!(turned.to_array()));
        let (expected, still) = (load(&file, "off").0, moving.still_at(time_s));
        assert_eq!((still.triangles.len(), &still.draws), (expected.triangles.len(), &expected.draws));
        for (got, expected) in still.triangles.iter().zip(&expected.triangles) {
            assert_eq!(got, expected, "{time_s}: front faces");
        }
        // The keys are rounded to f32: a turn by 6e-8, some 3 m away. Local spaces keep 3e-7 m there.
        let world = |scene: &Scene, at: usize| scene.positions[at].as_dvec3() + scene.origin_m;
        for at in 0..still.positions.len() {
            let (apart, bent) =
                (world(&still, at).distance(world(&expected, at)), still.normals[at].distance(expected.normals[at]));
            assert!(apart < 2e-6 && bent < 1e-6, "{time_s}, vertex {at}: {apart} m, {bent}");
        }
    }
}

#[test]
fn rounds_repeat_and_end_with_the_last_key_of_any_channel() {
    let mut file = rising();
    let scene = whole(&file);
    for (time_s, x) in [(0.0, 0.0), (1.0, 1.0), (3.0, 1.0), (-0.5, 1.5), (2e6 + 1.0, 1.0)] {
        assert_eq!(corner(&scene, time_s), Some(DVec3::X * x), "{time_s}");
    }
    // A channel that is not drawn lengthens the round: the place is held.
    let weights = json!({"node": 0, "path": "weights"});
    channel(&mut file, &weights, &[0.0, 4.0], "SCALAR", &[0.0, 1.0]);
    let (scene, told) = load(&file, "first");
    assert!(told.contains("not drawn: animated weights of meshes without morph targets"), "{told}");
    assert_eq!([3.0, 5.0].map(|time_s| corner(&scene, time_s)), [Some(DVec3::X * 2.0), Some(DVec3::X)]);
}

#[test]
fn what_never_changes_rests_where_the_animation_has_it() {
    let mut file = file();
    channel(&mut file, &json!({"node": 0, "path": "translation"}), &[0.0, 2.0], "VEC3", &[7.0, 0.0, 0.0].repeat(2));
    let (scene, told) = load(&file, "0");
    assert_eq!(told, "");
    assert!(scene.animation.is_none());
    assert_eq!(scene.positions[0].as_dvec3() + scene.origin_m, DVec3::X * 7.0);
    // Beside something that does change.
    let turn = [[0.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.0]].concat();
    channel(&mut file, &json!({"node": 0, "path": "rotation"}), &[0.0, 2.0], "VEC4", &turn);
    assert_eq!(corner(&whole(&file), 0.5), Some(DVec3::X * 7.0));
}

#[test]
fn what_has_no_size_at_first_is_kept_and_what_is_hidden_is_not_shown() {
    let mut file = file();
    file.json["nodes"][0]["scale"] = json!([0, 0, 0]);
    channel(&mut file, &json!({"node": 0, "path": "scale"}), &[0.0, 2.0], "VEC3", &[0.0, 0.0, 0.0, 4.0, 4.0, 4.0]);
    let scene = whole(&file);
    assert_eq!([0.0, 0.5].map(|time_s| scene.still_at(time_s).triangles.len()), [1, 2]);
    assert_eq!((scene.triangles.len(), scene.at_rest().triangles.len()), (2, 1));
    let still = scene.still_at(0.5);
    assert_eq!(still.positions[1] - still.positions[0], Vec3::X);

    // The file hides it; the animation shows it in the second half, by a pointer.
    let mut file = self::file();
    file.json["nodes"][0]["extensions"] = json!({"KHR_node_visibility": {"visible": false}});
    let pointer = json!({"pointer": "/nodes/0/extensions/KHR_node_visibility/visible"});
    let target = json!({"path": "pointer", "extensions": {"KHR_animation_pointer": pointer}});
    let (input, output) = (file.floats("SCALAR", &[0.0, 1.0, 2.0]), file.accessor(5121, "SCALAR", 3, &[0, 1, 1]));
    file.json["animations"][0]["samplers"] = json!([{"input": input, "output": output, "interpolation": "STEP"}]);
    file.json["animations"][0]["channels"] = json!([{"sampler": 0, "target": target}]);
    let scene = whole(&file);
    assert_eq!([0.5, 1.5].map(|time_s| corner(&scene, time_s).is_some()), [false, true]);
    assert_eq!(scene.at_rest().triangles.len(), 1);
    assert_eq!(load(&file, "off").0.triangles.len(), 1);
}

#[test]
fn a_scale_that_changes_its_sign_keeps_front_faces_in_front() {
    let mut file = file();
    let mirror = [1.0, 1.0, 1.0, -1.0, 1.0, 1.0];
    channel(&mut file, &json!({"node": 0, "path": "scale"}), &[0.0, 2.0], "VEC3", &mirror);
    let scene = whole(&file);
    for (time_s, x) in [(0.5, 0.5), (1.5, -0.5)] {
        let still = scene.still_at(time_s);
        let [a, b, c] = still.triangles[0].map(|corner| still.positions[corner as usize]);
        assert_eq!((b - a).cross(c - a).normalize(), Vec3::Z, "{time_s}");
        assert!(still.positions.iter().take(3).any(|position| position.x == x));
        assert_eq!(still.normals[0], Vec3::Z);
    }
}

#[test]
fn lights_and_cameras_move_and_change() {
    let mut file = rising();
    file.json["nodes"] = json!([
        {"mesh": 0, "children": [2, 3]},
        {"mesh": 0},
        {"translation": [0, 3, 0], "extensions": {"KHR_lights_punctual": {"light": 0}}},
        {"translation": [0, 0, 4], "camera": 0},
    ]);
    file.json["cameras"] = json!([{"type": "perspective", "perspective": {"yfov": 0.5}}]);
    file.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [{"type": "spot", "intensity": 0}]}});
    let mut pointer = |pointer: &str, shape: &str, values: &[f32]| {
        let target = json!({"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": pointer}}});
        channel(&mut file, &target, &[0.0, 2.0], shape, values);
    };
    pointer("/extensions/KHR_lights_punctual/lights/0/intensity", "SCALAR", &[0.0, 100.0]);
    pointer("/extensions/KHR_lights_punctual/lights/0/color", "VEC3", &[0.0, 0.0, 1.0, 1.0, 0.0, 1.0]);
    pointer("/extensions/KHR_lights_punctual/lights/0/range", "SCALAR", &[2.0, 6.0]);
    pointer("/extensions/KHR_lights_punctual/lights/0/spot/outerConeAngle", "SCALAR", &[0.25, 0.75]);
    pointer("/cameras/0/perspective/yfov", "SCALAR", &[0.5, 1.5]);
    let (scene, told) = load(&file, "0");
    assert_eq!(told, "");
    // It is off in the file, and shines at times.
    assert_eq!(scene.lights.len(), 1);
    let light = &scene.moment(1.0).unwrap().lights[0];
    let place = light.position.as_dvec3() + scene.origin_m;
    assert_eq!((place, light.intensity, light.range_m), (DVec3::new(1.0, 3.0, 0.0), 50.0, 4.0));
    assert_eq!(light.color, Vec3::new(0.5, 0.0, 1.0));
    let gnomon_scene::LightKind::Spot { inner_cone_rad, outer_cone_rad } = light.kind else { panic!("{light:?}") };
    assert_eq!((inner_cone_rad, outer_cone_rad), (0.0, 0.5));
    let camera = &scene.cameras_at(1.0)[0];
    assert_eq!((camera.position_m, camera.yfov_rad), (DVec3::new(1.0, 0.0, 4.0), 1.0));
    assert_eq!(scene.at_rest().lights[0].intensity, 0.0);
    // Other lights take the places of all.
    let folder = tempfile::tempdir().unwrap();
    let lights = LoadOptions { animation: Some("0".to_owned()), ..one_light(folder.path()) };
    let (scene, _) = file.load_with(&lights).unwrap();
    assert!(scene.animation.unwrap().lights.is_empty());
}

/// A change of a file.
type Change<'a> = &'a dyn Fn(&mut GltfFile);

#[test]
fn broken_channels_are_left_out_or_mended() {
    let told = |change: Change<'_>| {
        let mut file = rising();
        change(&mut file);
        let (scene, told) = load(&file, "0");
        (scene, told)
    };
    let cases: [(&str, Change<'_>); 4] = [
        ("a channel without a sampler", &|file| {
            file.json["animations"][0]["channels"][0]["sampler"] = json!(7);
        }),
        ("a channel of nothing", &|file| {
            file.json["animations"][0]["channels"][0]["target"]["node"] = json!(7);
        }),
        ("a channel whose times cannot be read", &|file| {
            file.json["animations"][0]["samplers"][0]["input"] = json!(77);
        }),
        ("a channel whose values cannot be read", &|file| {
            file.json["animations"][0]["samplers"][0]["output"] =
                file.json["animations"][0]["samplers"][0]["input"].clone();
        }),
    ];
    for (says, change) in cases {
        let (scene, told) = told(change);
        let says = says.replace("a channel", "an animation's channel");
        assert!(scene.animation.is_none() && told.contains(&says), "{says}: {told}");
    }
    // Keys that are no numbers or go back are left out: 0 s, 1 s and 2 s remain.
    let (scene, says) = told(&|file| {
        file.json["animations"][0] = json!({"channels": [], "samplers": []});
        let times = [0.0, f32::NAN, 1.0, 0.5, 2.0];
        let xs = [0.0, 9.0, 5.0, 9.0, 6.0];
        let values: Vec<f32> = xs.iter().flat_map(|x| [*x, 0.0, 0.0]).collect();
        channel(file, &json!({"node": 0, "path": "translation"}), &times, "VEC3", &values);
    });
    assert!(says.contains("keys of animations that are not finite, or go back in time (2×"), "{says}");
    assert_eq!([0.5, 1.5].map(|time_s| corner(&scene, time_s)), [Some(DVec3::X * 2.5), Some(DVec3::X * 5.5)]);
    let (scene, says) = told(&|file| file.json["animations"][0]["samplers"][0]["interpolation"] = json!("BEZIER"));
    assert!(says.contains("an interpolation that does not exist") && corner(&scene, 1.0) == Some(DVec3::X), "{says}");
    let (scene, says) = told(&|file| {
        file.json["nodes"][0] = json!({"mesh": 0, "matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 5, 0, 0, 1]});
    });
    assert!(says.contains("an animated node with a matrix: taken apart"), "{says}");
    let still = scene.still_at(1.0);
    assert_eq!(
        (still.positions[0].as_dvec3() + still.origin_m, still.positions[1] - still.positions[0]),
        (DVec3::X, Vec3::X * 2.0)
    );
    let (_, says) = told(&|file| {
        let pointer = json!({"KHR_animation_pointer": {"pointer": "/materials/0/emissiveFactor"}});
        channel(file, &json!({"path": "pointer", "extensions": pointer}), &[0.0], "VEC3", &[1.0; 3]);
    });
    assert!(says.contains("not drawn: animated properties but"), "{says}");
    // Out of all reach: not shown then, and legal.
    let (scene, _) = told(&|file| {
        file.json["animations"][0] = json!({"channels": [], "samplers": []});
        let values = [0.0, 0.0, 0.0, 3e38, 0.0, 0.0];
        channel(file, &json!({"node": 0, "path": "translation"}), &[0.0, 2.0], "VEC3", &values);
    });
    assert!(corner(&scene, 0.0).is_some() && corner(&scene, 1.0).is_none());
}

#[test]
fn real_animated_files_move_and_stay_legal() {
    let folder = tempfile::tempdir().unwrap();
    let mut moving = 0;
    for path in files(&scenes().join("animated")) {
        if !path.extension().is_some_and(|extension| extension == "gltf" || extension == "glb") {
            continue;
        }
        let options = LoadOptions { animation: Some("all".to_owned()), ..one_light(folder.path()) };
        let scene = Scene::load(&path, &options).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        assert_eq!(scene.check(), Ok(()), "{}", path.display());
        assert!(Scene::unpack(&scene.pack().unwrap()).unwrap() == scene, "{}", path.display());
        let resting = Scene::load(&path, &one_light(folder.path())).unwrap();
        assert_eq!(scene.at_rest().triangles.len(), resting.triangles.len(), "{}", path.display());
        for time_s in [0.0, 0.3, 1.7, 123.4] {
            assert_eq!(scene.still_at(time_s).check(), Ok(()), "{} at {time_s}", path.display());
        }
        moving += u32::from(scene.animation.is_some());
    }
    assert!(moving >= 5, "{moving} files move");
}
