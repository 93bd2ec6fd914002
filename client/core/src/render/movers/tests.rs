//! The adapter's vertices are those of the host, but for what rounding in f32 may do to them.

use std::sync::Arc;

use glam::{DMat4, DQuat, DVec3, Vec3};
use gnomon_scene::{AnimatedNode, Edit, Edits, Influence, NodeEdit, OwnVertices, Placement, Scene, SceneAt};
use gnomon_shaders::gpu::Gpu;

use crate::{
    occluders::Occluders,
    render::{
        FrameRenderer,
        exposure::Exposure,
        testing::{camera, gpu},
        tests::{
            living::{SIZE, living, node, renderer},
            shapes::blade,
        },
        vertex::{MoreOfVertex, Vertex},
    },
};

/// The rounding unit of f32.
const UNIT: f64 = 1.0 / (1_u32 << 24) as f64;

/// Reads a buffer of the scene.
fn read<T: bytemuck::AnyBitPattern>(gpu: &Gpu, buffer: &wgpu::Buffer) -> Vec<T> {
    let copy = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: buffer.size(),
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_buffer_to_buffer(buffer, 0, &copy, 0, buffer.size());
    gpu.queue.submit([encoder.finish()]);
    copy.map_async(wgpu::MapMode::Read, .., |result| result.unwrap());
    gpu.device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
    let bytes = copy.get_mapped_range(..).unwrap();
    bytes.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned).collect()
}

/// How far the adapter's position of a vertex may lie from the host's.
///
/// Sums are of magnitudes. A transform's numbers and the position, from the middle, are each rounded once (2 units of
/// a product), products and sums of three and the translation 4 times; of a mean, weights and products once each, and
/// sums once less than there are joints; of each morph target its weight, product and sum; the host rounds once. Units
/// of units, and what a weight of a morph target is rounded by, are in one more.
fn bound(placement: &Placement, own: &OwnVertices<'_>, (vertex, middle): (usize, Vec3)) -> f64 {
    let size = |by: &DMat4, of: DVec3| {
        let linear = [0, 1, 2].map(|n| by.col(n).truncate().abs());
        let there = by.transform_point3(middle.as_dvec3()) - placement.origin_m;
        linear[0] * of.x + linear[1] * of.y + linear[2] * of.z + there.abs()
    };
    let mut reach = (own.positions[vertex].as_dvec3() - middle.as_dvec3()).abs();
    for (target, weight) in placement.targets() {
        reach += own.deltas[target * own.positions.len() + vertex].position.as_dvec3().abs() * weight.abs();
    }
    let sets = own.shape.map_or(0, |shape| shape.sets as usize);
    let influences = &own.influences[vertex * sets..(vertex + 1) * sets];
    let joints: Vec<(usize, f64)> = influences.iter().flat_map(Influence::each).collect();
    let all = match joints.iter().map(|(_, weight)| weight).sum::<f64>() {
        0.0 => size(placement.transforms().0, reach),
        weights => joints.iter().fold(DVec3::ZERO, |sum, (joint, weight)| {
            sum + size(&placement.joints()[*joint], reach) * (weight / weights)
        }),
    };
    let roundings = 8 + if joints.is_empty() { 0 } else { joints.len() + 1 } + 3 * placement.targets().len();
    roundings as f64 * UNIT * all.max_element()
}

fn check(gpu: &Gpu, renderer: &mut FrameRenderer, scene: &Scene, time_s: f64) -> usize {
    renderer.set_time(time_s);
    renderer.draw_surfaces(&camera(SIZE.0, SIZE.1)).unwrap();
    let vertices: Vec<Vertex> = read(gpu, renderer.scene.vertices());
    let more: Vec<MoreOfVertex> = read(gpu, renderer.scene.more());
    let animation = scene.animation.as_deref().unwrap();
    let moment = scene.moment(time_s).unwrap();
    let (mut checked, middles) = (0, super::own::middles(animation));
    for (number, (piece, own)) in animation.pieces.iter().zip(animation.own_vertices()).enumerate() {
        let Some(placement) = &moment.pieces[number] else { continue };
        let bounds: Vec<f64> =
            (0..own.positions.len()).map(|at| bound(placement, &own, (at, middles[number]))).collect();
        for at in 0..own.positions.len() {
            let found = &vertices[piece.first_vertex as usize + at];
            let (position, normal) = placement.vertex(&own, at);
            let apart = (found.position - position).abs().max_element();
            assert!(f64::from(apart) <= bounds[at], "{time_s} s, {number}, {at}: {apart} of {}", bounds[at]);
            // A step of 16 bits, and what corners that lie elsewhere turn a facet by.
            let step = 1.0 / f32::from(i16::MAX);
            let flat = own.shape.is_some_and(|shape| shape.flat);
            let turned = if flat { facet_turns(placement, &own, at, &bounds) } else { 0.0 };
            let off = (found.unit_normal() - normal).abs().max_element();
            assert!(f64::from(off) <= f64::from(step) + turned, "{time_s} s, {number}, {at}: {off} {turned}");
            if !own.tangents.is_empty() {
                let tangent = placement.tangent_of(&own, at);
                let off = (more[piece.first_vertex as usize + at].unit_tangent() - tangent).abs().max_element();
                assert!(off <= step, "{time_s} s, {number}, {at}: {tangent} {off}");
            }
            checked += 1;
        }
    }
    checked
}

