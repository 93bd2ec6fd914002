//! Lights at difficult places: grazing, in a wall's plane, on a surface, inside a mesh, far away, and very many.

use glam::{DVec3, Vec3};
use gnomon_scene::{AlphaMode, Scene, camera::Camera};

use super::{
    case::{Case, Known, look},
    place::still_life,
};
use crate::scenes::builder::SceneBuilder;

fn low_sun(degrees: f32) -> Vec3 {
    let height = degrees.to_radians();
    Vec3::new(-height.cos() * 0.8, -height.sin(), -height.cos() * 0.6)
}

/// A slope of long thin triangles without any occluder.
fn bare_slope() -> SceneBuilder {
    let mut builder = SceneBuilder::new();
    for strip in 0..40_u8 {
        let corner = Vec3::new(-7.0 + 0.35 * f32::from(strip), 0.21 * f32::from(strip) - 3.0, -8.0);
        builder = builder.quad(corner, Vec3::Z * 16.0, Vec3::new(0.35, 0.21, 0.0));
    }
    builder
}

/// A ball in a hall, both closed, with a light inside the ball.
fn light_in_ball(at: Vec3) -> Scene {
    SceneBuilder::new()
        .cuboid(Vec3::new(-4.0, -3.0, -4.0), Vec3::new(4.0, 3.0, 4.0))
        .material(AlphaMode::Opaque, false)
        .sphere(Vec3::ZERO, 1.0, 32)
        .point_light(at, f32::INFINITY)
        .build()
}

pub(super) fn cases(size: (u32, u32), large: bool) -> Vec<Case> {
    let mut cases = Vec::new();
    let view = look([0.7, 2.1, 4.3], [0.0, 0.5, 0.0], size);
    for degrees in [5.0, 1.0, 0.1, 0.01] {
        let scene = still_life().sun(low_sun(degrees)).build();
        cases.push(Case::judged(format!("grazing-{degrees}"), scene, view));
        // Nothing shadows a bare slope, however low the light: n = (−0.21, 0.35, 0)/0.408 turned by the angle.
        let up = Vec3::new(-0.21, 0.35, 0.0).normalize();
        let to_sun = Vec3::Z * degrees.to_radians().cos() + up * degrees.to_radians().sin();
        let camera = look([-1.0, 2.0, 0.4], [0.0, 0.0, 0.0], size);
        cases.push(Case::all(format!("grazing-bare-{degrees}"), bare_slope().sun(-to_sun).build(), camera, Known::Lit));
    }
    let lamp = |at: Vec3| still_life().point_light(at, f32::INFINITY).build();
    // In the plane of the box's right side, and in the floor's.
    cases.push(Case::judged("light-in-wall-plane", lamp(Vec3::new(-0.4, 2.0, 1.5)), view));
    cases.push(Case::judged("light-in-floor-plane", lamp(Vec3::new(0.5, 0.0, 3.0)), view));
    // On top of the box, and in it.
    cases.push(Case::judged("light-on-surface", lamp(Vec3::new(-0.9, 1.1, 0.0)), view));
    cases.push(Case::judged("light-in-mesh", lamp(Vec3::new(-0.9, 0.5, 0.0)), view));
    for exponent in [3, 5, 7] {
        let at = Vec3::new(0.5, 1.0, 0.4).normalize() * 10.0_f32.powi(exponent);
        cases.push(Case::judged(format!("light-far-1e{exponent}"), lamp(at), view));
        let bare = bare_slope().point_light(Vec3::new(-0.3, 0.9, 0.2) * 10.0_f32.powi(exponent), f32::INFINITY);
        let camera = look([-1.0, 2.0, 0.4], [0.0, 0.0, 0.0], size);
        cases.push(Case::all(format!("light-far-bare-1e{exponent}"), bare.build(), camera, Known::Lit));
    }
    for (name, at) in [("centre", Vec3::ZERO), ("aside", Vec3::new(0.3, -0.4, 0.5)), ("skin", Vec3::X * 0.99)] {
        // In all directions: 3.5 million rays in large pictures.
        for way in 0..if large { 20_u8 } else { 3 } {
            // The camera stands at the light: every ray passes the ball's single-sided inside.
            let (eye, turn) = (at.as_dvec3(), f64::from(way) * 2.399_963);
            let height = 1.0 - (2.0 * f64::from(way) + 1.0) / if large { 20.0 } else { 3.0 };
            let towards = DVec3::new(turn.cos(), height, turn.sin());
            let camera = Camera::looking_at(eye, eye + towards, 1.4, size.0, size.1);
            cases.push(Case::all(format!("light-inside-{name}-{way}"), light_in_ball(at), camera, Known::Dark));
        }
    }
    let mut many = still_life();
    for light in 0..29_u8 {
        let turn = f32::from(light) * 2.4;
        let at = Vec3::new(turn.cos() * 3.0, 0.5 + 0.08 * f32::from(light), turn.sin() * 3.0);
        many = many.point_light(at, if light % 3 == 0 { 3.0 } else { f32::INFINITY });
    }
    cases.push(Case::judged("lights-32", many.build(), view));
    cases
}
