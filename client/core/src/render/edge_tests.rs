//! Edges of shadows and surfaces against the true share of a pixel.

use glam::{DQuat, DVec3, Vec3, Vec4};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{Light, LightKind, Scene, SceneAt, camera::Camera};
use gnomon_shaders::gpu::Gpu;

use super::{
    environment::Environment,
    predict::MaskView,
    quality::Quality,
    readback::{PictureReader, texels},
    survey::Survey,
    testing::{self, draw, floor_and_lights, gpu, renderer},
    tone::ToneCurve,
};

const SIDE: u32 = 64;

/// Returns the share of light 0 that each pixel is drawn with: its own picture between one without and one with light.
fn shares(quality: Quality, mask: &Mask) -> Vec<f64> {
    let (gpu, mut scene) = (gpu(), floor_and_lights());
    scene.lights =
        vec![Light { kind: LightKind::Directional, direction: Vec3::NEG_Y, intensity: 5.0, ..scene.lights[0].clone() }];
    // Straight down, on nothing but the floor.
    let above = scene.origin_m + DVec3::new(2.0, 3.0, 2.0);
    let camera = Camera::looking_at(above, above - DVec3::Y, 0.6, SIDE, SIDE);
    let mut renderer = renderer(&gpu, &scene, MaskShape::new(SIDE, SIDE, 1).unwrap());
    renderer.set_quality(quality);
    let mut light = |mask: &Mask| -> Vec<f64> {
        draw(&gpu, &mut renderer, &camera, Some(mask));
        let texels = texels(&gpu, &renderer.targets.light, wgpu::TextureAspect::All).unwrap();
        texels.as_chunks().0.iter().map(|[low, high, ..]: &[u8; 8]| half(u16::from_le_bytes([*low, *high]))).collect()
    };
    let lit = {
        let mut mask = Mask::new(MaskShape::new(SIDE, SIDE, 1).unwrap());
        (0..SIDE * SIDE).for_each(|pixel| mask.set(0, pixel % SIDE, pixel / SIDE, true));
        light(&mask)
    };
    let dark = light(&Mask::new(MaskShape::new(SIDE, SIDE, 1).unwrap()));
    let drawn = light(mask);
    drawn.iter().zip(dark).zip(lit).map(|((drawn, dark), lit)| (drawn - dark) / (lit - dark)).collect()
}

/// A finite 16-bit float that is not subnormal.
fn half(bits: u16) -> f64 {
    let (exponent, fraction) = (i32::from(bits >> 10 & 0x1f), f64::from(bits & 0x3ff));
    (1.0 + fraction / 1024.0) * f64::from(exponent - 15).exp2()
}

#[test]
fn smooth_edges_are_closer_to_the_true_share_than_bits() {
    let (mut of_low, mut of_high) = (0.0, 0.0);
    for angle in [0.35_f64, 1.2, 2.9, 5.4] {
        let (sin, cos) = angle.sin_cos();
        let middle = f64::from(SIDE) / 2.0 + 0.3;
        let beyond = |x: f64, y: f64| cos * (x - middle) + sin * (y - middle) > 0.0;
        let mask = {
            let mut mask = Mask::new(MaskShape::new(SIDE, SIDE, 1).unwrap());
            for (x, y) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y))) {
                mask.set(0, x, y, beyond(f64::from(x) + 0.5, f64::from(y) + 0.5));
            }
            mask
        };
        let truth = |pixel: u32| {
            let (x, y) = (f64::from(pixel % SIDE), f64::from(pixel / SIDE));
            let samples = (0..256_u32).filter(|sample| {
                beyond(x + (f64::from(sample % 16) + 0.5) / 16.0, y + (f64::from(sample / 16) + 0.5) / 16.0)
            });
            samples.count() as f64 / 256.0
        };
        for (quality, sum) in [(Quality::Low, &mut of_low), (Quality::High, &mut of_high)] {
            for (pixel, share) in (0..).zip(shares(quality, &mask)) {
                *sum += (share - truth(pixel)).powi(2);
            }
        }
    }
    // The table gains 6.5 dB over all straight edges; four of them, counted on 16×16 samples, come within half of one.
    let gain_db = 10.0 * (of_low / of_high).log10();
    assert!(gain_db > 6.0, "{gain_db} dB");
}

/// Samples a pixel of the truth, in each direction.
const FINER: u32 = 16;

