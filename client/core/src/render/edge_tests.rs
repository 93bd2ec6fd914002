//! Shadow edges against the true share of a pixel.

use glam::{DVec3, Vec3};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{Light, LightKind, camera::Camera};

use super::{
    quality::Quality,
    readback::texels,
    testing::{draw, floor_and_lights, gpu, renderer},
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
    renderer.set_quality(quality).unwrap();
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
