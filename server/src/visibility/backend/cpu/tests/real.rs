//! Checks the back end on real scenes: brute force in f64 judges a sample of pixels.

use std::path::{Path, PathBuf};

use glam::DVec3;
use gnomon_scene::{LoadOptions, Scene, camera::Camera};
use rayon::iter::{IndexedParallelIterator, IntoParallelIterator, ParallelIterator};

use super::{brute::Brute, trace};

/// A scene, a file with lights if it has none, and a camera: position, target, field of view.
struct Place {
    scene: &'static str,
    lights: Option<&'static str>,
    from: [f64; 3],
    to: [f64; 3],
    yfov_deg: f64,
}

fn folder() -> PathBuf {
    std::env::var_os("GNOMON_SCENES")
        .expect(
            "set GNOMON_SCENES to the folder that holds sponza/, modern-hall/, grey-white-room/ and pink-room-partial/",
        )
        .into()
}

fn load(folder: &Path, place: &Place) -> Scene {
    let options = LoadOptions {
        lights_from: place.lights.map(|file| folder.join(file)),
        max_lights: Some(4),
        ..LoadOptions::default()
    };
    Scene::load(&folder.join(place.scene), &options).unwrap()
}

/// Checks every 211th pixel: at most one relevant bit in a thousand may be wrong.
fn check(place: &Place) {
    let scene = load(&folder(), place);
    let [from, to] = [place.from, place.to].map(DVec3::from_array);
    let camera = Camera::looking_at(from, to, place.yfov_deg.to_radians(), 640, 360);
    let (mask, _) = trace(&super::backend(&scene), &scene, &camera);
    let brute = Brute::new(&scene);
    let (wrong, relevant) = (0..640 * 360_u32)
        .into_par_iter()
        .step_by(211)
        .map(|pixel| {
            let (x, y) = (pixel % 640, pixel / 640);
            let (mut wrong, mut relevant) = (0_u64, 0_u64);
            if let Some(point) = brute.surface(&camera, x, y) {
                for (k, light) in (0..).zip(&scene.lights) {
                    if let Some((lit, _)) = brute.visible(&point, light) {
                        relevant += 1;
                        wrong += u64::from(lit != mask.get(k, x, y));
                    }
                }
            }
            (wrong, relevant)
        })
        .reduce(|| (0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
    assert!(relevant > 1000, "{relevant} relevant bits are too few to judge by");
    assert!(wrong * 1000 <= relevant, "{wrong} of {relevant} bits are wrong");
}

#[test]
fn sponza_is_right() {
    check(&Place {
        scene: "sponza/sponza_lights.gltf",
        lights: None,
        from: [-8.5, 1.7, -0.35],
        to: [0.0, 2.5, -0.35],
        yfov_deg: 60.0,
    });
}

#[test]
fn modern_hall_is_right() {
    check(&Place {
        scene: "modern-hall/modern-hall.glb",
        lights: Some("modern-hall/lights_camera.json"),
        from: [6.912, 1.652, 2.554],
        to: [1.511, 1.652, -0.059],
        yfov_deg: 43.0,
    });
}

#[test]
fn grey_white_room_is_right() {
    check(&Place {
        scene: "grey-white-room/grey-white-room.glb",
        lights: Some("grey-white-room/lights_camera.json"),
        from: [5.105, 0.731, -2.318],
        to: [-0.431, 1.159, -0.801],
        yfov_deg: 58.72,
    });
}

#[test]
fn pink_room_is_right() {
    check(&Place {
        scene: "pink-room-partial/pink-room-partial.glb",
        lights: Some("pink-room-partial/lights_camera.json"),
        from: [0.277, 1.018, -5.193],
        to: [-2.252, 0.852, 0.0],
        yfov_deg: 50.0,
    });
}
