//! The atlas of leaves, with alpha: a twig, a broad leaf, a frond, and a tuft of blades with flowers.

use glam::{DVec2, DVec3, DVec4};

use super::super::rng::Rng;
use super::{Picture, clouds, step};

/// Cells of the atlas, 2 × 2, each with its foot in the middle of its lower edge.
pub(crate) const TWIG: usize = 0;
pub(crate) const BROAD: usize = 1;
pub(crate) const FROND: usize = 2;
pub(crate) const TUFT: usize = 3;

const SIZE: u32 = 512;
/// Softness of an edge, in cells: about a pixel and a half, so that a cutoff at ½ follows the drawn edge.
const SOFT: f64 = 1.5 / 256.0;
/// Colour of transparent pixels: filtering mixes it into the edges, so it is leaf green.
const GROUND: DVec3 = DVec3::new(0.30, 0.42, 0.16);

struct Leaflet {
    foot: DVec2,
    along: DVec2,
    length: f64,
    half_width: f64,
    /// Place of the greatest width: 1 in the middle, more towards the tip.
    belly: f64,
    color: DVec3,
}

impl Leaflet {
    /// Cover (0 to 1) and colour at `p`, in cell coordinates with y up.
    fn sample(&self, p: DVec2) -> (f64, DVec3) {
        let local = p - self.foot;
        let t = local.dot(self.along) / self.length;
        let s = local.perp_dot(self.along);
        if !(0.0..=1.0).contains(&t) {
            return (0.0, self.color);
        }
        let width = self.half_width * (std::f64::consts::PI * t.powf(self.belly)).sin().max(0.0).powf(0.8);
        let cover = 1.0 - step(-SOFT, SOFT, s.abs() - width);
        let rib = 1.0 - step(0.0, 0.006 + 0.006 * (1.0 - t), s.abs());
        let veins = ((t * 9.0 - s.abs() / self.half_width.max(1e-6) * 1.5) * std::f64::consts::TAU).sin();
        let half = if s > 0.0 { 0.05 } else { -0.05 };
        let shade = self.color * (1.0 + half + 0.05 * veins - 0.12 * (1.0 - t));
        (cover, shade.lerp(DVec3::new(0.62, 0.68, 0.36), 0.55 * rib))
    }
}

pub(crate) fn atlas() -> Picture {
    let cells = [twig(), broad(), frond(), tuft()];
    Picture::new(SIZE, move |uv| {
        let cell = usize::from(uv.x >= 0.5) + 2 * usize::from(uv.y >= 0.5);
        let inside = (uv * 2.0).fract_gl();
        let p = DVec2::new(inside.x, 1.0 - inside.y);
        // Nothing touches a cell's edge, except at its foot.
        let frame = step(0.0, 0.02, p.x.min(1.0 - p.x).min(1.0 - p.y));
        let mut color = GROUND;
        let mut cover = 0.0f64;
        for leaflet in &cells[cell] {
            let (own, shade) = leaflet.sample(p);
            color = color.lerp(shade * (1.0 + 0.05 * clouds(uv, 8, 2, 91)), step(0.2, 0.6, own));
            cover = cover.max(own);
        }
        DVec4::from((color.clamp(DVec3::ZERO, DVec3::ONE), cover * frame))
    })
}

fn green(rng: &mut Rng, base: DVec3) -> DVec3 {
    base * rng.between(0.82, 1.15)
        + DVec3::new(rng.between(-0.02, 0.05), rng.between(-0.02, 0.03), rng.between(-0.02, 0.02))
}

/// A straight stem as a very thin leaflet.
fn stem(foot: DVec2, tip: DVec2, half_width: f64) -> Leaflet {
    let along = tip - foot;
    Leaflet {
        foot,
        along: along.normalize(),
        length: along.length() * 1.25,
        half_width,
        belly: 0.55,
        color: DVec3::new(0.36, 0.33, 0.16),
    }
}

