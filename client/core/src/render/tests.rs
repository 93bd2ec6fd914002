//! Compares the passes with results computed on the CPU.

mod blend;
mod coincident;
mod edited;
pub(super) mod living;
mod scale;
pub(super) mod shapes;

use glam::{DVec3, Vec3, Vec4};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{
    AlphaMode, Draw, Image, Light, LightKind, Material, Scene, Texture, Wrap,
    camera::{Camera, NEAR_M},
};
use gnomon_shaders::shading;

use super::{
    FrameRenderer, PICTURE_FORMAT,
    exposure::Exposure,
    readback::texels,
    testing::{camera, draw, floor_and_lights, gpu, renderer},
    tone,
};
use crate::{occluders::Occluders, predictor::Predictor};

/// Material and depth of the nearest surface on a pixel's ray, and the ray's distance to the nearest triangle edge.
fn nearest(scene: &Scene, camera: &Camera, x: u32, y: u32) -> (u32, f64, f64) {
    let (origin, direction) = camera.ray(x, y);
    let origin = origin - scene.origin_m;
    let mut found = (0, f64::INFINITY, f64::INFINITY);
    for draw in &scene.draws {
        let first = draw.first_triangle as usize;
        for corners in &scene.triangles[first..first + draw.triangles as usize] {
            let [a, b, c] = corners.map(|index| scene.positions[index as usize].as_dvec3());
            let normal = (b - a).cross(c - a);
            if !scene.materials[draw.material as usize].double_sided && normal.dot(direction) >= 0.0 {
                continue;
            }
            let depth = normal.dot(a - origin) / normal.dot(direction);
            let point = origin + direction * depth;
            let inside = [(a, b), (b, c), (c, a)]
                .map(|(from, to)| (to - from).cross(point - from).dot(normal) / normal.length() / (to - from).length());
            let margin = inside.into_iter().fold(f64::INFINITY, f64::min) / depth;
            if depth > NEAR_M && margin.abs() < found.2 && margin < 0.0 {
                found.2 = margin.abs();
            }
            if depth > NEAR_M && margin >= 0.0 && depth < found.1 {
                found = (draw.material + 1, depth, found.2.min(margin));
            }
        }
    }
    found
}

#[test]
fn the_g_buffer_holds_the_surface_that_each_pixels_centre_sees() {
    let (gpu, scene) = (gpu(), floor_and_lights());
    let shape = MaskShape::new(150, 83, 2).unwrap();
    let camera = camera(150, 83);
    let mut renderer = renderer(&gpu, &scene, shape);
    renderer.draw_surfaces(&camera).unwrap();
    let surfaces = texels(&gpu, &renderer.targets.normal_material, wgpu::TextureAspect::All).unwrap();
    let surfaces: &[[u32; 4]] = bytemuck::cast_slice(&surfaces);
    let depths = texels(&gpu, renderer.history.view(), wgpu::TextureAspect::DepthOnly).unwrap();
    let depths: &[f32] = bytemuck::cast_slice(&depths);
    let colors = texels(&gpu, &renderer.targets.color, wgpu::TextureAspect::All).unwrap();
    let mut seen = [0; 3];
    for y in 0..83 {
        for x in 0..150 {
            let place = (y * 150 + x) as usize;
            let (material, depth, margin) = nearest(&scene, &camera, x, y);
            // A hundredth of a pixel, the precision of fixed-point rasterisation.
            if margin < 1e-4 {
                continue;
            }
            assert_eq!(surfaces[place][1] & 0xffff, material, "({x}, {y})");
            seen[material as usize] += 1;
            if material == 0 {
                assert_eq!(depths[place], 0.0);
                continue;
            }
            let found = NEAR_M / f64::from(depths[place]);
            assert!((found / depth - 1.0).abs() < 1e-4, "({x}, {y}): depth {found}, expected {depth}");
            let packed = surfaces[place][0].to_le_bytes();
            let [nx, ny] = [0, 2].map(|at| f64::from(i16::from_le_bytes([packed[at], packed[at + 1]])) / 32767.0);
            let expected = if material == 1 { (0.0, 1.0) } else { (0.0, 0.0) };
            assert!((nx - expected.0).abs() < 1e-3 && (ny - expected.1).abs() < 1e-3, "({x}, {y}): {nx} {ny}");
            // Adapters may be off by 0.6 when they encode sRGB (Vulkan's and Direct3D's rule).
            let expected: [u8; 3] = if material == 1 { [188, 188, 188] } else { [231, 89, 89] };
            let found = &colors[place * 4..place * 4 + 3];
            assert!(expected.iter().zip(found).all(|(e, f)| e.abs_diff(*f) <= 1), "({x}, {y}): {found:?}");
        }
    }
    assert!(seen.iter().all(|count| *count > 200), "{seen:?}");
}

