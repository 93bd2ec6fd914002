//! Which lights a scene keeps.
//!
//! Lights that are off take no plane of a mask, unless all are off. Of more than a mask has planes for, the strongest
//! are kept: directional lights count by their illuminance, others by what they bring to a surface at half the scene's
//! diagonal. A scene without lights gets a sun.

use glam::{DVec3, Vec3};

use crate::{
    Light, LightKind, LoadOptions, LoadReport, Scene, error::SceneError, limits::MAX_LIGHTS, reader::WarningKind,
};

/// Way of the default sun's light: from the upper right, in front of what faces +Z as glTF's models do.
const SUN_DIRECTION: Vec3 = Vec3::new(-0.4, -0.8, -0.45);

/// Illuminance of the default sun, in lux. White paper that faces it sends out as much as a surface whose emissive
/// factor is 1: lamps and screens of scenes without lights are made for such a sun.
const SUN_LUX: f32 = std::f32::consts::PI;

/// Leaves the scene with 1 to 32 lights.
/// Errors if there are none and none is to be added, or fewer than the options ask for.
pub(crate) fn choose(scene: &mut Scene, options: &LoadOptions, report: &mut LoadReport) -> Result<(), SceneError> {
    let shines: Vec<bool> = (0..).zip(&scene.lights).map(|(index, light)| ever_shines(scene, index, light)).collect();
    let off = shines.iter().filter(|shines| !**shines).count();
    if off < scene.lights.len() {
        keep(scene, |index| shines.get(index) == Some(&true));
        report.add(WarningKind::LeftOut, "lights that are off", "", off as u64);
    }
    let available = scene.lights.len();
    if let Some(requested) = options.max_lights {
        let count = usize::try_from(requested).ok().filter(|count| (1..=MAX_LIGHTS).contains(count));
        match count {
            Some(count) if count <= available => keep(scene, |index| index < count),
            // The sun is one light.
            Some(1) if available == 0 && options.default_light => {}
            _ if available == 0 && !options.default_light => return Err(SceneError::NoLights),
            _ => return Err(SceneError::LightCount { requested, available }),
        }
    }
    if scene.lights.len() > MAX_LIGHTS {
        keep_strongest(scene);
        let what = format!("lights beyond the {MAX_LIGHTS} that fit a mask: the strongest are kept");
        report.add(WarningKind::LeftOut, what, "", (available - MAX_LIGHTS) as u64);
    }
    if scene.lights.is_empty() {
        if !options.default_light {
            return Err(SceneError::NoLights);
        }
        scene.lights.push(sun());
        report.add(WarningKind::Note, "no lights: a default sun shines (--default-light off leaves it out)", "", 1);
    }
    Ok(())
}

fn keep_strongest(scene: &mut Scene) {
    let radius = (scene.bounds.max - scene.bounds.min).as_dvec3().length() / 2.0;
    let mut order: Vec<(f64, usize)> =
        scene.lights.iter().enumerate().map(|(index, light)| (strength(light, radius), index)).collect();
    // Stable: of equal lights, the first ones stay.
    order.sort_by(|(a, _), (b, _)| b.total_cmp(a));
    let kept: Vec<usize> = order.into_iter().take(MAX_LIGHTS).map(|(_, index)| index).collect();
    keep(scene, |index| kept.contains(&index));
}

/// Returns whether a light is on at some time.
fn ever_shines(scene: &Scene, index: u32, light: &Light) -> bool {
    let moving = scene.animation.iter().flat_map(|animation| &animation.lights).find(|moving| moving.light == index);
    light.shines() || moving.is_some_and(|moving| moving.intensity_track.is_some() || moving.color_track.is_some())
}

