//! What the device moves, compared bit by bit with what the host moves.

use glam::{DMat4, DQuat};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{Aabb, AnimatedNode, Animation, Delta, Influence, Joint, Piece, Shape, Target};
use gnomon_shaders::{gpu::GpuOptions, splice::splice};
use wgpu::util::DeviceExt as _;

use super::*;
use crate::visibility::{
    backend::compute::{Posers, posing},
    test_scenes::living_room,
};

/// What a buffer holds.
fn content(gpu: &Gpu, buffer: &wgpu::Buffer) -> Vec<u32> {
    let host = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: buffer.size(),
        usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_buffer_to_buffer(buffer, 0, &host, 0, buffer.size());
    gpu.queue.submit([encoder.finish()]);
    host.map_async(wgpu::MapMode::Read, .., |result| result.unwrap());
    gpu.device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
    bytemuck::pod_collect_to_vec(&host.get_mapped_range(..).unwrap())
}

/// Numbers of a simple sequence.
struct Numbers(u64);

impl Numbers {
    fn word(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let folded = (self.0 >> 33) ^ self.0;
        folded.wrapping_mul(0xff51_afd7_ed55_8ccd) ^ (folded >> 29)
    }

    /// From −1 to 1.
    fn unit(&mut self) -> f64 {
        (self.word() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    #[expect(clippy::cast_possible_truncation, reason = "any number will do")]
    fn single(&mut self) -> f32 {
        self.unit() as f32
    }

    /// A number with an exponent of this range, of any bits, few bits or all bits.
    fn number(&mut self, least: i32, most: i32) -> f64 {
        let range = u64::try_from(most - least).unwrap();
        let exponent = i64::from(least) + i64::try_from(self.word() % range).unwrap() + 1023;
        let fraction = match self.word() % 5 {
            0 => self.word() % 8,
            1 => (1 << 52) - 1 - self.word() % 8,
            // As of an f32, or just beside the middle between two.
            2 => (self.word() % (1 << 23)) << 29,
            3 => ((self.word() % (1 << 23)) << 29 | 1 << 28).wrapping_add(self.word() % 3).wrapping_sub(1) % (1 << 52),
            _ => self.word() % (1 << 52),
        };
        f64::from_bits(self.word() << 63 | u64::try_from(exponent).unwrap() << 52 | fraction)
    }
}

/// Pairs of numbers: products, sums and what rounding makes of them, near and far, equal, opposite and zero.
fn pairs() -> Vec<[f64; 2]> {
    let mut numbers = Numbers(1);
    let mut pairs = vec![[0.0, 0.0], [-0.0, 0.0], [0.0, -0.0], [-0.0, -0.0], [1.0, 0.0], [-0.0, 3.0], [1.0, -1.0]];
    for n in 0..80_000 {
        let a = match n % 16 {
            // Below 2^-1022, and what comes there.
            13 => f64::from_bits(numbers.word() >> (12 + n / 16 % 52)),
            14 => numbers.number(-1022, -900),
            15 => numbers.number(-560, -500),
            _ => numbers.number(-150, 150),
        };
        let near = i32::try_from(a.to_bits() >> 52 & 0x7ff).unwrap().max(60) - 1023;
        let b = match n % 7 {
            0 => numbers.number(-150, 150),
            6 => numbers.number(-560, -400),
            1 => -a,
            2 => -f64::from_bits(a.to_bits() ^ (numbers.word() % 16)),
            3 => f64::from_bits((a * 2.0).to_bits() ^ (1 << 63) ^ (numbers.word() % 4)),
            _ => numbers.number(near - 56, near.min(500) + 3),
        };
        pairs.push([a, b]);
    }
    pairs
}

/// Numbers that an f32 takes from f64, down to its smallest.
const TEST: &str = "
@group(0) @binding(0) var<storage, read> pairs: array<vec4u>;
@group(0) @binding(1) var<storage, read_write> results: array<vec4u>;

fn bits_of(x: Double) -> vec2u {
    let power = select(u32(x.exponent + 1075), 0u, x.mantissa == 0lu);
    if x.mantissa != 0lu && x.exponent < LAST_POWER {
        // All bits that are cut off are zeros.
        let small = x.mantissa >> u32(LAST_POWER - x.exponent);
        return vec2u(u32(small), (x.sign << 31u) | u32(small >> 32u));
    }
    let high = (x.sign << 31u) | (power << 20u) | (u32(x.mantissa >> 32u) & 0xfffffu);
    return vec2u(u32(x.mantissa), high);
}

@compute @workgroup_size(64)
fn test(@builtin(global_invocation_id) at: vec3u) {
    let pair = pairs[at.x];
    let a = double_of(pair.x, pair.y);
    let b = double_of(pair.z, pair.w);
    let positive = Double(0u, a.exponent, a.mantissa);
    let other = Double(0u, b.exponent, b.mantissa);
    var over = ZERO;
    var of_square = ZERO;
    if b.mantissa != 0lu {
        over = quotient(a, b);
    }
    if a.mantissa != 0lu {
        of_square = root(positive);
    }
    results[4u * at.x] = vec4u(bits_of(sum(a, b)), bits_of(difference(a, b)));
    results[4u * at.x + 1u] = vec4u(bits_of(product(a, b)), bits_of(over));
    results[4u * at.x + 2u] = vec4u(bits_of(of_square), single_of(a), single_of(double_of_single(pair.x)));
    results[4u * at.x + 3u] = vec4u(bits_of(double_of_single(pair.y)), u32(is_greater(positive, other)), 0u);
}
";

#[test]
fn doubles_of_whole_numbers_are_those_of_the_processor() {
    let wanted = posing::NEEDED;
    let gpu = pollster::block_on(Gpu::open(&GpuOptions { adapter: None, wanted, allow_software: true })).unwrap();
    let pairs = pairs();
    let text = splice("shared/double.wgsl").unwrap() + TEST;
    let source = wgpu::ShaderSource::Wgsl(text.into());
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source });
    let kernel = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: None,
        layout: None,
        module: &module,
        entry_point: Some("test"),
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    });
    let buffer = |contents: &[u8]| {
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC;
        gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: None, contents, usage })
    };
    let (input, output) = (buffer(bytemuck::cast_slice(&pairs)), buffer(&vec![0; 64 * pairs.len()]));
    let entries = [(0, &input), (1, &output)]
        .map(|(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() });
    let layout = &kernel.get_bind_group_layout(0);
    let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor { label: None, layout, entries: &entries });
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
    pass.set_pipeline(&kernel);
    pass.set_bind_group(0, &group, &[]);
    pass.dispatch_workgroups(u32::try_from(pairs.len()).unwrap().div_ceil(64), 1, 1);
    drop(pass);
    gpu.queue.submit([encoder.finish()]);

    let mut compared = 0;
    for ([a, b], found) in pairs.iter().zip(content(&gpu, &output).chunks(16)) {
        let single = |bits: u64| f32::from_bits(u32::try_from(bits & 0xffff_ffff).unwrap());
        let found_f64 = |at: usize| f64::from_bits(u64::from(found[at]) | u64::from(found[at + 1]) << 32);
        for (what, expected, found) in [
            ("sum", a + b, found_f64(0)),
            ("difference", a - b, found_f64(2)),
            ("product", a * b, found_f64(4)),
            ("quotient", if *b == 0.0 { 0.0 } else { a / b }, found_f64(6)),
            ("root", a.abs().sqrt(), found_f64(8)),
            ("f64 of an f32", f64::from(single(a.to_bits() >> 32)), found_f64(12)),
        ] {
            if expected.is_finite() {
                assert_eq!(
                    expected.to_bits(),
                    found.to_bits(),
                    "{what} of {a:e} and {b:e}: {expected:e}, not {found:e}"
                );
                compared += 1;
            }
        }
        #[expect(clippy::cast_possible_truncation, reason = "what the kernel rounds, too")]
        let rounded = *a as f32;
        assert_eq!(rounded.to_bits(), found[10], "{a:e} as f32: {rounded:e}");
        let low = single(a.to_bits());
        assert!(low.to_bits() == found[11] || !low.is_finite(), "{low:e} to f64 and back");
        assert_eq!(u32::from(a.abs() > b.abs()), found[14], "{a:e} and {b:e}");
    }
    assert!(compared > 5 * pairs.len());
}

