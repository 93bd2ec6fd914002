//! Promise: back ends compute only what a scene needs, as their counters show. No ray is traced for a light that is
//! off, out of range, outside its cone or behind the surface; alpha is sampled only on MASK materials; and masks and
//! their buffers grow with the scene's lights alone.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use glam::{DVec3, Vec3};
use gnomon_lab::{
    backends::BackendName,
    reference::Reference,
    scenes::{builder::SceneBuilder, real},
};
use gnomon_protocol::mask::{Mask, MaskShape, TILE_PX};
use gnomon_scene::{AlphaMode, LoadOptions, Scene, Wrap, camera::Camera};
use gnomon_server::visibility::backend::{compute::ComputeBackend, cpu::CpuBackend};

const SIZE: (u32, u32) = (96, 64);

/// Looks down on a floor that fills the picture.
fn camera() -> Camera {
    Camera::looking_at(DVec3::new(0.1, 3.0, 0.2), DVec3::new(0.0, 0.0, 0.1), 0.8, SIZE.0, SIZE.1)
}

fn floor() -> SceneBuilder {
    SceneBuilder::new().quad(Vec3::new(-9.0, 0.0, -9.0), Vec3::Z * 18.0, Vec3::X * 18.0)
}

/// Returns the traced rays and the set bits.
fn traced(backend: BackendName, scene: &Scene) -> (u64, u32) {
    let mut mask = Mask::new(MaskShape::new(SIZE.0, SIZE.1, scene.lights.len().try_into().unwrap()).unwrap());
    let cost = backend.open(scene).unwrap()(&camera(), &mut mask).unwrap();
    (cost.shadow_rays, mask.words().iter().map(|word| word.count_ones()).sum())
}

#[test]
fn no_ray_is_traced_for_a_light_that_cannot_matter() {
    let pixels = u64::from(SIZE.0 * SIZE.1);
    let lamp = Vec3::new(0.5, 2.0, -0.4);
    let mut dimmed =
        floor().point_light(lamp, f32::INFINITY).sun(Vec3::NEG_Y).spot_light(lamp, Vec3::NEG_Y, 1.5).build();
    dimmed.lights.iter_mut().for_each(|light| light.intensity = 0.0);
    let mut black = dimmed.clone();
    black.lights.iter_mut().for_each(|light| (light.intensity, light.color) = (5.0, Vec3::ZERO));
    // A smooth normal towards the sun on a plane that faces away: relevant, and dark without a ray.
    let mut behind = floor().sun(Vec3::new(-1.0, 0.2, 0.0)).build();
    behind.normals.fill(Vec3::new(0.8, 0.6, 0.0));
    for (what, scene) in [
        ("out of range", floor().point_light(lamp, 1.9).build()),
        ("outside the cone", floor().spot_light(lamp, Vec3::Y, 1.2).build()),
        ("below the floor", floor().point_light(Vec3::new(0.5, -2.0, 0.0), f32::INFINITY).build()),
        ("in the floor's plane", floor().point_light(Vec3::new(5.0, 0.0, 0.3), f32::INFINITY).build()),
        ("a sun from below", floor().sun(Vec3::new(0.2, 1.0, 0.0)).build()),
        ("behind the plane", behind),
        ("switched off", dimmed),
        ("black", black),
    ] {
        let truth = Reference::new(&scene).trace(&camera());
        assert!(truth.pixels.iter().all(|verdict| verdict.surface && verdict.lit == 0), "{what}: the scene is wrong");
        for backend in BackendName::EVERYWHERE {
            assert_eq!(traced(backend, &scene), (0, 0), "{what} on {}", backend.name());
        }
    }
    // Beside a light that matters, they cost nothing either.
    let mut mixed =
        floor().point_light(lamp, f32::INFINITY).point_light(lamp, 1.9).sun(Vec3::Y).sun(Vec3::NEG_Y).build();
    mixed.lights[3].intensity = 0.0;
    for backend in BackendName::EVERYWHERE {
        assert_eq!(traced(backend, &mixed).0, pixels, "{}", backend.name());
    }
}

#[test]
fn alpha_is_sampled_only_on_mask_materials() {
    let sheet =
        |builder: SceneBuilder| builder.quad(Vec3::new(-1.0, 1.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0).sun(Vec3::NEG_Y);
    let opaque = sheet(floor()).build();
    let mask = AlphaMode::Mask { cutoff: 0.5 };
    let masked = sheet(floor().material(mask, true).alpha_picture(2, &[0, 255, 255, 0], Wrap::Repeat)).build();
    // Without a texture, alpha is constant and opaque: no sampling needed.
    let plain = sheet(floor().material(mask, true)).build();
    for (what, scene, asked) in
        [("opaque", &opaque, false), ("masked", &masked, true), ("without a picture", &plain, false)]
    {
        let mut mask = Mask::new(MaskShape::new(SIZE.0, SIZE.1, 1).unwrap());
        let (_, work) = CpuBackend::new(scene, None).unwrap().trace_counted(&camera(), 0.0, &mut mask);
        let tests: u64 = work.iter().map(|work| work.alpha_tests).sum();
        assert_eq!(tests > 0, asked, "{what} on cpu: {tests} tests of alpha");
        assert_eq!(ComputeBackend::open(scene, None, true).unwrap().tests_alpha(), asked, "{what} on compute");
    }
}

#[test]
fn masks_and_their_buffers_grow_with_the_lights() {
    let tiles = u64::from(SIZE.0.div_ceil(TILE_PX) * SIZE.1.div_ceil(TILE_PX));
    for lights in [1, 3, 8, 32] {
        let scene = (0..lights).fold(floor(), |builder, _| builder.sun(Vec3::NEG_Y)).build();
        let shape = MaskShape::new(SIZE.0, SIZE.1, lights).unwrap();
        assert_eq!(Mask::new(shape).words().len() as u64, tiles * u64::from(lights));
        let mut backend = ComputeBackend::open(&scene, None, true).unwrap();
        backend.fit([shape]).unwrap();
        let memory = backend.memory();
        assert_eq!(memory.lights_bytes, u64::from(lights) * 48, "{memory:?}");
        assert_eq!(memory.mask_bytes, tiles * 8 * u64::from(lights), "{memory:?}");
        assert_eq!(memory.alpha_bytes, 0, "{memory:?}");
        for backend in BackendName::EVERYWHERE {
            let pixels = u64::from(SIZE.0 * SIZE.1);
            assert_eq!(traced(backend, &scene).0, pixels * u64::from(lights), "{}", backend.name());
        }
    }
}

/// Why reused meshes have no hierarchy of their own: it would save only the small part of an instance's memory.
/// Triangles stay separate, since their positions in space decide ties.
#[test]
fn hierarchies_take_a_small_part_of_a_scenes_memory() {
    let folder = real::folder().unwrap();
    for scene in &real::JUDGED {
        let lights_from = scene.lights_from_json.then(|| scene.json_in(&folder));
        let options = LoadOptions { lights_from, ..LoadOptions::default() };
        let loaded = Scene::load(&folder.join(scene.file), &options).unwrap();
        let memory = ComputeBackend::open(&loaded, None, true).unwrap().memory();
        let share = memory.hierarchy_bytes as f64 / (memory.hierarchy_bytes + memory.triangle_bytes) as f64;
        println!(
            "{}: hierarchy {} bytes, triangles {}: {share:.3}",
            scene.name, memory.hierarchy_bytes, memory.triangle_bytes
        );
        assert!((0.01..0.15).contains(&share), "{}: {memory:?}", scene.name);
    }
}
