//! Checks a light from a glTF file or a lights file, and fills in its defaults.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use glam::{DVec3, Vec3};

use crate::{
    Light, LightKind,
    limits::{MAX_COORDINATE_M, MAX_NAME_BYTES, in_reach},
};

/// Exporters round π/2 up to f32.
const CONE_ROUNDING: f64 = 1e-6;

/// A light in world space, unchecked and without the defaults of KHR_lights_punctual.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LightSource<'a> {
    pub(super) name: Option<&'a str>,
    /// "directional", "point" or "spot".
    pub(super) kind: &'a str,
    /// In metres.
    pub(super) position: DVec3,
    /// In which it travels. Any length but zero.
    pub(super) direction: DVec3,
    pub(super) color: Option<[f64; 3]>,
    pub(super) intensity: Option<f64>,
    pub(super) range_m: Option<f64>,
    pub(super) inner_cone_rad: Option<f64>,
    pub(super) outer_cone_rad: Option<f64>,
}

impl LightSource<'_> {
    /// Returns the light of a file whose details may be out of range, relative to the scene's origin, and what was
    /// mended. Everything is read as other viewers do.
    /// Errors with a sentence if it lies out of reach.
    pub(super) fn mended(&self, origin_m: DVec3) -> Result<(Light, Vec<&'static str>), String> {
        let mut mended = self.clone();
        let mut faults = Vec::new();
        let most = f64::from(f32::MAX);
        let mut clamp = |value: &mut f64, most: f64, fault: &'static str| {
            if !(0.0..=most).contains(value) {
                *value = value.clamp(0.0, most);
                faults.push(fault);
            }
        };
        for channel in mended.color.iter_mut().flatten() {
            clamp(channel, most, "a light's colour that is negative or too large");
        }
        if let Some(intensity) = &mut mended.intensity {
            clamp(intensity, most, "a light's intensity that is negative or too large");
        }
        if let Some(outer) = &mut mended.outer_cone_rad {
            clamp(outer, FRAC_PI_2 + CONE_ROUNDING, "a spot's outer cone angle outside 0 to π/2");
        }
        let outer = mended.outer_cone_rad.unwrap_or(FRAC_PI_4);
        if let Some(inner) = &mut mended.inner_cone_rad {
            clamp(inner, outer, "a spot's inner cone angle outside 0 to the outer one");
            // Equal angles break the rule, but mean a sharp edge: exporters write them.
            if self.kind == "spot" && *inner >= outer {
                faults.push("a spot's inner cone angle that is not below the outer one: a sharp edge");
            }
        }
        if let Some(range) = mended.range_m {
            if range <= 0.0 {
                faults.push("a light's range that is not positive: without end");
            }
            // A range that rounds to 0 lights next to nothing; one that rounds to infinity has no end.
            let legal = (range > 0.0).then(|| range.max(f64::from(f32::MIN_POSITIVE)));
            mended.range_m = legal.filter(|range| *range <= most);
        }
        faults.dedup();
        Ok((mended.light(origin_m)?, faults))
    }

    /// Returns the light, relative to the scene's origin.
    /// Errors with a sentence at the first value that is out of range.
    pub(super) fn light(&self, origin_m: DVec3) -> Result<Light, String> {
        let color = self.color.unwrap_or([1.0; 3]);
        let intensity = self.intensity.unwrap_or(1.0);
        let big = f64::from(f32::MAX);
        if !color.iter().all(|v| (0.0..=big).contains(v)) {
            return Err(format!("the light's colour {color:?} is out of range"));
        }
        if !(0.0..=big).contains(&intensity) {
            return Err(format!("the light's intensity {intensity} is out of range"));
        }
        let kind = match self.kind {
            "directional" => LightKind::Directional,
            "point" => LightKind::Point,
            "spot" => self.cone()?,
            other => return Err(format!("light type {other:.32?} is not directional, point or spot")),
        };
        let directional = kind == LightKind::Directional;
        // A directional light has no position: the file's is not even checked.
        let position = if directional { origin_m } else { self.position };
        if !in_reach(position) {
            return Err(format!("the light lies at {position}, beyond ±{MAX_COORDINATE_M} m"));
        }
        let direction = match kind {
            LightKind::Point => Some(DVec3::NEG_Z),
            LightKind::Directional | LightKind::Spot { .. } => self.direction.try_normalize(),
        };
        let direction = direction.ok_or_else(|| format!("the light's direction {} has no length", self.direction))?;
        let range_m = match self.range_m {
            Some(range) if !directional => {
                // Checked as f32: a range that rounds to 0 lights nothing.
                let range = f32_of(range);
                if !(range > 0.0 && range.is_finite()) {
                    return Err(format!("the light's range {range} m is not positive and finite"));
                }
                range
            }
            _ => f32::INFINITY,
        };
        Ok(Light {
            name: short_name(self.name),
            kind,
            position: (position - origin_m).as_vec3(),
            direction: direction.as_vec3().normalize(),
            color: Vec3::from_array(color.map(f32_of)),
            intensity: f32_of(intensity),
            range_m,
        })
    }

    fn cone(&self) -> Result<LightKind, String> {
        let inner = self.inner_cone_rad.unwrap_or(0.0);
        let outer = self.outer_cone_rad.unwrap_or(FRAC_PI_4);
        if !(inner >= 0.0 && inner <= outer && outer <= FRAC_PI_2 + CONE_ROUNDING) {
            return Err(format!("the spot's cone angles are {inner} and {outer}: must be 0 <= inner <= outer <= π/2"));
        }
        Ok(LightKind::Spot { inner_cone_rad: f32_of(inner), outer_cone_rad: f32_of(outer) })
    }
}

