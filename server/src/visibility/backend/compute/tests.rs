//! Compares the kernels with closed forms, with obvhs' own traversal, and with the `cpu` back end.

mod edited;
mod moving;
mod posing;

use glam::{DVec3, Vec3, Vec3A};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{LightKind, Scene, camera::Camera};
use gnomon_shaders::gpu::Gpu;
use obvhs::ray::{Ray, RayHit};

use super::{ComputeBackend, Lists, PictureLimit, RING_FRAMES, geometry};
use crate::visibility::{
    TraceCost,
    backend::{BackendError, cpu::CpuBackend},
    test_scenes::{DOUBLE_SIDED, LEAF, SINGLE_SIDED, TestScene, room},
};

fn backend(scene: &Scene) -> ComputeBackend {
    ComputeBackend::open(scene, None, true).expect("these tests need a Vulkan adapter; a software one will do")
}

fn mask_for(scene: &Scene, camera: &Camera) -> Mask {
    Mask::new(MaskShape::new(camera.width, camera.height, u32::try_from(scene.lights.len()).unwrap()).unwrap())
}

fn trace(scene: &Scene, camera: &Camera) -> (Mask, TraceCost) {
    let mut mask = mask_for(scene, camera);
    // Garbage that the trace must overwrite.
    mask.words_mut().fill(0xdead_beef_dead_beef);
    let cost = backend(scene).trace(camera, &mut mask).unwrap();
    (mask, cost)
}

fn ones(mask: &Mask) -> u32 {
    mask.words().iter().map(|word| word.count_ones()).sum()
}

fn differing(a: &Mask, b: &Mask) -> u32 {
    assert_eq!(a.shape(), b.shape());
    a.words().iter().zip(b.words()).map(|(a, b)| (a ^ b).count_ones()).sum()
}

fn cameras() -> Vec<Camera> {
    let look = |from: [f64; 3], to: [f64; 3], width, height| {
        Camera::looking_at(DVec3::from(from), DVec3::from(to), 1.1, width, height)
    };
    vec![
        look([-4.2, 1.6, 3.4], [1.0, 1.0, -1.5], 160, 90),
        look([4.5, 3.6, -3.5], [-1.0, 0.5, 1.0], 157, 91),
        // Straight down and along an axis: directions with zeros.
        look([0.0, 3.5, 0.0], [0.0, 0.0, 0.0], 128, 128),
        look([-4.0, 1.0, 0.5], [4.0, 1.0, 0.5], 129, 65),
    ]
}

#[test]
fn masks_equal_those_of_the_cpu_back_end() {
    let scene = room();
    let cpu = CpuBackend::new(&scene, None).unwrap();
    let mut compute = backend(&scene);
    for camera in cameras() {
        let (mut a, mut b) = (mask_for(&scene, &camera), mask_for(&scene, &camera));
        let on_device = compute.trace(&camera, &mut a).unwrap();
        let on_cpu = cpu.trace(&camera, &mut b);
        let (wrong, rays) = (differing(&a, &b), on_cpu.shadow_rays);
        assert!(ones(&a) > 1000, "{} bits of {camera:?}", ones(&a));
        // Both round, and may disagree where a shadow's edge passes within rounding of a pixel's centre.
        assert!(u64::from(wrong) * 1000 <= rays, "{wrong} bits of {rays} differ for {camera:?}");
        assert_eq!(on_device.primary_rays, u64::from(camera.width * camera.height));
        assert!(on_device.shadow_rays.abs_diff(rays) * 1000 <= rays, "{} of {rays} rays", on_device.shadow_rays);
    }
}

/// Slivers and large triangles in all directions: the lists of its blocks are long, or there are none.
fn cloud(triangles: u32) -> TestScene {
    let mut random = 1_u32;
    let mut next = || {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (random >> 8) as f32 / (1 << 24) as f32 * 2.0 - 1.0
    };
    let mut cloud = TestScene::default();
    for index in 0..triangles {
        let size = if index % 50 == 0 { 2.0 } else { 0.3 };
        let centre = Vec3::new(next(), next(), next()) * 3.0;
        let mut corner = || centre + Vec3::new(next(), next(), next()) * size;
        cloud = cloud.triangle(DOUBLE_SIDED, [corner(), corner(), corner()]);
    }
    cloud
}