#[test]
fn a_cleared_bit_removes_exactly_its_light() {
    let (gpu, scene) = (gpu(), floor_and_lights());
    let (width, height) = (96, 54);
    let shape = MaskShape::new(width, height, 2).unwrap();
    let camera = camera(width, height);
    let exposure = Exposure::of_scene(&scene, &Occluders::largest_of(&scene));
    // The picture with every subset of the lights, without a mask.
    let subsets: Vec<Vec<u8>> = (0..4_u32)
        .map(|bits| {
            let mut part = scene.clone();
            for (k, light) in part.lights.iter_mut().enumerate() {
                light.intensity *= if bits >> k & 1 == 1 { 1.0 } else { 0.0 };
            }
            let mut renderer = FrameRenderer::new(
                &gpu,
                &part,
                (shape.width(), shape.height()),
                exposure,
                PICTURE_FORMAT,
                Predictor::None,
            )
            .unwrap();
            draw(&gpu, &mut renderer, &camera, None).rgba
        })
        .collect();
    assert!(subsets[3] != subsets[2] && subsets[3] != subsets[1] && subsets[1] != subsets[0]);
    // Each pixel gets its own subset.
    let subset_of = |x: u32, y: u32| (x / 3 + y * 7) % 4;
    let mut mask = Mask::new(shape);
    for y in 0..height {
        for x in 0..width {
            for k in 0..2 {
                mask.set(k, x, y, subset_of(x, y) >> k & 1 == 1);
            }
        }
    }
    let mut renderer = renderer(&gpu, &scene, shape);
    let shaded = draw(&gpu, &mut renderer, &camera, Some(&mask)).rgba;
    for y in 0..height {
        for x in 0..width {
            let place = ((y * width + x) * 4) as usize;
            let expected = &subsets[subset_of(x, y) as usize][place..place + 4];
            assert_eq!(&shaded[place..place + 4], expected, "({x}, {y})");
        }
    }
}

/// Displayed values for exposed light, by the definitions in `tone.wgsl`, before rounding to bytes.
fn shown(light: Vec3) -> [f32; 3] {
    let peak = light.max_element();
    let top = tone::gnomon().curve(peak).clamp(0.0, 1.0);
    let fade = top * top * (1.0 - 1.0 / (1.0 + 0.25 * (peak - 0.5).max(0.0)));
    let toned = (light * (top / peak)).lerp(Vec3::splat(top), fade);
    toned.to_array().map(|value| {
        let encoded = if value <= 0.003_130_8 { value * 12.92 } else { 1.055 * value.powf(1.0 / 2.4) - 0.055 };
        encoded * 255.0
    })
}

