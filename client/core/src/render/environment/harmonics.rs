//! Irradiance from all around as spherical harmonics of order 2 (Ramamoorthi and Hanrahan, "An Efficient Representation
//! for Irradiance Environment Maps", 2001).

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use super::cube::Cube;

/// Coefficients of 1, y, z, x, xy, yz, 3z² − 1, xz and x² − y²; their sum for a normal is the irradiance over π.
pub(crate) type Harmonics = [Vec3; 9];

/// The functions, without their norms.
fn basis(n: DVec3) -> [f64; 9] {
    [1.0, n.y, n.z, n.x, n.x * n.y, n.y * n.z, 3.0 * n.z * n.z - 1.0, n.x * n.z, n.x * n.x - n.y * n.y]
}

/// Squared norms of the functions times the share of each order that a cosine lobe keeps: π, 2π/3 and π/4 over π.
const WEIGHTS: [f64; 9] = [
    1.0 / (4.0 * PI),
    3.0 / (4.0 * PI) * 2.0 / 3.0,
    3.0 / (4.0 * PI) * 2.0 / 3.0,
    3.0 / (4.0 * PI) * 2.0 / 3.0,
    15.0 / (4.0 * PI) / 4.0,
    15.0 / (4.0 * PI) / 4.0,
    5.0 / (16.0 * PI) / 4.0,
    15.0 / (4.0 * PI) / 4.0,
    15.0 / (16.0 * PI) / 4.0,
];

pub(crate) fn project(cube: &Cube) -> Harmonics {
    let mut sums = [DVec3::ZERO; 9];
    cube.integrate(|direction, angle, radiance| {
        for (sum, value) in sums.iter_mut().zip(basis(direction)) {
            *sum += radiance * (angle * value);
        }
    });
    let mut harmonics = [Vec3::ZERO; 9];
    for ((coefficient, sum), weight) in harmonics.iter_mut().zip(sums).zip(WEIGHTS) {
        *coefficient = (sum * weight).as_vec3();
    }
    harmonics
}

/// Returns the irradiance over π of a surface with this normal, as `environment.wgsl` computes it.
pub(crate) fn irradiance(harmonics: &Harmonics, normal: Vec3) -> Vec3 {
    let sum: DVec3 =
        harmonics.iter().zip(basis(normal.as_dvec3())).map(|(factor, value)| factor.as_dvec3() * value).sum();
    sum.as_vec3().max(Vec3::ZERO)
}

#[cfg(test)]
mod tests {
    use super::*;

    const NORMALS: [Vec3; 5] = [Vec3::X, Vec3::Y, Vec3::NEG_Z, Vec3::new(0.6, 0.0, -0.8), Vec3::new(0.48, -0.6, 0.64)];

    #[test]
    fn an_even_environment_lights_all_sides_alike() {
        let harmonics = project(&Cube::new(64, |_| Vec3::new(1.0, 2.0, 4.0)));
        for normal in NORMALS {
            // π times the radiance, over π. The midpoint rule's error falls with the square of the side.
            let found = irradiance(&harmonics, normal);
            assert!((found / Vec3::new(1.0, 2.0, 4.0) - 1.0).abs().max_element() < 1.0 / (64.0 * 64.0), "{found}");
        }
    }

    #[test]
    fn two_halves_light_as_the_integral_says() {
        // Radiance 1 above, 0 below: (1 + cos) / 2 of it arrives, which has no part beyond order 1.
        let harmonics = project(&Cube::new(64, |direction| Vec3::splat(f32::from(u8::from(direction.y > 0.0)))));
        for normal in NORMALS {
            let found = irradiance(&harmonics, normal).x;
            assert!((found - (0.5 + 0.5 * normal.y)).abs() < 1e-3, "{normal}: {found}");
        }
    }

    #[test]
    fn a_light_from_one_side_lights_that_side() {
        let direction = Vec3::new(0.6, 0.0, -0.8);
        let cube = Cube::new(64, |d| if d.dot(direction) > 0.99 { Vec3::splat(100.0) } else { Vec3::ZERO });
        let harmonics = project(&cube);
        let exact = |normal: Vec3| {
            let mut sum = 0.0;
            cube.integrate(|d, angle, radiance| sum += angle * radiance.x * d.dot(normal.as_dvec3()).max(0.0));
            sum / PI
        };
        let most = exact(direction);
        for normal in NORMALS.into_iter().chain([direction, -direction]) {
            // max(c, 0) differs most from 1/4 + c/2 + 5/32 (3c² − 1) at c = 0: by 3/32. The source is 16° wide, and
            // `most` is 1 % less than it gives head-on.
            let error = f64::from(irradiance(&harmonics, normal).x) - exact(normal);
            assert!(error.abs() < 3.0 / 32.0 * 1.01 * most, "{normal}: {error} of {most}");
        }
    }
}
