//! The well on the south-eastern lawn: a stone ring, wrought-iron work over it, a lattice over its mouth, and a bucket.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::{DAffine3, DVec2, DVec3};

use super::layout::GARTH;
use super::mesh::Soup;
use super::shapes::{bevelled, lathe, part, profile, shaped_lathe, smooth};
use super::sweep::{Ends, circle, tube};

const KERB: f64 = GARTH + 0.92;
/// Height of the pulley that the bucket's rope hangs from.
pub(crate) const PULLEY: f64 = GARTH + 2.62;
/// Radius of the ring on which the iron stands.
const STAND: f64 = 0.74;

pub(crate) fn stone() -> Soup {
    let y = GARTH - 0.1;
    let step = [(1.45, y), (1.45, y + 0.23), (1.42, y + 0.26), (0.0, y + 0.26)];
    let mut soup = lathe(&profile(&step), 8, 1.0);
    let y = GARTH + 0.15;
    let ring = [
        (0.92, y),
        (0.92, y + 0.10),
        (0.86, y + 0.15),
        (0.82, y + 0.18),
        (0.82, y + 0.56),
        (0.86, y + 0.60),
        (0.92, y + 0.64),
        (0.92, KERB - 0.03),
        (0.89, KERB),
        (0.60, KERB),
        (0.57, KERB - 0.03),
        (0.57, y - 0.05),
    ];
    soup.append(lathe(&profile(&ring), 32, 1.0));
    soup
}

/// A flat spiral in the plane of `right` and `up`, from its eye outwards.
fn scroll(centre: DVec3, right: DVec3, up: DVec3, radius: f64, turns: f64) -> Soup {
    let steps = 26;
    let path: Vec<DVec3> = (0..=steps)
        .map(|i| part(i, steps))
        .map(|t| {
            let (r, a) = (radius * (0.16 + 0.84 * t), TAU * turns * t);
            centre + right * (r * a.cos()) + up * (r * a.sin())
        })
        .collect();
    tube(&path, 5, Ends::Capped, |_| 0.009)
}

/// The iron overthrow: four posts that bow inwards to a crown, scrolls between them, and the pulley's bearing.
pub(crate) fn iron() -> Soup {
    let mut soup = Soup::default();
    for k in 0..4u8 {
        let turn = DAffine3::from_rotation_y(FRAC_PI_2 * f64::from(k) + PI * 0.25);
        let post = smooth(
            &[
                (STAND, KERB - 0.06),
                (STAND, KERB + 0.5),
                (STAND, KERB + 1.05),
                (0.60, KERB + 1.5),
                (0.26, KERB + 1.82),
                (0.05, KERB + 2.1),
            ]
            .map(|(x, y)| DVec3::new(x, y, 0.0)),
            5,
        );
        let mut part_of_post = tube(&post, 6, Ends::Capped, |t| 0.021 - 0.006 * t);
        for y in [KERB + 0.01, KERB + 1.02] {
            let collar = profile(&[(0.0, y), (0.04, y), (0.045, y + 0.025), (0.04, y + 0.05), (0.0, y + 0.05)]);
            part_of_post.append(lathe(&collar, 10, 1.0).moved(DVec3::X * STAND));
        }
        part_of_post.append(scroll(DVec3::new(STAND - 0.13, KERB + 1.16, 0.0), DVec3::NEG_X, DVec3::NEG_Y, 0.12, 1.75));
        part_of_post.append(scroll(DVec3::new(0.36, KERB + 1.98, 0.0), DVec3::NEG_X, DVec3::Y, 0.13, 1.75));
        soup.append(part_of_post.placed(turn));
        // A grille between neighbouring posts: two rails, bars, and a lozenge lattice above.
        soup.append(grille().placed(turn));
    }
    for (y, r) in [(KERB + 1.04, STAND), (KERB + 1.5, 0.60)] {
        soup.append(tube(&circle(DVec3::Y * y, DVec3::X * r, DVec3::NEG_Z * r, 40), 6, Ends::Loop, |_| 0.013));
    }
    let knob = profile(&[(0.0, 2.0), (0.05, 2.03), (0.075, 2.1), (0.05, 2.17), (0.02, 2.2), (0.03, 2.25), (0.0, 2.42)]);
    soup.append(lathe(&knob, 12, 1.0).moved(DVec3::Y * KERB));
    soup.append(tube(&[DVec3::Y * (KERB + 2.05), DVec3::Y * (PULLEY + 0.1)], 6, Ends::Capped, |_| 0.012));
    soup.append(pulley());
    soup
}

