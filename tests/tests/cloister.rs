//! Promise: both programs load the cloister whole: lights, materials, motion, and room for the camera on its paths.

use glam::{DVec3, Vec3};
use gnomon_lab::cloister::asset;
use gnomon_scene::{AlphaMode, LightKind, LoadOptions, Scene};
use rayon::prelude::*;
use serde_json::Value;

/// Least distance of cameras from every surface, in metres.
const CLEARANCE_M: f64 = 0.35;

#[test]
fn it_loads_whole_with_every_kind_of_light_and_material() {
    let (scene, report) = Scene::load_with_report(&asset("cloister.glb"), &LoadOptions::default()).unwrap();
    assert_eq!((report.dropped_triangles, report.repaired_normals, report.skipped_primitives), (0, 0, 0), "{report}");
    assert!(scene.triangles.len() <= 250_000, "{} triangles", scene.triangles.len());

    let count = |kind: fn(&LightKind) -> bool| scene.lights.iter().filter(|light| kind(&light.kind)).count();
    assert_eq!(count(|kind| matches!(kind, LightKind::Directional)), 1);
    assert!(count(|kind| matches!(kind, LightKind::Point)) >= 3);
    assert_eq!(count(|kind| matches!(kind, LightKind::Spot { .. })), 1);
    // `--lights 1` keeps the sun.
    assert!(matches!(scene.lights[0].kind, LightKind::Directional));
    assert!(scene.lights[0].direction.y < -0.5, "the sun shines upwards");

    let drawn = |wanted: fn(&AlphaMode) -> bool| {
        let draws = scene.draws.iter().filter(|draw| wanted(&scene.materials[draw.material as usize].alpha));
        draws.map(|draw| draw.triangles).sum::<u32>()
    };
    assert!(drawn(|alpha| matches!(alpha, AlphaMode::Mask { .. })) > 1000, "leaves");
    assert!(drawn(|alpha| matches!(alpha, AlphaMode::Blend)) > 10, "water and glass");
}

#[test]
fn lights_stand_free_and_reach_something() {
    let scene = Scene::load(&asset("cloister.glb"), &LoadOptions::default()).unwrap();
    for light in scene.lights.iter().filter(|light| !matches!(light.kind, LightKind::Directional)) {
        let near = nearest_m(&scene, light.position.as_dvec3());
        assert!(near > 0.05, "{} stands {near} m from a surface", light.name);
    }
    // A lantern's light leaves its cage: most rays into the lower half travel at least a metre.
    let lantern = scene.lights.iter().find(|light| matches!(light.kind, LightKind::Point)).unwrap();
    let free = (0..200u16).filter(|k| {
        let (y, turn) = (-(f32::from(*k) + 0.5) / 200.0, f32::from(*k) * 2.399_963);
        let radius = (1.0 - y * y).sqrt();
        let direction = Vec3::new(radius * turn.cos(), y, radius * turn.sin());
        !blocked(&scene, lantern.position, lantern.position + direction)
    });
    let free = free.count();
    assert!(free > 140, "{free} of 200 rays leave the lantern");
}

#[test]
fn two_objects_move_rigidly_and_stand_sensibly_at_rest() {
    let bytes = std::fs::read(asset("cloister.glb")).unwrap();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let json: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    assert!(json["asset"]["generator"].as_str().unwrap().starts_with("Gnomon"));
    let animations = json["animations"].as_array().unwrap();
    assert_eq!(animations.len(), 2);
    for animation in animations {
        let target = &animation["channels"][0]["target"];
        assert_eq!(target["path"], "rotation");
        let node = &json["nodes"][usize::try_from(target["node"].as_u64().unwrap()).unwrap()];
        assert!(node["mesh"].is_u64(), "what moves can be seen");
        // The first key is the rest pose, and animated nodes may not have a matrix (glTF 2.0, §3.11).
        assert!(node.get("matrix").is_none() && node.get("rotation").is_none(), "{node}");
    }
}

