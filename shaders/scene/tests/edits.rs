//! What people may change in a scene, and what it is then.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

mod common;

use std::sync::Arc;

use common::gltf_file::GltfFile;
use glam::{DQuat, DVec3, Vec3};
use gnomon_scene::{Edit, EditError, Edits, LightEdit, LightKind, LoadOptions, NodeEdit, Scene, SceneAt, SceneError};
use serde_json::json;

/// Two triangles; node 0 is called "door" and has a lamp below it.
fn file() -> GltfFile {
    let mut file = GltfFile::triangle();
    file.json["nodes"] = json!([
        {"mesh": 0, "name": "door", "children": [2], "translation": [0, 0, 1]},
        {"mesh": 0, "name": "wall", "translation": [0, 0, -9]},
        {"name": "lamp", "translation": [0, 3, 0], "extensions": {"KHR_lights_punctual": {"light": 0}}},
    ]);
    file.json["scenes"][0]["nodes"] = json!([0, 1]);
    file.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [{"type": "spot", "intensity": 40}]}});
    file
}

fn load(file: &GltfFile, editable: &[&str]) -> Scene {
    let editable = editable.iter().map(|name| (*name).to_owned()).collect();
    file.load_with(&LoadOptions { editable, ..LoadOptions::default() }).unwrap().0
}

fn at(edits: &[Edit]) -> SceneAt {
    let mut all = Edits::default();
    edits.iter().for_each(|edit| all.apply(*edit).unwrap());
    SceneAt { time_s: 0.0, edits: Arc::new(all) }
}

#[test]
fn named_nodes_may_be_edited_and_nothing_else_changes() {
    let file = file();
    let plain = load(&file, &[]);
    assert!(plain.animation.is_none());
    let scene = load(&file, &["door"]);
    let animation = scene.animation.as_ref().unwrap();
    let [door] = &animation.nodes[..] else { panic!("{:?}", animation.nodes) };
    assert_eq!(
        (door.name.as_str(), door.editable, animation.pieces.len(), animation.lights.len()),
        ("door", true, 1, 1)
    );
    // It is the same scene until it is edited, and no time changes it.
    assert!(!animation.moves_scene());
    assert_eq!(Scene { animation: None, ..scene.clone() }, plain);
    assert_eq!(scene.still_at(7.5), plain);
    assert_eq!(Scene::unpack(&scene.pack().unwrap()).unwrap(), scene);
    assert_eq!(load(&file, &["all"]).animation.unwrap().nodes.len(), 3);
    assert_eq!(load(&file, &["1", "door"]).animation.unwrap().pieces.len(), 2);
    let wanted = LoadOptions { editable: vec!["gate".to_owned()], ..LoadOptions::default() };
    let error = file.load_with(&wanted).unwrap_err();
    assert!(matches!(&error, SceneError::NoSuch { kind: "node", .. }), "{error}");
}

#[test]
fn an_edited_node_is_where_a_file_would_have_it() {
    let mut file = file();
    let scene = load(&file, &["door"]);
    let (translation, turn, scale) =
        (DVec3::new(1.5, -2.0, 0.25), DQuat::from_rotation_y(1.1), DVec3::new(-1.0, 2.0, 3.0));
    let moved = NodeEdit { translation_m: Some(translation), rotation: Some(turn), scale: Some(scale), shown: None };
    let edited = scene.still_at(at(&[Edit::Node(0, moved)]));
    file.json["nodes"][0]["translation"] = json!(translation.to_array());
    file.json["nodes"][0]["rotation"] = json!(turn.to_array());
    file.json["nodes"][0]["scale"] = json!(scale.to_array());
    let expected = load(&file, &[]);
    // The origin is that of another middle.
    let world = |scene: &Scene, corner: u32| scene.positions[corner as usize].as_dvec3() + scene.origin_m;
    for (one, other) in edited.triangles.as_flattened().iter().zip(expected.triangles.as_flattened()) {
        assert!(world(&edited, *one).distance(world(&expected, *other)) < 1e-5);
    }
    let lamp = |scene: &Scene| scene.lights[0].position.as_dvec3() + scene.origin_m;
    assert!(lamp(&edited).distance(lamp(&expected)) < 1e-5);
    assert_eq!(edited.triangles.len(), 2);
    let hidden = NodeEdit { shown: Some(false), ..NodeEdit::default() };
    let edited = scene.still_at(at(&[Edit::Node(0, moved), Edit::Node(0, hidden)]));
    assert_eq!((edited.triangles.len(), edited.lights[0].intensity), (1, 0.0), "the lamp is out with it");
    // The last word counts, and nothing is said any more.
    let undone = at(&[Edit::Node(0, moved), Edit::Node(0, NodeEdit::default())]);
    assert!(undone.edits.is_empty() && scene.still_at(&undone) == scene.still_at(0.0));
}

