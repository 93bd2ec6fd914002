//! The sundial on the north-eastern lawn: two steps, a baluster, a bronze plate with hour lines, and the gnomon.

use glam::{DVec2, DVec3};

use super::layout::GARTH;
use super::mesh::Soup;
use super::shapes::{bevelled, lathe, profile, smooth_profile};
use super::sweep::{Ends, tube};

/// Height of the plate's face above the garth.
const PLATE: f64 = 1.12;
const LATITUDE_DEG: f64 = 48.0;

/// Steps and baluster, around the y axis.
pub(crate) fn pedestal() -> Soup {
    let y = GARTH - 0.1;
    let steps = [
        (1.0, y),
        (1.0, y + 0.27),
        (0.97, y + 0.30),
        (0.66, y + 0.30),
        (0.66, y + 0.44),
        (0.63, y + 0.47),
        (0.0, y + 0.47),
    ];
    let mut soup = lathe(&profile(&steps), 8, 1.0);
    let y = GARTH + 0.36;
    soup.append(bevelled(DVec3::new(-0.25, y, -0.25), DVec3::new(0.25, y + 0.12, 0.25), 0.02).box_mapped(1.0));
    let mut outline = profile(&[(0.23, y + 0.11), (0.235, y + 0.15), (0.19, y + 0.18)]);
    outline.extend(smooth_profile(
        &[(0.15, y + 0.20), (0.17, y + 0.27), (0.205, y + 0.36), (0.17, y + 0.47), (0.115, y + 0.56), (0.11, y + 0.60)],
        3,
    ));
    outline.extend(profile(&[
        (0.15, y + 0.62),
        (0.15, y + 0.645),
        (0.12, y + 0.655),
        (0.30, y + 0.70),
        (0.42, y + 0.70),
    ]));
    outline.extend(profile(&[(0.44, y + 0.72), (0.44, y + 0.75), (0.0, y + 0.75)]));
    soup.append(lathe(&outline, 20, 1.0));
    soup
}

/// The plate and the gnomon: a triangle whose upper edge points at the pole (−z is north).
pub(crate) fn dial() -> Soup {
    let y = GARTH + PLATE;
    let mut soup = lathe(
        &profile(&[(0.38, y - 0.03), (0.40, y - 0.01), (0.40, y + 0.012), (0.38, y + 0.02), (0.0, y + 0.02)]),
        40,
        1.0,
    );
    soup.append(gnomon().moved(DVec3::new(0.0, y + 0.015, 0.14)));
    soup
}

/// The plate's raised hour lines, which spread from the gnomon's foot, and two rings around them.
pub(crate) fn lines() -> Soup {
    let y = GARTH + PLATE;
    let mut soup = Soup::default();
    let latitude = LATITUDE_DEG.to_radians();
    for hour in -6..=6i32 {
        // The hour line's angle from the noon line: tan = sin(latitude) · tan(hour angle).
        let hour_angle = f64::from(hour) * 15.0f64.to_radians();
        let angle = (latitude.sin() * hour_angle.sin()).atan2(hour_angle.cos());
        let direction = DVec3::new(angle.sin(), 0.0, -angle.cos());
        let from = DVec3::new(0.0, y + 0.02, 0.14);
        let reach = |r: f64| {
            let (b, c) = (from.z * direction.z, from.z * from.z - r * r);
            -b + (b * b - c).sqrt()
        };
        soup.append(tube(&[from + direction * 0.10, from + direction * reach(0.33)], 4, Ends::Capped, |_| 0.003));
    }
    for radius in [0.34, 0.365] {
        let ring = super::sweep::circle(DVec3::Y * (y + 0.02), DVec3::X * radius, DVec3::Z * radius, 40);
        soup.append(tube(&ring, 4, Ends::Loop, |_| 0.004));
    }
    soup
}

/// The triangle from its foot at the origin towards −z, and a scroll that props its high end.
fn gnomon() -> Soup {
    let (length, height) = (0.36, 0.36 * LATITUDE_DEG.to_radians().tan());
    let mut soup =
        plate(&[(0.0, 0.0), (0.26, 0.0), (length, height - 0.07), (length, height)].map(|(x, y)| DVec2::new(x, y)));
    let scroll: Vec<DVec3> = (0..=30u8)
        .map(|i| f64::from(i) / 30.0)
        .map(|t| {
            let (radius, angle) = (0.055 * (1.0 - 0.8 * t), 10.0 * t - 2.2);
            DVec3::new(0.0, 0.055 + radius * angle.sin(), -0.335 - radius * angle.cos())
        })
        .collect();
    soup.append(tube(&scroll, 6, Ends::Capped, |t| 0.012 - 0.005 * t));
    soup
}

/// A thin plate in the plane x = 0 over a convex outline of (distance towards −z, height).
fn plate(outline: &[DVec2]) -> Soup {
    let half = 0.011;
    let at = |i: usize, x: f64| {
        let p = outline[i % outline.len()];
        (DVec3::new(x, p.y, -p.x), DVec2::new(p.x, -p.y))
    };
    // Seen from +x, −z is to the right: counter-clockwise outlines are those that turn left there.
    let turn: f64 = (0..outline.len()).map(|i| outline[i].perp_dot(outline[(i + 1) % outline.len()])).sum();
    let (front, back) = if turn > 0.0 { (half, -half) } else { (-half, half) };
    let mut soup = Soup::default();
    for k in 1..outline.len() - 1 {
        soup.triangle(at(0, front), at(k, front), at(k + 1, front));
        soup.triangle(at(0, back), at(k + 1, back), at(k, back));
    }
    for k in 0..outline.len() {
        soup.quad(at(k, back), at(k + 1, back), at(k + 1, front), at(k, front));
    }
    soup
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gnomons_plates_are_closed_and_face_outwards() {
        let square = [(0.0, 0.0), (1.0, 0.0), (1.0, 2.0), (0.0, 2.0)].map(|(x, y)| DVec2::new(x, y));
        let reversed: Vec<DVec2> = square.iter().rev().copied().collect();
        for outline in [&square[..], &reversed] {
            let mesh = plate(outline).weld(10.0);
            let at = |i: u32| mesh.positions[i as usize].as_dvec3();
            let volume: f64 = mesh.indices.chunks(3).map(|t| at(t[0]).dot(at(t[1]).cross(at(t[2]))) / 6.0).sum();
            assert!((volume - 2.0 * 0.022).abs() < 1e-3, "{volume}");
        }
    }
}