#[test]
fn lights_fall_off_with_distance_range_and_cone_as_the_host_computes_it() {
    let (gpu, mut scene) = (gpu(), floor_and_lights());
    let spot = LightKind::Spot { inner_cone_rad: 0.3, outer_cone_rad: 0.6 };
    let lamp = |kind, position, color, intensity, range_m| Light {
        kind,
        position,
        direction: Vec3::new(0.2, -1.0, -0.1).normalize(),
        color,
        intensity,
        range_m,
        ..scene.lights[0].clone()
    };
    scene.lights = vec![
        lamp(spot, Vec3::new(-1.0, 3.0, 1.0), Vec3::new(1.0, 0.6, 0.3), 20.0, f32::INFINITY),
        lamp(LightKind::Point, Vec3::new(1.5, 0.8, 0.5), Vec3::new(0.3, 0.5, 1.0), 2.0, 2.0),
    ];
    // A paint that 8 bits of base colour represent exactly.
    let paint = ((188.0_f32 / 255.0 + 0.055) / 1.055).powf(2.4);
    scene.materials[0].base_color = Vec4::new(paint, paint, paint, 1.0);
    // Lambert's law alone.
    scene.materials[0].specular.strength = 0.0;
    let (width, height) = (150, 83);
    let camera = camera(width, height);
    let exposure = Exposure::of_scene(&floor_and_lights(), &Occluders::default()).at_ev(1.0);
    let mut renderer =
        FrameRenderer::new(&gpu, &scene, (width, height), exposure, PICTURE_FORMAT, Predictor::None).unwrap();
    let picture = draw(&gpu, &mut renderer, &camera, None).rgba;
    let ambient_above = Vec3::new(0.165, 0.178, 0.205) * exposure.reference_lux * exposure.scale;
    let mut counts = [[0; 2]; 2];
    for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
        let (material, depth, margin) = nearest(&scene, &camera, x, y);
        if material != 1 || margin < 1e-4 {
            continue;
        }
        let (origin, direction) = camera.ray(x, y);
        let point = (origin - scene.origin_m + direction * depth).as_vec3();
        let mut irradiance = ambient_above;
        for (k, light) in scene.lights.iter().enumerate() {
            let (arriving, toward) = shading::Light::new(light, exposure.scale).arrival(point);
            irradiance += arriving * toward.y.max(0.0);
            counts[k][usize::from(arriving != Vec3::ZERO)] += 1;
        }
        let place = ((y * width + x) * 4) as usize;
        for (found, expected) in picture[place..place + 3].iter().zip(shown(irradiance * paint)) {
            // Error budget: dither half a byte, rounding half, 16-bit light less than 0.1.
            assert!((f32::from(*found) - expected).abs() < 1.2, "({x}, {y}): {found}, expected {expected}");
        }
    }
    assert!(counts.as_flattened().iter().all(|count| *count > 300), "{counts:?}");
}

#[test]
fn a_surface_beyond_f16_range_is_white() {
    let (gpu, mut scene) = (gpu(), floor_and_lights());
    scene.lights.truncate(1);
    scene.lights[0] = Light {
        kind: LightKind::Point,
        position: Vec3::new(0.0, 0.005, 1.0),
        intensity: 1e6,
        ..scene.lights[0].clone()
    };
    let shape = MaskShape::new(96, 54, 1).unwrap();
    let camera = camera(96, 54);
    let exposure = Exposure::of_scene(&scene, &Occluders::default()).at_ev(0.0);
    let mut renderer =
        FrameRenderer::new(&gpu, &scene, (shape.width(), shape.height()), exposure, PICTURE_FORMAT, Predictor::None)
            .unwrap();
    let picture = draw(&gpu, &mut renderer, &camera, None).rgba;
    let mut seen = 0;
    for place in 0..96 * 54 {
        let (origin, direction) = camera.ray(place % 96, place / 96);
        let point = origin - scene.origin_m - direction * (origin.y / direction.y);
        // Within 30 cm, 1e6 cd · 5 mm / (30 cm)³ make 185000 lx, more than 16-bit floating point can hold.
        if direction.y < 0.0 && point.distance(DVec3::new(0.0, 0.0, 1.0)) < 0.3 {
            let texel = &picture[place as usize * 4..][..3];
            assert!(texel.iter().all(|channel| *channel >= 254), "{texel:?} at {point}");
            seen += 1;
        }
    }
    assert!(seen > 50, "{seen}");
}

#[test]
fn without_a_mask_of_its_size_every_light_is_on() {
    let (gpu, scene) = (gpu(), floor_and_lights());
    let shape = MaskShape::new(64, 40, 2).unwrap();
    let camera = camera(64, 40);
    let mut renderer = renderer(&gpu, &scene, shape);
    let plain = draw(&gpu, &mut renderer, &camera, None);
    let dark = draw(&gpu, &mut renderer, &camera, Some(&Mask::new(shape)));
    assert_ne!(plain, dark);
    let other = Mask::new(MaskShape::new(64, 41, 2).unwrap());
    assert_eq!(draw(&gpu, &mut renderer, &camera, Some(&other)), plain);
    let mut lit = Mask::new(shape);
    lit.words_mut().fill(u64::MAX);
    assert_eq!(draw(&gpu, &mut renderer, &camera, Some(&lit)), plain);
}

