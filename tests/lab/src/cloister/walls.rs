//! The outer wall, its dado, string course and coping; doors; and the bell gable over the north side.

use std::f64::consts::PI;

use glam::{DAffine3, DVec2, DVec3};

use super::arcade::{STONE, arch_wall, archivolt, inward_band};
use super::layout::{ASHLAR, GROUND, OUTSIDE, SPRINGING, WALK_OUT, WALL_TOP, arch_curve};
use super::mesh::Soup;
use super::shapes::{bevelled, block, prism, profile, shaped_lathe, smooth_profile};
use super::sweep::{Ends, moulding, tube};

/// The outer wall of one side, mitred towards its neighbours.
pub(crate) fn wall() -> Soup {
    let plan = [(-OUTSIDE, OUTSIDE), (OUTSIDE, OUTSIDE), (WALK_OUT, WALK_OUT), (-WALK_OUT, WALK_OUT)];
    prism(plan.map(|(x, z)| DVec2::new(x, z)), [GROUND; 4], [WALL_TOP; 4], [true, false, true, false])
        .box_mapped(ASHLAR * 1.5)
}

pub(crate) fn dado() -> Soup {
    let base = profile(&[
        (-0.05, -0.1),
        (0.075, -0.1),
        (0.075, 0.80),
        (0.05, 0.86),
        (0.025, 0.87),
        (0.025, 0.92),
        (-0.05, 0.92),
    ]);
    inward_band(WALK_OUT, 0.0, &base, ASHLAR)
}

/// The moulding from which the vaults spring.
pub(crate) fn string_course() -> Soup {
    let string = profile(&[(-0.05, -0.12), (0.02, -0.12), (0.035, -0.08), (0.085, -0.05), (0.085, 0.0), (-0.05, 0.0)]);
    inward_band(WALK_OUT, SPRINGING, &string, STONE)
}

pub(crate) fn coping() -> Soup {
    let section = profile(&[(-0.34, -0.02), (0.34, -0.02), (0.34, 0.06), (0.0, 0.2), (-0.34, 0.06)]);
    inward_band((WALK_OUT + OUTSIDE) * 0.5, WALL_TOP, &section, STONE)
}

/// Half the width of a door's leaf, and where its arch springs.
const DOOR: (f64, f64) = (0.72, 1.55);

/// A door's frame, standing at the wall z = 0 towards −z, on the walk's floor.
pub(crate) fn door_frame() -> Soup {
    let (half, springing) = DOOR;
    let mut soup = archivolt(half, springing, 0.09);
    for side in [-1.0, 1.0] {
        let x = side * (half + 0.09);
        soup.append(
            bevelled(DVec3::new(x - 0.11, -0.02, -0.14), DVec3::new(x + 0.11, springing, 0.05), 0.03).box_mapped(STONE),
        );
    }
    soup.append(
        bevelled(DVec3::new(-half - 0.3, -0.05, -0.32), DVec3::new(half + 0.3, 0.06, 0.05), 0.02).box_mapped(STONE),
    );
    soup
}

pub(crate) fn door_leaf() -> Soup {
    let (half, springing) = DOOR;
    let curve = arch_curve(half + 0.02, springing, 8);
    let mut soup = Soup::default();
    let at = |x: f64, y: f64| (DVec3::new(x, y, -0.085), DVec2::new(-x / 1.2, -y / 1.2));
    for pair in curve.windows(2) {
        let (a, b) = (pair[0], pair[1]);
        soup.quad(at(a.x, 0.06), at(b.x, 0.06), at(b.x, b.y), at(a.x, a.y));
    }
    soup
}

pub(crate) fn door_iron() -> Soup {
    let mut soup = Soup::default();
    for y in [0.4, 1.0, 1.6] {
        soup.append(bevelled(DVec3::new(-0.60, y - 0.03, -0.105), DVec3::new(0.60, y + 0.03, -0.08), 0.008));
        for k in 0..7u8 {
            let x = (f64::from(k) - 3.0) * 0.18;
            let stud = shaped_lathe(&profile(&[(0.022, 0.0), (0.016, 0.014), (0.0, 0.02)]), 6, 1.0, |_, _| 1.0);
            soup.append(
                stud.placed(
                    DAffine3::from_translation(DVec3::new(x, y, -0.104)) * DAffine3::from_rotation_x(-PI * 0.5),
                ),
            );
        }
    }
    let ring = super::sweep::circle(DVec3::new(0.42, 1.18, -0.12), DVec3::X * 0.07, DVec3::Y * 0.07, 20);
    soup.append(tube(&ring, 8, Ends::Loop, |_| 0.01));
    soup
}

