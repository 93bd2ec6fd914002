//! Pots, planters and what grows in them, from cards that show cells of the leaf atlas.

use std::f64::consts::TAU;

use glam::{DAffine3, DVec2, DVec3};

use super::mesh::Soup;
use super::rng::Rng;
use super::shapes::{bevelled, part, profile, shaped_lathe, smooth_profile};
use super::textures::atlas_cell;
use super::textures::leaves::{BROAD, FROND, TUFT};

/// A leaf card of one atlas cell from `foot` along `along`, `half` wide to each side, folded in the middle.
/// `bend` is how far the middle and the tip lie off the straight line, in lengths.
pub(crate) fn card(cell: usize, foot: DVec3, along: DVec3, half: DVec3, bend: DVec2) -> Soup {
    let normal = half.cross(along).normalize_or_zero() * along.length();
    let rows = if bend == DVec2::ZERO { 1 } else { 2 };
    let mut soup = Soup::default();
    soup.grid(1, rows, |column, row| {
        let t = part(row, rows);
        let lift = if row == 0 {
            0.0
        } else if row == rows {
            bend.y
        } else {
            bend.x
        };
        let side = if column == 0 { -1.0 } else { 1.0 };
        let uv = DVec2::new(part(column, 1), 1.0 - t);
        // The whole cell is shown: its picture keeps clear of the edges.
        let uv = (DVec2::new((cell % 2) as f64, (cell / 2) as f64) + uv * 0.998 + 0.001) * 0.5;
        (foot + along * t + half * side + normal * lift, uv)
    });
    soup
}

/// A ring of leaves around the y axis that rise from `foot` and hang over.
struct Whorl {
    cell: usize,
    count: usize,
    foot: f64,
    rise_deg: f64,
    length: f64,
    half_width: f64,
    bend: DVec2,
}

fn whorl(rng: &mut Rng, spec: &Whorl) -> Soup {
    let mut soup = Soup::default();
    let turn = rng.between(0.0, TAU);
    for k in 0..spec.count {
        let angle = turn + TAU * (part(k, spec.count) + rng.between(-0.04, 0.04));
        let rise = (spec.rise_deg + rng.between(-9.0, 9.0)).to_radians();
        let out = DVec3::new(angle.sin(), 0.0, angle.cos());
        let length = spec.length * rng.between(0.8, 1.15);
        let along = (out * rise.cos() + DVec3::Y * rise.sin()) * length;
        let half = out.cross(DVec3::Y) * spec.half_width * rng.between(0.85, 1.15);
        let foot = out * 0.03 + DVec3::Y * (spec.foot + rng.between(-0.02, 0.02));
        soup.append(card(spec.cell, foot, along, half, spec.bend));
    }
    soup
}

/// A shrub of broad leaves, about 0.9 m high, its foot at `y`.
pub(crate) fn shrub(rng: &mut Rng, y: f64) -> Soup {
    let mut soup = Soup::default();
    for (k, rise) in [18.0, 34.0, 52.0, 68.0, 82.0].into_iter().enumerate() {
        let t = part(k, 4);
        soup.append(whorl(
            rng,
            &Whorl {
                cell: BROAD,
                count: 9 - k,
                foot: y + 0.10 + 0.24 * t,
                rise_deg: rise,
                length: 0.52 - 0.10 * t,
                half_width: 0.20,
                bend: DVec2::new(0.06, -0.14),
            },
        ));
    }
    soup
}

/// A fern of arching fronds, about 0.8 m high.
pub(crate) fn fern(rng: &mut Rng, y: f64) -> Soup {
    let mut soup = Soup::default();
    for (rise, count, length) in [(30.0, 9, 0.78), (55.0, 8, 0.85), (76.0, 5, 0.8)] {
        soup.append(whorl(
            rng,
            &Whorl {
                cell: FROND,
                count,
                foot: y,
                rise_deg: rise,
                length,
                half_width: 0.23,
                bend: DVec2::new(0.08, -0.22),
            },
        ));
    }
    soup
}

/// A stand of flowering blades; `count` pairs of crossed cards within `radius` of the y axis.
pub(crate) fn flowers(rng: &mut Rng, y: f64, radius: f64, count: usize) -> Soup {
    let mut soup = Soup::default();
    for _ in 0..count {
        let (angle, r) = (rng.between(0.0, TAU), radius * rng.unit().sqrt());
        let foot = DVec3::new(r * angle.sin(), y - 0.02, r * angle.cos());
        let lean = DVec3::new(angle.sin(), 0.0, angle.cos()) * 0.35 * r / radius.max(1e-6);
        let height = rng.between(0.36, 0.52);
        let facing = rng.between(0.0, TAU);
        for turn in [0.0, TAU * 0.25] {
            let side = DVec3::new((facing + turn).cos(), 0.0, (facing + turn).sin());
            soup.append(card(TUFT, foot, (DVec3::Y + lean) * height, side * height * 0.42, DVec2::ZERO));
        }
    }
    soup
}