/// Rounds a number that has been checked to fit.
#[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the point")]
pub(super) fn f32_of(value: f64) -> f32 {
    value as f32
}

/// Cuts a name to [`MAX_NAME_BYTES`]. No name gives an empty one.
pub(super) fn short_name(name: Option<&str>) -> String {
    let name = name.unwrap_or_default();
    name.get(..name.floor_char_boundary(MAX_NAME_BYTES)).unwrap_or_default().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source(kind: &str) -> LightSource<'_> {
        LightSource {
            name: None,
            kind,
            position: DVec3::new(1e6 + 0.25, 2.0, 3.0),
            direction: DVec3::new(0.0, -3.0, 4.0),
            color: None,
            intensity: None,
            range_m: None,
            inner_cone_rad: None,
            outer_cone_rad: None,
        }
    }

    #[test]
    fn defaults_are_those_of_the_extension() {
        let light = source("spot").light(DVec3::new(1e6, 0.0, 0.0)).unwrap();
        assert_eq!(light.position, Vec3::new(0.25, 2.0, 3.0));
        assert!((light.direction - Vec3::new(0.0, -0.6, 0.8)).length() < 1e-6);
        assert_eq!((light.color, light.intensity, light.range_m), (Vec3::ONE, 1.0, f32::INFINITY));
        let outer_cone_rad = std::f32::consts::FRAC_PI_4;
        assert_eq!(light.kind, LightKind::Spot { inner_cone_rad: 0.0, outer_cone_rad });
    }

    #[test]
    fn values_out_of_range_are_refused() {
        let fault = |change: &dyn Fn(&mut LightSource<'_>)| {
            let mut source = source("spot");
            change(&mut source);
            source.light(DVec3::ZERO).unwrap_err()
        };
        assert!(fault(&|s| s.kind = "area").contains("area"));
        assert!(fault(&|s| s.color = Some([0.0, -1.0, 0.0])).contains("colour"));
        assert!(fault(&|s| s.intensity = Some(1e39)).contains("intensity"));
        assert!(fault(&|s| s.range_m = Some(0.0)).contains("range"));
        assert!(fault(&|s| s.range_m = Some(1e-60)).contains("range"));
        assert!(fault(&|s| s.direction = DVec3::ZERO).contains("direction"));
        assert!(fault(&|s| s.position.x = 2e9).contains("lies at"));
        assert!(fault(&|s| s.outer_cone_rad = Some(1.6)).contains("cone"));
        assert!(fault(&|s| (s.inner_cone_rad, s.outer_cone_rad) = (Some(0.2), Some(0.1))).contains("cone"));
    }

    #[test]
    fn details_of_files_are_mended_as_other_viewers_read_them() {
        let mended = |change: &dyn Fn(&mut LightSource<'_>)| {
            let mut source = source("spot");
            change(&mut source);
            let (light, faults) = source.mended(DVec3::ZERO).unwrap();
            let LightKind::Spot { inner_cone_rad, outer_cone_rad } = light.kind else { panic!("{light:?}") };
            (light, [inner_cone_rad, outer_cone_rad], faults.len())
        };
        let (light, cone, faults) = mended(&|_| {});
        assert_eq!((light, faults), (source("spot").light(DVec3::ZERO).unwrap(), 0));
        assert_eq!(cone[0], 0.0);
        assert_eq!(mended(&|s| s.color = Some([0.5, -1.0, 1e99])).0.color, Vec3::new(0.5, 0.0, f32::MAX));
        assert_eq!(mended(&|s| s.intensity = Some(-1.0)).0.intensity, 0.0);
        // Legal, and practically infinite or nothing.
        let range = |range| {
            let (light, _, faults) = mended(&|s| s.range_m = Some(range));
            (light.range_m, faults)
        };
        assert_eq!(range(f64::MAX), (f32::INFINITY, 0));
        assert_eq!(range(1e-60), (f32::MIN_POSITIVE, 0));
        assert_eq!([range(0.0), range(-1.0)], [(f32::INFINITY, 1); 2]);
        let cone = |inner, outer| {
            let (_, cone, faults) = mended(&|s| (s.inner_cone_rad, s.outer_cone_rad) = (Some(inner), Some(outer)));
            (cone, faults)
        };
        assert_eq!(cone(0.25, 0.25), ([0.25, 0.25], 1));
        assert_eq!(cone(0.5, 0.25), ([0.25, 0.25], 2));
        assert_eq!(cone(-0.5, 0.25), ([0.0, 0.25], 1));
        let (wide, faults) = cone(0.5, 3.0);
        assert!((wide[1] - std::f32::consts::FRAC_PI_2).abs() < 1e-5 && faults == 1, "{wide:?}");
        assert!(source("point").mended(DVec3::ZERO).is_ok());
    }

    #[test]
    fn directional_lights_ignore_positions_and_point_lights_directions() {
        let mut sun = source("directional");
        (sun.position, sun.range_m) = (DVec3::splat(1e30), Some(5.0));
        assert_eq!(sun.light(DVec3::ONE).map(|sun| (sun.position, sun.range_m)), Ok((Vec3::ZERO, f32::INFINITY)));
        let mut lamp = source("point");
        lamp.direction = DVec3::ZERO;
        assert!(lamp.light(DVec3::ZERO).is_ok());
    }

    #[test]
    fn long_names_are_cut_between_characters() {
        assert_eq!(short_name(Some(&"ü".repeat(200))).len(), 256);
        assert_eq!(short_name(Some(&format!("a{}", "ü".repeat(200)))).len(), 255);
        assert_eq!(short_name(None), "");
    }
}
