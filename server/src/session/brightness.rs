//! Weights of lights. Changes in a dim light's shadows are less visible, so they are sent later if bandwidth is short.

use glam::Vec3;
use gnomon_protocol::refresh::FULL_WEIGHT;
use gnomon_scene::Scene;
use gnomon_shaders::shading::Light;

/// Returns each light's weight: its mean irradiance over the scene's surfaces, without shadows. The brightest light has
/// [`FULL_WEIGHT`]; the minimum is 1.
pub(crate) fn weights(scene: &Scene) -> Vec<u32> {
    let lights: Vec<Light> = scene.lights.iter().map(|light| Light::new(light, 1.0)).collect();
    let mut totals = vec![0.0_f64; lights.len()];
    for corners in scene.tracing_triangles() {
        let [a, b, c] = corners.map(|index| scene.positions[index as usize]);
        let cross = (b - a).cross(c - a);
        let (area, normal, middle) = (f64::from(cross.length()), cross.normalize_or_zero(), (a + b + c) / 3.0);
        for (sum, light) in totals.iter_mut().zip(&lights) {
            let lux = f64::from(received_lux(light, middle, normal));
            // Infinite for a lamp inside a surface.
            if lux.is_finite() {
                *sum += area * lux;
            }
        }
    }
    let most = totals.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "from 1 to the full weight")]
    let weight = |sum: f64| (sum / most * f64::from(FULL_WEIGHT)).max(1.0) as u32;
    totals.into_iter().map(weight).collect()
}

/// Counts both sides of a surface, since either may be visible.
fn received_lux(light: &Light, point: Vec3, normal: Vec3) -> f32 {
    let (irradiance, toward) = light.arrival(point);
    irradiance.max_element() * normal.dot(toward).abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::visibility::test_scenes;

    #[test]
    fn dim_lights_weigh_less_but_at_least_one() {
        let mut scene = test_scenes::room();
        let bright = scene.lights[0].clone();
        let scaled = |factor: f32| {
            let mut light = bright.clone();
            light.intensity *= factor;
            light
        };
        scene.lights = vec![scaled(0.5), scaled(1.0), scaled(1e-6), scaled(0.0)];
        let [half, full, little, off] = weights(&scene)[..] else { panic!("four lights") };
        assert_eq!((full, little, off), (FULL_WEIGHT, 1, 1));
        assert!(half.abs_diff(FULL_WEIGHT / 2) <= 1, "{half}");
        scene.lights.clear();
        assert!(weights(&scene).is_empty());
    }
}
