//! A small scene and an adapter for tests.

#![allow(clippy::expect_used, clippy::unwrap_used, reason = "for tests only")]

use glam::{DVec3, Vec2, Vec3, Vec4};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{Aabb, AlphaMode, Draw, Light, LightKind, Material, Scene, SceneAt, camera::Camera};
use gnomon_shaders::gpu::{Gpu, GpuOptions};

use super::{
    exposure::Exposure,
    predict::MaskView,
    readback::{Picture, PictureReader},
    renderer::FrameRenderer,
    targets::PICTURE_FORMAT,
};
use crate::{occluders::Occluders, predictor::Predictor};

/// Opens an adapter, software if need be. Tests require one.
pub fn gpu() -> Gpu {
    let options = GpuOptions { allow_software: true, ..GpuOptions::default() };
    pollster::block_on(Gpu::open(&options)).expect("tests need a graphics adapter: install mesa-vulkan-drivers")
}

/// A floor of 8 × 8 m in y = 0 with a sun and a lamp over it, and a small red wall that faces +z.
pub fn floor_and_lights() -> Scene {
    let square = |corner: Vec3, side: Vec3, up: Vec3| [corner, corner + side, corner + side + up, corner + up];
    let floor = square(Vec3::new(-4.0, 0.0, 4.0), Vec3::X * 8.0, Vec3::Z * -8.0);
    let wall = square(Vec3::new(-0.5, 0.0, -1.0), Vec3::X, Vec3::Y);
    let material = |name: &str, color: Vec4, double_sided| Material {
        name: name.into(),
        base_color: color,
        alpha: AlphaMode::Opaque,
        double_sided,
        ..Material::default()
    };
    let light = |kind, position, intensity| Light {
        name: String::new(),
        kind,
        position,
        direction: Vec3::new(0.6, -0.8, 0.0),
        color: Vec3::ONE,
        intensity,
        range_m: f32::INFINITY,
    };
    Scene {
        origin_m: DVec3::new(1000.0, 0.0, 0.0),
        bounds: Aabb { min: Vec3::new(-4.0, 0.0, -4.0), max: Vec3::new(4.0, 1.0, 4.0) },
        positions: floor.into_iter().chain(wall).collect(),
        normals: [[Vec3::Y; 4], [Vec3::Z; 4]].concat(),
        uvs: vec![Vec2::ZERO; 8],
        triangles: vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]],
        draws: vec![
            Draw { first_triangle: 0, triangles: 2, material: 0 },
            Draw { first_triangle: 2, triangles: 2, material: 1 },
        ],
        materials: vec![
            material("floor", Vec4::new(0.5, 0.5, 0.5, 1.0), false),
            material("wall", Vec4::new(0.8, 0.1, 0.1, 1.0), true),
        ],
        lights: vec![
            light(LightKind::Directional, Vec3::ZERO, 5.0),
            light(LightKind::Point, Vec3::new(0.0, 3.0, 2.0), 40.0),
        ],
        instances: 2,
        ..Scene::default()
    }
}

/// A camera that looks at the wall from the front, a little from above.
pub fn camera(width: u32, height: u32) -> Camera {
    let origin = DVec3::new(1000.0, 0.0, 0.0);
    Camera::looking_at(origin + DVec3::new(0.0, 1.4, 3.0), origin + DVec3::new(0.0, 0.4, 0.0), 1.1, width, height)
}

/// A renderer of `scene` at this size, without prediction.
pub fn renderer(gpu: &Gpu, scene: &Scene, shape: MaskShape) -> FrameRenderer {
    let exposure = Exposure::of_scene(scene, &Occluders::largest_of(scene));
    FrameRenderer::new(gpu, scene, (shape.width(), shape.height()), exposure, PICTURE_FORMAT, Predictor::None).unwrap()
}

/// Draws a picture with a mask that was traced for it.
pub fn draw(gpu: &Gpu, renderer: &mut FrameRenderer, camera: &Camera, mask: Option<&Mask>) -> Picture {
    draw_with(gpu, renderer, camera, mask.map(|mask| (mask, camera)))
}

/// Draws a picture with a mask, if any, that was traced for the position and direction of another camera.
pub fn draw_with(gpu: &Gpu, renderer: &mut FrameRenderer, camera: &Camera, mask: Option<(&Mask, &Camera)>) -> Picture {
    let mut reader = PictureReader::new(gpu, camera.width, camera.height, 1);
    renderer.draw_surfaces(camera).unwrap();
    let traced_for = mask.map(|(mask, traced_for)| Camera {
        width: mask.shape().width(),
        height: mask.shape().height(),
        ..*traced_for
    });
    let scene = SceneAt::default();
    let mask = mask.zip(traced_for.as_ref()).map(|((mask, _), traced_for)| MaskView {
        mask,
        coverage: None,
        more: false,
        traced_for,
        scene: &scene,
    });
    renderer.set_mask(mask).unwrap();
    let target = reader.target();
    let submission = renderer.shade(camera, 1.0, &target, |encoder| reader.copy(encoder)).unwrap();
    reader.submitted(0, submission, true);
    reader.take_oldest().unwrap().unwrap().unwrap()
}