#[test]
fn a_masked_surface_has_holes_where_its_alpha_is_low() {
    let (gpu, mut scene) = (gpu(), floor_and_lights());
    // The wall gets a texture of 4 × 4 texels; its left half is transparent.
    let rgba: Vec<u8> = (0..16_u8).flat_map(|i| [255, 255, 255, if i % 4 < 2 { 0 } else { 255 }]).collect();
    scene.images.push(Image { encoded: Vec::new(), width: 4, height: 4, rgba });
    scene.materials[1].base_color_texture = Some(Texture::new(0, Wrap::ClampToEdge, Wrap::ClampToEdge));
    scene.materials[1].alpha = AlphaMode::Mask { cutoff: 0.5 };
    for (corner, (u, v)) in [(0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0)].into_iter().enumerate() {
        scene.uvs[4 + corner] = glam::Vec2::new(u, v);
    }
    let shape = MaskShape::new(160, 90, 2).unwrap();
    let camera = camera(160, 90);
    let mut renderer = renderer(&gpu, &scene, shape);
    renderer.draw_surfaces(&camera).unwrap();
    let surfaces = texels(&gpu, &renderer.targets.normal_material, wgpu::TextureAspect::All).unwrap();
    let surfaces: &[[u32; 4]] = bytemuck::cast_slice(&surfaces);
    let (mut holes, mut leaves) = (0, 0);
    for (place, surface) in (0_u32..).zip(surfaces) {
        let (x, y) = (place % 160, place / 160);
        let (origin, direction) = camera.ray(x, y);
        let depth = (-1.0 - (origin - scene.origin_m).z) / direction.z;
        let point: DVec3 = origin - scene.origin_m + direction * depth;
        let inside = point.x.abs() < 0.49 && (0.01..0.99).contains(&point.y);
        // The bilinear alpha is one half midway between the second and third columns of texels.
        if inside && point.x.abs() > 0.005 {
            assert_eq!(surface[1] & 0xffff == 2, point.x > 0.0, "({x}, {y}) sees the wall at {point}");
            *(if point.x > 0.0 { &mut leaves } else { &mut holes }) += 1;
        }
    }
    assert!(holes > 100 && leaves > 100, "{holes} {leaves}");
}

#[test]
fn blended_surfaces_let_light_through_by_their_alpha() {
    let (gpu, plain) = (gpu(), floor_and_lights());
    let mut scene = plain.clone();
    // A pane of black glass in front of the wall's left half.
    let corners = [(-0.5, 0.1), (0.0, 0.1), (0.0, 0.9), (-0.5, 0.9)].map(|(x, y)| Vec3::new(x, y, -0.9));
    scene.positions.extend(corners);
    scene.normals.extend([Vec3::Z; 4]);
    scene.uvs.extend([glam::Vec2::ZERO; 4]);
    scene.triangles.extend([[8, 9, 10], [8, 10, 11]]);
    scene.draws.push(Draw { first_triangle: 4, triangles: 2, material: 2 });
    let glass =
        Material { base_color: Vec4::new(0.0, 0.0, 0.0, 0.5), alpha: AlphaMode::Blend, ..scene.materials[1].clone() };
    scene.materials.push(glass);
    let shape = MaskShape::new(96, 54, 2).unwrap();
    let camera = camera(96, 54);
    let exposure = Exposure::of_scene(&plain, &Occluders::largest_of(&plain));
    let picture = |scene: &Scene| {
        let mut renderer =
            FrameRenderer::new(&gpu, scene, (shape.width(), shape.height()), exposure, PICTURE_FORMAT, Predictor::None)
                .unwrap();
        draw(&gpu, &mut renderer, &camera, None).rgba
    };
    let (without, with) = (picture(&plain), picture(&scene));
    let changed: Vec<usize> = (0..96 * 54).filter(|p| without[p * 4..p * 4 + 4] != with[p * 4..p * 4 + 4]).collect();
    assert!((50..400).contains(&changed.len()), "{}", changed.len());
    for place in changed {
        assert!(place % 96 <= 48, "the pane covers the left half only");
        let (before, after) = (without[place * 4], with[place * 4]);
        assert!(after < before && after > before / 3, "{before} → {after}");
    }
}
