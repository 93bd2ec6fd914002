//! The arcade: twin columns on a low wall, pointed arches with their mouldings and tracery, corner piers, cornice.
//!
//! Parts stand in a side's frame, moved so that the arcade wall's middle plane is z = 0; the garth is at −z.

use std::f64::consts::{PI, TAU};

use glam::{DAffine3, DVec2, DVec3};

use super::layout::{
    ARCADE, ARCADE_HALF, ARCADE_TOP, ARCH_HALF, ASHLAR, BAY, CAPITAL, GROUND, HALF_RUN, SILL, SPRINGING, arch_curve,
    column_x,
};
use super::mesh::Soup;
use super::shapes::{bevelled, block, part, profile, shaped_lathe, smooth_profile};
use super::sweep::{Ends, moulding};

const ARCH_STEPS: usize = 10;
/// Size of the plain stone texture, in metres.
pub(crate) const STONE: f64 = 1.0;

/// One column from the low wall to the top of its capital, around the y axis.
pub(crate) fn column() -> Soup {
    let half = 0.15;
    let mut soup =
        bevelled(DVec3::new(-half, SILL - 0.01, -half), DVec3::new(half, SILL + 0.08, half), 0.012).box_mapped(STONE);
    // An Attic base (two tori and a hollow), then a shaft that swells a little (entasis) and ends in an astragal.
    let mut points = vec![(0.145, 0.08), (0.152, 0.10), (0.148, 0.128), (0.122, 0.138), (0.116, 0.155), (0.128, 0.17)];
    points.extend([(0.13, 0.185), (0.112, 0.20), (0.104, 0.22)]);
    points.extend((1..4).map(|i| part(i, 4)).map(|t| (0.104 - 0.012 * t + 0.006 * (PI * t).sin(), 0.22 + 1.14 * t)));
    points.extend([(0.092, 1.36), (0.108, 1.372), (0.108, 1.395), (0.092, 1.405)]);
    let shaft: Vec<(f64, f64)> = points.into_iter().map(|(r, y)| (r, SILL + y)).collect();
    soup.append(shaped_lathe(&profile(&shaft), 14, STONE, |_, _| 1.0));
    soup.append(capital(SILL + 1.40));
    soup
}

/// A leaf capital: round below, square above, with a ring of curling leaves.
fn capital(foot: f64) -> Soup {
    let height = CAPITAL - 0.06 - foot;
    let steps = 8;
    let outline: Vec<DVec2> = (0..=steps)
        .map(|i| part(i, steps))
        .map(|t| DVec2::new(0.093 + 0.055 * t.powf(1.6), foot + height * t))
        .collect();
    let mut soup = shaped_lathe(&outline, 20, STONE, |row, angle| {
        let t = part(row, steps);
        let power = 2.0 + 5.0 * t * t;
        let square = (angle.cos().abs().powf(power) + angle.sin().abs().powf(power)).powf(-1.0 / power);
        let lower = (1.0 - ((t - 0.42) / 0.2).powi(2)).max(0.0) * (4.0 * angle).cos().abs();
        let upper = (1.0 - ((t - 0.82) / 0.2).powi(2)).max(0.0) * (2.0 * angle).sin().powi(2);
        square * (1.0 + 0.20 * lower + 0.16 * upper)
    });
    // Twin columns stand 0.33 m apart: their abaci just do not touch.
    let half = 0.163;
    soup.append(
        bevelled(DVec3::new(-half, CAPITAL - 0.062, -half), DVec3::new(half, CAPITAL + 0.005, half), 0.012)
            .box_mapped(STONE),
    );
    soup
}

/// The moulded block that joins twin columns and carries the arches.
pub(crate) fn impost() -> Soup {
    let mut soup = Soup::default();
    for (low, high, x, z) in [(0.0, 0.07, 0.235, 0.345), (0.065, 0.15, 0.275, 0.385)] {
        soup.append(bevelled(DVec3::new(-x, CAPITAL + low, -z), DVec3::new(x, CAPITAL + high, z), 0.018));
    }
    soup.box_mapped(STONE)
}

