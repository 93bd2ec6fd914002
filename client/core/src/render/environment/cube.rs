//! Cube maps on the host: radiance by direction, its averages, and what surfaces of a roughness mirror of it.

use std::f32::consts::{PI, TAU};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Directions that a texel of a rough level averages.
const SAMPLES: u16 = 96;

/// Six square faces in the order and orientation of the graphics interfaces: +x −x +y −y +z −z.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Cube {
    pub(crate) side: usize,
    pub(crate) texels: Vec<Vec3>,
}

impl Cube {
    /// Evaluates `radiance` at the centre of every texel.
    pub(crate) fn new(side: usize, radiance: impl Fn(Vec3) -> Vec3 + Sync) -> Self {
        let texels = (0..6 * side * side).into_par_iter().map(|place| radiance(direction(side, place))).collect();
        Self { side, texels }
    }

    pub(crate) fn black() -> Self {
        Self { side: 1, texels: vec![Vec3::ZERO; 6] }
    }

    /// Returns this and ever smaller cubes, each the average of the last, down to one texel a face.
    fn averages(self) -> Vec<Self> {
        let mut levels = vec![self];
        while let Some(last) = levels.last().filter(|last| last.side > 1) {
            let (from, side) = (last.side, last.side / 2);
            let texels = (0..6 * side * side).map(|place| {
                let (face, y, x) = (place / (side * side), place / side % side, place % side);
                let at = |dx, dy| last.texels[(face * from + 2 * y + dy) * from + 2 * x + dx];
                (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1)) * 0.25
            });
            let texels = texels.collect();
            levels.push(Self { side, texels });
        }
        levels
    }

    /// Returns what surfaces mirror, `levels` cubes for roughness 0 to 1, each half as large as the last.
    ///
    /// A surface is taken to be looked at head-on, as in the split sum of Karis ("Real Shading in Unreal Engine 4",
    /// 2013), and its microfacets to follow GGX.
    pub(crate) fn mirrored(self, levels: usize) -> Vec<Self> {
        let averages = self.averages();
        let mut all = vec![averages[0].clone()];
        for level in 1..levels {
            #[expect(clippy::cast_precision_loss, reason = "a few")]
            let roughness = level as f32 / (levels - 1) as f32;
            let side = (averages[0].side >> level).max(1);
            let lobe = lobe(roughness, averages[0].side);
            all.push(Self::new(side, |normal| average(&averages, normal, &lobe)));
        }
        all
    }

    /// Reads the texels around a direction, without those across a face's edge.
    pub(crate) fn read(&self, direction: Vec3) -> Vec3 {
        let (face, u, v) = face_of(direction);
        #[expect(clippy::cast_precision_loss, reason = "sides are far below 2²⁴")]
        let (side, most) = (self.side as f32, (self.side - 1) as f32);
        let place = |t: f32| ((t * 0.5 + 0.5) * side - 0.5).clamp(0.0, most);
        let (x, y) = (place(u), place(v));
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the face")]
        let (left, top) = (x as usize, y as usize);
        let (right, bottom) = ((left + 1).min(self.side - 1), (top + 1).min(self.side - 1));
        let at = |x: usize, y: usize| self.texels[(face * self.side + y) * self.side + x];
        let upper = at(left, top).lerp(at(right, top), x.fract());
        upper.lerp(at(left, bottom).lerp(at(right, bottom), x.fract()), y.fract())
    }

    /// Calls `visit` with the direction, the solid angle and the radiance of each texel.
    pub(crate) fn integrate(&self, mut visit: impl FnMut(DVec3, f64, DVec3)) {
        #[expect(clippy::cast_precision_loss, reason = "sides are far below 2⁵³")]
        let width = 2.0 / self.side as f64;
        for (place, radiance) in self.texels.iter().enumerate() {
            // The corner of a face's square is farther away and seen at an angle.
            let on_face = unit_face(self.side, place);
            let squared = on_face.length_squared();
            visit(on_face / squared.sqrt(), width * width / (squared * squared.sqrt()), radiance.as_dvec3());
        }
    }
}

/// A direction of light around a normal along z, its weight, and the level of averages that stands for its share.
struct Sample {
    toward: Vec3,
    weight: f32,
    level: usize,
}

fn lobe(roughness: f32, side: usize) -> Vec<Sample> {
    let alpha_squared = roughness.powi(4);
    #[expect(clippy::cast_precision_loss, reason = "sides are far below 2²⁴")]
    let texel = 4.0 * PI / (6.0 * (side * side) as f32);
    let samples = (0..SAMPLES).filter_map(|index| {
        // Hammersley's points, and the half vector of GGX for each (Karis, 2013).
        let (u, v) = ((f32::from(index) + 0.5) / f32::from(SAMPLES), f32::from(index.reverse_bits()) / 65536.0);
        let cosine = ((1.0 - u) / (1.0 + (alpha_squared - 1.0) * u)).sqrt();
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        let half = Vec3::new(sine * (TAU * v).cos(), sine * (TAU * v).sin(), cosine);
        let toward = half * (2.0 * cosine) - Vec3::Z;
        let density = {
            let below = cosine * cosine * (alpha_squared - 1.0) + 1.0;
            alpha_squared / (PI * below * below) / 4.0
        };
        let share = 1.0 / (f32::from(SAMPLES) * density);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the levels")]
        let level = (0.5 * (share / texel).log2() + 1.0).round().clamp(0.0, side.ilog2() as f32) as usize;
        (toward.z > 0.0).then_some(Sample { toward, weight: toward.z, level })
    });
    samples.collect()
}

