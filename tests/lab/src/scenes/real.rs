//! The real scenes of the tests, and their cameras.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use glam::DVec3;
use gnomon_scene::camera::Camera;
use serde_json::Value;

pub const SCENES_VARIABLE: &str = "GNOMON_SCENES";

#[derive(Debug, Clone, Copy)]
pub struct RealScene {
    pub name: &'static str,
    /// The file, relative to the folder of scenes.
    pub file: &'static str,
    /// Lights come from the `lights_camera.json` beside it.
    pub lights_from_json: bool,
    /// Name of the camera path (`None`: the file's only one), and the time on it in seconds.
    pub stops: &'static [(Option<&'static str>, f64)],
}

const START_AND_3_S: &[(Option<&str>, f64)] = &[(None, 0.0), (None, 3.0)];

const fn scene(name: &'static str, file: &'static str, lights_from_json: bool) -> RealScene {
    RealScene { name, file, lights_from_json, stops: START_AND_3_S }
}

pub const JUDGED: [RealScene; 6] = [
    RealScene {
        stops: &[(Some("A_atrium_dolly"), 0.0), (Some("B_corner_into_aisle"), 3.5)],
        ..scene("sponza", "sponza/sponza_lights.gltf", false)
    },
    scene("modern-hall", "modern-hall/modern-hall.glb", false),
    scene("grey-white-room", "grey-white-room/grey-white-room.glb", true),
    scene("pink-room-partial", "pink-room-partial/pink-room-partial.glb", true),
    scene("breakfast-room", "breakfast-room/breakfast-room.glb", true),
    scene("sponza-dabrovic", "sponza-dabrovic/sponza-dabrovic.glb", true),
];

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stop {
    pub position_m: DVec3,
    pub target_m: DVec3,
    /// Full vertical field of view, in degrees.
    pub yfov_deg: f64,
}

impl Stop {
    pub fn camera(&self, width: u32, height: u32) -> Camera {
        Camera::looking_at(self.position_m, self.target_m, self.yfov_deg.to_radians(), width, height)
    }

    /// Returns a client's camera path that stays at this place.
    pub fn path_json(&self) -> Value {
        let (position, target) = (self.position_m.to_array(), self.target_m.to_array());
        let keyframe = |t: f64| serde_json::json!({ "t": t, "pos": position, "target": target });
        serde_json::json!({
            "yfov_deg": self.yfov_deg,
            "camera_path": { "keyframes": [keyframe(0.0), keyframe(1.0)] },
        })
    }
}

pub fn folder() -> Result<PathBuf> {
    let Some(folder) = std::env::var_os(SCENES_VARIABLE).map(PathBuf::from) else {
        bail!("{SCENES_VARIABLE} is not set: it must name the folder that holds sponza/, modern-hall/, …");
    };
    if !folder.is_dir() {
        bail!("{SCENES_VARIABLE} names {}, which is no folder", folder.display());
    }
    Ok(folder)
}

impl RealScene {
    pub fn path(&self) -> Result<PathBuf> {
        let path = folder()?.join(self.file);
        if path.is_file() { Ok(path) } else { bail!("{} is missing from {SCENES_VARIABLE}", path.display()) }
    }

    pub fn json(&self) -> Result<PathBuf> {
        Ok(self.path()?.with_file_name("lights_camera.json"))
    }

    /// The `lights_camera.json` beside the scene file in a folder of scenes.
    pub fn json_in(&self, folder: &Path) -> PathBuf {
        folder.join(self.file).with_file_name("lights_camera.json")
    }

    pub fn stops(&self) -> Result<Vec<Stop>> {
        self.stops_in(&folder()?)
    }

    pub fn stops_in(&self, folder: &Path) -> Result<Vec<Stop>> {
        let json = self.json_in(folder);
        self.stops.iter().map(|&(name, time_s)| stop(&json, name, time_s)).collect()
    }
}

/// Returns a place on a camera path; position and target are linear between keyframes.
pub fn stop(json: &Path, name: Option<&str>, time_s: f64) -> Result<Stop> {
    let text = std::fs::read_to_string(json).with_context(|| format!("reading {}", json.display()))?;
    let value: Value = serde_json::from_str(&text).with_context(|| format!("parsing {}", json.display()))?;
    let path = match name {
        Some(name) => &value["camera_paths"][name],
        None => &value["camera_path"],
    };
    parse(path, &value["yfov_deg"], time_s)
        .with_context(|| format!("camera path {} in {}", name.unwrap_or("(the only one)"), json.display()))
}

fn parse(path: &Value, outer_yfov_deg: &Value, time_s: f64) -> Result<Stop> {
    let yfov_deg = path["yfov_deg"].as_f64().or(outer_yfov_deg.as_f64()).context("no yfov_deg")?;
    let keyframes = path["keyframes"].as_array().context("no keyframes")?;
    let read = |keyframe: &Value| -> Result<(f64, DVec3, DVec3)> {
        let vector = |key: &str| -> Result<DVec3> {
            let values: [f64; 3] = serde_json::from_value(keyframe[key].clone()).with_context(|| key.to_owned())?;
            Ok(DVec3::from_array(values))
        };
        Ok((keyframe["t"].as_f64().context("t")?, vector("pos")?, vector("target")?))
    };
    let keyframes = keyframes.iter().map(read).collect::<Result<Vec<_>>>()?;
    let after = keyframes.iter().position(|(t, ..)| *t > time_s).unwrap_or(keyframes.len());
    let (last, next) = (after.saturating_sub(1), after.min(keyframes.len().saturating_sub(1)));
    let (Some(a), Some(b)) = (keyframes.get(last), keyframes.get(next)) else { bail!("no keyframe at all") };
    let share = if b.0 > a.0 { (time_s - a.0) / (b.0 - a.0) } else { 0.0 };
    Ok(Stop { position_m: a.1.lerp(b.1, share), target_m: a.2.lerp(b.2, share), yfov_deg })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stops_lie_between_their_keyframes() {
        let keyframe = |t: f64, x: f64| serde_json::json!({ "t": t, "pos": [x, 0.0, 1.0], "target": [0.0, x, 2.0] });
        let path = serde_json::json!({ "keyframes": [keyframe(0.0, 1.0), keyframe(2.0, 5.0), keyframe(4.0, 0.0)] });
        for (time_s, x) in [(0.0, 1.0), (0.5, 2.0), (2.0, 5.0), (3.0, 2.5), (4.0, 0.0), (9.0, 0.0)] {
            let stop = parse(&path, &serde_json::json!(50.0), time_s).unwrap();
            assert_eq!(stop.position_m, DVec3::new(x, 0.0, 1.0), "at {time_s} s");
            assert_eq!((stop.target_m, stop.yfov_deg), (DVec3::new(0.0, x, 2.0), 50.0));
        }
        assert!(parse(&serde_json::json!({ "keyframes": [] }), &serde_json::json!(50.0), 0.0).is_err());
        assert!(parse(&path, &Value::Null, 0.0).is_err());
    }

    #[test]
    fn the_judged_scenes_are_there_with_their_paths() {
        for scene in JUDGED {
            let stops = scene.stops().unwrap();
            assert_eq!(stops.len(), scene.stops.len());
            assert_ne!(stops[0], stops[1]);
        }
    }
}
