//! The lean-to roof of one side: a slab, its rafters' ends, and half-round tiles laid over it.

use std::f64::consts::PI;

use glam::{DAffine3, DMat3, DVec2, DVec3};

use super::layout::{EAVE, ROOF_TOP, WALK_OUT};
use super::mesh::Soup;
use super::rng::Rng;
use super::shapes::{bevelled, part, prism};
use super::sweep::{Ends, moulding};
use super::textures::atlas_cell;

const TILE_ROWS: usize = 10;
const TILE_PITCH: f64 = 0.315;
const SLAB: f64 = 0.1;

/// Rise of the roof per metre towards the wall.
const SLOPE: f64 = (ROOF_TOP - EAVE.1) / (WALK_OUT - EAVE.0);

/// Height of the roof's upper face at distance `z` from the centre.
fn roof_y(z: f64) -> f64 {
    EAVE.1 + SLOPE * (z - EAVE.0)
}

/// The slab of one side, mitred towards its neighbours. Mapped with one cell of the tile atlas.
pub(crate) fn slab() -> Soup {
    let (inner, outer) = (EAVE.0, WALK_OUT + 0.1);
    let plan = [(-outer, outer), (outer, outer), (inner, inner), (-inner, inner)].map(|(x, z)| DVec2::new(x, z));
    let (eave, top) = (roof_y(inner), roof_y(outer));
    let high = [top, top, eave, eave];
    prism(plan, high.map(|y| y - SLAB), high, [false, false, true, false]).box_mapped(1.0)
}

pub(crate) fn rafters() -> Soup {
    let mut soup = Soup::default();
    for k in 0..27u8 {
        let x = (f64::from(k) - 13.0) * 0.53125;
        let end = bevelled(DVec3::new(x - 0.045, -SLAB - 0.1, 0.06), DVec3::new(x + 0.045, -SLAB + 0.01, 0.75), 0.012);
        soup.append(end.bent(|p| p + DVec3::new(0.0, roof_y(EAVE.0 + p.z), EAVE.0)));
    }
    soup.box_mapped(0.7)
}

pub(crate) fn tiles(rng: &mut Rng) -> Soup {
    let along = DVec3::new(0.0, SLOPE, 1.0).normalize();
    let length = (WALK_OUT - EAVE.0) * (1.0 + SLOPE * SLOPE).sqrt();
    let pitch = length / TILE_ROWS as f64;
    let frame = DMat3::from_cols(DVec3::NEG_X, along.cross(DVec3::X), -along);
    let mut soup = Soup::default();
    for column in 0..72u8 {
        let x = (f64::from(column) - 35.5) * TILE_PITCH;
        for row in 0..TILE_ROWS {
            let start = pitch * row as f64 - 0.06;
            let foot = DVec3::new(x, EAVE.1, EAVE.0) + along * start;
            // Tiles that would cross the valley between two sides are left out.
            if foot.z + 0.02 < x.abs() + 0.1 {
                continue;
            }
            let sway = DAffine3::from_rotation_y(rng.between(-0.02, 0.02));
            let place = DAffine3::from_mat3_translation(frame, foot) * sway;
            let cell = rng.below(4);
            let shift = DVec2::new(rng.unit(), rng.unit()) * 0.5;
            soup.append(tile(pitch + 0.05).with_uv(|uv| atlas_cell(cell, 2, uv * 0.5 + shift)).placed(place));
        }
    }
    soup
}

/// A half-round tile that tapers up the slope (−z) from the origin; up is +y. Its lower end lies over the next tile.
fn tile(length: f64) -> Soup {
    let steps = 4;
    let ring = |i: usize, z: f64, radius: f64, lift: f64| {
        let angle = PI * part(i, steps);
        DVec3::new(radius * angle.cos(), lift + 0.85 * radius * angle.sin(), z)
    };
    let mut soup = Soup::default();
    soup.grid(1, steps, |column, row| {
        let p = if column == 0 { ring(row, 0.0, 0.12, 0.03) } else { ring(row, -length, 0.09, -0.01) };
        (p, DVec2::new(part(column, 1), part(row, steps)))
    });
    // Wound for a grid whose columns go away from the eye: the outside is up.
    for i in 1..steps {
        let at = |i: usize| (ring(i, 0.0, 0.12, 0.03), DVec2::new(0.1, part(i, steps)));
        soup.triangle(at(0), at(i), at(i + 1));
    }
    soup
}

/// The lead gutter along the valley at the +x end of a side.
pub(crate) fn valley() -> Soup {
    let (low, high) = (EAVE.0 - 0.06, WALK_OUT + 0.05);
    let path = [DVec3::new(low, roof_y(low), low), DVec3::new(high, roof_y(high), high)];
    let up = DVec3::new(-SLOPE, 2.0, -SLOPE).normalize();
    let section = [(-0.14, -0.04), (0.0, -0.06), (0.14, -0.04), (0.14, 0.075), (0.0, 0.012), (-0.14, 0.075)];
    moulding(&path, up, &section.map(|(x, y)| DVec2::new(x, y)), true, Ends::Capped, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_lie_on_the_roof_with_their_backs_up() {
        let mesh = tiles(&mut Rng::new(1)).weld(40.0);
        for p in &mesh.positions {
            let above = f64::from(p.y) - roof_y(f64::from(p.z));
            assert!((-0.08..0.2).contains(&above), "a tile {above} m above the roof at {p}");
        }
        let up = mesh.normals.iter().filter(|n| n.y > -0.45).count();
        assert_eq!(up, mesh.normals.len());
    }
}
