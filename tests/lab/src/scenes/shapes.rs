//! Small scenes whose things change their shape: bending stems, and a ball with morph targets.

use glam::{DMat4, DQuat, DVec3, Vec3};
use gnomon_scene::{Aabb, AlphaMode, Animation, Delta, Influence, Interpolation, Joint, Scene, Shape, Target};

use super::builder::{SceneBuilder, track};

/// Height of a stem, and of the joint in its middle, in metres.
const HEIGHT_M: f32 = 3.0;
const MIDDLE_M: f32 = 1.5;

/// Two stems that bend, the second one mirrored, and a ball that swells on one side and leans.
pub(super) fn creatures() -> Scene {
    let bend = |axis: DVec3, most_rad: f64| {
        let turn = |angle: f64| DQuat::from_axis_angle(axis, angle).as_quat().to_array();
        track(Interpolation::Linear, &[0.0, 0.8, 2.0], &[turn(-most_rad), turn(most_rad), turn(-most_rad)].concat())
    };
    let root = |x: f64, side: f64| {
        let mut node = SceneBuilder::node(None);
        (node.translation_m, node.scale) = (DVec3::new(x, 0.0, -1.0), DVec3::new(side, 1.0, 1.0));
        node
    };
    let tip = |root: u32, axis: DVec3| {
        let mut node = SceneBuilder::node(Some(root));
        node.above = DMat4::from_translation(DVec3::Y * f64::from(MIDDLE_M));
        node.rotation_track = bend(axis, 1.1);
        node
    };
    let stem = |builder: SceneBuilder| builder.sphere(Vec3::Y * (HEIGHT_M / 2.0), HEIGHT_M / 2.0, 24);
    let nothing = |builder: SceneBuilder| builder;
    let mut scene = SceneBuilder::new()
        .origin(DVec3::new(3e4, 0.0, 1e4))
        .quad(Vec3::new(-8.0, 0.0, 8.0), Vec3::X * 16.0, Vec3::NEG_Z * 16.0)
        .material(AlphaMode::Opaque, false)
        .moving(Some(root(-2.5, 1.0)), stem)
        .moving(Some(tip(0, DVec3::Z)), nothing)
        .moving(Some(root(2.5, -1.0)), |builder| {
            builder.cuboid(Vec3::new(-0.5, 0.0, -0.5), Vec3::new(0.5, HEIGHT_M, 0.5))
        })
        .moving(Some(tip(2, DVec3::new(0.6, 0.0, 0.8))), nothing)
        .moving(Some(root(0.0, 1.0)), |builder| builder.sphere(Vec3::new(0.0, 1.2, 3.0), 0.9, 20))
        .sun(Vec3::new(0.4, -0.8, -0.5))
        .point_light(Vec3::new(0.5, 4.0, 3.0), 40.0)
        .build();
    let Some(animation) = scene.animation.as_deref_mut() else { return scene };
    skin(animation, 0, (0, 1));
    skin(animation, 1, (2, 3));
    morph(animation, 2);
    scene
}

/// Lets a piece follow the node below up to a third of its height, the one above from two thirds on, both between.
fn skin(animation: &mut Animation, piece: u32, (below, above): (u32, u32)) {
    let own = animation.own_vertices()[piece as usize].positions.to_vec();
    let share = |position: &Vec3| (position.y / HEIGHT_M * 3.0 - 1.0).clamp(0.0, 1.0);
    let bounds = |of: &dyn Fn(f32) -> bool| Aabb::around(own.iter().filter(|position| of(share(position))));
    let back = DMat4::from_translation(DVec3::NEG_Y * f64::from(MIDDLE_M));
    let joint = |node, node_from_own, bounds| Joint { node: Some(node), node_from_own, bounds };
    let joints = vec![
        joint(below, DMat4::IDENTITY, bounds(&|share| share < 1.0)),
        joint(above, back, bounds(&|share| share > 0.0)),
    ];
    // Twice 1, since weights are normalised.
    let influence = |position: &Vec3| {
        let share = share(position);
        Influence { joints: [0, 1, 0, 0], weights: [2.0 - 2.0 * share, 2.0 * share, 0.0, 0.0] }
    };
    animation.influences.extend(own.iter().map(influence));
    let (node_from_own, targets, weights_track) = (DMat4::IDENTITY, Vec::new(), None);
    animation.shapes.push(Shape { piece, node_from_own, joints, sets: 1, targets, weights_track, flat: false });
}

/// Gives a piece two targets: one swells its upper half, the other shears it.
fn morph(animation: &mut Animation, piece: u32) {
    let own = animation.own_vertices()[piece as usize];
    let swell = own.positions.iter().zip(own.normals).map(|(_, normal)| {
        let by = normal.y.max(0.0);
        Delta { position: *normal * by * 0.7, normal: Vec3::Y * (by * 0.3), tangent: Vec3::ZERO }
    });
    let shear = own.positions.iter().map(|position| {
        let by = Vec3::new(0.5, 0.0, 0.2) * (position.y - 1.2);
        Delta { position: by, normal: Vec3::ZERO, tangent: Vec3::ZERO }
    });
    let deltas: Vec<Delta> = swell.chain(shear).collect();
    let target = |of_target: &[Delta]| {
        let bounds = Aabb::around(of_target.iter().map(|delta| &delta.position));
        Target { weight: 0.5, bounds }
    };
    let targets = deltas.chunks(own.positions.len()).map(target).collect();
    let keys = [[0.0, 0.0], [0.0, 1.0], [2.0, 0.0], [0.0, -1.0], [1.0, -1.0], [0.0, 1.0]];
    let weights_track = track(Interpolation::CubicSpline, &[0.0, 1.7], keys.as_flattened());
    animation.deltas.extend(deltas);
    let (node_from_own, joints) = (DMat4::from_rotation_y(0.3), Vec::new());
    animation.shapes.push(Shape { piece, node_from_own, joints, sets: 0, targets, weights_track, flat: false });
}