/// A turned terracotta pot of height 1 and rim radius about 0.5; scale it.
pub(crate) fn pot() -> Soup {
    let outline = [
        (0.0, 0.0),
        (0.30, 0.0),
        (0.33, 0.05),
        (0.31, 0.09),
        (0.40, 0.42),
        (0.455, 0.70),
        (0.47, 0.80),
        (0.53, 0.82),
        (0.54, 0.90),
        (0.53, 0.985),
        (0.505, 1.0),
        (0.46, 0.99),
        (0.44, 0.88),
        (0.0, 0.88),
    ];
    shaped_lathe(&profile(&outline), 24, 1.6, |_, _| 1.0).with_uv(|uv| atlas_cell(0, 2, (uv * 0.5).fract_gl()))
}

pub(crate) fn pot_soil() -> Soup {
    shaped_lathe(&profile(&[(0.46, 0.90), (0.0, 0.915)]), 16, 1.0, |_, _| 1.0)
}

/// A stone urn on a pedestal, standing on y = 0.
pub(crate) fn urn() -> Soup {
    let mut soup = bevelled(DVec3::new(-0.42, -0.1, -0.42), DVec3::new(0.42, 0.18, 0.42), 0.03);
    soup.append(bevelled(DVec3::new(-0.30, 0.17, -0.30), DVec3::new(0.30, 0.82, 0.30), 0.03));
    soup.append(bevelled(DVec3::new(-0.36, 0.81, -0.36), DVec3::new(0.36, 0.92, 0.36), 0.03));
    let mut soup = soup.box_mapped(1.0);
    let mut outline = profile(&[(0.24, 0.91), (0.25, 0.96)]);
    outline.extend(smooth_profile(
        &[
            (0.20, 0.98),
            (0.09, 1.04),
            (0.09, 1.10),
            (0.22, 1.16),
            (0.36, 1.30),
            (0.40, 1.48),
            (0.33, 1.62),
            (0.36, 1.68),
        ],
        3,
    ));
    outline.extend(profile(&[(0.45, 1.72), (0.46, 1.75), (0.42, 1.77), (0.36, 1.74), (0.32, 1.66), (0.0, 1.66)]));
    let fluted =
        |row: usize, angle: f64| if (12..20).contains(&row) { 1.0 + 0.035 * (12.0 * angle).cos() } else { 1.0 };
    soup.append(shaped_lathe(&outline, 48, 1.0, fluted));
    soup
}

pub(crate) fn in_urn() -> DAffine3 {
    DAffine3::from_translation(DVec3::Y * 1.07) * DAffine3::from_scale(DVec3::new(0.75, 0.7, 0.75))
}

/// A stone trough 1.5 m long along x, standing on y = 0.
pub(crate) fn trough() -> Soup {
    let mut soup = Soup::default();
    let (x, z, top) = (0.75, 0.27, 0.56);
    for (low, high) in [
        ((-x, -z), (x, -z + 0.08)),
        ((-x, z - 0.08), (x, z)),
        ((-x, -z + 0.08), (-x + 0.08, z - 0.08)),
        ((x - 0.08, -z + 0.08), (x, z - 0.08)),
    ] {
        soup.append(bevelled(DVec3::new(low.0, 0.08, low.1), DVec3::new(high.0, top, high.1), 0.012));
    }
    soup.append(bevelled(DVec3::new(-x - 0.04, -0.05, -z - 0.04), DVec3::new(x + 0.04, 0.10, z + 0.04), 0.02));
    soup.box_mapped(1.0)
}

pub(crate) fn trough_soil() -> Soup {
    bevelled(DVec3::new(-0.68, 0.09, -0.20), DVec3::new(0.68, 0.50, 0.20), 0.02).box_mapped(0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_card_shows_only_its_own_cell() {
        let mesh = card(FROND, DVec3::ZERO, DVec3::Y, DVec3::X * 0.3, DVec2::new(0.1, -0.2)).weld(60.0);
        assert_eq!(mesh.triangle_count(), 4);
        assert!(mesh.uvs.iter().all(|uv| uv.x < 0.5 && uv.y > 0.5), "{:?}", mesh.uvs);
    }
}
