//! Exposure, computed from the scene and its lights alone, so that every run shows the same picture.
//!
//! A few hundred points, distributed over the surfaces by area, are lit by every light that the largest triangles
//! ([`Occluders`]) do not hide. The exposure maps a high percentile of their irradiance to a fixed point of the tone
//! curve.

use glam::Vec3;
use gnomon_scene::{Light as SceneLight, Scene, camera::Space, limits::MAX_LIGHTS};
use gnomon_shaders::shading::{Light, Lighting};

use super::predict::shadow_views;
use crate::occluders::Occluders;

const SAMPLES: u16 = 768;

/// Share of the lit points that receive less than the reference.
const PERCENTILE: f64 = 0.70;

/// Exposed irradiance at the reference: white paint there appears slightly below white.
const REFERENCE: f32 = 0.62;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposure {
    /// Exposed irradiance per lux.
    pub scale: f32,
    /// Irradiance at the reference.
    pub reference_lux: f32,
}

impl Exposure {
    /// Returns the exposure that suits `scene`.
    #[must_use]
    pub fn of_scene(scene: &Scene, occluders: &Occluders) -> Self {
        let lights: Vec<Light> =
            scene.lights.iter().map(|light| Light::new(light, 1.0).in_space(Space::of(scene))).collect();
        let reach = (scene.bounds.max - scene.bounds.min).length();
        let mut received: Vec<f32> = sample_points(scene)
            .into_iter()
            .map(|(point, normal)| {
                lights.iter().map(|light| unhidden_lux(light, point, normal, reach, occluders)).sum::<f32>()
            })
            .filter(|lux| *lux > 0.0 && lux.is_finite())
            .collect();
        received.sort_unstable_by(f32::total_cmp);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index below the length")]
        let place = (received.len() as f64 * PERCENTILE) as usize;
        // Nothing is lit: any exposure will do, since the ambient light still shows the scene.
        Self::for_reference(received.get(place).copied().unwrap_or(1.0))
    }

    /// Returns the exposure that shows 1 lux as 2^−EV.
    #[must_use]
    pub fn at_ev(self, ev: f32) -> Self {
        Self { scale: (-ev).exp2(), ..self }
    }

    /// Returns the EV, as [`Self::at_ev`] takes it.
    #[must_use]
    pub fn ev(self) -> f32 {
        -self.scale.log2()
    }

    /// Returns the exposure that shows `lux` as the reference: where every picture starts from.
    #[must_use]
    pub fn for_reference(lux: f32) -> Self {
        let reference_lux = if lux.is_normal() && lux > 0.0 { lux } else { 1.0 };
        Self { scale: REFERENCE / reference_lux, reference_lux }
    }

    /// Returns the same exposure as the one that suits the scene: its reference is what it shows as such.
    #[must_use]
    pub(crate) fn as_reference(self) -> Self {
        Self { reference_lux: REFERENCE / self.scale, ..self }
    }

    /// Returns the lights in the shaders' layout, without light around.
    #[must_use]
    pub fn lighting(self, lights: &[SceneLight], space: Space) -> Lighting {
        let mut lighting = Lighting { lit_from_px: u32::MAX, ..bytemuck::Zeroable::zeroed() };
        let mut shadow_view = 0;
        for (place, light) in lighting.lights.iter_mut().zip(lights) {
            *place = Light { shadow_view, ..Light::new(light, self.scale).in_space(space) };
            shadow_view += shadow_views::views_of(light.kind);
            lighting.count += 1;
        }
        debug_assert!(lights.len() <= MAX_LIGHTS);
        lighting
    }
}

impl From<[f32; 2]> for Exposure {
    fn from([scale, reference_lux]: [f32; 2]) -> Self {
        Self { scale, reference_lux }
    }
}

impl From<Exposure> for [f32; 2] {
    fn from(exposure: Exposure) -> Self {
        [exposure.scale, exposure.reference_lux]
    }
}

/// What a light gives to a point, unless an occluder hides it.
pub(super) fn unhidden_lux(light: &Light, point: Vec3, normal: Vec3, reach: f32, occluders: &Occluders) -> f32 {
    let (irradiance, toward) = light.arrival(point);
    let lux = irradiance.max_element() * normal.dot(toward);
    if lux.is_nan() || lux <= 0.0 {
        return 0.0;
    }
    let distance = if light.kind == 0 { reach } else { light.position.distance(point) };
    if occluders.blocks(point, toward, reach * 1e-4, distance * 0.999) { 0.0 } else { lux }
}

/// Points and normals, distributed evenly by area.
pub(super) fn sample_points(scene: &Scene) -> Vec<(Vec3, Vec3)> {
    let triangles = scene.tracing_triangles();
    let mut total = 0.0;
    let cumulative: Vec<f64> = triangles
        .iter()
        .map(|corners| {
            let [a, b, c] = corners.map(|index| scene.positions[index as usize]);
            total += f64::from((b - a).cross(c - a).length());
            total
        })
        .collect();
    (0..SAMPLES)
        .filter_map(|sample| {
            let wanted = (f64::from(sample) + 0.5) / f64::from(SAMPLES) * total;
            let corners = triangles.get(cumulative.partition_point(|area| *area < wanted))?;
            let [a, b, c] = corners.map(|index| scene.positions[index as usize]);
            let normals = corners.map(|index| scene.normals[index as usize]);
            // The R2 sequence (Roberts, 2018), folded into the triangle.
            let step = f64::from(sample);
            #[expect(clippy::cast_possible_truncation, reason = "rounding is what is wanted")]
            let (u, v) = ((step * 0.754_877_666_246_693).fract() as f32, (step * 0.569_840_290_998_053).fract() as f32);
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            let normal = (normals[0] * (1.0 - u - v) + normals[1] * u + normals[2] * v).normalize_or_zero();
            Some((a + (b - a) * u + (c - a) * v, normal))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::testing::floor_and_lights;

    #[test]
    fn the_exposure_depends_only_on_the_lights() {
        let scene = floor_and_lights();
        let occluders = Occluders::largest_of(&scene);
        let first = Exposure::of_scene(&scene, &occluders);
        assert_eq!(first, Exposure::of_scene(&scene, &occluders));
        let mut brighter = scene.clone();
        brighter.lights.iter_mut().for_each(|light| light.intensity *= 16.0);
        let second = Exposure::of_scene(&brighter, &occluders);
        assert!((second.ev() - first.ev() - 4.0).abs() < 1e-3, "{first:?} {second:?}");
        assert!((first.at_ev(first.ev()).scale / first.scale - 1.0).abs() < 1e-5);
    }

    #[test]
    fn light_that_a_wall_hides_does_not_count() {
        let scene = floor_and_lights();
        let mut hidden = scene.clone();
        // A lamp far below the floor, which hides it from the wall.
        hidden.lights.push(SceneLight {
            position: Vec3::new(0.0, -5.0, 0.0),
            intensity: 1e9,
            ..scene.lights[1].clone()
        });
        let occluders = Occluders::largest_of(&scene);
        assert_eq!(Exposure::of_scene(&scene, &occluders), Exposure::of_scene(&hidden, &occluders));
    }
}
