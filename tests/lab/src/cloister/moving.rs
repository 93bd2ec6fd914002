//! Moving parts: the armillary sphere turns about its axis, and the well's bucket swings. Both rest poses look right.

use std::f64::consts::TAU;

use glam::{DQuat, DVec3};
use serde_json::json;

use super::furnishing::{ARMILLARY, WELL};
use super::glb::{Glb, at, mesh_node};
use super::house::CREASE_DEG;
use super::materials::Palette;
use super::{armillary, well};

const TURN_S: f64 = 24.0;
/// Period and amplitude of the bucket's swing: a pendulum of 1.2 m takes 2.2 s.
const SWING: (f64, f64) = (2.2, 0.16);

pub(crate) fn add(glb: &mut Glb, palette: &Palette) {
    let cradle = glb.mesh("armillary cradle", &[(palette.bronze, armillary::cradle().weld(CREASE_DEG))]);
    let rings = glb.mesh("armillary rings", &[(palette.bronze, armillary::rings().weld(CREASE_DEG))]);
    let stand = glb.node(None, at(mesh_node("armillary sphere", cradle), ARMILLARY));
    let tilt = DQuat::from_rotation_z(-armillary::TILT_RAD);
    let mut axis = at(json!({ "name": "polar axis" }), DVec3::Y * armillary::CENTRE);
    axis["rotation"] = json!(tilt.as_quat().to_array());
    let axis = glb.node(Some(stand), axis);
    let turning = glb.node(Some(axis), mesh_node("armillary rings", rings));
    let keys: Vec<(f64, DQuat)> =
        (0..=8u8).map(|k| f64::from(k) / 8.0).map(|t| (t * TURN_S, DQuat::from_rotation_y(t * TAU))).collect();
    glb.rotation_animation("armillary sphere turns", turning, &keys);

    let bucket = glb.mesh(
        "bucket",
        &[
            (palette.wood, well::bucket().weld(CREASE_DEG)),
            (palette.iron, well::bucket_iron().weld(CREASE_DEG)),
            (palette.rope, well::rope().weld(CREASE_DEG)),
        ],
    );
    let swinging = glb.node(None, at(mesh_node("bucket", bucket), WELL + DVec3::Y * well::PULLEY));
    let (period, amplitude) = SWING;
    let keys: Vec<(f64, DQuat)> = (0..=16u8)
        .map(|k| f64::from(k) / 16.0)
        .map(|t| (t * period, DQuat::from_rotation_z(amplitude * (TAU * t).sin())))
        .collect();
    glb.rotation_animation("bucket swings", swinging, &keys);
}