/// Keeps lights by their index, and what moves them.
fn keep(scene: &mut Scene, kept: impl Fn(usize) -> bool) {
    let mut index = 0..;
    scene.lights.retain(|_| index.next().is_some_and(&kept));
    if let Some(animation) = &mut scene.animation {
        animation.lights.retain(|moving| kept(moving.light as usize));
        for moving in &mut animation.lights {
            let before = (0..moving.light).filter(|index| kept(*index as usize)).count();
            // Fewer than it was.
            moving.light = u32::try_from(before).unwrap_or(moving.light);
        }
    }
    drop_if_empty(scene);
}

/// Leaves the scene without an animation if nothing moves any more.
pub(crate) fn drop_if_empty(scene: &mut Scene) {
    if scene.animation.as_ref().is_some_and(|animation| animation.is_empty()) {
        scene.animation = None;
    }
}

/// Returns what a light brings to a surface that faces it, in lux.
fn strength(light: &Light, radius_m: f64) -> f64 {
    let luminance = light.color.as_dvec3().dot(DVec3::new(0.2126, 0.7152, 0.0722));
    let strength = luminance * f64::from(light.intensity);
    match light.kind {
        LightKind::Directional => strength,
        LightKind::Point | LightKind::Spot { .. } => strength / (radius_m * radius_m).max(f64::MIN_POSITIVE),
    }
}

fn sun() -> Light {
    Light {
        name: "default sun".to_owned(),
        kind: LightKind::Directional,
        position: Vec3::ZERO,
        direction: SUN_DIRECTION.normalize(),
        color: Vec3::ONE,
        intensity: SUN_LUX,
        range_m: f32::INFINITY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::check::tests::scene;

    fn chosen(lights: Vec<Light>) -> (Vec<f32>, LoadReport) {
        let mut scene = Scene { lights, ..scene() };
        let mut report = LoadReport::default();
        choose(&mut scene, &LoadOptions::default(), &mut report).unwrap();
        assert_eq!(scene.check(), Ok(()));
        (scene.lights.iter().map(|light| light.intensity).collect(), report)
    }

    fn lamp(intensity: u8) -> Light {
        Light { kind: LightKind::Point, intensity: intensity.into(), ..sun() }
    }

    #[test]
    fn lights_that_are_off_take_no_plane_unless_all_are() {
        assert_eq!(chosen(vec![lamp(0), lamp(2), lamp(0)]).0, [2.0]);
        let (lights, report) = chosen(vec![lamp(0), lamp(0)]);
        assert!(lights == [0.0, 0.0] && report.is_empty(), "{report}");
        let mut black = lamp(3);
        black.color = Vec3::ZERO;
        assert_eq!(chosen(vec![black, lamp(1)]).0, [1.0]);
    }

    #[test]
    fn the_strongest_are_kept_in_the_files_order() {
        let (lights, report) =
            chosen((0..40).map(|number| lamp(if number % 5 == 0 { 1 } else { 50 + number })).collect());
        assert_eq!(lights.len(), MAX_LIGHTS);
        assert!(lights.is_sorted() && lights[0] == 51.0, "{lights:?}");
        assert!(report.to_string().contains("strongest are kept (8×)"), "{report}");
        // The scene's diagonal is √2 m, so that a candela brings 2 lux at half of it.
        let mut many = vec![lamp(4); 32];
        many.push(Light { intensity: 7.0, ..sun() });
        assert_eq!(chosen(many.clone()).0, [4.0; 32]);
        many[32].intensity = 9.0;
        assert_eq!(chosen(many).0.last(), Some(&9.0));
    }

    #[test]
    fn a_scene_without_lights_gets_a_sun_or_an_error() {
        let (lights, report) = chosen(Vec::new());
        assert_eq!(lights, [SUN_LUX]);
        assert!(report.to_string().contains("default sun"), "{report}");
        let mut scene = Scene { lights: Vec::new(), ..scene() };
        let options = LoadOptions { default_light: false, ..LoadOptions::default() };
        let error = choose(&mut scene, &options, &mut LoadReport::default());
        assert!(matches!(error, Err(SceneError::NoLights)));
    }
}