/// Scenes that ask everything of shared lists, each with cameras.
fn hard_for_lists() -> Vec<(&'static str, Scene, Vec<Camera>)> {
    let look = |from: [f64; 3], to: [f64; 3]| Camera::looking_at(DVec3::from(from), DVec3::from(to), 1.0, 150, 93);
    let floor =
        || TestScene::default().quad(SINGLE_SIDED, Vec3::new(-9.0, 0.0, 9.0), Vec3::X * 18.0, Vec3::NEG_Z * 18.0);
    let above = vec![look([0.0, 3.0, 8.0], [0.0, 0.0, 0.0]), look([5.0, 0.3, 5.0], [0.0, 0.0, 0.0])];
    let closed = TestScene::default().sphere(SINGLE_SIDED, Vec3::ZERO, 3.0, 40, true);
    let in_closed = vec![look([0.0; 3], [0.0, 0.0, -1.0]), look([2.0, 1.0, 0.5], [-1.0, 0.2, 0.0])];
    let suns = [Vec3::NEG_Y, Vec3::new(1.0, -0.02, 0.3), Vec3::new(-0.4, -1.0, 0.1)];
    let with_suns = |scene: TestScene| {
        suns.iter().fold(scene, |scene, sun| scene.light(LightKind::Directional, Vec3::ZERO, *sun, f32::INFINITY))
    };
    vec![
        ("a room with every kind of light", room(), cameras()),
        (
            "a cloud with a light outside, one within, and suns",
            with_suns(cloud(3000).point(Vec3::new(0.2, 6.0, 0.1)).point(Vec3::ZERO)).build(),
            vec![look([3.5, 3.0, 4.0], [0.0; 3]), look([0.3, 0.2, 0.1], [2.0, 0.0, 1.0])],
        ),
        (
            "a closed sphere with lights inside and outside",
            closed.point(Vec3::ZERO).point(Vec3::new(2.9, 0.3, 0.0)).point(Vec3::new(1.3, -4.0, 7.0)).build(),
            in_closed,
        ),
        (
            "a roof over half a floor, and lights on the floor, just above it and on the roof",
            with_suns(floor().quad(DOUBLE_SIDED, Vec3::new(-9.0, 2.0, -9.0), Vec3::X * 9.0, Vec3::Z * 18.0))
                .point(Vec3::new(1.0, 0.0, 0.5))
                .point(Vec3::new(1.0, 1e-4, 0.5))
                .point(Vec3::new(-1.0, 2.0, 0.5))
                .point(Vec3::new(-0.5, 40.0, 0.5))
                .build(),
            above.clone(),
        ),
        (
            "leaves with holes in rows",
            with_suns((0..12_u8).fold(floor(), |scene, row| {
                let height = 0.2 + 0.1 * f32::from(row);
                scene.quad(LEAF, Vec3::new(-3.0, height, 3.0), Vec3::X * 6.0, Vec3::new(0.0, 0.1, -6.0))
            }))
            .point(Vec3::new(0.4, 4.0, 0.3))
            .build(),
            above,
        ),
    ]
}

