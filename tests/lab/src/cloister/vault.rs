//! The groin vaults over the walk: cells, diagonal ribs and transverse arches.

use std::f64::consts::FRAC_PI_2;

use glam::{DVec2, DVec3};

use super::layout::{BAY, SPRINGING, VAULT_RISE, WALK_IN, WALK_OUT, arch_height};
use super::mesh::Soup;
use super::shapes::{part, profile};
use super::sweep::{Ends, moulding};

pub(crate) const WALK_HALF: f64 = (WALK_OUT - WALK_IN) * 0.5;
const STEPS: usize = 16;
/// How far cells reach into the walls, as a share of half the walk, so that no gap is left.
const INTO_WALL: f64 = 0.03;

/// Steps that are short near the feet, where the curve is steep.
fn spaced(index: usize, steps: usize) -> f64 {
    (FRAC_PI_2 * (2.0 * part(index, steps) - 1.0)).sin()
}

/// The underside of one cell, centred on the origin: two pointed barrels that cross, seen from below.
pub(crate) fn cell() -> Soup {
    let place = |u: f64, v: f64, along_u: bool| {
        let t = if along_u { u } else { v };
        let p = DVec3::new(u * BAY * 0.5, SPRINGING + VAULT_RISE * arch_height(t), v * WALK_HALF);
        (p, DVec2::new(p.x, p.z) / 2.0)
    };
    let mut soup = Soup::default();
    for i in 0..STEPS {
        let (a, b) = (spaced(i, STEPS), spaced(i + 1, STEPS));
        for side in [-1.0, 1.0] {
            let end = side * (1.0 + INTO_WALL);
            // Between the groin |v| = |u| and the wall v = ±1 the height follows u; between the groin and u = ±1 it
            // follows v.
            let along_x = [
                place(a, a.abs() * side, true),
                place(b, b.abs() * side, true),
                place(b, end, true),
                place(a, end, true),
            ];
            let along_z = [
                place(a.abs() * side, a, false),
                place(b.abs() * side, b, false),
                place(side, b, false),
                place(side, a, false),
            ];
            if side > 0.0 {
                soup.quad(along_x[0], along_x[1], along_x[2], along_x[3]);
                soup.quad(along_z[3], along_z[2], along_z[1], along_z[0]);
            } else {
                soup.quad(along_x[3], along_x[2], along_x[1], along_x[0]);
                soup.quad(along_z[0], along_z[1], along_z[2], along_z[3]);
            }
        }
    }
    soup
}

/// The two diagonal ribs of a cell and the boss where they cross.
pub(crate) fn ribs() -> Soup {
    let section = profile(&[(-0.05, -0.075), (0.03, -0.075), (0.065, -0.045), (0.105, -0.04)]);
    let mirrored: Vec<DVec2> = section.iter().rev().map(|p| DVec2::new(p.x, -p.y)).collect();
    let section = [section, mirrored].concat();
    let mut soup = Soup::default();
    for side in [-1.0, 1.0] {
        let path: Vec<DVec3> = (0..=STEPS)
            .map(|i| spaced(i, STEPS))
            .map(|t| DVec3::new(t * BAY * 0.5, SPRINGING + VAULT_RISE * arch_height(t), t * side * WALK_HALF))
            .collect();
        let along = DVec3::new(BAY * 0.5, 0.0, side * WALK_HALF).normalize();
        soup.append(moulding(&path, along.cross(DVec3::Y), &section, true, Ends::Open, 1.0));
    }
    let crown = SPRINGING + VAULT_RISE;
    let boss = profile(&[
        (0.0, -0.17),
        (0.06, -0.165),
        (0.10, -0.14),
        (0.15, -0.125),
        (0.165, -0.09),
        (0.15, -0.05),
        (0.15, 0.0),
    ]);
    soup.append(
        super::shapes::shaped_lathe(&boss, 16, 1.0, |row, angle| {
            if row == 3 || row == 4 { 1.0 + 0.10 * (8.0 * angle).cos() } else { 1.0 }
        })
        .moved(DVec3::Y * crown),
    );
    soup
}

/// The arch across the walk between two cells, in the plane x = 0. Scaled along x it fills the wider strip at the
/// corners.
pub(crate) fn transverse_arch() -> Soup {
    let section =
        profile(&[(-0.05, -0.11), (0.085, -0.11), (0.125, -0.075), (0.125, 0.075), (0.085, 0.11), (-0.05, 0.11)]);
    let path: Vec<DVec3> = (0..=STEPS)
        .map(|i| spaced(i, STEPS))
        .map(|t| DVec3::new(0.0, SPRINGING + VAULT_RISE * arch_height(t), t * WALK_HALF))
        .collect();
    moulding(&path, DVec3::NEG_X, &section, true, Ends::Open, 1.0)
}

/// Offset that puts a part into the middle of a side's walk.
pub(crate) fn in_walk(x: f64) -> DVec3 {
    DVec3::new(x, 0.0, WALK_IN + WALK_HALF)
}

/// Width of a transverse arch before scaling.
pub(crate) const TRANSVERSE_WIDTH: f64 = 0.22;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_seen_from_below_and_cover_their_plan() {
        let mesh = cell().weld(35.0);
        assert!(mesh.normals.iter().all(|n| n.y < 0.1), "a cell's face looks up");
        let plan: f64 = mesh
            .indices
            .chunks(3)
            .map(|t| {
                let [a, b, c] = [0, 1, 2].map(|k| mesh.positions[t[k] as usize].as_dvec3());
                -(b - a).cross(c - a).y * 0.5
            })
            .sum();
        // Includes the strips inside the walls.
        let expected = BAY * WALK_HALF * 2.0 * (1.0 + INTO_WALL);
        assert!((plan - expected).abs() < 1e-2, "{plan} {expected}");
    }
}
