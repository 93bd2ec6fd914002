//! Woven pictures for the hangings: a field with lozenges between bands.

use glam::DVec3;

use super::{Picture, clouds, solid, step};

/// A hanging's picture; it is seen once over the whole cloth. Colours are sRGB.
fn woven(field: DVec3, band: DVec3, line: DVec3, seed: u64) -> Picture {
    Picture::new(256, move |uv| {
        let mut color = field;
        // A lattice of lozenges with a small one inside each.
        let (u, v) = (uv.x * 4.0, uv.y * 6.0);
        let lozenge = ((u - u.floor() - 0.5).abs() + (v - v.floor() - 0.5).abs()) * 2.0;
        color = color.lerp(band, 0.75 * (1.0 - step(0.28, 0.34, lozenge)));
        color = color.lerp(line, 1.0 - step(0.05, 0.09, (lozenge - 0.82).abs()));
        color = color.lerp(line, 1.0 - step(0.10, 0.14, lozenge));
        // Bands above and below, and a border at the sides.
        let end = uv.y.min(1.0 - uv.y);
        let in_band = 1.0 - step(0.118, 0.124, end);
        color = color.lerp(band, in_band);
        for (at, half) in [(0.118, 0.006), (0.098, 0.003), (0.03, 0.008)] {
            color = color.lerp(line, 1.0 - step(half, half + 0.004, (end - at).abs()));
        }
        let teeth = uv.x * 12.0;
        let tooth = (teeth - teeth.floor() - 0.5).abs() * 2.0;
        if (0.045..0.09).contains(&end) && tooth < (end - 0.045) / 0.045 {
            color = line;
        }
        let side = uv.x.min(1.0 - uv.x);
        color = color.lerp(line, 1.0 - step(0.022, 0.027, side));
        let weave = 0.035 * ((uv.x * 804.0).sin() * (uv.y * 804.0).sin());
        solid(color * (1.0 + weave + 0.06 * clouds(uv, 3, 4, seed)))
    })
}

pub(crate) fn teal() -> Picture {
    woven(DVec3::new(0.07, 0.42, 0.44), DVec3::new(0.05, 0.28, 0.34), DVec3::new(0.88, 0.68, 0.30), 81)
}

pub(crate) fn ochre() -> Picture {
    woven(DVec3::new(0.83, 0.58, 0.20), DVec3::new(0.60, 0.20, 0.13), DVec3::new(0.95, 0.86, 0.66), 82)
}
