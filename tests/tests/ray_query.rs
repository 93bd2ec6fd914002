//! Promise: the `ray-query` back end agrees with `compute` and `cpu`, on an adapter that has ray queries.
//!
//! Without such an adapter a test prints that it did not run: `rig::ray_queries`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::{path::Path, sync::Arc};

use glam::{DVec3, Vec3};
use gnomon_lab::{
    metrics::RelevantError,
    reference::Reference,
    report::living::views,
    rig::{ServerProcess, ray_queries},
    scenes::{builder::SceneBuilder, living},
};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{AlphaMode, Edit, Edits, LightEdit, Scene, SceneAt, Wrap, camera::Camera};
use gnomon_server::visibility::{
    TraceCost,
    backend::{
        compute::{ComputeBackend, RING_FRAMES, SLOTS},
        cpu::CpuBackend,
        ray_query,
    },
};
use gnomon_shaders::gpu::{Gpu, GpuOptions};

fn with_ray_queries(test: &str, body: impl FnOnce()) {
    ray_queries::with_ray_queries(test, &room(), body).unwrap();
}

fn mask_for(scene: &Scene, camera: &Camera) -> Mask {
    let lights = u32::try_from(scene.lights.len()).unwrap();
    let mut mask = Mask::new(MaskShape::new(camera.width, camera.height, lights).unwrap());
    // Garbage, all of which must be overwritten.
    mask.words_mut().fill(0xdead_beef_dead_beef);
    mask
}

fn traced(scene: &Scene, camera: &Camera) -> (Mask, TraceCost) {
    let mut mask = mask_for(scene, camera);
    let cost = ray_query::open(scene, None, true).unwrap().trace(camera, &mut mask).unwrap();
    (mask, cost)
}

fn ones(mask: &Mask) -> u64 {
    mask.words().iter().map(|word| u64::from(word.count_ones())).sum()
}

fn differing(a: &Mask, b: &Mask) -> u64 {
    assert_eq!(a.shape(), b.shape());
    a.words().iter().zip(b.words()).map(|(a, b)| u64::from((a ^ b).count_ones())).sum()
}

/// Repeated leaves with round holes.
fn leaf(builder: SceneBuilder) -> SceneBuilder {
    let texels: Vec<u8> = (0..12_i32)
        .flat_map(|y| (0..16_i32).map(move |x| if (2 * x - 15).pow(2) + (2 * y - 11).pow(2) < 81 { 255 } else { 0 }))
        .collect();
    builder.material(AlphaMode::Mask { cutoff: 0.5 }, true).alpha_picture(16, &texels, Wrap::MirroredRepeat)
}

/// A closed room seen from inside, with boxes, a smooth ball, a single-sided screen, a leaf with holes, and one light
/// of each kind.
fn room() -> Scene {
    let (low, size) = (Vec3::new(-5.0, 0.0, -4.0), Vec3::new(10.0, 4.0, 8.0));
    let high = low + size;
    let (x, y, z) = (Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z);
    let builder = SceneBuilder::new()
        .cuboid(Vec3::new(-3.0, 0.0, -2.0), Vec3::new(-2.5, 3.0, -1.5))
        .material(AlphaMode::Opaque, false)
        .quad(low, x, y)
        .quad(low, y, z)
        .quad(low, z, x)
        .quad(high, -y, -x)
        .quad(high, -z, -y)
        .quad(high, -x, -z)
        .cuboid(Vec3::new(1.0, 0.0, -3.0), Vec3::new(1.4, 4.0, -2.6))
        .sphere(Vec3::new(2.5, 1.0, -0.5), 0.8, 12)
        .quad(Vec3::new(3.0, 0.5, 2.0), Vec3::Z * 1.5, Vec3::Y * 1.5);
    leaf(builder)
        .quad(Vec3::new(-1.5, 1.0, -1.0), Vec3::new(1.8, 0.2, -0.8), Vec3::new(-0.1, 1.4, 0.4))
        .point_light(Vec3::new(0.3, 3.1, 0.2), f32::INFINITY)
        .point_light(Vec3::new(-4.0, 1.5, 3.0), 5.0)
        .spot_light(Vec3::new(3.5, 3.5, 3.0), Vec3::new(-0.6, -1.0, -0.9), 0.7)
        .sun(Vec3::new(0.3, -1.0, 0.2))
        .build()
}

