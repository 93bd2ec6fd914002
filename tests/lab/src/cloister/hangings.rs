//! Cloth: banners that hang in folds from a rod, and a swag between two columns. Single sheets, seen from both sides.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};

use super::layout::ARCH_HALF;
use super::mesh::Soup;
use super::shapes::{bevelled, part};
use super::sweep::{Ends, circle, tube};

/// Width and height, in metres.
const BANNER: (f64, f64) = (1.22, 1.62);

/// A banner in the plane z = 0 that hangs from its rod at y = 0, its folds deepening downwards; its foot is a point.
pub(crate) fn banner() -> Soup {
    let (width, height) = BANNER;
    let (columns, rows) = (28, 14);
    let mut soup = Soup::default();
    soup.grid(columns, rows, |column, row| {
        let (u, v) = (part(column, columns), 1.0 - part(row, rows));
        let deep = 0.012 + 0.055 * v;
        let phase = 0.6 * (v * 2.3).sin();
        let fold = deep * (TAU * 3.2 * u + phase).sin() + 0.03 * v * (TAU * 1.1 * u + 1.0).sin();
        let x = (u - 0.5) * width * (1.0 - 0.07 * v);
        let point = 0.22 * v * v * (1.0 - (2.0 * u - 1.0).abs());
        (DVec3::new(x, -0.035 - v * (height - 0.255) - point, fold), DVec2::new(u, v))
    });
    soup
}

/// The banner's rod, which ends in the imposts on both sides of an arch, and its rings.
pub(crate) fn rod() -> Soup {
    let half = ARCH_HALF - 0.01;
    let mut soup = tube(&[DVec3::new(-half, 0.0, 0.0), DVec3::new(half, 0.0, 0.0)], 8, Ends::Open, |_| 0.014);
    for k in 0..7u8 {
        let x = (f64::from(k) / 6.0 - 0.5) * (BANNER.0 - 0.06);
        let ring = circle(DVec3::new(x, -0.012, 0.0), DVec3::Y * 0.03, DVec3::Z * 0.03, 10);
        soup.append(tube(&ring, 4, Ends::Loop, |_| 0.005));
    }
    soup
}

/// A cloth hung between two points one bay apart, sagging, its lower edge lower still.
pub(crate) fn swag(width: f64) -> Soup {
    let (columns, rows) = (26, 8);
    let mut soup = Soup::default();
    soup.grid(columns, rows, |column, row| {
        let (u, v) = (part(column, columns), 1.0 - part(row, rows));
        let sag = 4.0 * u * (1.0 - u);
        let drop = 0.20 * sag + v * (0.16 + 0.55 * sag);
        let fold = (0.015 + 0.05 * v) * (TAU * 2.5 * v + 3.0 * u).sin() * sag.sqrt();
        let belly = 0.10 * v * sag;
        (DVec3::new((u - 0.5) * width, -drop, fold - belly), DVec2::new(u, v * 0.5))
    });
    soup
}

/// A stone bench 1.8 m long along x, standing on y = 0.
pub(crate) fn bench() -> Soup {
    let mut soup = bevelled(DVec3::new(-0.9, 0.40, -0.22), DVec3::new(0.9, 0.49, 0.22), 0.025);
    for x in [-0.62, 0.62] {
        soup.append(bevelled(DVec3::new(x - 0.09, -0.1, -0.17), DVec3::new(x + 0.09, 0.41, 0.17), 0.02));
    }
    soup.box_mapped(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cloth_shows_its_whole_picture_once() {
        let mesh = banner().weld(80.0);
        assert!(mesh.uvs.iter().all(|uv| (0.0..=1.0).contains(&uv.x) && (0.0..=1.0).contains(&uv.y)));
        let lowest = mesh.positions.iter().fold(0.0f32, |low, p| low.min(p.y));
        assert!((f64::from(lowest) + BANNER.1).abs() < 0.03, "{lowest}");
    }
}
