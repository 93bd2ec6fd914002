//! The lights of a `lights_camera.json` file. They replace those of a scene.
//!
//! The file is one JSON object. `lights` lists the lights; a file without it may list them as `suggested_point_lights`.
//! Each has `type` (directional, point or spot), and may have `name`, `position` (world space, metres), `direction` (in
//! which it travels), `color` (linear RGB), `intensity` or `intensity_cd` (candela; lux for directional ones), `range`
//! (metres), `innerConeAngle` and `outerConeAngle` (radians). Other keys are ignored, such as camera paths and
//! `original_lights`, which repeats the scene's own.

use std::path::Path;

use glam::DVec3;
use serde::Deserialize;

use crate::{Light, error::SceneError, file::read_file, light::LightSource, limits::MAX_LIGHTS_FILE_BYTES};

#[derive(Deserialize)]
struct LightsFile {
    lights: Option<Vec<FileLight>>,
    suggested_point_lights: Option<Vec<FileLight>>,
}

#[derive(Deserialize)]
struct FileLight {
    #[serde(rename = "type")]
    kind: String,
    name: Option<String>,
    position: Option<[f64; 3]>,
    direction: Option<[f64; 3]>,
    color: Option<[f64; 3]>,
    intensity: Option<f64>,
    intensity_cd: Option<f64>,
    range: Option<f64>,
    #[serde(rename = "innerConeAngle")]
    inner_cone_angle: Option<f64>,
    #[serde(rename = "outerConeAngle")]
    outer_cone_angle: Option<f64>,
}

/// Reads a file's lights, relative to a scene's origin. The caller bounds their number.
/// Errors if the file cannot be read, is not such JSON, has no list of lights, or a light is malformed.
pub(super) fn read(path: &Path, origin_m: DVec3) -> Result<Vec<Light>, SceneError> {
    let bytes = read_file(path, MAX_LIGHTS_FILE_BYTES)?;
    parse(&bytes, origin_m).map_err(|fault| SceneError::LightsFile { path: path.to_owned(), fault })
}

fn parse(json: &[u8], origin_m: DVec3) -> Result<Vec<Light>, String> {
    let file: LightsFile = serde_json::from_slice(json).map_err(|error| error.to_string())?;
    let lights = file.lights.or(file.suggested_point_lights);
    let lights = lights.ok_or("it has neither \"lights\" nor \"suggested_point_lights\"")?;
    let light = |(index, light): (usize, &FileLight)| {
        let needs = |there: bool, key| if there { Ok(()) } else { Err(format!("light {index}: it has no {key:?}")) };
        needs(light.position.is_some() || light.kind == "directional", "position")?;
        needs(light.direction.is_some() || light.kind == "point", "direction")?;
        let source = LightSource {
            name: light.name.as_deref(),
            kind: &light.kind,
            position: light.position.map_or(DVec3::ZERO, DVec3::from_array),
            direction: light.direction.map_or(DVec3::ZERO, DVec3::from_array),
            color: light.color,
            intensity: light.intensity.or(light.intensity_cd),
            range_m: light.range,
            inner_cone_rad: light.inner_cone_angle,
            outer_cone_rad: light.outer_cone_angle,
        };
        source.light(origin_m).map_err(|fault| format!("light {index}: {fault}"))
    };
    lights.iter().enumerate().map(light).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::LightKind;

    #[test]
    fn both_spellings_are_read() {
        let lights = parse(
            br#"{"camera_paths":{"A":{}},"lights":[
                {"type":"directional","name":"sun","direction":[0,-2,0],"intensity":12},
                {"type":"spot","position":[1,2,3],"direction":[0,-1,0],"range":9,
                 "innerConeAngle":0.25,"outerConeAngle":0.5}]}"#,
            DVec3::new(1.0, 0.0, 0.0),
        )
        .unwrap();
        assert_eq!(
            (lights[0].name.as_str(), lights[0].kind, lights[0].intensity),
            ("sun", LightKind::Directional, 12.0)
        );
        assert_eq!(lights[0].direction, glam::Vec3::NEG_Y);
        assert_eq!(lights[1].kind, LightKind::Spot { inner_cone_rad: 0.25, outer_cone_rad: 0.5 });
        assert_eq!((lights[1].position, lights[1].range_m), (glam::Vec3::new(0.0, 2.0, 3.0), 9.0));
        let json = br#"{"original_lights":[{"type":"x"}],
            "suggested_point_lights":[{"type":"point","position":[0,1,0],"intensity_cd":5.5}]}"#;
        assert_eq!(parse(json, DVec3::ZERO).unwrap()[0].intensity, 5.5);
    }

    #[test]
    fn faults_name_the_light() {
        let fault = |json: &str| parse(json.as_bytes(), DVec3::ZERO).unwrap_err();
        assert!(fault("[]").contains("invalid length 0"));
        assert!(fault("{}").contains("neither"));
        assert!(fault(r#"{"lights":[{"position":[0,0,0]}]}"#).contains("type"));
        assert!(fault(r#"{"lights":[{"type":"point"}]}"#).contains("light 0: it has no \"position\""));
        assert!(fault(r#"{"lights":[{"type":"spot","position":[0,0,0]}]}"#).contains("direction"));
        let area = r#"{"lights":[{"type":"point","position":[0,0,0]},
            {"type":"area","position":[0,0,0],"direction":[0,0,1]}]}"#;
        assert!(fault(area).contains("light 1: light type \"area\""));
        assert!(fault(r#"{"lights":[{"type":"point","position":[0,0,1e999]}]}"#).contains("number"));
    }
}
