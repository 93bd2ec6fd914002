//! Places and scales: far from the origin, tiny and huge scenes, and unusual cameras.

use glam::{DVec3, Vec3};
use gnomon_scene::{Aabb, AlphaMode, Scene, camera::Camera};

use super::case::{Case, Known};
use crate::scenes::builder::SceneBuilder;

/// A floor, a box, a ball and a pole, under a lamp, a spot light and the sun.
pub(super) fn still_life() -> SceneBuilder {
    SceneBuilder::new()
        .quad(Vec3::new(-6.0, 0.0, -6.0), Vec3::Z * 12.0, Vec3::X * 12.0)
        .material(AlphaMode::Opaque, false)
        .cuboid(Vec3::new(-1.5, 0.0, -0.7), Vec3::new(-0.4, 1.1, 0.6))
        .sphere(Vec3::new(1.1, 0.8, 0.2), 0.8, 24)
        .cuboid(Vec3::new(0.1, 0.0, 1.3), Vec3::new(0.12, 2.0, 1.32))
        .point_light(Vec3::new(0.3, 2.5, 1.9), 9.0)
        .spot_light(Vec3::new(-2.0, 3.0, 2.0), Vec3::new(0.6, -1.0, -0.5), 0.7)
        .sun(Vec3::new(0.5, -1.0, -0.35))
}

fn view(scale: f64, origin_m: DVec3, size: (u32, u32)) -> Camera {
    let eye = DVec3::new(0.7, 2.1, 4.3) * scale;
    Camera::looking_at(origin_m + eye, origin_m + DVec3::new(0.0, 0.5, 0.0) * scale, 0.9, size.0, size.1)
}

fn scaled(mut scene: Scene, factor: f32) -> Scene {
    scene.positions.iter_mut().for_each(|position| *position *= factor);
    scene.bounds = Aabb { min: scene.bounds.min * factor, max: scene.bounds.max * factor };
    for light in &mut scene.lights {
        light.position *= factor;
        light.range_m *= factor;
    }
    scene
}

pub(super) fn cases(size: (u32, u32)) -> Vec<Case> {
    let mut cases = Vec::new();
    for exponent in [3, 5, 7] {
        let origin = DVec3::new(1.0, -0.5, 0.7) * 10.0_f64.powi(exponent);
        let scene = still_life().origin(origin).build();
        cases.push(Case::judged(format!("moved-1e{exponent}"), scene, view(1.0, origin, size)));
    }
    for exponent in -4_i16..=4 {
        let factor = 10.0_f32.powi(i32::from(exponent));
        let camera = view(f64::from(factor), DVec3::ZERO, size);
        cases.push(Case::judged(format!("scaled-1e{exponent}"), scaled(still_life().build(), factor), camera));
    }
    // Not recentred: the same objects at the far end of a long scene, where an f32 step is 2⁻¹⁰ m.
    let shift = Vec3::new(8192.0, 0.0, 0.0);
    let mut far = still_life().build();
    far.positions.iter_mut().for_each(|position| *position += shift);
    far.lights.iter_mut().for_each(|light| light.position += shift);
    far.bounds = Aabb { min: far.bounds.min + shift, max: far.bounds.max + shift };
    cases.push(Case::judged("local-8192", far, view(1.0, shift.as_dvec3(), size)).doubtful(0.1));

    let side = 1e5_f32;
    let ground = SceneBuilder::new()
        .quad(Vec3::new(-side, 0.0, -side), Vec3::Z * 2.0 * side, Vec3::X * 2.0 * side)
        .cuboid(Vec3::new(-0.2, 0.0, -0.2), Vec3::new(0.2, 0.3, 0.2))
        .sphere(Vec3::new(0.6, 0.2, 0.1), 0.2, 24)
        .point_light(Vec3::new(0.4, 1.5, 1.0), f32::INFINITY)
        .sun(Vec3::new(-0.4, -1.0, -0.3));
    let camera = Camera::looking_at(DVec3::new(0.3, 0.9, 1.8), DVec3::new(0.1, 0.1, 0.0), 0.8, size.0, size.1);
    // Rounding follows the largest coordinate, 10⁵ m, so decimetres along every edge are in doubt.
    cases.push(Case::judged("ground-1e5", ground.build(), camera).doubtful(0.25));

    // Odd sizes put a pixel's centre on the axis: two components of its ray are 0.
    let odd = (size.0 | 1, size.1 | 1);
    for (name, towards) in [("x", DVec3::X), ("y", DVec3::NEG_Y), ("z", DVec3::NEG_Z)] {
        let eye = DVec3::new(0.05, 1.4, 0.9);
        let camera = Camera::looking_at(eye, eye + towards, 1.5, odd.0, odd.1);
        cases.push(Case::judged(format!("zero-components-{name}"), closed_room(), camera));
    }
    for degrees in [1.0_f64, 30.0, 120.0, 170.0] {
        let eye = DVec3::new(0.7, 2.1, 4.3);
        let camera = Camera::looking_at(eye, DVec3::new(0.11, 1.0, 1.32), degrees.to_radians(), size.0, size.1);
        cases.push(Case::judged(format!("fov-{degrees}"), still_life().build(), camera));
    }
    // Inside the ball, whose single-sided inside does not block, and exactly on the floor.
    for (name, eye) in [("inside", DVec3::new(1.1, 0.8, 0.2)), ("on-surface", DVec3::new(0.7, 0.0, 3.0))] {
        let camera = Camera::looking_at(eye, DVec3::new(-1.0, 0.7, 0.0), 1.0, size.0, size.1);
        cases.push(Case::judged(format!("camera-{name}"), still_life().build(), camera));
    }
    let camera = Camera::looking_at(DVec3::new(1.5, 1.2, -1.0), DVec3::new(-1.0, 0.2, 0.6), 1.9, size.0, size.1);
    cases.push(Case::all("room-all-lit", empty_room(), camera, Known::Lit));
    cases
}

fn closed_room() -> Scene {
    still_life().material(AlphaMode::Opaque, true).cuboid(Vec3::new(-4.0, -0.5, -4.0), Vec3::new(4.0, 4.0, 4.5)).build()
}

/// A box with only two lamps: every point sees both.
fn empty_room() -> Scene {
    SceneBuilder::new()
        .cuboid(Vec3::new(-3.0, 0.0, -2.1), Vec3::new(3.0, 2.9, 2.3))
        .point_light(Vec3::new(0.3, 2.0, 0.4), f32::INFINITY)
        .point_light(Vec3::new(-2.2, 0.1, -1.7), f32::INFINITY)
        .build()
}
