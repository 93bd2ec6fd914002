//! The wrought-iron lanterns of the walk. Their light stands inside; bars and crown throw its shadows.

use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3};

use super::mesh::Soup;
use super::shapes::{lathe, part, profile, shaped_lathe};
use super::sweep::{Ends, circle, moulding, tube};

/// Height of the light below the chain's hook, in metres.
pub(crate) const LIGHT: f64 = -1.24;
const CORNERS: usize = 6;
/// Height of the cage's upper and lower frames, and their radii.
const CAGE: [(f64, f64); 2] = [(-1.03, 0.165), (-1.43, 0.115)];

fn corner(k: usize, (y, radius): (f64, f64)) -> DVec3 {
    let angle = TAU * part(k % CORNERS, CORNERS);
    DVec3::new(radius * angle.sin(), y, radius * angle.cos())
}

/// Chain, crown, cage and finial, hanging from the origin. It is open below, so that its light reaches the floor.
pub(crate) fn iron() -> Soup {
    let mut soup = chain(0.0, -0.80);
    let square = profile(&[(-0.009, -0.009), (0.009, -0.009), (0.009, 0.009), (-0.009, 0.009)]);
    for frame in CAGE {
        let ring: Vec<DVec3> = (0..CORNERS).map(|k| corner(k, frame)).collect();
        soup.append(moulding(&ring, DVec3::Y, &square, true, Ends::Loop, 1.0));
    }
    for k in 0..CORNERS {
        soup.append(tube(&[corner(k, CAGE[1]), corner(k, CAGE[0])], 4, Ends::Open, |_| 0.009));
        // A hoop across each pane.
        let (a, b) = (
            corner(k, CAGE[0]).lerp(corner(k, CAGE[1]), 0.5),
            corner(k + 1, CAGE[0]).lerp(corner(k + 1, CAGE[1]), 0.5),
        );
        soup.append(tube(&[a, b], 4, Ends::Open, |_| 0.005));
    }
    let crown = profile(&[
        (0.185, -1.03),
        (0.185, -1.015),
        (0.13, -0.97),
        (0.075, -0.90),
        (0.035, -0.86),
        (0.03, -0.82),
        (0.0, -0.80),
    ]);
    soup.append(shaped_lathe(&crown, CORNERS, 1.0, |_, _| 1.0));
    let lining = profile(&[(0.0, -0.83), (0.06, -0.91), (0.12, -0.985), (0.185, -1.03)]);
    soup.append(shaped_lathe(&lining, CORNERS, 1.0, |_, _| 1.0));
    // The candle's plate is held by three thin arms: little of the floor lies in its shadow.
    soup.append(lathe(&profile(&[(0.0, -1.425), (0.022, -1.42), (0.025, -1.405), (0.0, -1.40)]), 10, 1.0));
    for k in 0..3 {
        soup.append(tube(&[DVec3::Y * -1.412, corner(2 * k, CAGE[1])], 4, Ends::Open, |_| 0.005));
    }
    soup
}

fn chain(from: f64, to: f64) -> Soup {
    let link = 0.066;
    let count = 12;
    let mut soup = Soup::default();
    for k in 0..count {
        let y = from + (to - from) * (part(k, count) + 0.5 / 12.0);
        let side = if k % 2 == 0 { DVec3::X } else { DVec3::Z };
        let path = circle(DVec3::Y * y, side * 0.019, DVec3::Y * (link * 0.72), 8);
        soup.append(tube(&path, 3, Ends::Loop, |_| 0.005));
    }
    soup
}

pub(crate) fn glass() -> Soup {
    let mut soup = Soup::default();
    for k in 0..CORNERS {
        let at = |k: usize, frame: (f64, f64)| (corner(k, frame) * DVec3::new(0.97, 1.0, 0.97), DVec2::ZERO);
        soup.quad(at(k, CAGE[1]), at(k + 1, CAGE[1]), at(k + 1, CAGE[0]), at(k, CAGE[0]));
    }
    soup
}

/// The candle below the flame, short enough to stay out of the light's way.
pub(crate) fn candle() -> Soup {
    lathe(&profile(&[(0.0, -1.405), (0.013, -1.405), (0.013, -1.345), (0.0, -1.34)]), 10, 1.0)
}

/// Drawn blended, so that it throws no shadow: the light is inside it.
pub(crate) fn flame() -> Soup {
    let outline: Vec<DVec2> = (0..=8)
        .map(|i| part(i, 8))
        .map(|t| DVec2::new(0.022 * (PI * t.powf(0.7)).sin().max(0.0) * (1.0 - 0.35 * t), -1.335 + 0.14 * t))
        .collect();
    lathe(&outline, 10, 1.0)
}

/// The bracket and hood of the spot light, at the origin; it shines along −z.
pub(crate) fn spot_housing() -> Soup {
    let hood = profile(&[
        (0.0, -0.16),
        (0.05, -0.15),
        (0.06, -0.08),
        (0.095, 0.06),
        (0.085, 0.06),
        (0.05, -0.07),
        (0.0, -0.08),
    ]);
    let mut soup = lathe(&hood, 16, 1.0).placed(glam::DAffine3::from_rotation_x(-PI * 0.5));
    soup.append(tube(
        &[DVec3::new(0.0, 0.0, 0.12), DVec3::new(0.0, 0.16, 0.16), DVec3::new(0.0, 0.30, 0.05)],
        8,
        Ends::Capped,
        |_| 0.016,
    ));
    soup
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_solid_stands_at_the_light() {
        for soup in [iron(), candle()] {
            let nearest = soup
                .weld(30.0)
                .positions
                .iter()
                .map(|p| p.as_dvec3().distance(DVec3::Y * LIGHT))
                .fold(f64::INFINITY, f64::min);
            assert!(nearest > 0.06, "{nearest} m");
        }
    }
}
