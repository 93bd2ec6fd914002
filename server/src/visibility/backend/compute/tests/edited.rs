//! Scenes that people have changed, compared with scenes whose files have the change.

use std::sync::Arc;

use glam::DQuat;
use gnomon_scene::{Edit, Edits, LightEdit, NodeEdit, SceneAt};

use super::*;
use crate::visibility::test_scenes::living_room;

fn at(time_s: f64, edits: &[Edit]) -> SceneAt {
    let mut all = Edits::default();
    edits.iter().for_each(|edit| all.apply(*edit).unwrap());
    SceneAt { time_s, edits: Arc::new(all) }
}

fn traced(compute: &mut ComputeBackend, scene: &Scene, camera: &Camera, at: &SceneAt) -> Mask {
    let mut mask = mask_for(scene, camera);
    mask.words_mut().fill(0xdead_beef_dead_beef);
    compute.trace_at(camera, at, &mut mask).unwrap();
    mask
}

#[test]
fn an_edited_scene_has_the_mask_of_the_scene_that_stands_so() {
    let carried = NodeEdit {
        translation_m: Some(DVec3::new(0.3, 0.2, -0.4)),
        rotation: Some(DQuat::from_rotation_y(0.7)),
        ..NodeEdit::default()
    };
    let hidden = NodeEdit { shown: Some(false), ..NodeEdit::default() };
    let there = LightEdit { position_m: Some(DVec3::new(1.5, 2.5, 1.0)), ..LightEdit::default() };
    let off = LightEdit { intensity: Some(0.0), ..LightEdit::default() };
    // The last puts everything back.
    let states = [
        at(0.0, &[Edit::Light(0, there)]),
        at(0.3, &[Edit::Light(0, off), Edit::Light(1, there), Edit::Node(0, carried)]),
        at(0.3, &[Edit::Node(0, carried), Edit::Node(1, hidden)]),
        at(0.0, &[]),
    ];
    for (name, scene) in [("at rest", Scene::clone(&room())), ("moving", living_room())] {
        let cpu = CpuBackend::new(&scene, None).unwrap();
        for lists in [Lists::Never, Lists::Always] {
            let open = |scene: &Scene| ComputeBackend::open_with_lists(scene, None, true, lists).unwrap();
            let (mut edited, mut masks) = (open(&scene), Vec::new());
            for state in &states {
                let still = scene.still_at(state);
                let (mut standing, standing_cpu) = (open(&still), CpuBackend::new(&still, None).unwrap());
                for camera in cameras().iter().take(3) {
                    let mask = traced(&mut edited, &scene, camera, state);
                    let expected = traced(&mut standing, &still, camera, &SceneAt::default());
                    assert_eq!(differing(&mask, &expected), 0, "{name}, {state:?}, {lists:?}, {camera:?}");
                    let [mut on_cpu, mut stands] = [(); 2].map(|()| mask_for(&scene, camera));
                    cpu.trace_at(camera, state, &mut on_cpu);
                    standing_cpu.trace(camera, &mut stands);
                    assert_eq!(differing(&on_cpu, &stands), 0, "cpu, {name}, {state:?}, {camera:?}");
                    masks.push(mask);
                }
            }
            let first: Vec<&Mask> = masks.iter().step_by(3).collect();
            assert!(first[0] != first[3] && first[1] != first[3], "{name}: nothing is edited");
        }
    }
}
