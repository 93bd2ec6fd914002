//! A clear sky from the scene's suns: its directional lights that come from above. Without any, it is night.

use glam::{Vec3, Vec4};
use gnomon_scene::{Light, LightKind};

/// Radiance at the zenith and at the horizon when the sun stands high, as shares of what white paint shows of the sun.
/// A clear sky gives a sixth of the sun's light, and is brighter and paler near the horizon.
const ZENITH: Vec3 = Vec3::new(0.100, 0.155, 0.265);
const HORIZON: Vec3 = Vec3::new(0.40, 0.45, 0.50);

/// Radiance around the sun, and how fast it fades with the angle.
const GLOW: Vec3 = Vec3::new(0.16, 0.13, 0.09);
const GLOW_POWER: i32 = 12;

/// Radiance of the ground below a high sun: soil.
const GROUND: Vec3 = Vec3::new(0.205, 0.190, 0.170);

/// Share of the sky that is left when the sun is at the horizon.
const LOW_SUN: f32 = 0.35;

/// Share of the sun's colour that the sky takes over.
const TINT: f32 = 0.5;

/// Luminance of linear sRGB.
const LUMINANCE: Vec3 = Vec3::new(0.2126, 0.7152, 0.0722);

/// What the suns of a scene add up to.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Sun {
    toward: Vec3,
    /// Colour times illuminance, in lux.
    lux: Vec3,
}

/// The illuminance that suns give together, in lux, on surfaces that face them.
pub(super) fn sun_lux<'a>(lights: impl IntoIterator<Item = &'a Light>) -> f32 {
    lights.into_iter().filter_map(sun).map(|sun| sun.lux.dot(LUMINANCE)).sum()
}

/// Returns a light as a sun, if it shines from above.
fn sun(light: &Light) -> Option<Sun> {
    let shines = light.kind == LightKind::Directional && light.direction.y < 0.0;
    let lux = light.color * light.intensity;
    (shines && lux.dot(LUMINANCE) > 0.0).then_some(Sun { toward: -light.direction, lux })
}

/// Returns what a sky is made of, in steps too small to be seen: each sun's direction, to a degree, and its share of
/// the light, to a percent.
pub(super) fn rough(lights: &[Light]) -> Vec<Vec4> {
    let suns: Vec<Sun> = lights.iter().filter_map(sun).collect();
    let total = suns.iter().map(|sun| sun.lux.dot(LUMINANCE)).sum::<f32>().max(f32::MIN_POSITIVE);
    let step = |sun: &Sun| {
        let shares = (sun.lux / total * 100.0).round();
        [(sun.toward * 57.0).round().extend(shares.x), shares.extend(0.0)]
    };
    suns.iter().flat_map(step).collect()
}

/// Returns the sky's radiance by direction, as a share of what white paint shows of all suns together.
pub(super) fn radiance(lights: &[Light]) -> impl Fn(Vec3) -> Vec3 + Sync + use<> {
    let suns: Vec<Sun> = lights.iter().filter_map(sun).collect();
    let total = suns.iter().map(|sun| sun.lux.dot(LUMINANCE)).sum::<f32>().max(f32::MIN_POSITIVE);
    move |direction: Vec3| suns.iter().map(|sun| of_sun(*sun, direction) / total).sum()
}

fn of_sun(Sun { toward, lux }: Sun, direction: Vec3) -> Vec3 {
    let luminance = lux.dot(LUMINANCE);
    let tinted = Vec3::splat(luminance).lerp(lux, TINT);
    let height = LOW_SUN + (1.0 - LOW_SUN) * toward.y;
    let up = direction.y;
    let sky = HORIZON.lerp(ZENITH, up.max(0.0).sqrt()) + GLOW * direction.dot(toward).max(0.0).powi(GLOW_POWER);
    // Haze hides where the ground begins.
    let below = (-up * 2.5).clamp(0.0, 1.0);
    let below = below * below * (3.0 - 2.0 * below);
    tinted * (sky * height).lerp(GROUND * toward.y, below)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::testing::floor_and_lights;

    #[test]
    fn the_sky_follows_the_sun() {
        let mut lights = floor_and_lights().lights;
        assert!((sun_lux(&lights) - 5.0).abs() < 1e-4);
        let day = radiance(&lights);
        let toward = -lights[0].direction;
        assert!(day(toward).length() > day(Vec3::new(-toward.x, toward.y, toward.z)).length());
        assert!(day(Vec3::X).length() > day(Vec3::Y).length() && day(Vec3::Y).z > day(Vec3::Y).x);
        // A brighter sun changes the unit, not the shares.
        lights[0].intensity *= 7.0;
        let brighter = radiance(&lights);
        assert!((day(Vec3::Y) - brighter(Vec3::Y)).length() < 1e-6);
    }

    #[test]
    fn without_a_sun_above_it_is_night() {
        let mut lights = floor_and_lights().lights;
        lights[0].direction = Vec3::Y;
        for direction in [Vec3::X, Vec3::Y, Vec3::NEG_Y] {
            assert_eq!(radiance(&lights)(direction), Vec3::ZERO);
        }
        lights[0] = Light { direction: Vec3::NEG_Y, intensity: 0.0, ..lights[0].clone() };
        assert_eq!((sun_lux(&lights), radiance(&lights)(Vec3::Y)), (0.0, Vec3::ZERO));
    }
}