/// Balls that nodes turn, stretch, shear, mirror, flatten and carry far away, and slivers among them. Some follow
/// joints, some change by morph targets.
fn carried() -> Scene {
    let mut numbers = Numbers(9);
    let nodes = 60;
    let mut test = TestScene::default().point(Vec3::new(0.0, 3.0, 0.0));
    for _ in 0..nodes {
        let [x, y, z] = [(); 3].map(|()| numbers.single());
        let at = Vec3::new(x, y, z) * 3.0;
        test = test.sphere(DOUBLE_SIDED, at, 0.3 + 0.2 * x, 6, y > 0.0);
        test = test.quad(DOUBLE_SIDED, at, Vec3::X * 1e-7, Vec3::Y * z).quad(DOUBLE_SIDED, at, at, at * (1.0 + 1e-7));
        test = test.quad(DOUBLE_SIDED, at * 1e-38, Vec3::X * 1e-40, Vec3::Y * z);
    }
    let mut scene = test.build();
    // Slivers have no normal of their own. Files' are repaired when they are loaded.
    scene.normals.iter_mut().filter(|normal| !normal.is_finite()).for_each(|normal| *normal = Vec3::Y);
    let count = u32::try_from(scene.positions.len()).unwrap() / nodes;
    let mut animation = Animation::default();
    for node in 0..nodes {
        let mut three = |size: f64| DVec3::new(numbers.unit(), numbers.unit(), numbers.unit()) * size;
        let scale = match node % 6 {
            0 => DVec3::ONE,
            1 => three(1e3),
            2 => three(1e-9),
            3 => DVec3::new(1.0, 0.0, -2.0),
            4 => DVec3::new(1e-70, 1.0, 1.0),
            _ => three(2.0),
        };
        let turned = DQuat::from_scaled_axis(three(3.0));
        let above = DMat4::from_scale_rotation_translation(three(1.5), DQuat::from_scaled_axis(three(3.0)), three(1.0));
        animation.nodes.push(AnimatedNode {
            editable: true,
            above: if node.is_multiple_of(4) { DMat4::IDENTITY } else { above },
            translation_m: if node.is_multiple_of(5) { three(1e6) } else { three(4.0) },
            rotation: turned.normalize(),
            scale,
            visible: node % 13 != 5,
            ..AnimatedNode::default()
        });
        let (first, end) = ((node * count) as usize, ((node + 1) * count) as usize);
        let positions = &scene.positions[first..end];
        let bounds = positions.iter().fold(Aabb { min: positions[0], max: positions[0] }, |Aabb { min, max }, at| {
            Aabb { min: min.min(*at), max: max.max(*at) }
        });
        animation.pieces.push(Piece {
            node,
            first_vertex: node * count,
            vertices: count,
            bounds,
            mirrored: node.is_multiple_of(7),
        });
        animation.positions.extend_from_slice(positions);
        animation.normals.extend_from_slice(&scene.normals[first..end]);
        if node % 3 == 1 {
            bend(&mut animation, node, count, &mut numbers);
        }
    }
    scene.animation = Some(Box::new(animation));
    scene
}