/// The bell gable: two openings under a stepped gable, standing on the north wall at the origin.
pub(crate) fn gable() -> Soup {
    let (half, thickness) = (1.5, 0.25);
    let mut soup = block(DVec3::new(-half, -0.3, -thickness), DVec3::new(half, 0.9, thickness));
    for x in [-1.29, 0.0, 1.29] {
        let w = if x == 0.0 { 0.17 } else { 0.21 };
        soup.append(block(DVec3::new(x - w, 0.9, -thickness), DVec3::new(x + w, 1.9, thickness)));
    }
    for x in [-0.625, 0.625] {
        soup.append(arch_wall(1.25, 0.455, 1.9, 2.75, thickness).moved(DVec3::X * x));
    }
    let outline = [(1.25, 2.75), (1.25, 2.8), (0.0, 3.7), (-1.25, 2.8), (-1.25, 2.75)];
    let front = outline.map(|(x, y)| DVec3::new(x, y, thickness));
    for k in 1..4 {
        let at = |i: usize, side: f64| (front[i] * DVec3::new(1.0, 1.0, side), DVec2::ZERO);
        soup.triangle(at(0, 1.0), at(k, 1.0), at(k + 1, 1.0));
        soup.triangle(at(0, -1.0), at(k + 1, -1.0), at(k, -1.0));
    }
    for x in [-1.375, 1.375] {
        soup.append(block(DVec3::new(x - 0.125, 1.9, -thickness), DVec3::new(x + 0.125, 2.75, thickness)));
    }
    let mut soup = soup.box_mapped(ASHLAR);
    let cap = profile(&[(-0.02, -0.33), (0.1, -0.33), (0.1, 0.33), (-0.02, 0.33)]);
    let rake = [(1.72, 2.52), (1.25, 2.8), (0.0, 3.7), (-1.25, 2.8), (-1.72, 2.52)].map(|(x, y)| DVec3::new(x, y, 0.0));
    soup.append(moulding(&rake, DVec3::Z, &cap, true, Ends::Capped, STONE));
    soup.append(bevelled(DVec3::new(-1.6, 0.78, -0.33), DVec3::new(1.6, 0.92, 0.33), 0.03).box_mapped(STONE));
    soup
}

/// A bell with its yoke; its axle is the origin.
pub(crate) fn bell() -> Soup {
    let mut outline = smooth_profile(
        &[(0.0, -0.16), (0.10, -0.165), (0.17, -0.24), (0.19, -0.38), (0.225, -0.52), (0.29, -0.62), (0.30, -0.66)],
        3,
    );
    outline.extend(smooth_profile(&[(0.27, -0.66), (0.20, -0.52), (0.165, -0.38), (0.14, -0.25), (0.0, -0.19)], 2));
    outline.reverse();
    let mut soup = shaped_lathe(&outline, 28, 1.0, |_, _| 1.0);
    soup.append(shaped_lathe(
        &profile(&[(0.0, -0.72), (0.04, -0.69), (0.04, -0.64), (0.012, -0.60), (0.01, -0.2)]),
        10,
        1.0,
        |_, _| 1.0,
    ));
    soup
}

pub(crate) fn yoke() -> Soup {
    let mut soup = bevelled(DVec3::new(-0.47, -0.07, -0.07), DVec3::new(0.47, 0.08, 0.07), 0.015);
    soup.append(bevelled(DVec3::new(-0.10, -0.17, -0.04), DVec3::new(0.10, -0.06, 0.04), 0.01));
    soup.box_mapped(0.8)
}

/// The wind vane on the gable's tip: a rod, four arms, an arrow with a tail and a sun.
pub(crate) fn vane() -> Soup {
    let bar = |a: DVec3, b: DVec3, r: f64| tube(&[a, b], 6, Ends::Capped, |_| r);
    let mut soup = bar(DVec3::ZERO, DVec3::Y * 1.25, 0.022);
    soup.append(bar(DVec3::new(-0.28, 0.45, 0.0), DVec3::new(0.28, 0.45, 0.0), 0.012));
    soup.append(bar(DVec3::new(0.0, 0.45, -0.28), DVec3::new(0.0, 0.45, 0.28), 0.012));
    soup.append(bar(DVec3::new(-0.5, 0.9, 0.1), DVec3::new(0.5, 0.9, -0.1), 0.014));
    soup.append(bar(DVec3::new(0.5, 0.9, -0.1), DVec3::new(0.38, 0.98, -0.076), 0.014));
    soup.append(bar(DVec3::new(0.5, 0.9, -0.1), DVec3::new(0.38, 0.82, -0.076), 0.014));
    for k in 0..3u8 {
        let x = -0.5 + 0.09 * f64::from(k);
        let z = -x * 0.2;
        soup.append(bar(DVec3::new(x, 0.9, z), DVec3::new(x - 0.09, 1.0, z + 0.018), 0.012));
        soup.append(bar(DVec3::new(x, 0.9, z), DVec3::new(x - 0.09, 0.8, z + 0.018), 0.012));
    }
    let knob = smooth_profile(&[(0.0, 1.2), (0.06, 1.25), (0.0, 1.33)], 5);
    soup.append(shaped_lathe(&knob, 12, 1.0, |_, _| 1.0));
    soup
}