#[test]
fn shared_lists_change_no_bit() {
    let (mut shares, mut primary) = ([0; 4], [0; 2]);
    for (name, scene, cameras) in hard_for_lists() {
        let open = |lists| ComputeBackend::open_with_lists(&scene, None, true, lists).unwrap();
        let (mut single, mut listed) = (open(Lists::Never), open(Lists::Always));
        assert_eq!((single.uses_lists(1), listed.uses_lists(1)), (false, true));
        for camera in cameras {
            let [mut a, mut b, mut again] = [(); 3].map(|()| mask_for(&scene, &camera));
            b.words_mut().fill(0xdead_beef_dead_beef);
            let alone = single.trace(&camera, &mut a).unwrap();
            let shared = listed.trace(&camera, &mut b).unwrap();
            assert_eq!(differing(&a, &b), 0, "{name}, {camera:?}");
            assert!(ones(&a) > 500, "{name} is dark");
            assert_eq!(alone.shares.counts(), [0, 0, 0, alone.shadow_rays], "{name}");
            assert_eq!(alone.primary_listed, 0, "{name}");
            primary = [primary[0] + shared.primary_rays, primary[1] + shared.primary_listed];
            assert_eq!(shared.shares.counts().iter().sum::<u64>(), alone.shadow_rays, "{name}: {shared:?}");
            listed.trace(&camera, &mut again).unwrap();
            assert_eq!(again, b, "{name}: the same frame twice");
            shares = std::array::from_fn(|i| shares[i] + shared.shares.counts()[i]);
        }
    }
    println!("proven lit and dark, listed, traced: {shares:?}; primary rays and those listed: {primary:?}");
    assert!(primary[1] > 1000 && primary[1] + 1000 < primary[0], "all primary rays in one way: {primary:?}");
    assert!(shares[1..].iter().all(|rays| *rays > 1000), "the scenes ask too little of the lists: {shares:?}");
}

#[test]
fn parts_of_any_height_share_lists_of_their_own() {
    let scene = room();
    let mut listed = ComputeBackend::open_with_lists(&scene, None, true, Lists::Always).unwrap();
    let camera = cameras()[1];
    let mut whole = mask_for(&scene, &camera);
    let cost = listed.trace(&camera, &mut whole).unwrap();
    // Blocks begin at odd rows of tiles, and the last ones are cut off.
    for rows in [1, 3, 5] {
        let mut part = listed.begin(&camera, 0.0, whole.shape()).unwrap();
        while let Some(rest) = listed.submit_part(part, rows).unwrap() {
            part = rest;
        }
        let mut mask = mask_for(&scene, &camera);
        mask.words_mut().fill(u64::MAX);
        let in_parts = loop {
            if let Some(cost) = listed.collect(std::time::Duration::from_secs(1), &mut mask).unwrap() {
                break cost;
            }
        };
        assert_eq!(mask, whole, "{rows} rows a part");
        assert_eq!(in_parts.shadow_rays, cost.shadow_rays);
        assert_eq!(in_parts.shares.counts().iter().sum::<u64>(), cost.shadow_rays, "all parts are counted");
    }
}

#[test]
fn lists_are_shared_only_where_they_pay() {
    let scene = room();
    // Software adapters are slower with them, and few devices have room for fewer buffers than lists need.
    assert!(!backend(&scene).uses_lists(usize::MAX));
    let few = device(super::kernels::NEEDED, |limits| limits.max_storage_buffers_per_shader_stage = 11);
    let options =
        super::KernelOptions { lists: Lists::Always, ..super::KernelOptions::new(super::Traversal::Hierarchy) };
    let mut compute = ComputeBackend::new_with(&scene, few, options).unwrap();
    assert!(!compute.uses_lists(usize::MAX));
    let camera = cameras()[0];
    let mut mask = mask_for(&scene, &camera);
    compute.trace(&camera, &mut mask).unwrap();
    assert_eq!(mask, trace(&scene, &camera).0);
}

#[test]
fn pixels_outside_the_picture_are_dark() {
    let scene = room();
    let camera = cameras()[1];
    let (mask, _) = trace(&scene, &camera);
    let mut inside = 0;
    for light in 0..mask.shape().lights() {
        for y in 0..camera.height {
            for x in 0..camera.width {
                inside += u32::from(mask.get(light, x, y));
            }
        }
    }
    assert_eq!(ones(&mask), inside);
}

#[test]
fn no_ray_passes_through_the_edges_of_a_closed_mesh() {
    for rings in [4, 17, 64] {
        let closed =
            |light: Vec3| TestScene::default().sphere(SINGLE_SIDED, Vec3::ZERO, 3.0, rings, true).point(light).build();
        // Along the axes, where rays hit corners and run along edges.
        let camera = Camera::looking_at(DVec3::ZERO, DVec3::NEG_Z, 2.0, 160, 120);
        // A light at the eye reaches everything that the eye sees, and the eye must see a surface everywhere.
        let (lit, cost) = trace(&closed(Vec3::ZERO), &camera);
        assert_eq!((ones(&lit), cost.shadow_rays), (160 * 120, 160 * 120), "{rings} rings");
        for outside in [Vec3::new(0.0, 0.0, 9.0), Vec3::new(0.0, 9.0, 9.0), Vec3::new(1.3, -4.0, 7.0)] {
            let (dark, cost) = trace(&closed(outside), &camera);
            assert_eq!(ones(&dark), 0, "{rings} rings, light at {outside}");
            assert!(cost.shadow_rays > 10_000, "{}", cost.shadow_rays);
        }
    }
}

