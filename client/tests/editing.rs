//! Picking and dragging in scenes as they are loaded: moved, mirrored, instanced, bent, with holes.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use std::{path::Path, sync::Arc};

use glam::{DQuat, DVec2, DVec3, Vec3};
use gnomon_client_core::edit::{
    Target,
    editor::Editor,
    handles::{Axis, Handle},
    stage::Stage,
    view::View,
};
use gnomon_scene::{
    Edit, Edits, LightEdit, LoadOptions, NodeEdit, Scene, SceneAt,
    camera::{Camera, Space},
};
use serde_json::{Value, json};

/// A glTF file under construction.
struct File {
    json: Value,
    bytes: Vec<u8>,
}

impl File {
    fn accessor(&mut self, kind: &str, component: u32, count: usize, bytes: &[u8]) -> usize {
        let views = self.json["bufferViews"].as_array_mut().unwrap();
        views.push(json!({"buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len()}));
        let view = views.len() - 1;
        self.bytes.extend(bytes);
        let accessors = self.json["accessors"].as_array_mut().unwrap();
        accessors.push(json!({"bufferView": view, "componentType": component, "count": count, "type": kind}));
        accessors.len() - 1
    }

    fn floats<const N: usize>(&mut self, values: &[[f32; N]]) -> usize {
        let kind = ["SCALAR", "VEC2", "VEC3", "VEC4"][N - 1];
        let bytes: Vec<u8> = values.as_flattened().iter().flat_map(|value| value.to_le_bytes()).collect();
        let accessor = self.accessor(kind, 5126, values.len(), &bytes);
        let bound = |least: bool| -> Vec<f32> {
            let of = |axis: usize| values.iter().map(move |value| value[axis]);
            (0..N).map(|axis| of(axis).reduce(if least { f32::min } else { f32::max }).unwrap()).collect()
        };
        (self.json["accessors"][accessor]["min"], self.json["accessors"][accessor]["max"]) =
            (json!(bound(true)), json!(bound(false)));
        accessor
    }

    fn indices(&mut self, values: &[u32]) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.accessor("SCALAR", 5125, values.len(), &bytes)
    }
}

/// Everything lies 5 m before a camera in the origin, but for the wall behind it. Names say what may be edited.
fn write(folder: &Path) -> std::path::PathBuf {
    let mut file =
        File { json: json!({"asset": {"version": "2.0"}, "accessors": [], "bufferViews": []}), bytes: Vec::new() };
    // A square of 1 m that faces +z, and a bumpy wall of 40 m with more triangles than share a box.
    let square = [[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]];
    let (positions, uvs) = (file.floats(&square), file.floats(&[[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]));
    let indices = file.indices(&[0, 1, 2, 0, 2, 3]);
    let side = 24_u32;
    let corner = |number: u32| {
        let (x, y) = (number % side, number / side);
        [x as f32 / 0.575 - 20.0, y as f32 / 0.575 - 20.0, ((x * 7 + y * 5) % 4) as f32 * 0.1]
    };
    let wall: Vec<[f32; 3]> = (0..side * side).map(corner).collect();
    let cells = (0..side - 1).flat_map(|y| (0..side - 1).map(move |x| y * side + x));
    let corners: Vec<u32> =
        cells.flat_map(|first| [0, 1, side + 1, 0, side + 1, side].map(|step| first + step)).collect();
    let (wall, corners) = (file.floats(&wall), file.indices(&corners));
    let up = file.floats(&[[0.0, 3.0, 0.0]; 4]);
    let places = file.floats(&[[-2.0, 3.0, 0.0], [2.0, 3.0, 0.0]]);
    let times = file.floats(&[[0.0], [2.0]]);
    let rises = file.floats(&[[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    let bends = file.floats(&[[0.0], [1.0]]);
    let picture = image::RgbaImage::from_fn(2, 1, |x, _| image::Rgba([255, 255, 255, if x == 0 { 0 } else { 255 }]));
    picture.save(folder.join("leaf.png")).unwrap();

    let json = &mut file.json;
    let mesh = |material: u32| {
        let attributes = json!({"POSITION": positions, "TEXCOORD_0": uvs});
        json!({"primitives": [{"attributes": attributes, "indices": indices, "material": material}]})
    };
    let mut bent = mesh(0);
    bent["primitives"][0]["targets"] = json!([{"POSITION": up}]);
    let wall = json!({"primitives": [{"attributes": {"POSITION": wall}, "indices": corners, "material": 0}]});
    json["meshes"] = json!([mesh(0), wall, mesh(1), bent]);
    json["materials"] = json!([
        {},
        {"alphaMode": "MASK", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}},
    ]);
    (json["textures"], json["images"]) = (json!([{"source": 0}]), json!([{"uri": "leaf.png"}]));
    json["extensionsUsed"] = json!(["KHR_lights_punctual", "EXT_mesh_gpu_instancing"]);
    json["extensions"] = json!({"KHR_lights_punctual": {"lights": [
        {"type": "point", "intensity": 100, "name": "lamp"},
        {"type": "directional", "intensity": 3},
        {"type": "spot", "intensity": 50},
    ]}});
    let light = |number: u32| json!({"KHR_lights_punctual": {"light": number}});
    json["nodes"] = json!([
        {"mesh": 1, "translation": [0, 0, -10]},
        {"name": "card", "mesh": 0, "translation": [-2, 0, -5]},
        {"name": "twin", "mesh": 0, "translation": [2, 0, -5], "scale": [-1, 1, 1]},
        {"name": "arm", "translation": [0, 0, -5], "rotation": [0, 0, 0.6, 0.8], "children": [4]},
        {"name": "hand", "mesh": 0},
        {"name": "crowd", "mesh": 0, "translation": [0, 0, -5],
            "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places}}}},
        {"name": "leaf", "mesh": 2, "translation": [0, -2, -5]},
        {"name": "stand", "translation": [4, -2, -5], "children": [8]},
        {"mesh": 3},
        {"translation": [-2, -2, -5], "extensions": light(0)},
        {"extensions": light(1)},
        {"translation": [2, -2, -5], "extensions": light(2)},
    ]);
    (json["scene"], json["scenes"]) = (json!(0), json!([{"nodes": [0, 1, 2, 3, 5, 6, 7, 9, 10, 11]}]));
    let channel = |node: u32, path: &str, output: usize| {
        (json!({"sampler": 0, "target": {"node": node, "path": path}}), json!({"input": times, "output": output}))
    };
    let (arm, arm_keys) = channel(3, "translation", rises);
    let (mut bend, bend_keys) = channel(8, "weights", bends);
    bend["sampler"] = json!(1);
    json["animations"] = json!([{"channels": [arm, bend], "samplers": [arm_keys, bend_keys]}]);
    json["buffers"] = json!([{"uri": "scene.bin", "byteLength": file.bytes.len()}]);
    std::fs::write(folder.join("scene.bin"), &file.bytes).unwrap();
    let path = folder.join("scene.gltf");
    std::fs::write(&path, file.json.to_string()).unwrap();
    path
}

fn scene() -> Scene {
    let folder = tempfile::tempdir().unwrap();
    let editable = ["card", "twin", "hand", "crowd", "leaf", "stand"].map(str::to_owned).to_vec();
    let options = LoadOptions { animation: Some("all".to_owned()), editable, ..LoadOptions::default() };
    Scene::load(&write(folder.path()), &options).unwrap()
}

fn view(scene: &Scene) -> View {
    let camera = Camera {
        position_m: DVec3::ZERO,
        orientation: DQuat::IDENTITY,
        yfov_rad: std::f64::consts::FRAC_PI_2,
        width: 1600,
        height: 1200,
    };
    View::new(camera, Space::of(scene))
}

fn at(time_s: f64, edits: &[Edit]) -> SceneAt {
    let mut all = Edits::default();
    edits.iter().for_each(|edit| all.apply(*edit).unwrap());
    SceneAt { time_s, edits: Arc::new(all) }
}

fn node(scene: &Scene, name: &str) -> u32 {
    let nodes = &scene.animation.as_ref().unwrap().nodes;
    u32::try_from(nodes.iter().position(|node| node.name == name).unwrap()).unwrap()
}

/// The name of what is picked where a point of the world is seen.
fn picked(editor: &Editor, at: &SceneAt, place: [f64; 3]) -> Option<String> {
    let view = view(editor.stage.scene());
    let px = view.project(place.into()).unwrap();
    let target = editor.pick(&view, &editor.stage.pose(at), px, 8.0);
    target.map(|target| editor.stage.label(target))
}

#[test]
fn a_click_picks_the_nearest_thing_that_may_be_edited() {
    let editor = Editor::new(scene());
    let file = at(0.0, &[]);
    for (place, expected) in [
        ([-2.0, 0.0, -5.0], Some("card")),
        ([-1.6, 0.4, -5.0], Some("card")),
        // Beside it there is the wall, which stays.
        ([-1.4, 0.0, -5.0], None),
        ([2.3, 0.2, -5.0], Some("twin")),
        // Both instances are of one node.
        ([-2.0, 3.0, -5.0], Some("crowd")),
        ([2.0, 3.0, -5.0], Some("crowd")),
        // The left half of the leaf is a hole.
        ([0.25, -2.0, -5.0], Some("leaf")),
        ([-0.25, -2.0, -5.0], None),
        // A lamp has no surface, but a marker of 8 px: 600 px are 5 m here.
        ([-2.0, -2.0, -5.0], Some("lamp")),
        ([-2.06, -2.0, -5.0], Some("lamp")),
        ([-2.08, -2.0, -5.0], None),
        ([2.0, -2.0, -5.0], Some("light 3")),
        // What bends has no name, but hangs on something that has.
        ([4.0, -2.0, -5.0], Some("stand")),
    ] {
        assert_eq!(picked(&editor, &file, place).as_deref(), expected, "{place:?}");
    }
    // Outside the wall there is nothing.
    assert_eq!(editor.stage.nearest(DVec3::ZERO, DVec3::new(5.0, 0.0, -1.0), &editor.stage.pose(&file)), None);
}

#[test]
fn a_click_picks_what_is_drawn_at_that_time_and_with_those_edits() {
    let editor = Editor::new(scene());
    let scene = editor.stage.scene();
    // The arm rises by a metre from 0, and loses the file's 5 m: the track counts.
    let (hand, low, high) = ("hand", [0.0, 0.0, -5.0], [0.0, 1.0, -5.0]);
    let moved = |time_s: f64| {
        let back = NodeEdit { translation_m: Some(DVec3::NEG_Z * 5.0), ..NodeEdit::default() };
        at(time_s, &[Edit::Node(node(scene, hand), back)])
    };
    assert_eq!(picked(&editor, &moved(0.0), low).as_deref(), Some(hand));
    assert_eq!(picked(&editor, &moved(2.0), [0.0, -0.6, -5.0]), None);
    assert_eq!(picked(&editor, &moved(1.999), high).as_deref(), Some(hand));
    // What bends goes up by three metres.
    assert_eq!(picked(&editor, &at(1.999, &[]), [4.0, -2.0, -5.0]), None);
    assert_eq!(picked(&editor, &at(1.999, &[]), [4.0, 1.0, -5.0]).as_deref(), Some("stand"));

    let card = node(scene, "card");
    let edited = |edit: NodeEdit| at(0.0, &[Edit::Node(card, edit)]);
    let place = [-2.0, 0.0, -5.0];
    let hidden = edited(NodeEdit { shown: Some(false), ..NodeEdit::default() });
    assert_eq!(picked(&editor, &hidden, place), None);
    let moved = edited(NodeEdit { translation_m: Some(DVec3::new(-3.5, 0.0, -5.0)), ..NodeEdit::default() });
    assert_eq!(picked(&editor, &moved, place), None);
    assert_eq!(picked(&editor, &moved, [-3.5, 0.0, -5.0]).as_deref(), Some("card"));
    // Its back is not drawn, and what is mirrored twice has its front before it again.
    let around = edited(NodeEdit { rotation: Some(DQuat::from_rotation_y(3.0)), ..NodeEdit::default() });
    assert_eq!(picked(&editor, &around, place), None);
    let twin = |edit: NodeEdit| at(0.0, &[Edit::Node(node(scene, "twin"), edit)]);
    let mirrored = twin(NodeEdit { scale: Some(DVec3::new(-1.0, -1.0, 1.0)), ..NodeEdit::default() });
    assert_eq!(picked(&editor, &mirrored, [2.0, 0.0, -5.0]).as_deref(), Some("twin"));
    let around = twin(NodeEdit { rotation: Some(DQuat::from_rotation_x(3.0)), ..NodeEdit::default() });
    assert_eq!(picked(&editor, &around, [2.0, 0.0, -5.0]), None);
    // A flat one is hit by nothing.
    let flat = edited(NodeEdit { scale: Some(DVec3::ZERO), ..NodeEdit::default() });
    assert_eq!(picked(&editor, &flat, place), None);
    let lamp = Edit::Light(0, LightEdit { position_m: Some(DVec3::new(1.0, 1.5, -4.0)), ..LightEdit::default() });
    assert_eq!(picked(&editor, &at(0.0, &[lamp]), [1.0, 1.5, -4.0]).as_deref(), Some("lamp"));
}

/// The nearest triangle whose front is seen, in the scene that stands still then. The leaf's hole counts as solid.
fn nearest_by_hand(still: &Scene, from: DVec3, direction: DVec3) -> Option<f64> {
    let corner = |vertex: u32| still.positions[vertex as usize].as_dvec3() + still.origin_m - from;
    let hits = still.triangles.iter().filter_map(|corners| {
        let [a, b, c] = corners.map(corner);
        let sides = [(a, b), (b, c), (c, a)].map(|(one, other)| one.cross(other).dot(direction));
        let normal = (b - a).cross(c - a);
        let inside = sides.iter().all(|side| *side <= 0.0) && normal.dot(direction) < 0.0;
        let distance = a.dot(normal) / direction.dot(normal);
        (inside && distance > 0.0).then_some(distance)
    });
    hits.reduce(f64::min)
}

#[test]
fn boxes_and_transforms_lose_no_hit() {
    let mut scene = scene();
    // Holes are for another test.
    scene.materials.iter_mut().for_each(|material| material.alpha = gnomon_scene::AlphaMode::Opaque);
    let stage = Stage::new(scene.clone());
    let turned = NodeEdit {
        translation_m: Some(DVec3::new(-1.0, 0.5, -4.0)),
        rotation: Some(DQuat::from_rotation_y(0.8) * DQuat::from_rotation_x(0.4)),
        scale: Some(DVec3::new(4.0, -2.0, 3.0)),
        shown: None,
    };
    let states = [at(0.0, &[]), at(1.3, &[Edit::Node(node(&scene, "card"), turned)])];
    let mut random = 1_u32;
    let mut next = || {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(random >> 8) / f64::from(1 << 24) * 2.0 - 1.0
    };
    let (mut hits, mut near) = (0, 0);
    for state in &states {
        let (posed, still) = (stage.pose(state), scene.still_at(state));
        for _ in 0..1500 {
            let from = DVec3::new(next(), next(), next());
            let direction = DVec3::new(next(), next(), -1.0);
            let expected = nearest_by_hand(&still, from, direction);
            let found = stage.nearest(from, direction, &posed).map(|hit| hit.distance);
            // Corners of the still scene are rounded to f32: by 2e-6 m at 40 m. A ray whose slope against a surface
            // is a twentieth or more is moved by 40 µm; one that passes an edge that closely may differ.
            let (Some(expected), Some(found)) = (expected, found) else {
                assert_eq!(expected, found, "{from} {direction}");
                continue;
            };
            assert!((expected - found).abs() < 1e-3, "{from} {direction}: {expected} {found}");
            hits += 1;
            near += usize::from(found < 8.0);
        }
    }
    assert!(hits > 2000 && near > 200, "{hits} hits, {near} of them near");
}

#[test]
fn an_outline_holds_all_that_moves_with_a_node() {
    let stage = Stage::new(scene());
    let posed = stage.pose(&at(0.0, &[]));
    let bounds = |name: &str| {
        let corners = stage.outline(node(stage.scene(), name), &posed).unwrap();
        corners.into_iter().fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[min, max], c| [min.min(c), max.max(c)])
    };
    // Places are sums of a few f32: of 2⁻²² m at most.
    let close = |one: [DVec3; 2], other: [DVec3; 2]| one[0].distance(other[0]) + one[1].distance(other[1]) < 1e-5;
    assert!(close(bounds("crowd"), [DVec3::new(-2.5, 2.5, -5.0), DVec3::new(2.5, 3.5, -5.0)]), "{:?}", bounds("crowd"));
    assert!(close(bounds("card"), [DVec3::new(-2.5, -0.5, -5.0), DVec3::new(-1.5, 0.5, -5.0)]));
    assert!(close(bounds("stand"), [DVec3::new(3.5, -2.5, -5.0), DVec3::new(4.5, -1.5, -5.0)]));
    let card = node(stage.scene(), "card");
    let hidden = Edit::Node(card, NodeEdit { shown: Some(false), ..NodeEdit::default() });
    assert_eq!(stage.outline(card, &stage.pose(&at(0.0, &[hidden]))), None);
}

/// Drags a handle of what is chosen. Returns the edits of each picture.
fn drag(editor: &mut Editor, at: &SceneAt, handle: Handle, by_px: DVec2) -> Vec<Edit> {
    let view = view(editor.stage.scene());
    let posed = editor.stage.pose(at);
    let gizmo = editor.gizmo(&view, &posed, 90.0).unwrap();
    let drawn = gizmo.handles.iter().find(|drawn| drawn.handle == handle).unwrap();
    let from = if matches!(handle, Handle::Turn(_)) { drawn.points[9].0 } else { drawn.points[0].0 };
    assert!(editor.grab(&view, &posed, &gizmo, (from, 8.0)) && editor.holds() == Some(handle));
    let edits = (1..=4).filter_map(|step| editor.drag_to(&view, from + by_px * (f64::from(step) / 4.0))).collect();
    editor.settle();
    edits
}

#[test]
fn a_drag_is_one_step_that_goes_back_to_the_file() {
    let mut editor = Editor::new(scene());
    let (view, file) = (view(editor.stage.scene()), at(0.0, &[]));
    let twin = node(editor.stage.scene(), "twin");
    editor.select(Some(Target::Node(twin)));
    let edits = drag(&mut editor, &file, Handle::Slide, DVec2::new(120.0, -60.0));
    assert_eq!(edits.len(), 4);
    // 600 px are 5 m at this distance: the node goes a metre to the right and half a metre up.
    let now = at(0.0, &edits[3..]);
    let there = editor.stage.scene().node_at(twin, &now).unwrap().translation_m;
    assert!(there.distance(DVec3::new(3.0, 0.5, -5.0)) < 1e-6, "{there}");
    // Said is only what has changed, so that the scale stays the file's.
    let Edit::Node(_, edit) = edits[3] else { panic!() };
    assert_eq!(edit, NodeEdit { translation_m: Some(there), ..NodeEdit::default() });

    // Turned about its middle, which stays where it is seen.
    let edits = drag(&mut editor, &now, Handle::Turn(Axis::Z), DVec2::new(30.0, 30.0));
    let turned = at(0.0, &edits[edits.len() - 1..]);
    let middle = |at: &SceneAt| {
        let corners = editor.stage.outline(twin, &editor.stage.pose(at)).unwrap();
        view.project((corners[0] + corners[7]) * 0.5).unwrap()
    };
    assert!(middle(&turned).distance(middle(&now)) < 1e-3, "{} {}", middle(&turned), middle(&now));
    assert!(editor.stage.scene().node_at(twin, &turned).unwrap().rotation.to_axis_angle().1 > 0.1);

    editor.select(None);
    assert_eq!(editor.undo(), now.edits.iter().next());
    // What is undone is shown.
    assert_eq!(editor.selected(), Some(Target::Node(twin)));
    assert_eq!(editor.undo(), Some(Edit::Node(twin, NodeEdit::default())));
    assert_eq!(editor.undo(), None);
    assert_eq!((editor.redo(), editor.redo()), (now.edits.iter().next(), turned.edits.iter().next()));
}

#[test]
fn handles_below_what_moves_and_of_lights_do_what_they_say() {
    let mut editor = Editor::new(scene());
    let view = view(editor.stage.scene());
    let hand = node(editor.stage.scene(), "hand");
    let before =
        at(1.0, &[Edit::Node(hand, NodeEdit { translation_m: Some(DVec3::NEG_Z * 5.0), ..NodeEdit::default() })]);
    editor.select(Some(Target::Node(hand)));
    // The arm is turned, and the arrow is the world's.
    let edits = drag(&mut editor, &before, Handle::Move(Axis::X), DVec2::new(60.0, 0.0));
    let world = |at: &SceneAt| editor.stage.scene().node_at(hand, at).unwrap().world_from_node().w_axis.truncate();
    let by = world(&at(1.0, &edits[3..])) - world(&before);
    assert!(by.distance(DVec3::X * 0.5) < 1e-6, "{by}");

    let lamp = at(0.0, &[Edit::Light(0, LightEdit { intensity: Some(2.0), ..LightEdit::default() })]);
    editor.select(Some(Target::Light(0)));
    let Some(Edit::Light(0, edit)) = drag(&mut editor, &lamp, Handle::Slide, DVec2::new(0.0, -120.0)).pop() else {
        panic!()
    };
    // It stays dimmed. Its place is an f32 of the scene's local space.
    assert!(edit.position_m.unwrap().distance(DVec3::new(-2.0, -1.0, -5.0)) < 1e-5 && edit.intensity == Some(2.0));

    // The sun has no place: its rings are in the middle of the picture, and turn it.
    editor.select(Some(Target::Light(1)));
    let posed = editor.stage.pose(&lamp);
    let gizmo = editor.gizmo(&view, &posed, 90.0).unwrap();
    assert!(view.project(gizmo.pivot).unwrap().distance(DVec2::new(800.0, 600.0)) < 1e-6);
    assert!(gizmo.handles.iter().all(|drawn| matches!(drawn.handle, Handle::Turn(_))));
    let Some(Edit::Light(1, edit)) = drag(&mut editor, &lamp, Handle::Turn(Axis::Y), DVec2::new(40.0, 0.0)).pop()
    else {
        panic!()
    };
    let direction = edit.direction.unwrap();
    assert!((direction.length() - 1.0).abs() < 1e-12 && direction.y.abs() < 1e-6, "{direction}");
    assert!(direction.distance(DVec3::NEG_Z) > 0.1 && edit.position_m.is_none());
    // A drag that is given up leaves no step.
    let steps = std::iter::from_fn(|| editor.undo()).count();
    editor.select(Some(Target::Light(1)));
    assert!(editor.grab(&view, &posed, &gizmo, (gizmo.handles[0].points[9].0, 8.0)));
    assert!(editor.drag_to(&view, DVec2::new(830.0, 640.0)).is_some());
    assert_eq!(editor.cancel(), Some(Edit::Light(1, LightEdit::default())));
    assert_eq!((steps, editor.undo()), (3, None));
}

#[test]
fn what_a_scene_may_not_have_is_not_edited() {
    let mut editor = Editor::new(scene());
    let file = at(0.0, &[]);
    let bright = |intensity| Edit::Light(0, LightEdit { intensity: Some(intensity), ..LightEdit::default() });
    assert_eq!(editor.change(&file, bright(f32::NAN)), None);
    assert_eq!(editor.change(&file, Edit::Node(99, NodeEdit::default())), None);
    let color = Some(Vec3::NEG_ONE);
    assert_eq!(editor.change(&file, Edit::Light(0, LightEdit { color, ..LightEdit::default() })), None);
    assert_eq!(editor.undo(), None);
    assert_eq!(editor.change(&file, bright(3.0)), Some(bright(3.0)));
    assert_eq!(editor.change(&at(0.0, &[bright(3.0)]), bright(4.0)), Some(bright(4.0)));
    assert_eq!((editor.undo(), editor.undo()), (Some(Edit::Light(0, LightEdit::default())), None));
}