fn cameras() -> [Camera; 4] {
    let look = |from: [f64; 3], to: [f64; 3], width, height| {
        Camera::looking_at(DVec3::from(from), DVec3::from(to), 1.1, width, height)
    };
    [
        look([-4.2, 1.6, 3.4], [1.0, 1.0, -1.5], 160, 90),
        look([4.5, 3.6, -3.5], [-1.0, 0.5, 1.0], 157, 83),
        // Straight down and along an axis: zeros in directions.
        look([0.0, 3.5, 0.0], [0.0, 0.0, 0.0], 120, 90),
        look([-4.0, 1.0, 0.5], [4.0, 1.0, 0.5], 129, 65),
    ]
}

/// Asserts that all three back ends and the referee agree up to rounding.
fn agree(scene: &Scene, cameras: &[Camera]) {
    let mut ours = ray_query::open(scene, None, true).unwrap();
    let mut compute = ComputeBackend::open(scene, None, true).unwrap();
    let cpu = CpuBackend::new(scene, None).unwrap();
    let referee = Reference::new(scene);
    for camera in cameras {
        let [mut a, mut b, mut c] = [(); 3].map(|()| mask_for(scene, camera));
        let cost = ours.trace(camera, &mut a).unwrap();
        let on_compute = compute.trace(camera, &mut b).unwrap();
        let on_cpu = cpu.trace(camera, &mut c);
        assert!(ones(&a) > 1000, "{} bits of {camera:?}", ones(&a));
        for (name, other, rays) in [("compute", &b, on_compute.shadow_rays), ("cpu", &c, on_cpu.shadow_rays)] {
            // Back ends may disagree where a shadow's edge passes within rounding of a pixel centre.
            let wrong = differing(&a, other);
            assert!(wrong * 1000 <= rays, "{wrong} bits of {rays} differ from {name} for {camera:?}");
            assert!(cost.shadow_rays.abs_diff(rays) * 1000 <= rays, "{} rays, {name} {rays}", cost.shadow_rays);
        }
        let error = RelevantError::of(&a, &referee.trace(camera));
        assert!(error.share() <= 0.001 && error.irrelevant_set == 0, "{error}: {:?}", error.examples);
        assert_eq!(cost.primary_rays, u64::from(camera.width * camera.height));
    }
}

#[test]
fn masks_agree_with_compute_cpu_and_the_referee() {
    with_ray_queries("masks_agree_with_compute_cpu_and_the_referee", || agree(&room(), &cameras()));
}

#[test]
fn all_of_32_lights_are_traced() {
    with_ray_queries("all_of_32_lights_are_traced", || {
        let mut scene = room();
        for index in 0_u8.. {
            if scene.lights.len() == 32 {
                break;
            }
            let mut light = scene.lights[0].clone();
            let turn = f32::from(index) * 2.4;
            light.position = Vec3::new(3.5 * turn.sin(), 0.5 + f32::from(index) * 0.1, 3.0 * turn.cos());
            scene.lights.push(light);
        }
        agree(&scene, &cameras()[..1]);
    });
}

#[test]
fn a_leaf_casts_its_holes() {
    with_ray_queries("a_leaf_casts_its_holes", || {
        let floor = SceneBuilder::new().quad(Vec3::new(-5.0, 0.0, 5.0), Vec3::X * 10.0, Vec3::NEG_Z * 10.0);
        let mut builder = leaf(floor);
        // Two layers: a shadow ray passes through a hole of one and may hit the other.
        for height in [1.0, 1.5] {
            builder = builder.quad(Vec3::new(-2.0, height, 2.0), Vec3::X * 4.0, Vec3::NEG_Z * 4.0);
        }
        let scene = builder.sun(Vec3::new(0.2, -1.0, 0.1)).build();
        // From below the leaf, and through its holes from above.
        let below = Camera::looking_at(DVec3::new(0.0, 0.5, 1.9), DVec3::new(0.0, 0.0, 1.0), 1.5, 120, 90);
        let above = Camera::looking_at(DVec3::new(0.3, 4.0, 0.2), DVec3::new(0.0, 0.0, 0.0), 1.0, 160, 90);
        agree(&scene, &[below, above]);
        let (mask, cost) = traced(&scene, &below);
        let lit = ones(&mask) as f64 / cost.shadow_rays as f64;
        assert!((0.2..0.8).contains(&lit), "{lit} of the floor is lit");
    });
}