/// Gives a piece a shape.
fn bend(animation: &mut Animation, piece: u32, vertices: u32, numbers: &mut Numbers) {
    let bounds = Aabb { min: Vec3::splat(-5.0), max: Vec3::splat(5.0) };
    let (joints, targets) = (if piece.is_multiple_of(2) { 5 } else { 0 }, piece % 4);
    let sets = if joints > 0 { 1 + piece % 3 } else { 0 };
    let mut three = |size: f64| DVec3::new(numbers.unit(), numbers.unit(), numbers.unit()) * size;
    let joint = |n: u16| {
        let scale = if n == 3 { DVec3::new(1.0, 0.0, 1.0) } else { DVec3::ONE + three(0.7) };
        let node_from_own = DMat4::from_scale_rotation_translation(
            scale * if piece.is_multiple_of(8) { 1e-12 } else { 1.0 },
            DQuat::from_scaled_axis(three(1.0)),
            three(0.5),
        );
        Joint { node: n.is_multiple_of(2).then_some(piece), node_from_own, bounds }
    };
    let shape = Shape {
        piece,
        node_from_own: DMat4::from_rotation_y(0.3),
        joints: (0..joints).map(joint).collect(),
        sets,
        targets: (0..targets).map(|n| Target { weight: n as f32 * 0.4 - 0.4, bounds }).collect(),
        weights_track: None,
        flat: piece.is_multiple_of(5),
    };
    for n in 0..sets * vertices {
        let mut weight = || numbers.single().max(0.0) * if n % 11 == 3 { 1e-40 } else { 1.0 };
        let weights = [weight(), weight(), weight(), if n.is_multiple_of(2) { 0.0 } else { weight() }];
        // Some follow nothing.
        let weights = if n % 23 == 7 { [0.0; 4] } else { weights };
        let joint = |at: u32| u16::try_from((n * 3 + at) % u32::from(joints)).unwrap();
        animation.influences.push(Influence { joints: [joint(0), joint(1), joint(2), joint(7)], weights });
    }
    for _ in 0..targets * vertices {
        let mut three = || Vec3::new(numbers.single(), numbers.single(), numbers.single()) * 0.3;
        animation.deltas.push(Delta { position: three(), normal: three(), tangent: three() });
    }
    animation.shapes.push(shape);
}