fn twig() -> Vec<Leaflet> {
    let mut rng = Rng::new(0x71);
    let mut leaflets = vec![stem(DVec2::new(0.5, 0.0), DVec2::new(0.5, 0.8), 0.012)];
    for k in 0..13u8 {
        let t = f64::from(k) / 12.0;
        let side = if k % 2 == 0 { 1.0 } else { -1.0 };
        let angle = if k == 12 { 90.0 } else { 90.0 - side * rng.between(38.0, 72.0) * (1.0 - 0.35 * t) };
        leaflets.push(Leaflet {
            foot: DVec2::new(0.5, 0.06 + 0.66 * t),
            along: DVec2::from_angle(f64::to_radians(angle)),
            length: rng.between(0.24, 0.34) * (1.1 - 0.25 * t),
            half_width: rng.between(0.058, 0.08),
            belly: 0.85,
            color: green(&mut rng, DVec3::new(0.36, 0.52, 0.17)),
        });
    }
    leaflets
}

fn broad() -> Vec<Leaflet> {
    let mut rng = Rng::new(0x72);
    let mut leaflets = vec![stem(DVec2::new(0.5, 0.0), DVec2::new(0.5, 0.25), 0.016)];
    leaflets.push(Leaflet {
        foot: DVec2::new(0.5, 0.1),
        along: DVec2::Y,
        length: 0.86,
        half_width: 0.27,
        belly: 0.75,
        color: green(&mut rng, DVec3::new(0.20, 0.42, 0.20)),
    });
    leaflets
}

fn frond() -> Vec<Leaflet> {
    let mut rng = Rng::new(0x73);
    let mut leaflets = vec![stem(DVec2::new(0.5, 0.0), DVec2::new(0.5, 0.85), 0.014)];
    for k in 0..34u8 {
        let t = f64::from(k / 2) / 16.5;
        let side = if k % 2 == 0 { 1.0 } else { -1.0 };
        let angle = 90.0 - side * (62.0 - 34.0 * t);
        leaflets.push(Leaflet {
            foot: DVec2::new(0.5, 0.06 + 0.74 * t),
            along: DVec2::from_angle(f64::to_radians(angle)),
            length: (0.46 * (std::f64::consts::PI * (0.12 + 0.80 * t)).sin()).max(0.1),
            half_width: 0.019,
            belly: 0.7,
            color: green(&mut rng, DVec3::new(0.27, 0.47, 0.20)),
        });
    }
    leaflets
}

fn tuft() -> Vec<Leaflet> {
    let mut rng = Rng::new(0x74);
    let mut leaflets: Vec<Leaflet> = (0..26u8)
        .map(|_| Leaflet {
            foot: DVec2::new(rng.between(0.36, 0.64), -0.02),
            along: DVec2::from_angle(rng.between(58.0, 122.0f64).to_radians()),
            length: rng.between(0.45, 0.95),
            half_width: rng.between(0.009, 0.016),
            belly: 0.5,
            color: green(&mut rng, DVec3::new(0.40, 0.53, 0.20)),
        })
        .collect();
    for _ in 0..7u8 {
        let tip = DVec2::new(rng.between(0.2, 0.8), rng.between(0.6, 0.88));
        leaflets.push(stem(DVec2::new(0.5, 0.0), tip, 0.007));
        for petal in 0..6u8 {
            leaflets.push(Leaflet {
                foot: tip,
                along: DVec2::from_angle(f64::from(petal) * std::f64::consts::FRAC_PI_3 + tip.x * 9.0),
                length: 0.062,
                half_width: 0.019,
                belly: 1.1,
                color: DVec3::new(0.62, 0.45, 0.80),
            });
        }
    }
    leaflets
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cell_has_a_leaf_and_air_around_it() {
        let decoded = image::load_from_memory(&atlas().png().unwrap()).unwrap().to_rgba8();
        let half = SIZE / 2;
        for (cell, (x, y)) in [(0, 0), (half, 0), (0, half), (half, half)].into_iter().enumerate() {
            let solid = (0..half * half).filter(|i| decoded.get_pixel(x + i % half, y + i / half)[3] > 127).count();
            let share = solid as f64 / f64::from(half * half);
            assert!((0.08..0.75).contains(&share), "cell {cell} is {share} covered");
        }
    }
}