#[test]
fn lights_may_be_edited_in_any_scene() {
    let scene = load(&file(), &[]);
    let edit = LightEdit {
        position_m: Some(DVec3::new(5.0, 6.0, 7.0)),
        direction: Some(DVec3::X),
        color: Some(Vec3::new(1.0, 0.5, 0.0)),
        intensity: Some(3.0),
        range_m: Some(9.0),
        cone_rad: Some([0.1, 0.2]),
    };
    let at = at(&[Edit::Light(0, edit)]);
    let edited = scene.still_at(&at);
    let light = &edited.lights[0];
    assert_eq!(light.position.as_dvec3() + scene.origin_m, DVec3::new(5.0, 6.0, 7.0));
    assert_eq!((light.direction, light.color), (Vec3::X, Vec3::new(1.0, 0.5, 0.0)));
    assert_eq!((light.intensity, light.range_m), (3.0, 9.0));
    assert_eq!(light.kind, LightKind::Spot { inner_cone_rad: 0.1, outer_cone_rad: 0.2 });
    assert_eq!(Scene { lights: scene.lights.clone(), ..edited.clone() }, scene);
    assert_eq!(scene.moment(&at).unwrap().lights, edited.lights);
    assert!(scene.moment(3.0).is_none());
    assert_eq!(edited.check(), Ok(()));
}

#[test]
fn edits_are_checked_and_bounded() {
    let scene = load(&file(), &["door"]);
    let node = |edit| Edit::Node(0, edit);
    let place = |x| Some(DVec3::new(x, 0.0, 0.0));
    for (edit, expected) in [
        (Edit::Node(1, NodeEdit::default()), EditError::Node(1)),
        (Edit::Light(1, LightEdit::default()), EditError::Light(1)),
        (node(NodeEdit { translation_m: place(1.1e9), ..NodeEdit::default() }), EditError::Range("the translation")),
        (node(NodeEdit { translation_m: place(f64::NAN), ..NodeEdit::default() }), EditError::Range("the translation")),
        (
            node(NodeEdit { rotation: Some(DQuat::IDENTITY * 1.01), ..NodeEdit::default() }),
            EditError::Range("the rotation"),
        ),
        (node(NodeEdit { scale: place(f64::INFINITY), ..NodeEdit::default() }), EditError::Range("the scale")),
    ] {
        assert_eq!(edit.check(&scene), Err(expected));
    }
    let mut moving = scene.clone();
    moving.animation.as_mut().unwrap().nodes[0].editable = false;
    assert_eq!(node(NodeEdit::default()).check(&moving), Err(EditError::Node(0)));
    let mut edits = Edits::default();
    let shown = |node| Edit::Node(node, NodeEdit { shown: Some(true), ..NodeEdit::default() });
    let most = u32::try_from(gnomon_scene::limits::MAX_EDITED).unwrap();
    (0..most).for_each(|node| edits.apply(shown(node)).unwrap());
    assert_eq!(edits.apply(shown(most)), Err(EditError::TooMany));
    assert_eq!((edits.apply(shown(0)), edits.len()), (Ok(()), most as usize));
}

#[test]
fn a_node_tells_where_it_is() {
    let scene = load(&file(), &["door", "lamp"]);
    let lamp = scene.node_at(1, &at(&[])).unwrap();
    assert_eq!((lamp.translation_m, lamp.shown, lamp.visible), (DVec3::Y * 3.0, true, true));
    assert_eq!(lamp.world_from_node().w_axis.truncate(), DVec3::new(0.0, 3.0, 1.0));
    let (turn, there) = (DQuat::from_rotation_z(0.5), DVec3::new(4.0, 0.0, 0.0));
    let door = NodeEdit { translation_m: Some(there), rotation: Some(turn), shown: Some(false), ..NodeEdit::default() };
    let edited = at(&[Edit::Node(0, door)]);
    let lamp = scene.node_at(1, &edited).unwrap();
    assert_eq!((lamp.translation_m, lamp.shown, lamp.visible), (DVec3::Y * 3.0, true, false));
    // A handful of roundings of a few metres.
    let expected = there + turn * (DVec3::Y * 3.0);
    assert!(lamp.world_from_node().w_axis.truncate().distance(expected) < 1e-14);
    assert_eq!(scene.node_at(2, &edited), None);
}

#[test]
fn edits_lead_from_one_state_to_another() {
    let node = |x: f64| Edit::Node(0, NodeEdit { translation_m: Some(DVec3::X * x), ..NodeEdit::default() });
    let light = |intensity| Edit::Light(1, LightEdit { intensity: Some(intensity), ..LightEdit::default() });
    let states = [at(&[]), at(&[node(1.0)]), at(&[node(2.0), light(3.0)]), at(&[light(3.0)])];
    for (before, after) in states.iter().flat_map(|one| states.iter().map(move |other| (one, other))) {
        let edits = after.edits.since(&before.edits);
        let mut state = before.edits.as_ref().clone();
        edits.iter().for_each(|edit| state.apply(*edit).unwrap());
        assert_eq!((&state, edits.is_empty()), (after.edits.as_ref(), before == after));
    }
    assert_eq!(states[2].edits.since(&states[1].edits), [node(2.0), light(3.0)]);
}