/// The triangles and normals of all regions, sorted: which come first is another matter.
fn moved(scene: &Scene, time_s: f64, posers: Posers) -> Vec<Vec<u32>> {
    let mut compute = ComputeBackend::open_with_posers(scene, None, true, posers).unwrap();
    assert_eq!(compute.moving.posing.is_some(), posers == Posers::Device);
    let camera = Camera::looking_at(DVec3::new(0.0, 1.0, 4.0), DVec3::ZERO, 1.1, 32, 32);
    let mut mask = Mask::new(MaskShape::new(32, 32, u32::try_from(scene.lights.len()).unwrap()).unwrap());
    compute.trace_at(&camera, time_s, &mut mask).unwrap();
    let [triangles, normals] = [&compute.moving.buffers.triangles, &compute.moving.buffers.normals]
        .map(|buffer| content(&compute.gpu, buffer));
    let mut all: Vec<Vec<u32>> =
        triangles.chunks(12).zip(normals.chunks(12)).map(|(triangle, normals)| [triangle, normals].concat()).collect();
    all.sort_unstable();
    all
}

#[test]
fn the_device_moves_triangles_to_the_very_bits_of_the_host() {
    for (name, scene, times_s) in
        [("a living room", living_room(), &[0.0, 0.3, 1.4, 1234.9][..]), ("carried things", carried(), &[0.0])]
    {
        for time_s in times_s {
            let [host, device] = [Posers::Host, Posers::Device].map(|posers| moved(&scene, *time_s, posers));
            let shown = host.iter().filter(|triangle| triangle.iter().any(|word| *word != 0)).count();
            assert!(shown > 30, "{name} at {time_s} s: {shown} triangles");
            let differing = host.iter().zip(&device).filter(|(host, device)| host != device).count();
            assert_eq!(differing, 0, "{name} at {time_s} s, of {shown} triangles");
        }
    }
}