/// The wall above one arch, one bay wide, from the springing to the top. `half`, `springing` and `top` in metres.
pub(crate) fn arch_wall(width: f64, half: f64, springing: f64, top: f64, thickness_half: f64) -> Soup {
    let mut lower = vec![DVec2::new(-width * 0.5, springing)];
    lower.extend(arch_curve(half, springing, ARCH_STEPS).iter().rev().map(|p| p.truncate()));
    lower.push(DVec2::new(width * 0.5, springing));
    let at = |p: DVec2, z: f64| (p.extend(z), DVec2::ZERO);
    let mut soup = Soup::default();
    for pair in lower.windows(2) {
        let (a, b) = (pair[0], pair[1]);
        let (a_top, b_top) = (DVec2::new(a.x, top), DVec2::new(b.x, top));
        let t = thickness_half;
        soup.quad(at(a, t), at(b, t), at(b_top, t), at(a_top, t));
        soup.quad(at(b, -t), at(a, -t), at(a_top, -t), at(b_top, -t));
        soup.quad(at(a, -t), at(b, -t), at(b, t), at(a, t));
        soup.quad(at(a_top, t), at(b_top, t), at(b_top, -t), at(a_top, -t));
    }
    soup.box_mapped(ASHLAR)
}

/// The moulding around an arch on both faces of its wall: a hood, a hollow and a roll on the edge.
pub(crate) fn archivolt(half: f64, springing: f64, thickness_half: f64) -> Soup {
    let mut section =
        profile(&[(0.235, -0.01), (0.235, 0.045), (0.205, 0.07), (0.165, 0.055), (0.15, 0.02), (0.085, 0.02)]);
    section.extend(
        (0..6).map(|i| PI * (0.3 + 1.15 * part(i, 5))).map(|a| DVec2::new(0.03, -0.01) + DVec2::from_angle(a) * 0.055),
    );
    let path: Vec<DVec3> =
        arch_curve(half, springing, ARCH_STEPS).iter().map(|p| *p + DVec3::Z * thickness_half).collect();
    let face = moulding(&path, DVec3::Z, &section, false, Ends::Open, STONE);
    let mut soup = face.placed(DAffine3::from_rotation_y(PI));
    soup.append(face);
    soup
}

/// The trefoil of slender bars inside an arch of the arcade.
pub(crate) fn tracery() -> Soup {
    let arc = |x: f64, y: f64, radius: f64, from_deg: f64, to_deg: f64, steps: usize| {
        (0..=steps)
            .map(move |i| (from_deg + (to_deg - from_deg) * part(i, steps)).to_radians())
            .map(move |a| DVec3::new(x + radius * a.cos(), SPRINGING + y + radius * a.sin(), 0.0))
    };
    // The side foils and the top foil are circles; they meet in cusps, at the outer one of their two crossings.
    let (side, top, radius) = (DVec2::new(0.445, 0.16), DVec2::new(0.0, 0.60), 0.345);
    let between = top - side;
    let cusp =
        side + between * 0.5 - between.perp().normalize() * (radius * radius - between.length_squared() * 0.25).sqrt();
    let angle = |centre: DVec2| (cusp - centre).to_angle().to_degrees();
    let mut path: Vec<DVec3> = vec![DVec3::new(side.x + radius, SPRINGING - 0.01, 0.0)];
    path.extend(arc(side.x, side.y, radius, 0.0, angle(side), 7));
    let crown: Vec<DVec3> = arc(top.x, top.y, radius, angle(top), 180.0 - angle(top), 14).collect();
    path.extend(crown.iter().skip(1).take(crown.len() - 2));
    let mirrored: Vec<DVec3> = path[..9].iter().rev().map(|p| DVec3::new(-p.x, p.y, 0.0)).collect();
    path.extend(mirrored);
    let section = profile(&[(0.04, -0.055), (0.04, 0.055), (0.0, 0.09), (-0.04, 0.055), (-0.04, -0.055), (0.0, -0.09)]);
    moulding(&path, DVec3::Z, &section, true, Ends::Open, STONE)
}

