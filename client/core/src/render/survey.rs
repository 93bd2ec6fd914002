//! How bright a scene is where the first camera looks: what the light around is made from, before a picture is drawn.
//!
//! Rays of a coarse picture meet the scene's largest triangles ([`Occluders`]). Each point that they meet is lit by all
//! lights that those triangles do not hide. A plain that no camera sees, however large, does not count.

use glam::Vec3;
use gnomon_scene::{
    Light, LightKind, Scene,
    camera::{Camera, Space},
};
use gnomon_shaders::shading;
use serde::{Deserialize, Serialize};

use super::exposure::{sample_points, unhidden_lux};
use crate::occluders::Occluders;

/// Rays of the coarse picture.
const COLUMNS: u32 = 24;
const ROWS: u32 = 14;

/// Fewer points say too little: the scene's surfaces are sampled by area instead.
const ENOUGH: usize = 24;

/// Share of the lit points that receive less than what is called typical.
const PERCENTILE: f32 = 0.70;

/// Least share of daylight: walls of any room pass some on.
const LEAST_DAYLIGHT: f32 = 0.02;

/// What light there is, in lux.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Survey {
    /// From all lights, typically.
    pub lux: f32,
    /// From lamps alone, typically.
    pub lamp_lux: f32,
    /// The intensity of all lamps that gives this much. If all are off, each is taken for one of 1 cd: some may shine
    /// later.
    pub lamps: f32,
    /// Share of the sky's light that arrives: 1 outdoors, little in a closed room.
    pub daylight: f32,
}

impl Default for Survey {
    /// Outdoors, without lamps.
    fn default() -> Self {
        Self { lux: 1.0, lamp_lux: 0.0, lamps: 0.0, daylight: 1.0 }
    }
}

impl Survey {
    #[must_use]
    pub fn new(scene: &Scene, occluders: &Occluders, camera: &Camera) -> Self {
        let reach = (scene.bounds.max - scene.bounds.min).length();
        let mut points = seen_points(scene, occluders, camera);
        if points.len() < ENOUGH {
            points = sample_points(scene);
        }
        let mut lights: Vec<shading::Light> =
            scene.lights.iter().map(|light| shading::Light::new(light, 1.0).in_space(Space::of(scene))).collect();
        let is_sun: Vec<bool> = scene.lights.iter().map(|light| light.kind == LightKind::Directional).collect();
        let mut power = power_of_lamps(&scene.lights, u32::MAX);
        let are_off = power == 0.0;
        if are_off {
            for (light, _) in lights.iter_mut().zip(&is_sun).filter(|(_, is_sun)| !**is_sun) {
                light.intensity = Vec3::ONE;
                power += 1.0;
            }
        }
        let (mut lux, mut lamp_lux) = (Vec::with_capacity(points.len()), Vec::with_capacity(points.len()));
        let (mut sunny, mut open, mut tried) = (0_u16, 0_u16, 0_u16);
        for (index, (point, normal)) in points.iter().enumerate() {
            let (mut sun, mut lamps) = (0.0, 0.0);
            for (light, is_sun) in lights.iter().zip(&is_sun) {
                let received = unhidden_lux(light, *point, *normal, reach, occluders);
                *(if *is_sun { &mut sun } else { &mut lamps }) += received;
            }
            lux.push(if are_off { sun } else { sun + lamps });
            lamp_lux.push(lamps);
            sunny += u16::from(sun > 0.0);
            let direction = scattered(*normal, index);
            if direction.y > 0.0 {
                tried += 1;
                open += u16::from(!occluders.blocks(*point, direction, reach * 1e-4, reach * 2.0));
            }
        }
        #[expect(clippy::cast_precision_loss, reason = "a thousand at most")]
        let count = points.len().max(1) as f32;
        // Half of what the sun lights up is lit again by what that scatters.
        let scattered = f32::from(sunny) / count * 0.5;
        let open = if tried == 0 { 1.0 } else { f32::from(open) / f32::from(tried) };
        Self {
            lux: typical(lux).unwrap_or(1.0),
            lamp_lux: typical(lamp_lux).unwrap_or(0.0),
            lamps: power,
            daylight: open.max(scattered).max(LEAST_DAYLIGHT),
        }
    }
}

