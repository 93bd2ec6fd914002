//! The ground: flagstones of the walk, paths and lawns of the garth.

use glam::{DVec2, DVec3};

use super::layout::{ARCADE, GARTH, GROUND, WALK_IN, WALK_OUT};
use super::mesh::Soup;
use super::rng::Rng;
use super::shapes::{bevelled, block, lathe, part, profile};
use super::textures::{atlas_cell, clouds};

/// Width of a joint between stones, in metres.
const JOINT: f64 = 0.014;
const WORN: f64 = 0.012;
/// Half the width of the paths that cross the garth.
pub(crate) const PATH_HALF: f64 = 1.2;
/// Radius of the raised round place in the middle.
pub(crate) const PLAZA: f64 = 3.5;
pub(crate) const PLAZA_Y: f64 = GARTH + 0.07;
/// Inner edge of the path along the arcade.
const RIM: f64 = 6.35;

/// A stone over a four-sided plan (counter-clockwise seen from above), its top at `y`, edges worn, sides 4 cm deep.
fn flagstone(rng: &mut Rng, plan: [DVec2; 4], y: f64) -> Soup {
    let centre = (plan[0] + plan[1] + plan[2] + plan[3]) * 0.25;
    let top = y + rng.between(-0.004, 0.004);
    let tilt = DVec2::new(rng.between(-0.004, 0.004), rng.between(-0.004, 0.004));
    let (cell, shift) = (rng.below(16), DVec2::new(rng.unit(), rng.unit()) * 0.4);
    let at = |p: DVec2, y: f64| {
        let uv = atlas_cell(cell, 4, (p - plan[3]).abs() * 0.6 / 1.1 + shift);
        (DVec3::new(p.x, y + tilt.dot(p - centre), p.y), uv)
    };
    let shrink = |by: f64| plan.map(|p| p + (centre - p).signum() * by);
    let (inner, outer) = (shrink(JOINT * 0.5 + WORN), shrink(JOINT * 0.5));
    let mut soup = Soup::default();
    let t = inner.map(|p| at(p, top));
    soup.quad(t[0], t[1], t[2], t[3]);
    for i in 0..4 {
        let j = (i + 1) % 4;
        soup.quad(at(outer[i], top - 0.03), at(outer[j], top - 0.03), t[j], t[i]);
    }
    soup
}

fn rectangle(x0: f64, x1: f64, z0: f64, z1: f64) -> [DVec2; 4] {
    [DVec2::new(x0, z1), DVec2::new(x1, z1), DVec2::new(x1, z0), DVec2::new(x0, z0)]
}

/// Stones in rows over a rectangle: rows along x, each cut into stones of its own lengths.
fn rows(rng: &mut Rng, x: (f64, f64), z: (f64, f64), count: usize, y: f64) -> Soup {
    let mut soup = Soup::default();
    let mut edges: Vec<f64> = (0..=count).map(|i| z.0 + (z.1 - z.0) * part(i, count)).collect();
    for edge in &mut edges[1..count] {
        *edge += rng.between(-0.06, 0.06);
    }
    for pair in edges.windows(2) {
        let mut from = x.0;
        while from < x.1 - 1e-6 {
            let mut to = from + rng.between(0.5, 1.0);
            if to > x.1 - 0.4 {
                to = x.1;
            }
            soup.append(flagstone(rng, rectangle(from, to, pair[0], pair[1]), y));
            from = to;
        }
    }
    soup
}

/// The stones of one side's walk with one of its corners; four rotated copies cover the whole walk.
pub(crate) fn walk(rng: &mut Rng) -> Soup {
    rows(rng, (-WALK_IN + 0.04, WALK_OUT + 0.02), (WALK_IN - 0.04, WALK_OUT + 0.02), 6, 0.0)
}

/// The bed below one side's stones, and the step at the opening to the garth. Rotated copies do not overlap.
pub(crate) fn bed() -> Soup {
    let top = -0.018;
    let mut soup = block(DVec3::new(-ARCADE, GROUND - 0.05, ARCADE), DVec3::new(WALK_OUT + 0.25, top, WALK_OUT + 0.25));
    soup.append(bevelled(DVec3::new(-0.76, GROUND, 7.46), DVec3::new(0.76, 0.0, WALK_IN - 0.05), 0.015));
    soup.append(bevelled(DVec3::new(-0.98, GROUND, 7.1), DVec3::new(0.98, -0.075, 7.47), 0.015));
    soup.box_mapped(1.0)
}

/// The stones of the paths on one side of the garth; four rotated copies make all paths.
pub(crate) fn paths(rng: &mut Rng) -> Soup {
    let mut soup = rows(rng, (-RIM, 7.5), (RIM, 7.5), 2, GARTH);
    soup.append(rows(rng, (-PATH_HALF, PATH_HALF), (PLAZA - 0.2, RIM), 4, GARTH));
    soup
}