/// Half of a side's low wall with its coping: from the corner pier to the opening in the middle bay, at −x.
pub(crate) fn low_wall() -> Soup {
    let (from, to) = (-HALF_RUN - 0.1, column_x(3) + 0.27);
    let mut soup = block(DVec3::new(from, GROUND, -0.24), DVec3::new(to - 0.04, SILL - 0.09, 0.24));
    soup.append(bevelled(DVec3::new(from, SILL - 0.1, -0.31), DVec3::new(to, SILL, 0.31), 0.025));
    soup.append(bevelled(DVec3::new(from, GROUND, -0.29), DVec3::new(to - 0.01, -0.02, 0.29), 0.03));
    soup.box_mapped(ASHLAR)
}

/// The pier in the corner between two sides, at the origin.
pub(crate) fn pier() -> Soup {
    let half = ARCADE - HALF_RUN;
    let mut soup = block(DVec3::new(-half, GROUND, -half), DVec3::new(half, ARCADE_TOP - 0.01, half));
    for (low, high, out) in [(GROUND, SILL - 0.085, 0.05), (CAPITAL - 0.015, SPRINGING + 0.012, 0.06)] {
        soup.append(bevelled(
            DVec3::new(-half - out, low, -half - out),
            DVec3::new(half + out, high, half + out),
            0.025,
        ));
    }
    soup.box_mapped(ASHLAR)
}

/// The cornice around the whole garth, and the small corbels below it, in the world's frame.
pub(crate) fn cornice() -> Soup {
    let section =
        profile(&[(-0.05, 0.0), (0.035, 0.0), (0.06, 0.04), (0.11, 0.06), (0.125, 0.10), (0.125, 0.14), (-0.05, 0.14)]);
    let mut soup = inward_band(ARCADE - ARCADE_HALF, 3.99, &section, STONE);
    for side in 0..4u8 {
        let turn = DAffine3::from_rotation_y(f64::from(side) * TAU * 0.25);
        for k in 0..27 {
            let x = (f64::from(k) - 13.0) * BAY * 0.25;
            let z = ARCADE - ARCADE_HALF;
            let corbel = block(DVec3::new(x - 0.06, 3.87, z - 0.085), DVec3::new(x + 0.06, 4.0, z + 0.02));
            soup.append(corbel.box_mapped(STONE).placed(turn));
        }
    }
    soup
}

/// A moulding around a square room with walls `half` metres from the centre; the section's x points inwards.
pub(crate) fn inward_band(half: f64, y: f64, section: &[DVec2], metres: f64) -> Soup {
    let corners = [(half, half), (-half, half), (-half, -half), (half, -half)].map(|(x, z)| DVec3::new(x, y, z));
    moulding(&corners, DVec3::Y, section, true, Ends::Loop, metres)
}

/// A corbel that carries a vault's ribs, hanging at the wall z = 0 towards −z, its top at `top`.
pub(crate) fn corbel(top: f64) -> Soup {
    let outline = smooth_profile(&[(0.0, -0.42), (0.035, -0.38), (0.05, -0.30), (0.10, -0.18), (0.16, -0.09)], 2);
    let mut soup = shaped_lathe(&outline, 12, STONE, |_, _| 1.0).moved(DVec3::Y * top);
    soup.append(bevelled(DVec3::new(-0.19, top - 0.1, -0.2), DVec3::new(0.19, top, 0.05), 0.015).box_mapped(STONE));
    soup
}

pub(crate) fn bay_wall() -> Soup {
    arch_wall(BAY, ARCH_HALF, SPRINGING, ARCADE_TOP, ARCADE_HALF)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mouldings_stay_inside_their_bay() {
        for soup in [archivolt(ARCH_HALF, SPRINGING, ARCADE_HALF), tracery()] {
            let mesh = soup.weld(35.0);
            assert!(mesh.positions.iter().all(|p| f64::from(p.x.abs()) < BAY * 0.5), "crosses into the next bay");
        }
    }
}
