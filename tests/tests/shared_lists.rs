//! Promise: where blocks of pixels share lists of triangles, no bit differs from those of rays traced one by one: on
//! the hard cases, on real scenes, and in the same frame twice.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use gnomon_lab::{
    hard_cases,
    scenes::real::{JUDGED, folder},
};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{LoadOptions, Scene, camera::Camera};
use gnomon_server::visibility::{
    RayShares,
    backend::compute::{ComputeBackend, Lists},
};

/// Compares the masks of these cameras. Returns how the bits were found.
fn compare(name: &str, scene: &Scene, cameras: impl IntoIterator<Item = Camera>) -> [u64; 4] {
    let open = |lists| ComputeBackend::open_with_lists(scene, None, true, lists).unwrap();
    let (mut single, mut listed) = (open(Lists::Never), open(Lists::Always));
    let lights = u32::try_from(scene.lights.len()).unwrap();
    let mut sum = [0; 4];
    for camera in cameras {
        let [mut a, mut b, mut again] =
            [(); 3].map(|()| Mask::new(MaskShape::new(camera.width, camera.height, lights).unwrap()));
        single.trace(&camera, &mut a).unwrap();
        let shares = listed.trace(&camera, &mut b).unwrap().shares.counts();
        listed.trace(&camera, &mut again).unwrap();
        let differing: u32 = a.words().iter().zip(b.words()).map(|(a, b)| (a ^ b).count_ones()).sum();
        assert_eq!(differing, 0, "{name}: bits of {camera:?}");
        assert_eq!(again, b, "{name}: the same frame twice");
        sum = std::array::from_fn(|i| sum[i] + shares[i]);
    }
    println!("{name}: {:?} {sum:?}", RayShares::NAMES);
    sum
}

#[test]
fn no_bit_of_the_hard_cases_differs() {
    for case in hard_cases::all((112, 64), false).unwrap() {
        compare(&case.name, &case.scene, [case.camera]);
    }
}

#[test]
fn no_bit_of_the_real_scenes_differs() {
    let folder = folder().unwrap();
    for scene in &JUDGED {
        let lights_from = scene.lights_from_json.then(|| scene.json_in(&folder));
        let options = LoadOptions { lights_from, ..LoadOptions::default() };
        let loaded = Scene::load(&folder.join(scene.file), &options).unwrap();
        let cameras = scene.stops_in(&folder).unwrap().into_iter().map(|stop| stop.camera(176, 100));
        let [_, dark, listed, _] = compare(scene.name, &loaded, cameras);
        assert!(dark + listed > 1000, "{}: hardly anything was shared", scene.name);
    }
}
