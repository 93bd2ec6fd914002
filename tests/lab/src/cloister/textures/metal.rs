//! Old bronze: bare metal, with green crusts where rain stands.

use glam::DVec3;

use super::{Picture, clouds, solid, step};

/// Share of a point that is crust.
fn crust(uv: glam::DVec2) -> f64 {
    step(0.12, 0.42, clouds(uv, 5, 5, 91))
}

/// Colour, sRGB: what the metal reflects, or the crust's own.
pub(crate) fn bronze() -> Picture {
    Picture::new(256, |uv| {
        let metal = DVec3::new(0.84, 0.64, 0.38) * (1.0 + 0.10 * clouds(uv, 8, 4, 92));
        let green = DVec3::new(0.36, 0.55, 0.47) * (1.0 + 0.15 * clouds(uv, 16, 3, 93));
        solid(metal.lerp(green, crust(uv)))
    })
}

/// Roughness in green, share of bare metal in blue (glTF 2.0, §3.9.2).
pub(crate) fn bronze_surface() -> Picture {
    Picture::new(256, |uv| {
        let crust = crust(uv);
        let polished = 0.30 + 0.10 * clouds(uv, 12, 4, 94);
        solid(DVec3::new(1.0, polished + (0.85 - polished) * crust, 1.0 - crust))
    })
}