#[test]
fn no_ray_passes_through_the_edges_of_a_closed_mesh() {
    with_ray_queries("no_ray_passes_through_the_edges_of_a_closed_mesh", || {
        for rings in [4, 17, 64] {
            let closed =
                |light| SceneBuilder::new().sphere(Vec3::ZERO, 3.0, rings).point_light(light, f32::INFINITY).build();
            // On the axes, where rays hit corners and run along edges.
            let camera = Camera::looking_at(DVec3::ZERO, DVec3::NEG_Z, 2.0, 120, 90);
            let pixels = 120 * 90;
            let (lit, cost) = traced(&closed(Vec3::ZERO), &camera);
            assert_eq!((ones(&lit), cost.shadow_rays), (pixels, pixels), "{rings} rings");
            // The mesh faces away from a light outside, so no ray is traced. A box inside does not.
            for outside in [Vec3::new(0.0, 0.0, 9.0), Vec3::new(0.0, 9.0, 9.0), Vec3::new(1.3, -4.0, 7.0)] {
                let scene = SceneBuilder::new()
                    .sphere(Vec3::ZERO, 3.0, rings)
                    .cuboid(Vec3::new(-1.0, -1.0, -2.0), Vec3::new(1.0, 1.0, -1.0))
                    .point_light(outside, f32::INFINITY)
                    .build();
                let (dark, cost) = traced(&scene, &camera);
                assert_eq!(ones(&dark), 0, "{rings} rings, light at {outside}");
                assert!(cost.shadow_rays > 1000, "{} rays", cost.shadow_rays);
            }
        }
    });
}

#[test]
fn a_surface_does_not_shadow_itself() {
    with_ray_queries("a_surface_does_not_shadow_itself", || {
        // A slope of one large triangle near the local origin, where coordinates are small but their error is not.
        let corners = [Vec3::new(-900.0, -300.0, -800.0), Vec3::new(0.0, 0.0, 900.0), Vec3::new(900.0, 300.0, -800.0)];
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
        let slope = SceneBuilder::new()
            .triangle(corners, [normal; 3], [glam::Vec2::ZERO; 3])
            .point_light(Vec3::new(0.0, 2.0, 0.0), f32::INFINITY)
            .sun(Vec3::new(0.9, -0.2, 0.1))
            .build();
        let camera = Camera::looking_at(DVec3::new(0.0, 2.0, 0.5), DVec3::new(0.3, 0.0, -0.3), 1.2, 160, 90);
        let (mask, cost) = traced(&slope, &camera);
        assert_eq!((ones(&mask), cost.shadow_rays), (2 * 160 * 90, 2 * 160 * 90));
    });
}

#[test]
fn a_scene_without_triangles_lights_nothing() {
    with_ray_queries("a_scene_without_triangles_lights_nothing", || {
        let glass = SceneBuilder::new().material(AlphaMode::Blend, true).quad(Vec3::NEG_Z, Vec3::X, Vec3::Y);
        let scene = glass.point_light(Vec3::Z, f32::INFINITY).build();
        let camera = Camera::looking_at(DVec3::ZERO, DVec3::NEG_Z, 1.0, 20, 20);
        let (mask, cost) = traced(&scene, &camera);
        assert_eq!((ones(&mask), cost.shadow_rays), (0, 0));
    });
}

#[test]
fn wrong_shapes_are_refused_and_several_frames_fly_at_once() {
    with_ray_queries("wrong_shapes_are_refused_and_several_frames_fly_at_once", || {
        let scene = room();
        let mut backend = ray_query::open(&scene, None, true).unwrap();
        let cameras = &cameras()[..RING_FRAMES];
        let shape = mask_for(&scene, &cameras[0]).shape();
        let error = backend.submit(&cameras[0], 0.0, shape).unwrap_err().to_string();
        assert!(error.contains("no buffers"), "{error}");
        let mut mask = Mask::new(MaskShape::new(cameras[0].width, cameras[0].height, 2).unwrap());
        let error = backend.trace(&cameras[0], &mut mask).unwrap_err().to_string();
        assert!(error.contains("160×90 pixels and 4 lights"), "{error}");

        let alone: Vec<Mask> = cameras.iter().map(|camera| traced(&scene, camera).0).collect();
        backend.fit(alone.iter().map(Mask::shape)).unwrap();
        for (camera, mask) in cameras.iter().zip(&alone) {
            backend.submit(camera, 0.0, mask.shape()).unwrap();
        }
        for expected in &alone {
            while backend.collect(std::time::Duration::from_millis(50), &mut mask).unwrap().is_none() {}
            assert_eq!(&mask, expected);
        }
    });
}