#[test]
fn a_surface_does_not_shadow_itself() {
    // One large sloping triangle, seen near the local origin, where coordinates are small but their error is not.
    let slope = TestScene::default()
        .triangle(
            DOUBLE_SIDED,
            [Vec3::new(-900.0, -300.0, -800.0), Vec3::new(0.0, 0.0, 900.0), Vec3::new(900.0, 300.0, -800.0)],
        )
        .point(Vec3::new(0.0, 2.0, 0.0))
        .light(LightKind::Directional, Vec3::ZERO, Vec3::new(0.9, -0.2, 0.1), f32::INFINITY)
        .build();
    let camera = Camera::looking_at(DVec3::new(0.0, 2.0, 0.5), DVec3::new(0.3, 0.0, -0.3), 1.2, 160, 90);
    let (mask, cost) = trace(&slope, &camera);
    assert_eq!((u64::from(ones(&mask)), cost.shadow_rays), (2 * 160 * 90, 2 * 160 * 90));
}

#[test]
fn a_shadow_lies_where_geometry_says() {
    // A unit square 1 m above the floor, with the light at 2 m: its shadow is a square of 2 m.
    let scene = TestScene::default()
        .quad(SINGLE_SIDED, Vec3::new(-5.0, 0.0, 5.0), Vec3::X * 10.0, Vec3::NEG_Z * 10.0)
        .quad(SINGLE_SIDED, Vec3::new(-0.5, 1.0, -0.5), Vec3::X, Vec3::Z)
        .point(Vec3::new(0.0, 2.0, 0.0))
        .build();
    // The camera sees the square from behind and looks through it, since it is single-sided.
    let camera = Camera::looking_at(DVec3::new(0.0, 3.0, 0.0), DVec3::ZERO, 1.5, 120, 120);
    let (mask, _) = trace(&scene, &camera);
    for y in 0..120 {
        for x in 0..120 {
            let (from, direction) = camera.ray(x, y);
            let point = from + direction * (from.y / -direction.y);
            let (edge, inside) = (point.x.abs().max(point.z.abs()), point.x.abs().max(point.z.abs()) < 1.0);
            if (edge - 1.0).abs() > 1e-3 {
                assert_eq!(mask.get(0, x, y), !inside, "({x}, {y}) sees {point}");
            }
        }
    }
}

#[test]
fn light_passes_through_the_holes_of_a_leaf() {
    let scene = TestScene::default()
        .quad(SINGLE_SIDED, Vec3::new(-5.0, 0.0, 5.0), Vec3::X * 10.0, Vec3::NEG_Z * 10.0)
        .quad(LEAF, Vec3::new(-2.0, 1.0, 2.0), Vec3::X * 4.0, Vec3::NEG_Z * 4.0)
        .light(LightKind::Directional, Vec3::ZERO, Vec3::NEG_Y, f32::INFINITY)
        .build();
    let camera = Camera::looking_at(DVec3::new(0.0, 0.5, 1.9), DVec3::new(0.0, 0.0, 1.0), 1.5, 120, 90);
    let (mask, cost) = trace(&scene, &camera);
    let lit = f64::from(ones(&mask)) / cost.shadow_rays as f64;
    // The disc covers a third of the picture.
    assert!((0.5..0.85).contains(&lit), "{lit}");
}

