//! Promise: masks of moving scenes are right. At any time at most 0.01 % of the relevant bits differ from the f64
//! referee, which evaluates the animation by its own code; and a moving scene is the still scene of that time, bit by
//! bit.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::path::Path;

use gnomon_lab::{
    backends::BackendName,
    report::living::{judge, views},
    rig::ray_queries::with_ray_queries,
    scenes::living::{TIMES_S, all},
};
use gnomon_scene::{LoadOptions, Scene};

/// Most bits, as a share of the relevant ones, that may differ where the referee is certain.
const MOST_WRONG: f64 = 0.0001;

fn holds(name: &str, scene: &Scene, backends: &[BackendName]) {
    assert_eq!(scene.check(), Ok(()), "{name}");
    let judged = judge(scene, &views(scene, (320, 180)), &TIMES_S, backends).unwrap();
    for judged in &judged {
        let error = &judged.error;
        let what = format!("{name} at {} s on {}", judged.time_s, judged.backend.name());
        println!("{what}: {error}");
        assert!(error.sure_share() <= MOST_WRONG, "{what}: {:?}", error.examples);
        assert!(error.undecided * 100 <= error.relevant, "{what}: {} undecided", error.undecided);
        assert_eq!(error.irrelevant_set, 0, "{what}");
        assert!(judged.as_still, "{what}: not the still scene's mask");
    }
    // A view may see backs alone at a time.
    let relevant = judged.iter().map(|judged| judged.error.relevant).sum::<u64>();
    assert!(relevant > 20_000, "{name}: only {relevant} relevant bits");
    // Of two views.
    let same_view = judged.iter().step_by(2 * backends.len());
    assert!(same_view.clone().any(|other| other.mask != judged[0].mask), "{name} does not move");
}

#[test]
fn small_living_scenes_are_right_at_any_time() {
    for (name, scene) in all() {
        holds(name, &scene, &BackendName::EVERYWHERE);
    }
}

#[test]
fn small_living_scenes_are_right_with_ray_queries() {
    with_ray_queries("small_living_scenes_are_right_with_ray_queries", &all()[0].1, || {
        for (name, scene) in all() {
            holds(name, &scene, &[BackendName::RayQuery]);
        }
    })
    .unwrap();
}

#[test]
fn real_animated_files_are_right_at_any_time() {
    real_files(&BackendName::EVERYWHERE);
}

#[test]
fn real_animated_files_are_right_with_ray_queries() {
    with_ray_queries("real_animated_files_are_right_with_ray_queries", &all()[0].1, || {
        real_files(&[BackendName::RayQuery]);
    })
    .unwrap();
}

fn real_files(backends: &[BackendName]) {
    let folder = std::env::var_os("GNOMON_SCENES").expect("GNOMON_SCENES names the scenes");
    for file in [
        "animated/CesiumMilkTruck.glb",
        "animated/SimpleAnimation.glb",
        "animated/AnimatedCube/glTF/AnimatedCube.gltf",
        "animated/03_all_animations/03_all_animations.gltf",
        "animated/07_nla-anim/07_nla-anim.gltf",
        "unsupported/skin-morph/Fox.glb",
        "unsupported/skin-morph/simple_skin/simple_skin.gltf",
        "unsupported/skin-morph/SimpleMorph/glTF/SimpleMorph.gltf",
    ] {
        let options = LoadOptions { animation: Some("all".to_owned()), ..LoadOptions::default() };
        holds(file, &Scene::load(&Path::new(&folder).join(file), &options).unwrap(), backends);
    }
}