/// The round place around the fountain: a low step, and rings of stones.
pub(crate) fn plaza(rng: &mut Rng) -> Soup {
    let outline =
        profile(&[(PLAZA, GROUND), (PLAZA, PLAZA_Y - 0.03), (PLAZA - 0.02, PLAZA_Y - 0.018), (0.0, PLAZA_Y - 0.018)]);
    let mut soup = lathe(&outline, 72, 1.0).with_uv(|uv| atlas_cell(5, 4, (uv * 0.1).fract_gl()));
    let rings = [(PLAZA - 0.01, 2.98, 34), (2.98, 2.46, 29), (2.46, 1.98, 24)];
    for (outer, inner, count) in rings {
        let turn = rng.unit();
        for k in 0..count {
            let angle = |k: usize| std::f64::consts::TAU * (part(k, count) + turn * 0.1);
            let at = |r: f64, a: f64| DVec2::new(r * a.sin(), r * a.cos());
            let (a, b) = (angle(k), angle(k + 1));
            soup.append(wedge(rng, [at(outer, a), at(outer, b), at(inner, b), at(inner, a)]));
        }
    }
    soup
}

/// A flagstone whose sides do not follow the axes.
fn wedge(rng: &mut Rng, plan: [DVec2; 4]) -> Soup {
    let centre = (plan[0] + plan[1] + plan[2] + plan[3]) * 0.25;
    let toward = |p: DVec2, by: f64| p + (centre - p).normalize() * by * std::f64::consts::SQRT_2;
    let (cell, shift) = (rng.below(16), DVec2::new(rng.unit(), rng.unit()) * 0.4);
    let top = PLAZA_Y + rng.between(-0.003, 0.003);
    let at = |p: DVec2, y: f64| (DVec3::new(p.x, y, p.y), atlas_cell(cell, 4, (p - plan[3]).abs() * 0.5 + shift));
    let inner = plan.map(|p| at(toward(p, JOINT * 0.5 + WORN), top));
    let outer = plan.map(|p| at(toward(p, JOINT * 0.5), top - 0.02));
    let mut soup = Soup::default();
    soup.quad(inner[0], inner[1], inner[2], inner[3]);
    for i in 0..4 {
        let j = (i + 1) % 4;
        soup.quad(outer[i], outer[j], inner[j], inner[i]);
    }
    soup
}

pub(crate) fn soil() -> Soup {
    block(DVec3::new(-ARCADE, GROUND - 0.1, -ARCADE), DVec3::new(ARCADE, GARTH - 0.02, ARCADE)).box_mapped(1.0)
}

pub(crate) fn lawn_y(x: f64, z: f64) -> f64 {
    GARTH + 0.045 + 0.03 * clouds(DVec2::new(x, z) / 16.0 + 0.5, 8, 2, 0x1a)
}

/// The lawn of the quarter at +x, +z.
pub(crate) fn lawn() -> Soup {
    let (from, to, steps) = (PATH_HALF + 0.13, RIM - 0.13, 14);
    let mut soup = Soup::default();
    soup.grid(steps, steps, |i, j| {
        let (x, z) = (from + (to - from) * part(i, steps), to - (to - from) * part(j, steps));
        (DVec3::new(x, lawn_y(x, z), z), DVec2::new(x, z) / 1.6)
    });
    soup
}

/// The kerbs around the lawn of the quarter at +x, +z.
pub(crate) fn kerbs() -> Soup {
    let (low, high, top) = (PATH_HALF, RIM, GARTH + 0.09);
    let start = PLAZA - 0.26;
    let mut soup = Soup::default();
    let mut kerb = |x: (f64, f64), z: (f64, f64)| {
        soup.append(bevelled(DVec3::new(x.0, GROUND, z.0), DVec3::new(x.1, top, z.1), 0.02));
    };
    kerb((low, low + 0.16), (start, high));
    kerb((high - 0.16, high), (low + 0.16, high));
    kerb((start, high - 0.16), (low, low + 0.16));
    kerb((low + 0.16, high - 0.16), (high - 0.16, high));
    soup.box_mapped(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_walk_is_paved_whole() {
        let mesh = walk(&mut Rng::new(2)).weld(50.0);
        let plan: f64 = mesh
            .indices
            .chunks(3)
            .map(|t| {
                let [a, b, c] = [0, 1, 2].map(|k| mesh.positions[t[k] as usize].as_dvec3());
                (b - a).cross(c - a).y * 0.5
            })
            .sum();
        let whole = (WALK_OUT + WALK_IN - 0.02) * (WALK_OUT - WALK_IN + 0.06);
        assert!(plan < whole && plan > whole * 0.95, "{plan} of {whole} m² are stone");
    }
}