#[test]
fn an_empty_scene_lights_nothing() {
    let scene = TestScene::default()
        .quad(crate::visibility::test_scenes::GLASS, Vec3::NEG_Z, Vec3::X, Vec3::Y)
        .point(Vec3::Z)
        .build();
    let (mask, cost) = trace(&scene, &Camera::looking_at(DVec3::ZERO, DVec3::NEG_Z, 1.0, 20, 20));
    assert_eq!((ones(&mask), cost.shadow_rays), (0, 0));
}

#[test]
fn far_from_the_origin_of_the_world_nothing_changes() {
    let scene = |origin| {
        TestScene::default()
            .origin(origin)
            .cuboid(SINGLE_SIDED, Vec3::new(-4.0, -2.0, -4.0), Vec3::new(4.0, 2.0, 4.0), true)
            .cuboid(SINGLE_SIDED, Vec3::new(-1.0, -2.0, -3.0), Vec3::new(0.0, 1.0, -2.0), false)
            .point(Vec3::new(2.0, 1.0, -1.0))
            .build()
    };
    let far = DVec3::new(1e8, -3e7, 2e8);
    let look =
        |at: DVec3| Camera::looking_at(at + DVec3::new(0.5, 0.25, 3.0), at + DVec3::new(-0.5, 0.0, -2.0), 1.0, 96, 64);
    let (near_mask, _) = trace(&scene(DVec3::ZERO), &look(DVec3::ZERO));
    let (far_mask, _) = trace(&scene(far), &look(far));
    // An f64 at 2·10⁸ m has a spacing of 3·10⁻⁸ m.
    assert!(differing(&near_mask, &far_mask) <= 2);
    assert!(ones(&near_mask) > 1000);
}

#[test]
fn the_kernels_traverse_the_hierarchy_as_obvhs_does() {
    // Wrong nodes would show.
    let scene = cloud(700).point(Vec3::new(0.2, 6.0, 0.1)).build();
    let camera = Camera::looking_at(DVec3::new(3.5, 3.0, 4.0), DVec3::ZERO, 0.9, 160, 90);
    let (mask, cost) = trace(&scene, &camera);

    let shapes: Vec<_> = scene
        .triangles
        .iter()
        .map(|corners| {
            let [v0, v1, v2] = corners.map(|index| Vec3A::from(scene.positions[index as usize]));
            obvhs::triangle::Triangle { v0, v1, v2 }
        })
        .collect();
    let hierarchy = geometry::build_hierarchy(&shapes, gnomon_shaders::host::TRAVERSAL_STACK);
    let triangle = |id: usize| shapes[hierarchy.primitive_indices[id] as usize];
    let light = Vec3A::from(scene.lights[0].position);
    let (mut wrong, mut seen) = (0, 0);
    for y in 0..camera.height {
        for x in 0..camera.width {
            let (from, direction) = camera.ray(x, y);
            let ray = Ray::new_inf(from.as_vec3a(), direction.as_vec3a());
            let mut hit = RayHit::none();
            let mut lit = false;
            if hierarchy.ray_traverse(ray, &mut hit, |ray, id| triangle(id).intersect(ray)) {
                seen += 1;
                let normal = triangle(hit.primitive_id as usize).compute_normal();
                let normal = if normal.dot(ray.direction) > 0.0 { -normal } else { normal };
                let point = ray.origin + ray.direction * hit.t + normal * 1e-4;
                // The shading normal is the front's, negated where the back is seen: the same here.
                let shadow = Ray::new(point, light - point, 0.0, 1.0);
                lit = normal.dot(light - point) > 0.0
                    && hierarchy.ray_traverse_miss(shadow, |ray, id| triangle(id).intersect(ray));
            }
            wrong += u32::from(lit != mask.get(0, x, y));
        }
    }
    assert!(seen > 5000 && cost.shadow_rays > 2000, "{seen} pixels, {} rays", cost.shadow_rays);
    // obvhs' triangle test is not watertight and its boxes are not widened, so edges differ.
    assert!(wrong * 500 <= seen, "{wrong} of {seen} differ");
}

