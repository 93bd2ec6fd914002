//! A scene looks the same at any size.

use glam::DVec3;
use gnomon_scene::{LightKind, Scene, camera::Camera};

use super::super::{
    FrameRenderer, PICTURE_FORMAT,
    exposure::Exposure,
    testing::{draw, floor_and_lights, gpu},
};
use crate::{camera::default_path::default_path, occluders::Occluders, predictor::Predictor};

/// Powers of two keep every mantissa: from a scene of 0.1 mm to one of 12 km.
const SCALES: [i32; 4] = [-17, -8, 4, 10];

fn scaled(factor: f32) -> Scene {
    let mut scene = floor_and_lights();
    scene.origin_m = DVec3::ZERO;
    scene.positions.iter_mut().for_each(|position| *position *= factor);
    (scene.bounds.min, scene.bounds.max) = (scene.bounds.min * factor, scene.bounds.max * factor);
    for light in &mut scene.lights {
        light.position *= factor;
        if light.kind != LightKind::Directional {
            light.intensity *= factor * factor;
        }
    }
    scene
}

fn picture(factor: f32, predictor: Predictor) -> Vec<u8> {
    let (gpu, scene, scale) = (gpu(), scaled(factor), f64::from(factor));
    let (eye, target) = (DVec3::new(0.3, 1.4, 3.0) * scale, DVec3::new(0.0, 0.4, 0.0) * scale);
    let camera = Camera::looking_at(eye, target, 1.1, 160, 90);
    let exposure = Exposure::of_scene(&scene, &Occluders::largest_of(&scene));
    let mut renderer = FrameRenderer::new(&gpu, &scene, (160, 90), exposure, PICTURE_FORMAT, predictor).unwrap();
    draw(&gpu, &mut renderer, &camera, None).rgba
}

#[test]
fn pictures_do_not_depend_on_the_scenes_size() {
    for predictor in [Predictor::None, Predictor::Surface] {
        let expected = picture(1.0, predictor);
        for exponent in SCALES {
            let found = picture(2.0_f32.powi(exponent), predictor);
            // Only the near plane is no power of two. So a point is off by an f32 rounding, far less than a pixel, and
            // its light by as much, which may tip the rounding to a byte.
            let worst = found.iter().zip(&expected).map(|(one, other)| one.abs_diff(*other)).max();
            assert!(worst <= Some(1), "2^{exponent} with {predictor:?}: {worst:?}");
        }
    }
    assert_ne!(picture(1.0, Predictor::None), picture(1.0, Predictor::Surface), "there is a shadow");
}

#[test]
fn the_default_camera_stands_off_by_the_scenes_size() {
    let view = |factor: f32| {
        let scene = scaled(factor);
        let camera = default_path(&scene, &Occluders::largest_of(&scene)).camera(1.0, 16, 9);
        (camera.position_m / f64::from(factor), camera.orientation)
    };
    let (position, orientation) = view(1.0);
    for exponent in SCALES {
        let found = view(2.0_f32.powi(exponent));
        assert!(found.0.distance(position) < 1e-5 && found.1.dot(orientation) > 1.0 - 1e-9, "2^{exponent}: {found:?}");
    }
}
