//! Things of 1,000 triangles, and how they move. Sizes are in units of about a metre; rounds are of [`ROUND_S`].

use std::f64::consts::TAU;

use glam::{DQuat, DVec3, Vec3};
use serde_json::json;

use super::shapes::{cuboid, ellipsoid};
use crate::cloister::{
    glb::{Channel, Glb, Id, at, mesh_node},
    mesh::Mesh,
};

/// Triangles of a thing.
pub const TRIANGLES: usize = 1000;

/// The length of a round, in seconds.
pub(super) const ROUND_S: f64 = 4.0;
const KEYS: u32 = 32;

/// Meshes that all things of a kind share.
pub(super) struct Kinds {
    trunk: Id,
    limb: Id,
    ball: Id,
    door: Id,
    lamp: Id,
    unit_m: f64,
}

/// A time or a length as files have it.
#[expect(clippy::cast_possible_truncation, reason = "rounded to the nearest")]
pub(super) fn single(value: f64) -> f32 {
    value as f32
}

/// Times of an animation's keys, in seconds.
pub(super) fn key_times() -> Vec<f32> {
    (0..=KEYS).map(|key| single(ROUND_S * f64::from(key) / f64::from(KEYS))).collect()
}

/// A rotation at each key; `pose` takes the share of the round.
pub(super) fn turning(node: Id, pose: impl Fn(f64) -> DQuat) -> Channel {
    let values = (0..=KEYS).flat_map(|key| pose(f64::from(key) / f64::from(KEYS)).as_quat().to_array()).collect();
    Channel { node, path: "rotation", values }
}

/// A translation at each key.
pub(super) fn moving(node: Id, pose: impl Fn(f64) -> DVec3) -> Channel {
    let values = (0..=KEYS).flat_map(|key| pose(f64::from(key) / f64::from(KEYS)).as_vec3().to_array()).collect();
    Channel { node, path: "translation", values }
}

impl Kinds {
    pub(super) fn new(glb: &mut Glb, unit_m: f64) -> Self {
        let unit = single(unit_m);
        let mut mesh = |name: &str, colour: [f32; 3], mesh: Mesh| {
            let [r, g, b] = colour;
            let roughness = json!({ "baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0 });
            let material = glb.material(json!({ "name": name, "pbrMetallicRoughness": roughness }));
            glb.mesh(name, &[(material, mesh)])
        };
        let round = |centre: Vec3, half: Vec3, fine| ellipsoid(centre * unit, half * unit, fine);
        let (low, high) = (Vec3::new(0.0, 0.02, -0.03) * unit, Vec3::new(0.9, 2.1, 0.03) * unit);
        Self {
            trunk: mesh("trunk", [0.6, 0.3, 0.2], round(Vec3::Y * 1.25, Vec3::new(0.22, 0.5, 0.16), (10, 11))),
            limb: mesh("limb", [0.3, 0.4, 0.6], round(Vec3::NEG_Y * 0.4, Vec3::new(0.08, 0.42, 0.08), (10, 11))),
            ball: mesh("ball", [0.7, 0.2, 0.2], round(Vec3::ZERO, Vec3::splat(0.3), (25, 21))),
            door: mesh("door", [0.5, 0.35, 0.2], cuboid(low, high, [6, 20, 5])),
            lamp: mesh("lamp", [0.8, 0.7, 0.4], round(Vec3::NEG_Y * 1.2, Vec3::new(0.25, 0.16, 0.25), (25, 21))),
            unit_m,
        }
    }

    /// Adds a thing on the floor at `place`; its kind follows from its number. Returns how it moves.
    pub(super) fn add(&self, glb: &mut Glb, number: u32, place: DVec3) -> Vec<Channel> {
        let (unit, turn) = (self.unit_m, f64::from(number) * 1.7);
        let phase = f64::from(number) * 0.37;
        let share = move |share: f64| (share + phase) * TAU;
        let along = DQuat::from_rotation_y(turn) * DVec3::X;
        match number % 4 {
            // Walks in a circle, at 1.3 units a second.
            0 => {
                let body = glb.node(None, at(mesh_node("figure", self.trunk), place));
                let mut channels = vec![
                    moving(body, |now| place + DVec3::new(share(now).sin(), 0.0, share(now).cos()) * 0.8 * unit),
                    // Looks along x.
                    turning(body, |now| DQuat::from_rotation_y(share(now))),
                ];
                // Legs and arms on both sides, of opposite steps.
                for (height, aside, step) in
                    [(0.85, 0.1, 0.5), (0.85, -0.1, -0.5), (1.6, 0.28, -0.4), (1.6, -0.28, 0.4)]
                {
                    let joint = DVec3::new(0.0, height, aside) * unit;
                    let limb = glb.node(Some(body), at(mesh_node("limb", self.limb), joint));
                    channels.push(turning(limb, |now| DQuat::from_rotation_z(step * (share(now) * 4.0).sin())));
                }
                channels
            }
            // Rolls to and fro.
            1 => {
                let place = place + DVec3::Y * 0.3 * unit;
                let ball = glb.node(None, at(mesh_node("ball", self.ball), place));
                let way = move |now: f64| 1.2 * share(now).sin();
                let axle = DVec3::Y.cross(along);
                vec![
                    moving(ball, |now| place + along * way(now) * unit),
                    turning(ball, |now| DQuat::from_axis_angle(axle, way(now) / 0.3)),
                ]
            }
            // Opens by 100° and closes.
            2 => {
                let door = glb.node(None, at(mesh_node("door", self.door), place));
                vec![turning(door, |now| DQuat::from_rotation_y(turn + 0.87 * (1.0 - share(now).cos())))]
            }
            // Swings twice a round, at 3.2 units.
            _ => {
                let lamp = glb.node(None, at(mesh_node("lamp", self.lamp), place + DVec3::Y * 3.2 * unit));
                vec![turning(lamp, |now| DQuat::from_axis_angle(along, 0.4 * (share(now) * 2.0).sin()))]
            }
        }
    }
}