#[test]
fn frames_in_flight_come_back_complete_and_in_order() {
    let scene = room();
    let mut compute = backend(&scene);
    let cameras: Vec<Camera> = cameras().into_iter().take(RING_FRAMES).collect();
    let alone: Vec<Mask> = cameras.iter().map(|camera| trace(&scene, camera).0).collect();
    compute.fit(alone.iter().map(Mask::shape)).unwrap();
    for _ in 0..2 {
        for (camera, mask) in cameras.iter().zip(&alone) {
            compute.submit(camera, 0.0, mask.shape()).unwrap();
        }
        assert!(compute.submit(&cameras[0], 0.0, alone[0].shape()).is_err(), "the ring is full");
        for expected in &alone {
            let mut mask = Mask::new(MaskShape::new(1, 1, 1).unwrap());
            while compute.collect(std::time::Duration::from_millis(50), &mut mask).unwrap().is_none() {}
            assert_eq!(&mask, expected);
        }
    }
    assert_eq!(compute.in_flight(), 0);
}

#[test]
fn sizes_that_do_not_fit_are_refused_with_numbers() {
    let scene = room();
    let mut compute = backend(&scene);
    let camera = cameras()[0];
    let error = compute.submit(&camera, 0.0, mask_for(&scene, &camera).shape()).unwrap_err();
    assert!(error.to_string().contains("no buffers"), "{error}");
    let mut mask = Mask::new(MaskShape::new(camera.width, camera.height, 2).unwrap());
    let error = compute.trace(&camera, &mut mask).unwrap_err();
    assert!(error.to_string().contains("160×90 pixels and 5 lights"), "{error}");
    let limit = PictureLimit::new(1000, "Toy".into());
    let error = limit.check(MaskShape::new(100, 100, 3).unwrap()).unwrap_err().to_string();
    assert!(error.contains("100×100") && error.contains("173056") && error.contains("1000"), "{error}");
}

/// A device with other features and limits than the server requests.
fn device(features: wgpu::Features, limit: impl Fn(&mut wgpu::Limits)) -> Gpu {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::VULKAN));
    let adapter = adapters.into_iter().next().expect("these tests need a Vulkan adapter");
    let mut limits = adapter.limits();
    limit(&mut limits);
    let descriptor = wgpu::DeviceDescriptor {
        required_features: features,
        required_limits: limits,
        ..wgpu::DeviceDescriptor::default()
    };
    let (device, queue) = pollster::block_on(adapter.request_device(&descriptor)).unwrap();
    Gpu { info: adapter.get_info(), device, queue }
}

#[test]
fn devices_without_needed_features_are_refused() {
    let scene = room();
    let needed = super::kernels::NEEDED;
    let refusal = |gpu: Gpu| ComputeBackend::new(&scene, gpu).unwrap_err().to_string();

    let error = refusal(device(wgpu::Features::empty(), |limits| limits.max_immediate_size = 0));
    assert!(error.contains("lacks immediate data"), "{error}");
    let error = refusal(device(needed, |limits| limits.max_storage_buffers_per_shader_stage = 8));
    assert!(error.contains("it has 8 where 10 are needed"), "{error}");
    let error = refusal(device(needed, |limits| {
        limits.max_storage_buffer_binding_size = 10_000;
        limits.max_buffer_size = 1 << 20;
    }));
    assert!(error.contains("too large") && error.contains("10000"), "{error}");

    // Masks are traced without a clock, too.
    let mut compute = ComputeBackend::new(&scene, device(needed, |_| {})).unwrap();
    let camera = cameras()[0];
    let mut mask = mask_for(&scene, &camera);
    let cost = compute.trace(&camera, &mut mask).unwrap();
    assert_eq!(mask, trace(&scene, &camera).0);
    assert!(cost.primary_ms == 0.0 && cost.shadow_ms > 0.0, "{cost:?}");
}

#[test]
fn a_destroyed_device_is_an_error() {
    let scene = room();
    let gpu = device(super::kernels::NEEDED, |_| {});
    let mut compute = ComputeBackend::new(&scene, gpu.clone()).unwrap();
    let camera = cameras()[0];
    let mut mask = mask_for(&scene, &camera);
    compute.trace(&camera, &mut mask).unwrap();
    gpu.device.destroy();
    let error = compute.trace(&camera, &mut mask).unwrap_err();
    assert!(matches!(error, BackendError::Device(_)), "{error}");
}