/// Bars on the ring between two posts, following the circle.
fn grille() -> Soup {
    let mut soup = Soup::default();
    let on_ring = |t: f64, y: f64| {
        let a = FRAC_PI_2 * t;
        DVec3::new(STAND * a.cos(), y, STAND * a.sin())
    };
    let count = 9;
    for k in 1..count {
        let t = part(k, count);
        soup.append(tube(&[on_ring(t, KERB + 0.74), on_ring(t, KERB + 1.04)], 5, Ends::Open, |_| 0.007));
    }
    let rail: Vec<DVec3> = (0..=9).map(|i| on_ring(part(i, 9), KERB + 0.74)).collect();
    soup.append(tube(&rail, 6, Ends::Open, |_| 0.011));
    for k in 0..6 {
        for (from, to) in [(k, k + 1), (k + 1, k)] {
            let (a, b) = (part(from, 6), part(to, 6));
            let bar: Vec<DVec3> = (0..=3)
                .map(|i| part(i, 3))
                .map(|s| {
                    let r = STAND + (0.60 - STAND) * s;
                    let p = on_ring(a + (b - a) * s, KERB + 1.04 + 0.46 * s);
                    DVec3::new(p.x * r / STAND, p.y, p.z * r / STAND)
                })
                .collect();
            soup.append(tube(&bar, 5, Ends::Open, |_| 0.007));
        }
    }
    soup
}

fn pulley() -> Soup {
    let wheel = profile(&[(0.03, -0.03), (0.13, -0.03), (0.105, 0.0), (0.13, 0.03), (0.03, 0.03), (0.03, -0.03)]);
    let mut soup = shaped_lathe(&wheel, 20, 1.0, |_, _| 1.0)
        .placed(DAffine3::from_translation(DVec3::Y * PULLEY) * DAffine3::from_rotation_x(FRAC_PI_2));
    for z in [-0.055, 0.055] {
        soup.append(bevelled(
            DVec3::new(-0.03, PULLEY - 0.05, z - 0.008),
            DVec3::new(0.03, PULLEY + 0.13, z + 0.008),
            0.003,
        ));
    }
    soup.append(tube(&[DVec3::new(0.0, PULLEY, -0.07), DVec3::new(0.0, PULLEY, 0.07)], 8, Ends::Capped, |_| 0.018));
    soup
}

pub(crate) fn lattice() -> Soup {
    let mut soup = Soup::default();
    let y = KERB + 0.012;
    for k in -5..=5i32 {
        let x = f64::from(k) * 0.115;
        let half = (0.64f64 * 0.64 - x * x).max(0.0).sqrt();
        soup.append(tube(&[DVec3::new(x, y, -half), DVec3::new(x, y, half)], 5, Ends::Capped, |_| 0.009));
        soup.append(tube(&[DVec3::new(-half, y + 0.012, x), DVec3::new(half, y + 0.012, x)], 5, Ends::Capped, |_| {
            0.009
        }));
    }
    soup.append(tube(&circle(DVec3::Y * y, DVec3::X * 0.64, DVec3::NEG_Z * 0.64, 32), 6, Ends::Loop, |_| 0.015));
    soup
}

/// Length of the rope from the pulley's axle to the bucket's handle.
const ROPE: f64 = 0.93;

/// The bucket's rope and irons; the origin is the pulley's axle, so that the whole swings about it.
pub(crate) fn bucket_iron() -> Soup {
    let mut soup = Soup::default();
    let handle: Vec<DVec3> = (0..=14)
        .map(|i| PI * part(i, 14))
        .map(|a| DVec3::new(0.185 * a.cos(), -ROPE - 0.20 + 0.2 * a.sin(), 0.0))
        .collect();
    soup.append(tube(&handle, 6, Ends::Capped, |_| 0.009));
    for (y, r) in [(-ROPE - 0.27, 0.179), (-ROPE - 0.44, 0.161)] {
        let hoop = profile(&[(r - 0.01, y), (r + 0.006, y), (r + 0.008, y + 0.03), (r - 0.01, y + 0.03)]);
        soup.append(lathe(&hoop, 24, 1.0));
    }
    soup
}

pub(crate) fn rope() -> Soup {
    let mut soup = tube(&[DVec3::new(0.0, -0.1, 0.0), DVec3::Y * -ROPE], 6, Ends::Capped, |_| 0.011);
    let loop_path: Vec<DVec3> = circle(DVec3::Y * (-ROPE - 0.005), DVec3::Y * 0.025, DVec3::Z * 0.025, 12);
    soup.append(tube(&loop_path, 6, Ends::Loop, |_| 0.009));
    soup
}

pub(crate) fn bucket() -> Soup {
    let top = -ROPE - 0.19;
    let outline =
        [(0.0, top - 0.30), (0.15, top - 0.30), (0.188, top), (0.165, top), (0.132, top - 0.27), (0.0, top - 0.27)];
    shaped_lathe(&profile(&outline), 24, 0.5, |_, _| 1.0).with_uv(|uv| DVec2::new(uv.y, uv.x))
}
