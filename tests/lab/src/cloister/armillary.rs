//! The armillary sphere on the fountain: bronze rings around an axis. The rings turn, the cradle stands.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DAffine3, DVec2, DVec3};

use super::mesh::Soup;
use super::shapes::{profile, shaped_lathe, smooth_profile};
use super::sweep::{Ends, circle, moulding, tube};

/// Radius of the outer rings, in metres.
const RADIUS: f64 = 0.46;
/// Height of the sphere's centre above the cradle's foot.
pub(crate) const CENTRE: f64 = 0.72;
/// Tilt of the polar axis from the vertical: a latitude of 48 degrees.
pub(crate) const TILT_RAD: f64 = 0.733;

/// A flat band of the given width around `axis` y, at height `y`.
fn band(radius: f64, y: f64, width: f64, thickness: f64) -> Soup {
    let path = circle(DVec3::Y * y, DVec3::X * radius, DVec3::Z * radius, 48);
    let (t, w) = (thickness * 0.5, width * 0.5);
    let section = [(-t, -w), (t, -w), (t, w), (-t, w)].map(|(x, y)| DVec2::new(x, y));
    moulding(&path, DVec3::Y, &section, true, Ends::Loop, 0.5)
}

/// The turning part; its axis is y, its centre the origin. Rings of equator, tropics, two meridians and the ecliptic,
/// the axis with its arrow (the gnomon of this dial), and the earth.
pub(crate) fn rings() -> Soup {
    let mut soup = band(RADIUS, 0.0, 0.055, 0.012);
    for side in [-1.0, 1.0] {
        let tropic = 0.41;
        soup.append(band(RADIUS * f64::cos(tropic) - 0.004, side * RADIUS * f64::sin(tropic), 0.022, 0.012));
    }
    let meridian = band(RADIUS - 0.014, 0.0, 0.03, 0.014).placed(DAffine3::from_rotation_x(FRAC_PI_2));
    soup.append(meridian.placed(DAffine3::from_rotation_y(FRAC_PI_2)));
    soup.append(meridian);
    soup.append(band(RADIUS + 0.016, 0.0, 0.08, 0.010).placed(DAffine3::from_rotation_z(0.409)));
    soup.append(tube(&[DVec3::Y * -0.60, DVec3::Y * 0.66], 8, Ends::Capped, |_| 0.011));
    soup.append(shaped_lathe(&profile(&[(0.0, 0.60), (0.045, 0.60), (0.0, 0.76)]), 10, 1.0, |_, _| 1.0));
    for side in [-1.0, 1.0] {
        let fin = moulding(
            &[DVec3::Y * -0.46, DVec3::Y * -0.60],
            DVec3::Z,
            &[(0.0, -0.003), (0.07, -0.003), (0.07, 0.003), (0.0, 0.003)].map(|(x, y)| DVec2::new(x, y)),
            true,
            Ends::Capped,
            1.0,
        );
        soup.append(fin.placed(DAffine3::from_rotation_y(if side > 0.0 { 0.0 } else { PI })));
    }
    let earth = smooth_profile(&[(0.0, -0.09), (0.064, -0.064), (0.09, 0.0), (0.064, 0.064), (0.0, 0.09)], 3);
    soup.append(shaped_lathe(&earth, 16, 1.0, |_, _| 1.0));
    soup
}

/// The rings' support: a foot at the origin, a half circle, and bearings at its ends.
pub(crate) fn cradle() -> Soup {
    let centre = DVec3::Y * CENTRE;
    let foot = smooth_profile(&[(0.13, 0.0), (0.10, 0.03), (0.04, 0.06), (0.03, 0.10), (0.05, 0.13), (0.03, 0.165)], 2);
    let mut soup = shaped_lathe(&foot, 16, 1.0, |_, _| 1.0);
    // The half circle lies in the plane of the axis, from bearing to bearing below the sphere.
    let axis = DAffine3::from_rotation_z(-TILT_RAD).transform_vector3(DVec3::Y);
    let down = DAffine3::from_rotation_z(-TILT_RAD).transform_vector3(DVec3::X);
    let path: Vec<DVec3> = (0..=24u8)
        .map(|i| PI * f64::from(i) / 24.0)
        .map(|a| centre + (axis * a.cos() + down * a.sin()) * 0.56)
        .collect();
    soup.append(tube(&path, 8, Ends::Capped, |_| 0.018));
    soup
}
