//! What changes its shape is drawn as the still scene of its time, and late masks know where its points were.

use glam::{DMat4, DQuat, DVec3, Vec2, Vec3, Vec4};
use gnomon_scene::{
    Aabb, Animation, Delta, Draw, Influence, Interpolation, Joint, Material, Piece, Scene, Shape, Target,
};

use super::living::{SIZE, alike, as_mask, draw, node, renderer, still, track};
use crate::{
    occluders::Occluders,
    render::{
        exposure::Exposure,
        predict::MaskView,
        testing::{camera, floor_and_lights, gpu},
    },
};

/// A green blade, of facets, whose upper half bends to and fro while all of it leans.
pub(in crate::render) fn blade() -> Scene {
    const STEPS: u8 = 8;
    let (low, high) = (0.1_f32, 1.1_f32);
    let mut scene = floor_and_lights();
    let material = u32::try_from(scene.materials.len()).unwrap();
    let green = Material { base_color: Vec4::new(0.05, 0.8, 0.05, 1.0), ..scene.materials[1].clone() };
    scene.materials.push(green);
    let first = scene.positions.len();
    let [first_vertex, first_triangle] = [first, scene.triangles.len()].map(|count| u32::try_from(count).unwrap());
    for step in 0..STEPS {
        let at = |x: f32, step: u8| Vec3::new(x, low + (high - low) * f32::from(step) / f32::from(STEPS), 0.6);
        let [a, b, c, d] = [at(-0.7, step), at(0.7, step), at(0.7, step + 1), at(-0.7, step + 1)];
        scene.positions.extend([a, b, c, a, c, d]);
    }
    let own = scene.positions[first..].to_vec();
    scene.normals.extend(vec![Vec3::Z; own.len()]);
    scene.uvs.extend(vec![Vec2::ZERO; own.len()]);
    let vertices = u32::try_from(own.len()).unwrap();
    scene.triangles.extend((0..vertices / 3).map(|number| [0, 1, 2].map(|corner| first_vertex + 3 * number + corner)));
    scene.draws.push(Draw { first_triangle, triangles: vertices / 3, material });

    let turn = |angle: f64| DQuat::from_rotation_x(angle).as_quat().to_array();
    let mut tip = node();
    tip.above = DMat4::from_translation(DVec3::Y * 0.5);
    tip.rotation_track = track(Interpolation::Linear, &[0.0, 1.0, 2.0], &[turn(-0.5), turn(0.9), turn(-0.5)].concat());
    let share = |at: &Vec3| ((at.y - 0.3) / 0.4).clamp(0.0, 1.0);
    let bounds = |of: &dyn Fn(f32) -> bool| Aabb::around(own.iter().filter(|at| of(share(at))));
    let joint = |node, way: DVec3, bounds| Joint { node, node_from_own: DMat4::from_translation(way), bounds };
    let influence = |at: &Vec3| Influence { joints: [0, 1, 0, 0], weights: [1.0 - share(at), share(at), 0.0, 0.0] };
    let deltas: Vec<Delta> =
        own.iter().map(|at| Delta { position: Vec3::X * (at.y - low) * 0.4, ..Delta::default() }).collect();
    let lean = Aabb::around(deltas.iter().map(|delta| &delta.position));
    let shape = Shape {
        piece: 0,
        node_from_own: DMat4::IDENTITY,
        joints: vec![
            joint(None, DVec3::X * 1000.0, bounds(&|share| share < 1.0)),
            joint(Some(0), DVec3::NEG_Y * 0.5, bounds(&|share| share > 0.0)),
        ],
        sets: 1,
        targets: vec![Target { weight: 0.0, bounds: lean }],
        weights_track: track(Interpolation::Linear, &[0.0, 0.7, 2.0], &[-0.5, 1.0, -0.5]),
        flat: true,
    };
    let bounds = Aabb::around(&own);
    scene.animation = Some(Box::new(Animation {
        nodes: vec![tip],
        pieces: vec![Piece { node: 0, first_vertex, vertices, bounds, mirrored: false }],
        influences: own.iter().map(influence).collect(),
        normals: vec![Vec3::Z; own.len()],
        positions: own,
        shapes: vec![shape],
        deltas,
        ..Animation::default()
    }));
    scene.bounds = Aabb::around(&scene.positions);
    assert_eq!(scene.check(), Ok(()));
    // All that moves stays in there.
    scene.bounds = Aabb { min: Vec3::new(-4.0, -2.0, -4.0), max: Vec3::new(4.0, 3.0, 4.0) };
    scene
}

#[test]
fn a_bent_blade_is_drawn_as_the_still_one_of_its_time() {
    let (gpu, camera, scene) = (gpu(), camera(SIZE.0, SIZE.1), blade());
    let exposure = Exposure::of_scene(&scene, &Occluders::default());
    let mut moving = renderer(&gpu, &scene, exposure);
    let mut pictures = Vec::new();
    for time_s in [0.0, 0.4, 1.0, 1234.5] {
        let mut standing = renderer(&gpu, &still(&scene, time_s), exposure);
        let found = draw(&gpu, &mut moving, (&camera, time_s), None);
        assert!(alike(&found, &draw(&gpu, &mut standing, (&camera, time_s), None)), "{time_s} s");
        pictures.push(found.0);
    }
    assert!(pictures[1..].iter().all(|picture| *picture != pictures[0]), "nothing bends");
}

#[test]
fn a_late_mask_knows_where_the_points_of_a_bent_blade_were() {
    let (gpu, camera, scene) = (gpu(), camera(SIZE.0, SIZE.1), blade());
    let (then_s, now_s) = (0.4, 0.5);
    let mut moving = renderer(&gpu, &scene, Exposure::of_scene(&scene, &Occluders::default()));
    let then = draw(&gpu, &mut moving, (&camera, then_s), None).1;
    let (picture, truth) = draw(&gpu, &mut moving, (&camera, now_s), None);
    let mask = as_mask(&then);
    let view = MaskView { mask: &mask, coverage: None, more: false, traced_for: &camera, scene: &then_s.into() };
    let found = draw(&gpu, &mut moving, (&camera, now_s), Some(view)).1;
    let green = |rgba: &[u8]| rgba[1] > 40 && u32::from(rgba[1]) > 2 * u32::from(rgba[0].max(rgba[2]));
    let blade: Vec<usize> = picture.chunks(4).enumerate().filter(|(_, rgba)| green(rgba)).map(|(at, _)| at).collect();
    let known = blade.iter().filter(|at| found[**at].known).count();
    let wrong = |pixels: &[crate::render::PixelVisibility]| {
        pixels.iter().zip(&truth).map(|(one, other)| (one.word ^ other.word).count_ones()).sum::<u32>()
    };
    println!(
        "{} pixels, {known} known; {} wrong of old bits, {} of predicted ones",
        blade.len(),
        wrong(&then),
        wrong(&found)
    );
    assert!(blade.len() > 500 && wrong(&then) > 100, "{} {}", blade.len(), wrong(&then));
    // What its own edge hid is unknown.
    assert!(known * 10 > blade.len() * 8, "{known} of {}", blade.len());
    assert!(wrong(&found) * 5 < wrong(&then), "{} of {}", wrong(&found), wrong(&then));
}
