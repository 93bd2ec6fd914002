//! The fountain in the middle of the garth: an eight-sided basin, a turned stem, a lobed bowl, and their water.

use std::f64::consts::{PI, TAU};

use glam::{DAffine3, DVec2, DVec3};

use super::mesh::Soup;
use super::paving::PLAZA_Y;
use super::shapes::{bevelled, lathe, part, profile, shaped_lathe, smooth_profile};
use super::sweep::{Ends, circle, tube};

/// Height of the armillary sphere's foot.
pub(crate) const STEM_TOP: f64 = 1.86;

pub(crate) fn basin() -> Soup {
    let y = PLAZA_Y;
    let outline = [
        (2.36, y - 0.1),
        (2.36, y + 0.11),
        (2.33, y + 0.14),
        (1.98, y + 0.14),
        (1.98, y + 0.20),
        (1.91, y + 0.26),
        (1.88, y + 0.30),
        (1.88, y + 0.50),
        (1.94, y + 0.54),
        (2.0, y + 0.57),
        (2.0, y + 0.64),
        (1.97, y + 0.67),
        (1.70, y + 0.67),
        (1.67, y + 0.64),
        (1.67, y + 0.05),
        (0.0, y + 0.05),
    ];
    let mut soup = lathe(&profile(&outline), 8, 1.0).placed(eighth());
    // A raised panel with a ring on each side.
    for k in 0..8u8 {
        let face = 1.88 * (PI / 8.0).cos();
        let mut panel =
            bevelled(DVec3::new(-0.50, y + 0.325, face - 0.05), DVec3::new(0.50, y + 0.475, face + 0.025), 0.015);
        let ring = circle(DVec3::new(0.0, y + 0.40, face + 0.025), DVec3::X * 0.05, DVec3::Y * 0.05, 16);
        panel.append(tube(&ring, 6, Ends::Loop, |_| 0.012));
        soup.append(panel.box_mapped(1.0).placed(DAffine3::from_rotation_y(TAU * part(usize::from(k), 8))));
    }
    soup
}

fn eighth() -> DAffine3 {
    DAffine3::from_rotation_y(PI / 8.0)
}

pub(crate) fn stem() -> Soup {
    let y = PLAZA_Y;
    let mut outline = profile(&[(0.42, y + 0.04), (0.42, y + 0.40), (0.36, y + 0.46)]);
    outline.extend(smooth_profile(
        &[(0.30, y + 0.50), (0.22, y + 0.62), (0.17, y + 0.78), (0.24, y + 0.92), (0.20, y + 1.02), (0.16, y + 1.08)],
        3,
    ));
    let bowl = smooth_profile(&[(0.24, y + 1.10), (0.46, y + 1.14), (0.70, y + 1.25), (0.86, y + 1.42)], 4);
    let first = outline.len();
    let lobes = bowl.len();
    outline.extend(bowl);
    outline.extend(profile(&[(0.89, y + 1.45), (0.86, y + 1.475)]));
    let last = outline.len();
    outline.extend(smooth_profile(&[(0.80, y + 1.46), (0.66, y + 1.34), (0.40, y + 1.25), (0.20, y + 1.23)], 3));
    outline.extend(smooth_profile(
        &[(0.15, y + 1.28), (0.10, y + 1.42), (0.085, y + 1.56), (0.13, y + 1.68), (0.09, y + 1.76), (0.16, y + 1.86)],
        3,
    ));
    outline.extend(profile(&[(0.16, STEM_TOP), (0.0, STEM_TOP)]));
    shaped_lathe(&outline, 40, 1.0, |row, angle| {
        let on_bowl = if (first..last).contains(&row) { part((row - first).min(lobes), lobes) } else { 0.0 };
        1.0 + 0.045 * on_bowl * (10.0 * angle).cos().abs()
    })
}

/// The water in the basin and in the bowl, and the threads that fall from the bowl's lip.
pub(crate) fn water() -> Soup {
    let mut soup = lathe(&profile(&[(1.69, PLAZA_Y + 0.52), (0.2, PLAZA_Y + 0.52)]), 8, 1.0).placed(eighth());
    soup.append(lathe(&profile(&[(0.79, PLAZA_Y + 1.43), (0.1, PLAZA_Y + 1.43)]), 24, 1.0));
    for k in 0..10u8 {
        let angle = TAU * part(usize::from(k), 10);
        let out = DVec3::new(angle.sin(), 0.0, angle.cos());
        let side = out.cross(DVec3::Y);
        let steps = 6;
        soup.grid(1, steps, |column, row| {
            let t = part(row, steps);
            let width = 0.035 * (1.0 - 0.45 * t);
            let fall = DVec3::Y * (PLAZA_Y + 1.465 - 0.93 * t * t);
            let p = out * (0.885 + 0.26 * t) + fall + side * width * if column == 0 { -1.0 } else { 1.0 };
            (p, DVec2::ZERO)
        });
    }
    soup
}