/// A grey square before black, drawn at this size: linear light of each pixel.
fn square(gpu: &Gpu, scene: &Scene, quality: Quality, camera: &Camera) -> Vec<f64> {
    let mut renderer = renderer(gpu, scene, MaskShape::new(camera.width, camera.height, 1).unwrap());
    renderer.set_environment(Environment::None, Survey::default());
    renderer.set_tone(ToneCurve::None);
    renderer.set_quality(quality);
    let linear = |byte: u8| (f64::from(byte) / 255.0 + 0.055) / 1.055;
    let light = |byte: u8| if byte <= 10 { f64::from(byte) / 255.0 / 12.92 } else { linear(byte).powf(2.4) };
    draw(gpu, &mut renderer, camera, None).rgba.as_chunks::<4>().0.iter().map(|[_, green, ..]| light(*green)).collect()
}

#[test]
fn smooth_edges_of_surfaces_are_closer_to_the_true_share_than_pixels_centres() {
    let (gpu, mut scene) = (gpu(), floor_and_lights());
    // The wall alone.
    scene.draws.remove(0);
    scene.lights.truncate(1);
    scene.materials[1].unlit = true;
    scene.materials[1].base_color = Vec4::new(0.5, 0.5, 0.5, 1.0);
    let (mut of_low, mut of_high) = (0.0, 0.0);
    for roll in [0.12, 0.35, 0.6, 1.0, 1.3, 1.5] {
        let eye = scene.origin_m + DVec3::new(0.03, 0.47, 1.0);
        let camera = Camera::looking_at(eye, eye - DVec3::Z, 0.9, SIDE, SIDE);
        let camera = Camera { orientation: camera.orientation * DQuat::from_rotation_z(roll), ..camera };
        let fine = Camera { width: SIDE * FINER, height: SIDE * FINER, ..camera };
        let fine = square(&gpu, &scene, Quality::Low, &fine);
        let truth = |pixel: u32| {
            let (x, y) = (pixel % SIDE * FINER, pixel / SIDE * FINER);
            let samples = (0..FINER * FINER).map(|k| ((y + k / FINER) * SIDE * FINER + x + k % FINER) as usize);
            samples.map(|place| fine[place]).sum::<f64>() / f64::from(FINER * FINER)
        };
        for (quality, sum) in [(Quality::Low, &mut of_low), (Quality::High, &mut of_high)] {
            let drawn = square(&gpu, &scene, quality, &camera);
            *sum += (0..).zip(drawn).map(|(pixel, light)| (light - truth(pixel)).powi(2)).sum::<f64>();
        }
    }
    // As of shadows: 6.5 dB over all straight edges, here those of six squares.
    let gain_db = 10.0 * (of_low / of_high).log10();
    assert!(gain_db > 6.0, "{gain_db} dB");
}

#[test]
fn pixels_that_are_put_off_are_drawn_as_all_others_would_be() {
    let (gpu, mut scene) = (gpu(), floor_and_lights());
    scene.materials[1].emissive = Vec3::new(0.1, 0.2, 0.3);
    let shape = MaskShape::new(SIDE, SIDE, 2).unwrap();
    let mut mask = Mask::new(shape);
    for (x, y) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y))) {
        (0..2).for_each(|k| mask.set(k, x, y, (x / (5 + k) + y / 7) % 2 == 0));
    }
    let camera = testing::camera(SIDE, SIDE);
    let mut renderer = renderer(&gpu, &scene, shape);
    renderer.set_quality(Quality::High);
    let mut light = |visibility_share: f32| -> Vec<f64> {
        let view =
            MaskView { mask: &mask, coverage: None, more: false, traced_for: &camera, scene: &SceneAt::default() };
        let reader = PictureReader::new(&gpu, SIDE, SIDE, 1);
        renderer.draw_surfaces(&camera).unwrap();
        renderer.set_mask(Some(view)).unwrap();
        renderer.shade(&camera, visibility_share, &reader.target(), |_| ()).unwrap();
        let texels = texels(&gpu, &renderer.targets.light, wgpu::TextureAspect::All).unwrap();
        texels.as_chunks().0.iter().map(|[low, high, ..]: &[u8; 8]| half(u16::from_le_bytes([*low, *high]))).collect()
    };
    // A share that is not quite 1 puts nothing off, and shows the same.
    let (in_two, in_one) = (light(1.0), light(1.0 - f32::EPSILON));
    for (pixel, (one, other)) in in_two.iter().zip(&in_one).enumerate() {
        // 16-bit floats have eleven digits.
        assert!((one - other).abs() <= 2.0_f64.powi(-10) * one.abs(), "pixel {pixel}: {one} and {other}");
    }
    assert!(in_two.iter().any(|light| *light != in_two[0]));
}