#[test]
fn cameras_have_room_on_every_path() {
    let scene = Scene::load(&asset("cloister.glb"), &LoadOptions::default()).unwrap();
    let json: Value = serde_json::from_slice(&std::fs::read(asset("cloister.json")).unwrap()).unwrap();
    let paths = json["camera_paths"].as_object().unwrap();
    assert!(paths.contains_key("walk") && paths.contains_key("orbit"));
    for (name, path) in paths {
        let frames = path["keyframes"].as_array().unwrap();
        let point = |frame: &Value| {
            let [x, y, z] = [0, 1, 2].map(|axis| frame["pos"][axis].as_f64().unwrap());
            DVec3::new(x, y, z) - scene.origin_m
        };
        for pair in frames.windows(2) {
            assert!(pair[0]["t"].as_f64() < pair[1]["t"].as_f64(), "{name}: time stands still");
            let (from, to) = (point(&pair[0]), point(&pair[1]));
            assert!(!blocked(&scene, from.as_vec3(), to.as_vec3()), "{name} goes through a surface after {from}");
            for step in 0..=8u8 {
                let at = from.lerp(to, f64::from(step) / 8.0);
                let near = nearest_m(&scene, at);
                assert!(near >= CLEARANCE_M, "{name}: {near:.2} m of room at {}", at + scene.origin_m);
            }
        }
    }
}

#[test]
fn a_path_through_the_fountain_is_noticed() {
    let scene = Scene::load(&asset("cloister.glb"), &LoadOptions::default()).unwrap();
    let local = |x: f64, y: f64, z: f64| (DVec3::new(x, y, z) - scene.origin_m).as_vec3();
    assert!(blocked(&scene, local(0.0, 1.2, 4.0), local(0.0, 1.2, -4.0)), "the fountain stands in the middle");
    let near = nearest_m(&scene, local(0.0, 0.55, 2.15).as_dvec3());
    assert!(near < CLEARANCE_M, "{near} m of room beside the basin's rim");
}

/// Returns the distance from `point` to the nearest triangle that blocks rays.
fn nearest_m(scene: &Scene, point: DVec3) -> f64 {
    let squared = scene.tracing_triangles().par_iter().map(|triangle| {
        let [a, b, c] = triangle.map(|index| scene.positions[index as usize].as_dvec3());
        closest_point(point, a, b, c).distance_squared(point)
    });
    squared.reduce(|| f64::INFINITY, f64::min).sqrt()
}

/// Returns the nearest point of a triangle to `p` (Ericson, Real-Time Collision Detection, §5.1.5).
fn closest_point(p: DVec3, a: DVec3, b: DVec3, c: DVec3) -> DVec3 {
    let (ab, ac, ap, bp, cp) = (b - a, c - a, p - a, p - b, p - c);
    let (d1, d2, d3, d4, d5, d6) = (ab.dot(ap), ac.dot(ap), ab.dot(bp), ac.dot(bp), ab.dot(cp), ac.dot(cp));
    let (vc, vb, va) = (d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4);
    if d1 <= 0.0 && d2 <= 0.0 {
        a
    } else if d3 >= 0.0 && d4 <= d3 {
        b
    } else if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        a + ab * (d1 / (d1 - d3))
    } else if d6 >= 0.0 && d5 <= d6 {
        c
    } else if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        a + ac * (d2 / (d2 - d6))
    } else if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)))
    } else {
        a + ab * (vb / (va + vb + vc)) + ac * (vc / (va + vb + vc))
    }
}

/// Returns whether any triangle crosses the segment (Möller & Trumbore 1997).
fn blocked(scene: &Scene, from: Vec3, to: Vec3) -> bool {
    let (from, along) = (from.as_dvec3(), (to - from).as_dvec3());
    scene.tracing_triangles().par_iter().any(|triangle| {
        let [a, b, c] = triangle.map(|index| scene.positions[index as usize].as_dvec3());
        let (ab, ac) = (b - a, c - a);
        let across = along.cross(ac);
        let determinant = ab.dot(across);
        let s = from - a;
        let u = s.dot(across) / determinant;
        let q = s.cross(ab);
        let v = along.dot(q) / determinant;
        let t = ac.dot(q) / determinant;
        determinant != 0.0 && u >= 0.0 && v >= 0.0 && u + v <= 1.0 && (0.0..=1.0).contains(&t)
    })
}