/// How far a facet's normal turns at most where its corners lie elsewhere: twice that by its least height.
fn facet_turns(placement: &Placement, own: &OwnVertices<'_>, vertex: usize, bounds: &[f64]) -> f64 {
    let first = vertex - vertex % 3;
    let [a, b, c] = [0, 1, 2].map(|corner| placement.vertex(own, first + corner).0.as_dvec3());
    let longest = (b - a).length().max((c - a).length()).max((c - b).length());
    let least_height = (b - a).cross(c - a).length() / longest;
    // Of all three axes, and of differences.
    let apart = bounds[first..first + 3].iter().fold(0.0, |most: f64, bound| most.max(*bound)) * 3.0_f64.sqrt() * 2.0;
    2.0 * apart / least_height
}

/// Nodes that turn, stretch, mirror and shear, far from the origin of the world.
fn strained() -> Scene {
    let mut scene = living(false);
    let nodes = &mut scene.animation.as_mut().unwrap().nodes;
    let shear =
        DMat4::from_cols_array(&[1.0, 0.3, 0.0, 0.0, -0.4, 1.2, 0.1, 0.0, 0.0, 0.2, 0.9, 0.0, 3.0, 1.0, -2.0, 1.0]);
    nodes[0].above = DMat4::from_translation(DVec3::X * 1000.0) * shear * DMat4::from_translation(DVec3::X * -1000.0);
    nodes[2].scale = DVec3::new(-0.02, 1.3, 50.0);
    nodes[3].scale = DVec3::new(1.0, 0.0, 1.0);
    scene
}

/// All bytes of the vertices.
fn vertices(gpu: &Gpu, renderer: &FrameRenderer) -> [Vec<u8>; 2] {
    [renderer.scene.vertices(), renderer.scene.more()].map(|buffer| read(gpu, buffer))
}

/// What is as in the file meets what rests exactly: its vertices are the host's, at first and whenever it returns.
#[test]
fn what_stands_as_in_the_file_has_the_hosts_vertices() {
    let gpu = gpu();
    let mut scene = living(false);
    let animation = scene.animation.as_mut().unwrap();
    animation.nodes.fill(AnimatedNode { editable: true, ..node() });
    animation.nodes[0].rotation = DQuat::from_rotation_y(0.4);
    let mut editable = renderer(&gpu, &scene, Exposure::of_scene(&scene, &Occluders::default()));
    let show = |renderer: &mut FrameRenderer, edits: &[Edit]| {
        let mut all = Edits::default();
        edits.iter().for_each(|edit| all.apply(*edit).unwrap());
        renderer.set_time(SceneAt { time_s: 0.0, edits: Arc::new(all) });
        renderer.draw_surfaces(&camera(SIZE.0, SIZE.1)).unwrap();
        vertices(&gpu, renderer)
    };
    let at_rest = show(&mut editable, &[]);
    let found: Vec<Vertex> = read(&gpu, editable.scene.vertices());
    let expected = scene.at_rest().positions;
    assert!(found.iter().zip(&expected).all(|(found, expected)| found.position == *expected));
    let carried = NodeEdit { translation_m: Some(DVec3::new(1000.3, 0.2, 0.1)), ..NodeEdit::default() };
    let hidden = NodeEdit { shown: Some(false), ..carried };
    let away = show(&mut editable, &[Edit::Node(0, carried)]);
    assert_ne!(away, at_rest);
    // Others stay, and what is hidden and shown again is where it was, or back.
    show(&mut editable, &[Edit::Node(0, hidden)]);
    assert_eq!(show(&mut editable, &[Edit::Node(0, carried)]), away);
    assert_eq!(show(&mut editable, &[]), at_rest);
}

#[test]
fn vertices_lie_where_the_host_has_them_but_for_rounding() {
    let gpu = gpu();
    for scene in [living(true), blade(), strained()] {
        let mut renderer = renderer(&gpu, &scene, Exposure::of_scene(&scene, &Occluders::default()));
        let times_s = [0.0, 0.3, 0.9, 1.1, 1.7, 1234.5];
        let checked = times_s.map(|time_s| check(&gpu, &mut renderer, &scene, time_s));
        assert!(checked.iter().sum::<usize>() > 50, "{checked:?}");
    }
}
