//! Pictures of building materials: ashlar, plain stone, plaster, flagstones, fired clay, grass and wood.

use glam::{DVec2, DVec3};

use super::super::rng::lattice;
use super::{Picture, clouds, noise, solid, step, whole};

fn rgb(r: f64, g: f64, b: f64) -> DVec3 {
    DVec3::new(r, g, b)
}

/// Dressed blocks in courses: six courses of three blocks, each with its own tone.
pub(crate) fn ashlar() -> Picture {
    Picture::new(512, |uv| {
        let (courses, blocks) = (6.0, 3.0);
        let course = whole(uv.y * courses);
        let shift = [0.0, 0.5, 0.17, 0.67, 0.33, 0.83][usize::try_from(course.rem_euclid(6)).unwrap_or(0)];
        let x = uv.x * blocks + shift;
        let block = whole(x).rem_euclid(3);
        let edge = |t: f64, scale: f64| (t - t.floor()).min(t.ceil() - t) * scale;
        // Distance to the nearest joint in metres (2.125 m a picture), wobbling a little.
        let joint = edge(x, 2.125 / blocks).min(edge(uv.y * courses, 2.125 / courses)) + clouds(uv, 40, 2, 5) * 0.004;
        let tone = lattice(block, course, 11) - 0.5;
        let warm = lattice(block, course, 12) - 0.5;
        let stone = rgb(0.80, 0.725, 0.60) + rgb(0.10, 0.10, 0.10) * tone + rgb(0.03, 0.0, -0.04) * warm;
        let stone = stone * (1.0 + 0.07 * clouds(uv, 6, 6, 7)) - 0.10 * step(0.42, 0.7, clouds(uv, 24, 4, 9));
        solid(stone.lerp(rgb(0.60, 0.535, 0.43), 1.0 - step(0.004, 0.011, joint)))
    })
}

/// Plain limestone, for turned and moulded work.
pub(crate) fn stone() -> Picture {
    Picture::new(256, |uv| {
        let base = rgb(0.845, 0.78, 0.66) * (1.0 + 0.07 * clouds(uv, 4, 6, 21));
        let veins = step(0.80, 1.0, 1.0 - (clouds(uv, 3, 4, 22)).abs() * 3.0);
        solid(base - rgb(0.05, 0.055, 0.06) * veins - 0.10 * step(0.45, 0.7, clouds(uv, 20, 3, 23)))
    })
}

/// Old lime plaster: warm, blotched, worn.
pub(crate) fn plaster() -> Picture {
    Picture::new(512, |uv| {
        let patches = step(-0.1, 0.45, clouds(uv, 2, 5, 31));
        let base = rgb(0.885, 0.79, 0.635).lerp(rgb(0.83, 0.70, 0.53), patches);
        let worn = step(0.38, 0.6, clouds(uv, 5, 6, 32));
        let base = base.lerp(rgb(0.80, 0.745, 0.66), 0.55 * worn);
        solid(base * (1.0 + 0.035 * clouds(uv, 24, 4, 35)))
    })
}

/// Sixteen flagstones, each with its own tone. A stone of the floor shows one of them.
pub(crate) fn flagstones() -> Picture {
    Picture::new(512, |uv| {
        let (x, y) = (whole(uv.x * 4.0), whole(uv.y * 4.0));
        let tone = lattice(x, y, 41) - 0.5;
        let warm = lattice(x, y, 42);
        let base = rgb(0.64, 0.605, 0.55).lerp(rgb(0.70, 0.615, 0.50), warm) * (1.0 + 0.20 * tone);
        let grain = 0.09 * clouds(uv, 16, 5, 43) - 0.12 * step(0.45, 0.65, clouds(uv, 48, 3, 44));
        solid(base * (1.0 + grain))
    })
}

/// Fired clay in four shades, with lichen.
pub(crate) fn clay() -> Picture {
    let shades = [rgb(0.74, 0.44, 0.30), rgb(0.67, 0.37, 0.26), rgb(0.79, 0.53, 0.38), rgb(0.62, 0.38, 0.29)];
    Picture::new(256, move |uv| {
        let cell = whole(uv.x * 2.0) + 2 * whole(uv.y * 2.0);
        let base = shades[usize::try_from(cell.clamp(0, 3)).unwrap_or(0)] * (1.0 + 0.13 * clouds(uv, 8, 5, 51));
        let lichen = step(0.42, 0.62, clouds(uv, 12, 4, 52));
        solid(base.lerp(rgb(0.66, 0.63, 0.47), 0.5 * lichen))
    })
}

pub(crate) fn grass() -> Picture {
    Picture::new(256, |uv| {
        let blades =
            noise(DVec2::new(uv.x * 96.0, uv.y * 24.0), 96, 61) * noise(DVec2::new(uv.x * 32.0, uv.y * 96.0), 96, 62);
        let base = rgb(0.27, 0.37, 0.13).lerp(rgb(0.50, 0.57, 0.24), blades);
        let dry = step(0.1, 0.6, clouds(uv, 3, 4, 63));
        solid(base.lerp(rgb(0.55, 0.53, 0.28), 0.35 * dry) * (1.0 + 0.12 * clouds(uv, 16, 3, 64)))
    })
}

/// Oak: boards run along the picture's height.
pub(crate) fn wood() -> Picture {
    Picture::new(256, |uv| {
        let board = whole(uv.x * 4.0);
        let edge = (uv.x * 4.0 - (uv.x * 4.0).floor() - 0.5).abs();
        let bend = clouds(uv, 3, 3, 71) * 0.05;
        let rings = noise(DVec2::new((uv.x + bend) * 64.0, uv.y * 4.0), 64, 72);
        let base = rgb(0.40, 0.275, 0.17).lerp(rgb(0.54, 0.40, 0.26), rings);
        let base = base * (1.0 + 0.22 * (lattice(board, 0, 73) - 0.5));
        solid(base * (1.0 - 0.55 * step(0.475, 0.495, edge)))
    })
}