fn average(averages: &[Cube], normal: Vec3, lobe: &[Sample]) -> Vec3 {
    let (across, along) = normal.any_orthonormal_pair();
    let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
    for Sample { toward, weight, level } in lobe {
        let direction = across * toward.x + along * toward.y + normal * toward.z;
        sum += averages[*level].read(direction) * *weight;
        weights += weight;
    }
    sum / weights
}

/// Unit vector to the centre of a texel.
pub(crate) fn direction(side: usize, place: usize) -> Vec3 {
    unit_face(side, place).normalize().as_vec3()
}

/// The centre of a texel on the cube from −1 to 1.
fn unit_face(side: usize, place: usize) -> DVec3 {
    let (face, y, x) = (place / (side * side), place / side % side, place % side);
    #[expect(clippy::cast_precision_loss, reason = "sides are far below 2⁵³")]
    let at = |i: usize| (2 * i + 1) as f64 / side as f64 - 1.0;
    let (u, v) = (at(x), at(y));
    match face {
        0 => DVec3::new(1.0, -v, -u),
        1 => DVec3::new(-1.0, -v, u),
        2 => DVec3::new(u, 1.0, v),
        3 => DVec3::new(u, -1.0, -v),
        4 => DVec3::new(u, -v, 1.0),
        _ => DVec3::new(-u, -v, -1.0),
    }
}

/// The face that a direction meets, and where, from −1 to 1.
fn face_of(d: Vec3) -> (usize, f32, f32) {
    let a = d.abs();
    if a.x >= a.y && a.x >= a.z {
        let face = usize::from(d.x < 0.0);
        (face, if face == 0 { -d.z } else { d.z } / a.x, -d.y / a.x)
    } else if a.y >= a.z {
        let face = usize::from(d.y < 0.0);
        (2 + face, d.x / a.y, if face == 0 { d.z } else { -d.z } / a.y)
    } else {
        let face = usize::from(d.z < 0.0);
        (4 + face, if face == 0 { d.x } else { -d.x } / a.z, -d.y / a.z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_texel_is_found_in_its_direction() {
        for place in 0..6 * 16 * 16 {
            let mut cube = Cube { side: 16, texels: vec![Vec3::ZERO; 6 * 16 * 16] };
            cube.texels[place] = Vec3::ONE;
            let found = cube.read(direction(16, place));
            assert!((found - Vec3::ONE).length() < 1e-4, "{place}: {found}");
        }
    }

    #[test]
    fn solid_angles_make_a_sphere() {
        let (mut sum, mut cosine) = (0.0, 0.0);
        Cube::black().integrate(|_, angle, _| sum += angle);
        // One texel a face: the midpoint rule is coarse.
        assert!(sum > 4.0 * std::f64::consts::PI);
        sum = 0.0;
        Cube::new(64, |_| Vec3::ONE).integrate(|direction, angle, _| {
            sum += angle;
            cosine += angle * direction.y.max(0.0);
        });
        // The midpoint rule's error falls with the square of the side.
        assert!((sum / (4.0 * std::f64::consts::PI) - 1.0).abs() < 1.0 / (64.0 * 64.0), "{sum}");
        assert!((cosine / std::f64::consts::PI - 1.0).abs() < 1e-3, "{cosine}");
    }

    #[test]
    fn an_even_environment_stays_even() {
        for (level, cube) in Cube::new(32, |_| Vec3::new(0.5, 2.0, 8.0)).mirrored(6).iter().enumerate() {
            assert_eq!(cube.side, 32 >> level);
            for texel in &cube.texels {
                assert!((*texel - Vec3::new(0.5, 2.0, 8.0)).abs().max_element() < 1e-4, "{level}: {texel}");
            }
        }
    }

    #[test]
    fn rougher_levels_blur_more_and_around_the_same_direction() {
        let spot = |d: Vec3| if d.dot(Vec3::new(0.6, 0.8, 0.0)) > 0.97 { Vec3::splat(10.0) } else { Vec3::ZERO };
        let levels = Cube::new(64, spot).mirrored(6);
        let seen: Vec<f32> = levels.iter().map(|cube| cube.read(Vec3::new(0.6, 0.8, 0.0)).x).collect();
        assert!(seen.windows(2).all(|pair| pair[1] < pair[0] + 1e-3), "{seen:?}");
        let away: Vec<f32> = levels.iter().map(|cube| cube.read(Vec3::new(-0.6, -0.8, 0.0)).x).collect();
        // At roughness 1 the lobe covers the hemisphere only.
        assert!(seen[5] > 0.05 && away.iter().all(|dark| *dark < seen[5] * 0.5), "{seen:?} {away:?}");
    }
}