#[test]
fn frames_of_different_times_are_under_way_at_once() {
    with_ray_queries("frames_of_different_times_are_under_way_at_once", || {
        for (name, scene) in living::all() {
            let (mut together, mut alone) =
                (ray_query::open(&scene, None, true).unwrap(), ray_query::open(&scene, None, true).unwrap());
            let camera = views(&scene, (120, 80))[0];
            let shape = mask_for(&scene, &camera).shape();
            together.fit([shape]).unwrap();
            // Slots are used again, for other times and for the same.
            for from_s in [0.1, 1.0, 1.0] {
                let times: Vec<f64> = (0..SLOTS).map(|slot| from_s + slot as f64 * 0.27).collect();
                let begin = |time_s: &f64| Some(together.begin(&camera, *time_s, shape).unwrap());
                let mut parts: Vec<_> = times.iter().map(begin).collect();
                let mut order = Vec::new();
                while order.len() < SLOTS {
                    for (slot, part) in parts.iter_mut().enumerate() {
                        let Some(frame) = part.take() else { continue };
                        *part = together.submit_part(frame, 4).unwrap();
                        if part.is_none() {
                            order.push(times[slot]);
                        }
                    }
                }
                for time_s in order {
                    let [mut mask, mut expected] = [(); 2].map(|()| mask_for(&scene, &camera));
                    while together.collect(std::time::Duration::from_secs(1), &mut mask).unwrap().is_none() {}
                    alone.trace_at(&camera, time_s, &mut expected).unwrap();
                    assert_eq!(mask, expected, "{name} at {time_s} s");
                }
            }
        }
    });
}

#[test]
fn lights_may_be_edited_where_everything_rests() {
    with_ray_queries("lights_may_be_edited_where_everything_rests", || {
        let scene = room();
        let mut edits = Edits::default();
        let off = LightEdit { intensity: Some(0.0), ..LightEdit::default() };
        let there = LightEdit { position_m: Some(scene.origin_m + DVec3::new(0.5, 1.5, 0.5)), ..LightEdit::default() };
        for edit in [Edit::Light(0, off), Edit::Light(1, there)] {
            edits.apply(edit).unwrap();
        }
        let at = SceneAt { time_s: 0.0, edits: Arc::new(edits) };
        let (camera, still) = (cameras()[0], scene.still_at(&at));
        let mut backend = ray_query::open(&scene, None, true).unwrap();
        let [mut edited, mut back] = [(); 2].map(|()| mask_for(&scene, &camera));
        backend.trace_at(&camera, &at, &mut edited).unwrap();
        assert_eq!(edited, traced(&still, &camera).0);
        backend.trace(&camera, &mut back).unwrap();
        assert_eq!(back, traced(&scene, &camera).0);
        assert_ne!(edited, back);
    });
}

#[test]
fn a_server_reports_it_to_clients_and_auto_prefers_it() {
    with_ray_queries("a_server_reports_it_to_clients_and_auto_prefers_it", || {
        let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/cloister.glb");
        let server = ServerProcess::start(&scene, &["--backend", "ray-query", "--allow-software"]).unwrap();
        let said = server.stop().unwrap();
        assert!(said.stderr.contains("ray-query on"), "{}", said.stderr);
        // `auto` takes this back end on any adapter that is not software.
        let best = ray_query::open_preferred(&room(), None, true).unwrap();
        assert!(best.describe().starts_with("ray-query on "), "{}", best.describe());
    });
}

#[test]
fn a_device_without_ray_queries_is_refused_by_name() {
    let options = GpuOptions { allow_software: true, ..GpuOptions::default() };
    let gpu = pollster::block_on(Gpu::open(&options)).unwrap();
    let name = gpu.info.name.clone();
    let error = ray_query::new(&room(), gpu).unwrap_err().to_string();
    assert!(error.contains("lacks ray queries") && error.contains(&name), "{error}");
    // On adapters without ray queries, the best back end is `compute`.
    let refused = ray_query::open(&room(), None, true).is_err();
    let best = ray_query::open_preferred(&room(), None, true).unwrap().describe();
    assert_eq!(best.starts_with("compute on "), refused, "{best}");
}
