//! Small scenes in which things move, each with another kind of motion.

use glam::{DQuat, DVec3, Vec3};
use gnomon_scene::{AlphaMode, AnimatedNode, Interpolation, Scene, Track, Wrap};

use super::{
    builder::{SceneBuilder, track},
    shapes::creatures,
};

/// Times to look at, in seconds: at keys, between them, and after many rounds.
pub const TIMES_S: [f64; 5] = [0.0, 0.3, 1.0, 1.77, 1234.5];

/// Turns from one angle to another within two seconds, about an axis.
fn turning(axis: DVec3, from_rad: f64, to_rad: f64) -> Option<Track> {
    let turn = |angle: f64| DQuat::from_axis_angle(axis, angle).as_quat().to_array();
    let half = turn(f64::midpoint(from_rad, to_rad));
    track(Interpolation::Linear, &[0.0, 1.0, 2.0], &[turn(from_rad), half, turn(to_rad)].concat())
}

fn node(parent: Option<u32>, change: impl FnOnce(&mut AnimatedNode)) -> Option<AnimatedNode> {
    let mut node = SceneBuilder::node(parent);
    change(&mut node);
    Some(node)
}

fn floor() -> SceneBuilder {
    SceneBuilder::new().quad(Vec3::new(-8.0, 0.0, 8.0), Vec3::X * 16.0, Vec3::NEG_Z * 16.0)
}

/// A lamp in a cage swings; a ball rolls below it.
fn lamp() -> Scene {
    let swing = node(None, |node| {
        node.translation_m = DVec3::Y * 5.0;
        node.rotation_track = turning(DVec3::Z, -0.6, 0.6);
    });
    let roll = node(None, |node| {
        node.translation_track = track(Interpolation::Linear, &[0.0, 2.0], &[-3.0, 1.0, 0.5, 3.0, 1.0, -0.5]);
        node.rotation_track = turning(DVec3::NEG_Z, 0.0, 3.0);
    });
    floor()
        .moving(swing, |builder| {
            let bars = [-0.4, 0.3].map(|x| (Vec3::new(x, -3.0, -0.4), Vec3::new(x + 0.1, -1.5, 0.4)));
            let builder = bars.into_iter().fold(builder, |builder, (min, max)| builder.cuboid(min, max));
            builder.point_light(Vec3::new(0.0, -2.0, 0.0), 30.0)
        })
        .moving(roll, |builder| builder.sphere(Vec3::ZERO, 1.0, 24))
        .spot_light(Vec3::new(4.0, 6.0, 3.0), Vec3::new(-0.5, -1.0, -0.4), 0.7)
        .build()
}

/// A fan of leaves with holes spins before the sun, far from the world's origin. It is stretched, and turns inside out.
fn fan() -> Scene {
    let arm = node(None, |node| {
        node.translation_track = track(
            Interpolation::CubicSpline,
            &[0.0, 1.5],
            &[[0.0; 3], [0.0, 2.0, 0.0], [4.0, 1.0, 0.0], [-1.0, 0.0, 2.0], [1.0, 3.0, 0.5], [0.0; 3]].concat(),
        );
        node.scale_track = track(Interpolation::Linear, &[0.0, 2.0], &[1.0, 1.0, 1.0, -1.5, 0.5, 1.0]);
    });
    let spin = node(Some(0), |node| {
        node.above = glam::DMat4::from_rotation_y(0.4);
        node.rotation_track = turning(DVec3::new(0.0, 0.6, 0.8), 0.0, 3.1);
    });
    let leaf = |builder: SceneBuilder, turn: f32| {
        let along = glam::Quat::from_rotation_y(turn) * Vec3::X;
        builder.quad(along * 0.3, along * 2.0, along.cross(Vec3::Y) * 0.8 + Vec3::Y * 0.2)
    };
    floor()
        .origin(DVec3::new(1e6, 0.0, -3e5))
        .moving(arm, |builder| builder.cuboid(Vec3::splat(-0.2), Vec3::splat(0.2)))
        .material(AlphaMode::Mask { cutoff: 0.4 }, true)
        .alpha_picture(4, &[255, 0, 255, 255, 255, 255, 0, 255], Wrap::Repeat)
        .moving(spin, |builder| [0.0, 1.3, 2.6, 3.9, 5.2].into_iter().fold(builder, leaf))
        .sun(Vec3::new(0.3, -1.0, 0.2))
        .sun(Vec3::new(-1.0, -0.6, -0.3))
        .build()
}

/// Doors open, one after the other, single-sided; a sign is shown half of the time; something grows from nothing.
fn doors() -> Scene {
    let door = |x: f64, from: f64, to: f64| {
        node(None, |node| {
            node.translation_m = DVec3::new(x, 0.0, 0.0);
            node.rotation_track = turning(DVec3::Y, from, to);
        })
    };
    let leaf = |builder: SceneBuilder| builder.cuboid(Vec3::new(0.0, 0.0, -0.05), Vec3::new(1.4, 2.5, 0.05));
    let sign = node(None, |node| {
        node.visible_track = track(Interpolation::Step, &[0.0, 0.9, 2.0], &[1.0, 0.0, 1.0]);
    });
    let grown = node(None, |node| {
        node.translation_m = DVec3::new(0.0, 0.0, 3.0);
        node.scale_track = track(Interpolation::Linear, &[0.0, 2.0], &[0.0, 0.0, 0.0, 1.0, 2.0, 1.0]);
    });
    floor()
        .material(AlphaMode::Opaque, false)
        .moving(door(-3.0, 0.0, 2.5), leaf)
        .moving(door(0.5, -2.0, 0.5), leaf)
        .moving(sign, |builder| builder.quad(Vec3::new(-1.0, 3.0, 1.0), Vec3::X * 2.0, Vec3::Y))
        .moving(grown, |builder| builder.sphere(Vec3::Y * 0.5, 0.5, 16))
        .sun(Vec3::new(0.4, -0.8, -0.7))
        .point_light(Vec3::new(0.3, 2.2, -3.0), 40.0)
        .build()
}

/// Returns the scenes by name.
pub fn all() -> [(&'static str, Scene); 4] {
    [("lamp", lamp()), ("fan", fan()), ("doors", doors()), ("creatures", creatures())]
}
