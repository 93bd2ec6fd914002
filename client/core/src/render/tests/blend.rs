//! BLEND surfaces are lit where they are.

use glam::{DVec3, Vec2, Vec3, Vec4};
use gnomon_scene::{AlphaMode, Draw, LightKind, Material, Scene, camera::Camera};

use super::super::{
    FrameRenderer, PICTURE_FORMAT,
    exposure::Exposure,
    testing::{draw, floor_and_lights, gpu},
};
use crate::{occluders::Occluders, predictor::Predictor};

/// Adds a square with a material of its own, which must be BLEND or the first of its kind.
fn add(scene: &mut Scene, material: Material, corner: Vec3, side: Vec3, up: Vec3) {
    let first = u32::try_from(scene.positions.len()).unwrap();
    scene.positions.extend([corner, corner + side, corner + side + up, corner + up]);
    scene.normals.extend([side.cross(up).normalize(); 4]);
    scene.uvs.extend([Vec2::ZERO; 4]);
    let first_triangle = u32::try_from(scene.triangles.len()).unwrap();
    scene.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    scene.materials.push(material);
    let material = u32::try_from(scene.materials.len() - 1).unwrap();
    scene.draws.push(Draw { first_triangle, triangles: 2, material });
}

/// The red channel of a row through a red card that stands before the wall. The sun comes over the camera's shoulder
/// and a roof hides it from the card's left half; behind the card there is the wall, and beside the wall the sky.
fn row(with_roof: bool, predictor: Predictor) -> Vec<u8> {
    let (gpu, mut scene) = (gpu(), floor_and_lights());
    scene.lights.truncate(1);
    assert_eq!(scene.lights[0].kind, LightKind::Directional);
    scene.lights[0].direction = Vec3::new(0.0, -1.0, -1.0).normalize();
    let plain = Material { double_sided: true, ..Material::default() };
    if with_roof {
        add(&mut scene, plain.clone(), Vec3::new(-2.0, 2.0, 2.5), Vec3::X * 2.0, Vec3::Z * -1.5);
    }
    let red = Material { base_color: Vec4::new(0.8, 0.05, 0.05, 0.9), alpha: AlphaMode::Blend, ..plain };
    add(&mut scene, red, Vec3::new(-1.0, 0.2, 0.5), Vec3::X * 2.0, Vec3::Y * 0.6);
    let eye = DVec3::new(1000.0, 0.5, 3.5);
    let camera = Camera::looking_at(eye, eye + DVec3::NEG_Z, 0.9, 96, 54);
    let exposure = Exposure::of_scene(&floor_and_lights(), &Occluders::default());
    let mut renderer = FrameRenderer::new(&gpu, &scene, (96, 54), exposure, PICTURE_FORMAT, predictor).unwrap();
    let picture = draw(&gpu, &mut renderer, &camera, None).rgba;
    (0..96).map(|x| picture[(27 * 96 + x) * 4]).collect()
}

#[test]
fn a_card_has_the_shadow_that_falls_on_it_whatever_lies_behind() {
    // The card covers 2 m of a row of 3 m · 2 · tan(0.45) · 96 / 54 = 5.15 m.
    let card = 31..66;
    let (open, shaded) = (row(false, Predictor::Surface), row(true, Predictor::Surface));
    for x in card {
        // The shadow's edge is at the middle of the picture.
        if (46..50).contains(&x) {
            continue;
        }
        let hidden = x < 48;
        assert_eq!(shaded[x] + 20 < open[x], hidden, "column {x}: {} without the roof, {} with it", open[x], shaded[x]);
    }
    let (open, shaded) = (row(false, Predictor::None), row(true, Predictor::None));
    assert_eq!(open[35], shaded[35], "every light reaches everything without prediction");
}
