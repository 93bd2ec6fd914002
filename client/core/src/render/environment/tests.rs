//! Pictures of scenes in an environment, compared with what must be.

use glam::{DVec3, Vec2, Vec4};
use gnomon_scene::{
    AlphaMode, Draw, LightKind, Material, Scene,
    camera::{Camera, Space},
};
use gnomon_shaders::gpu::Gpu;

use super::*;
use crate::{
    occluders::Occluders,
    predictor::Predictor,
    render::{
        FrameRenderer, PICTURE_FORMAT,
        testing::{camera, draw, floor_and_lights, gpu},
        tone::ToneCurve,
    },
};

const SIZE: (u32, u32) = (96, 54);

fn renderer(gpu: &Gpu, scene: &Scene) -> FrameRenderer {
    let exposure = Exposure { scale: 1.0, reference_lux: 1.0 };
    FrameRenderer::new(gpu, scene, SIZE, exposure, PICTURE_FORMAT, Predictor::None).unwrap()
}

fn even(radiance: Vec3) -> Environment {
    Environment::Panorama(Arc::new(Panorama::new(2, 1, vec![radiance; 2]).unwrap()))
}

fn encoded(linear: f32) -> f32 {
    255.0 * if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

#[test]
fn white_surfaces_vanish_in_an_even_environment() {
    let (gpu, mut scene) = (gpu(), floor_and_lights());
    scene.lights.clear();
    for (metallic, roughness) in [(1.0, 0.05), (1.0, 0.5), (1.0, 1.0), (0.0, 0.3), (0.0, 1.0)] {
        for material in &mut scene.materials {
            *material = Material { base_color: Vec4::ONE, metallic, roughness, ..material.clone() };
        }
        let mut renderer = renderer(&gpu, &scene);
        renderer.set_tone(ToneCurve::None);
        // Whatever its unit.
        renderer.set_environment(even(Vec3::splat(7.0)), Survey::default());
        let picture = draw(&gpu, &mut renderer, &camera(SIZE.0, SIZE.1), None).rgba;
        let expected = encoded(PANORAMA_SHARE);
        for (place, texel) in picture.chunks_exact(4).enumerate() {
            for channel in &texel[..3] {
                // Dither half a byte, rounding half; the light is a sum of a few 16-bit floats of 11 bits.
                let error = (f32::from(*channel) - expected).abs();
                assert!(error < 1.2, "{place}, metal {metallic}, roughness {roughness}: {channel}, not {expected}");
            }
        }
    }
}

#[test]
fn tone_curves_are_those_of_their_authors() {
    // The background of a scene far away shows the environment itself.
    let (gpu, scene) = (gpu(), floor_and_lights());
    let camera = Camera { position_m: DVec3::new(1000.0, 500.0, 0.0), ..camera(SIZE.0, SIZE.1) };
    let up = Camera { orientation: glam::DQuat::from_rotation_x(1.2), ..camera };
    // Values of three.js 0.187's NeutralToneMapping and ACESFilmicToneMapping, computed from their published constants
    // in f64.
    let neutral = |light: Vec3| {
        let least = light.min_element();
        let base = light - if least < 0.08 { least - 6.25 * least * least } else { 0.04 };
        let peak = base.max_element();
        if peak < 0.76 {
            return base;
        }
        let shown = 1.0 - 0.24 * 0.24 / (peak + 0.24 - 0.76);
        (base * (shown / peak)).lerp(Vec3::splat(shown), 1.0 - 1.0 / (0.15 * (peak - shown) + 1.0))
    };
    let hue = Vec3::new(1.0, 0.6, 0.25);
    for brightness in [0.05_f32, 0.3, 1.0, 4.0, 20.0] {
        let mut renderer = renderer(&gpu, &scene);
        renderer.set_environment(even(hue), Survey::default());
        // The share counts the mean of the channels.
        let light = hue * brightness;
        let scale = brightness * hue.element_sum() / 3.0 / PANORAMA_SHARE;
        renderer.set_exposure(Exposure { scale, reference_lux: 1.0 });
        for (curve, expected) in [(ToneCurve::Neutral, neutral(light)), (ToneCurve::None, light)] {
            renderer.set_tone(curve);
            let picture = draw(&gpu, &mut renderer, &up, None).rgba;
            for (channel, expected) in picture[..3].iter().zip(expected.to_array()) {
                let expected = encoded(expected.clamp(0.0, 1.0));
                // Dither and rounding make a byte; nine bits of the cube and eleven of the light make 1/400.
                let error = (f32::from(*channel) - expected).abs();
                assert!(error < 1.2 + expected / 400.0, "{curve} at {brightness}: {channel}, not {expected}");
            }
        }
    }
    // Grey 0.18 · 0.6 is what Hill's fit maps to 0.1058 (the fit's rational function; its matrices keep greys).
    let mut renderer = renderer(&gpu, &scene);
    renderer.set_environment(even(Vec3::ONE), Survey::default());
    renderer.set_tone(ToneCurve::Aces);
    for light in [0.18_f32, 1.0, 6.0] {
        renderer.set_exposure(Exposure { scale: light / PANORAMA_SHARE, reference_lux: 1.0 });
        let picture = draw(&gpu, &mut renderer, &up, None).rgba;
        let v = light / 0.6;
        let fit = (v * (v + 0.024_578_6) - 0.000_090_537) / (v * (0.983_729 * v + 0.432_951) + 0.238_081);
        let expected = encoded(fit.clamp(0.0, 1.0));
        for channel in &picture[..3] {
            assert!((f32::from(*channel) - expected).abs() < 1.2 + expected / 400.0, "{light}: {channel}, {expected}");
        }
    }
}

#[test]
fn night_is_black_and_lamps_light_it_a_little() {
    let (gpu, mut scene) = (gpu(), floor_and_lights());
    scene.lights.remove(0);
    let camera = camera(SIZE.0, SIZE.1);
    let survey = Survey::new(&scene, &Occluders::all_of(&scene), &camera);
    let mut renderer = renderer(&gpu, &scene);
    renderer.set_environment(Environment::Sky, survey);
    renderer.set_tone(ToneCurve::None);
    let lit = draw(&gpu, &mut renderer, &camera, None).rgba;
    assert!(lit.iter().take(3).all(|channel| *channel <= 1), "{:?}", &lit[..4]);
    let mut lighting = Exposure { scale: 1.0, reference_lux: 1.0 }.lighting(&scene.lights, Space::of(&scene));
    let surroundings = Surroundings::new(&gpu, Environment::Sky, survey, &scene.lights);
    surroundings.light(&mut lighting, &scene.lights, u32::MAX, Exposure { scale: 1.0, reference_lux: 1.0 });
    assert_eq!(lighting.ambient_above, AMBIENT_ABOVE * survey.lamp_lux);
    assert_eq!((lighting.sky_seen, lighting.sky_lit), (0.0, 0.0));
    surroundings.light(&mut lighting, &scene.lights, 0, Exposure { scale: 1.0, reference_lux: 1.0 });
    assert_eq!(lighting.ambient_above, Vec3::ZERO);
}

#[test]
fn lamps_that_were_off_when_surveyed_light_the_night_later() {
    let (gpu, mut scene) = (gpu(), floor_and_lights());
    scene.lights.remove(0);
    let (camera, exposure) = (camera(SIZE.0, SIZE.1), Exposure { scale: 1.0, reference_lux: 1.0 });
    let mut dark = scene.clone();
    dark.lights.iter_mut().for_each(|light| light.intensity = 0.0);
    let ambient = |surveyed: &Scene, shown: &Scene| {
        let survey = Survey::new(surveyed, &Occluders::all_of(surveyed), &camera);
        let surroundings = Surroundings::new(&gpu, Environment::Sky, survey, &surveyed.lights);
        let mut lighting = exposure.lighting(&shown.lights, Space::of(shown));
        surroundings.light(&mut lighting, &shown.lights, u32::MAX, exposure);
        lighting.ambient_above
    };
    let (expected, found) = (ambient(&scene, &scene), ambient(&dark, &scene));
    assert!(expected.min_element() > 0.0);
    // A handful of products, each rounded.
    assert!(found.abs_diff_eq(expected, 10.0 * f32::EPSILON * expected.max_element()), "{found}, not {expected}");
    assert_eq!(ambient(&dark, &dark), Vec3::ZERO);
    assert_eq!(Survey::new(&dark, &Occluders::all_of(&dark), &camera).lux, 1.0);
}

#[test]
fn the_sky_lights_what_it_reaches() {
    let (gpu, scene) = (gpu(), floor_and_lights());
    let exposure = Exposure { scale: 0.5, reference_lux: 1.0 };
    let of = |daylight, on| {
        let survey = Survey { daylight, ..Survey::default() };
        let surroundings = Surroundings::new(&gpu, Environment::Sky, survey, &scene.lights);
        let mut lighting = exposure.lighting(&scene.lights, Space::of(&scene));
        surroundings.light(&mut lighting, &scene.lights, on, exposure);
        lighting
    };
    let (outdoors, indoors) = (of(1.0, 3), of(0.25, 3));
    assert_eq!((outdoors.sky_seen, outdoors.sky_lit), (2.5 * SKY_SEEN, 2.5));
    assert_eq!((indoors.sky_seen, indoors.sky_lit), (2.5 * SKY_SEEN, 0.625));
    // A clear sky gives a tenth to a third of what its sun does.
    let above = irradiance(&outdoors.harmonics.map(Vec4::truncate), Vec3::Y).y / 2.5;
    assert!((0.1..0.34).contains(&above), "{above}");
    // Without its sun there is no sky.
    assert_eq!(of(1.0, 2).sky_seen, 0.0);
}

/// A closed room of 6 × 3 × 6 m with a lamp, on a plain with sides of this length, or on none.
fn room(plain_m: Option<f32>) -> Scene {
    let mut scene = floor_and_lights();
    (scene.positions, scene.normals, scene.uvs) = (Vec::new(), Vec::new(), Vec::new());
    (scene.triangles, scene.draws) = (Vec::new(), Vec::new());
    scene.materials.truncate(1);
    scene.materials[0] =
        Material { base_color: Vec4::new(0.7, 0.7, 0.7, 1.0), double_sided: true, ..scene.materials[0].clone() };
    let mut square = |middle: Vec3, side: Vec3, up: Vec3| {
        let first = u32::try_from(scene.positions.len()).unwrap();
        let corners = [-side - up, side - up, side + up, up - side].map(|corner| middle + corner);
        scene.positions.extend(corners);
        scene.normals.extend([side.cross(up).normalize(); 4]);
        scene.uvs.extend([Vec2::ZERO; 4]);
        scene.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    };
    let (x, y, z) = (Vec3::X * 3.0, Vec3::Y * 1.5, Vec3::Z * 3.0);
    square(y - z, x, y);
    square(y + z, -x, y);
    square(y - x, z, y);
    square(y + x, -z, y);
    square(Vec3::ZERO, x, -z);
    square(y * 2.0, x, z);
    if let Some(side) = plain_m {
        square(Vec3::NEG_Y * 0.1, Vec3::X * side * 0.5, Vec3::Z * side * -0.5);
    }
    let reach = plain_m.unwrap_or(6.0) * 0.5;
    scene.bounds = gnomon_scene::Aabb { min: Vec3::new(-reach, -0.1, -reach), max: Vec3::new(reach, 3.0, reach) };
    scene.draws =
        vec![Draw { first_triangle: 0, triangles: u32::try_from(scene.triangles.len()).unwrap(), material: 0 }];
    scene.lights = vec![Light {
        kind: LightKind::Point,
        position: Vec3::new(0.0, 2.6, 0.0),
        intensity: 100.0,
        ..scene.lights[0].clone()
    }];
    scene
}

#[test]
fn a_plain_that_nobody_sees_does_not_change_the_exposure() {
    let gpu = gpu();
    let origin = DVec3::new(1000.0, 0.0, 0.0);
    let camera = Camera::looking_at(origin + DVec3::new(0.0, 1.6, 2.8), origin + DVec3::Y, 1.0, SIZE.0, SIZE.1);
    let ev = |plain, environment| {
        let scene = room(plain);
        let survey = Survey::new(&scene, &Occluders::largest_of(&scene), &camera);
        let mut renderer = renderer(&gpu, &scene);
        renderer.set_environment(environment, survey);
        renderer.meter(&camera, Predictor::None).unwrap();
        assert_eq!(renderer.size(), SIZE);
        renderer.exposure().ev()
    };
    for environment in [Environment::Flat, Environment::Sky, Environment::None] {
        let alone = ev(None, environment.clone());
        let on_plain = ev(Some(220.0), environment.clone());
        // The metered exposure is a multiple of 1/16; only texels of the shadow map could move it by one.
        assert!((alone - on_plain).abs() <= 1.0 / 16.0, "{environment:?}: {alone} {on_plain}");
        assert_eq!(alone, ev(None, environment));
        // A white wall 3 m from 100 cd receives 11 lx.
        assert!((2.0..5.0).contains(&alone), "{alone}");
    }
}

#[test]
fn a_flat_environment_does_not_reflect() {
    let (gpu, scene) = (gpu(), floor_and_lights());
    let surroundings = Surroundings::new(&gpu, Environment::Flat, Survey::default(), &scene.lights);
    let exposure = Exposure { scale: 0.25, reference_lux: 3.0 };
    let mut lighting = exposure.lighting(&scene.lights, Space::of(&scene));
    surroundings.light(&mut lighting, &scene.lights, u32::MAX, exposure);
    assert_eq!((lighting.mirrored, lighting.sky_lit, lighting.sky_seen), (0.0, 0.0, 0.0));
    assert_eq!(lighting.harmonics, [Vec4::ZERO; 9]);
    assert_eq!(lighting.ambient_above, Vec3::new(0.165, 0.178, 0.205) * 0.75);
    assert_eq!(lighting.zenith, Vec3::new(0.20, 0.37, 0.72));
    assert!(scene.materials.iter().all(|material| matches!(material.alpha, AlphaMode::Opaque)));
}