/// What the lamps that are on give together; bit k of `on` is 1 if light k is.
pub(super) fn power_of_lamps(lights: &[Light], on: u32) -> f32 {
    let lamps = lights.iter().enumerate().filter(|(_, light)| light.kind != LightKind::Directional);
    let shining = lamps.filter(|(k, _)| on & (1 << k) != 0);
    shining.map(|(_, light)| light.intensity * light.color.max_element()).sum()
}

/// Points that the camera's rays meet, and unit normals towards it.
fn seen_points(scene: &Scene, occluders: &Occluders, camera: &Camera) -> Vec<(Vec3, Vec3)> {
    let coarse = Camera { width: COLUMNS, height: ROWS, ..*camera };
    let reach = ((scene.bounds.max - scene.bounds.min).length() * 4.0).max(f32::MIN_POSITIVE);
    (0..COLUMNS * ROWS)
        .filter_map(|place| {
            let (origin, direction) = coarse.ray(place % COLUMNS, place / COLUMNS);
            let (origin, direction) = ((origin - scene.origin_m).as_vec3(), direction.as_vec3().normalize_or_zero());
            let met = occluders.nearest(origin, direction, reach)?;
            let normal = if met.normal.dot(direction) > 0.0 { -met.normal } else { met.normal };
            Some((origin + direction * met.distance, normal))
        })
        .collect()
}

/// A direction around `normal`, cosine-weighted over many values of `index`.
fn scattered(normal: Vec3, index: usize) -> Vec3 {
    #[expect(clippy::cast_precision_loss, reason = "a thousand at most")]
    let step = index as f32;
    // The R2 sequence (Roberts, 2018) on a sphere; its sum with the normal is cosine-weighted.
    let (z, angle) = ((step * 0.754_877_7).fract() * 2.0 - 1.0, (step * 0.569_840_3).fract() * std::f32::consts::TAU);
    let around = (1.0 - z * z).sqrt();
    (normal + Vec3::new(around * angle.cos(), z, around * angle.sin())).normalize_or(normal)
}

fn typical(mut lux: Vec<f32>) -> Option<f32> {
    lux.retain(|lux| *lux > 0.0 && lux.is_finite());
    lux.sort_unstable_by(f32::total_cmp);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index below the length")]
    #[expect(clippy::cast_precision_loss, reason = "a thousand at most")]
    let place = (lux.len() as f32 * PERCENTILE) as usize;
    lux.get(place).copied()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::testing::{camera, floor_and_lights};

    #[test]
    fn lamps_and_the_sky_are_told_apart() {
        let scene = floor_and_lights();
        let occluders = Occluders::all_of(&scene);
        let survey = Survey::new(&scene, &occluders, &camera(160, 90));
        // Nothing but a small wall hides the sky. The lamp of 40 cd hangs 3 m above the floor.
        assert!(survey.daylight > 0.9, "{survey:?}");
        assert!((1.0..40.0 / 9.0 + 0.1).contains(&survey.lamp_lux), "{survey:?}");
        assert!(survey.lux > survey.lamp_lux && survey.lux < 5.0 * 0.8 + 40.0 / 9.0 + 0.1, "{survey:?}");
        let mut sunny = scene.clone();
        sunny.lights.truncate(1);
        let survey = Survey::new(&sunny, &occluders, &camera(160, 90));
        assert!(survey.lamp_lux == 0.0 && (survey.lux - 4.0).abs() < 1e-3, "{survey:?}");
    }

    #[test]
    fn a_roof_keeps_daylight_out() {
        let mut scene = floor_and_lights();
        let first = u32::try_from(scene.positions.len()).unwrap();
        for (x, z) in [(-40.0, -40.0), (40.0, -40.0), (40.0, 40.0), (-40.0, 40.0)] {
            scene.positions.push(Vec3::new(x, 2.0, z));
            scene.normals.push(Vec3::NEG_Y);
            scene.uvs.push(glam::Vec2::ZERO);
        }
        scene.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        scene.draws.last_mut().unwrap().triangles += 2;
        let survey = Survey::new(&scene, &Occluders::all_of(&scene), &camera(160, 90));
        // The sky is seen in the last 3° above the horizon only.
        assert!(survey.daylight < 0.05, "{survey:?}");
    }
}
