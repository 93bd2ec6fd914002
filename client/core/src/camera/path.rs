//! Camera paths: keyframes, and the camera's position at any time.
//!
//! Between two keyframes the position moves in a straight line at constant speed, and the view direction turns at a
//! constant rate along the great circle. Before the first keyframe, the path shows the first one. After the last one,
//! the camera goes back to the first, and so on to and fro.
//!
//! A path may also be that of a camera that moves in the scene's file.

use std::{collections::BTreeMap, sync::Arc};

use glam::{DQuat, DVec3};
use gnomon_protocol::limits::{MAX_POSITION_M, YFOV_RANGE_RAD};
use gnomon_scene::{NamedCamera, Scene, camera::Camera};
use serde::Deserialize;
use thiserror::Error;

const MAX_KEYFRAMES: usize = 100_000;

/// Vertical field of view if the file gives none.
const DEFAULT_YFOV_DEG: f64 = 60.0;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keyframe {
    pub time_s: f64,
    /// In world space.
    pub position_m: DVec3,
    /// The point that the camera looks at, in world space.
    pub target_m: DVec3,
}

/// At least one keyframe, in order of time.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraPath {
    name: String,
    keyframes: Vec<Keyframe>,
    yfov_rad: f64,
    /// Used instead of the keyframes' directions, which know no roll.
    orientation: Option<DQuat>,
    /// Followed instead of all this.
    scene: Option<SceneCamera>,
}

/// A camera that moves in the scene's file.
#[derive(Debug, Clone, PartialEq)]
struct SceneCamera {
    /// Nothing but cameras, and what moves them.
    stage: Arc<Scene>,
    index: usize,
}

#[derive(Debug, Error)]
pub enum PathError {
    #[error("{0}")]
    Malformed(String),
    #[error("no camera path {wanted:?}: it has {}", found.join(", "))]
    NoSuchPath { wanted: String, found: Vec<String> },
}

#[derive(Debug, Deserialize)]
struct PathFile {
    yfov_deg: Option<f64>,
    camera_path: Option<PathEntry>,
    #[serde(default)]
    camera_paths: BTreeMap<String, PathEntry>,
}

#[derive(Debug, Deserialize)]
struct PathEntry {
    yfov_deg: Option<f64>,
    keyframes: Vec<KeyframeEntry>,
}

#[derive(Debug, Deserialize)]
struct KeyframeEntry {
    t: f64,
    pos: [f64; 3],
    target: [f64; 3],
}

impl CameraPath {
    /// Makes a path through these keyframes.
    ///
    /// # Errors
    /// If there are none or too many, times do not increase, or a keyframe is invalid: a value is not finite or too
    /// large, or the target is its own position.
    pub fn new(name: &str, keyframes: Vec<Keyframe>, yfov_rad: f64) -> Result<Self, String> {
        if keyframes.is_empty() || keyframes.len() > MAX_KEYFRAMES {
            return Err(format!("{} keyframes: a path has 1 to {MAX_KEYFRAMES}", keyframes.len()));
        }
        if !YFOV_RANGE_RAD.contains(&yfov_rad) {
            return Err(format!("a field of view of {}°: it must be 1° to 170°", yfov_rad.to_degrees()));
        }
        for (index, keyframe) in keyframes.iter().enumerate() {
            let Keyframe { time_s, position_m, target_m } = keyframe;
            let inside = |point: &DVec3| point.abs().max_element() <= MAX_POSITION_M && point.is_finite();
            if !time_s.is_finite() || !inside(position_m) || !inside(target_m) {
                return Err(format!("keyframe {index} has a value that is not finite or beyond {MAX_POSITION_M:e} m"));
            }
            if (*target_m - *position_m).try_normalize().is_none() {
                return Err(format!("keyframe {index} looks at its own position"));
            }
            if index > 0 && *time_s <= keyframes[index - 1].time_s {
                return Err(format!("keyframe {index} is not later than the one before it ({time_s} s)"));
            }
        }
        Ok(Self { name: name.to_owned(), keyframes, yfov_rad, orientation: None, scene: None })
    }

    /// A path that stays at one keyframe, which must be valid.
    pub(crate) fn standing(name: &str, keyframe: Keyframe, yfov_rad: f64) -> Self {
        Self { name: name.to_owned(), keyframes: vec![keyframe], yfov_rad, orientation: None, scene: None }
    }

    /// A path that stays at a place and orientation, which must be valid.
    pub(crate) fn standing_as(name: &str, position_m: DVec3, orientation: DQuat, yfov_rad: f64) -> Self {
        let target_m = position_m + orientation * DVec3::NEG_Z;
        let path = Self::standing(name, Keyframe { time_s: 0.0, position_m, target_m }, yfov_rad);
        Self { orientation: Some(orientation), ..path }
    }

    /// This path as that of the scene's camera with this index.
    pub(crate) fn of_moving(self, stage: Arc<Scene>, index: usize) -> Self {
        Self { scene: Some(SceneCamera { stage, index }), ..self }
    }

    /// Whether the times of [`Self::camera`] are times of the scene, in seconds.
    #[must_use]
    pub fn follows_scene(&self) -> bool {
        self.scene.is_some()
    }

    /// Parses `name` from a `lights_camera.json` file, or else `camera_path`, or else the first of `camera_paths` by
    /// name.
    ///
    /// # Errors
    /// If the text is malformed or has no such path.
    pub fn parse(text: &str, name: Option<&str>) -> Result<Self, PathError> {
        let malformed = PathError::Malformed;
        let parsed: PathFile = serde_json::from_str(text).map_err(|error| malformed(error.to_string()))?;
        let mut paths = parsed.camera_paths;
        if let Some(path) = parsed.camera_path {
            paths.insert("camera_path".to_owned(), path);
        }
        let name = match name {
            Some(name) => name.to_owned(),
            None if paths.contains_key("camera_path") => "camera_path".to_owned(),
            None => paths.keys().next().cloned().ok_or_else(|| malformed("it has no camera path".to_owned()))?,
        };
        let Some(entry) = paths.get(&name) else {
            return Err(PathError::NoSuchPath { wanted: name, found: paths.into_keys().collect() });
        };
        let keyframes = (entry.keyframes.iter())
            .map(|keyframe| Keyframe {
                time_s: keyframe.t,
                position_m: keyframe.pos.into(),
                target_m: keyframe.target.into(),
            })
            .collect();
        let yfov_deg = entry.yfov_deg.or(parsed.yfov_deg).unwrap_or(DEFAULT_YFOV_DEG);
        Self::new(&name, keyframes, yfov_deg.to_radians()).map_err(|reason| malformed(format!("{name}: {reason}")))
    }

    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Time from the first keyframe to the last.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.keyframes[self.keyframes.len() - 1].time_s - self.keyframes[0].time_s
    }

    /// Returns the camera `time_s` seconds after the first keyframe, for a picture of this size.
    #[must_use]
    pub fn camera(&self, time_s: f64, width: u32, height: u32) -> Camera {
        if let Some(camera) = self.scene.as_ref().and_then(|scene| scene.camera(time_s)) {
            return Camera { width, height, ..camera };
        }
        let duration = self.duration_s();
        let lap = if duration > 0.0 { time_s.max(0.0) % (2.0 * duration) } else { 0.0 };
        let time = self.keyframes[0].time_s + if lap > duration { 2.0 * duration - lap } else { lap };
        let after = self.keyframes.partition_point(|keyframe| keyframe.time_s <= time);
        let from = &self.keyframes[after.saturating_sub(1)];
        let (position, direction) = match self.keyframes.get(after) {
            Some(to) if after > 0 => {
                let share = (time - from.time_s) / (to.time_s - from.time_s);
                let turn = DQuat::from_rotation_arc(from.direction(), to.direction());
                (from.position_m.lerp(to.position_m, share), DQuat::IDENTITY.slerp(turn, share) * from.direction())
            }
            _ => (from.position_m, from.direction()),
        };
        let camera = Camera::looking_at(position, position + direction, self.yfov_rad, width, height);
        Camera { orientation: self.orientation.unwrap_or(camera.orientation), ..camera }
    }
}

impl SceneCamera {
    fn camera(&self, scene_time_s: f64) -> Option<Camera> {
        let cameras = self.stage.cameras_at(scene_time_s);
        let NamedCamera { position_m, orientation, yfov_rad, .. } = cameras.get(self.index)?;
        let yfov_rad = yfov_rad.clamp(*YFOV_RANGE_RAD.start(), *YFOV_RANGE_RAD.end());
        Some(Camera { position_m: *position_m, orientation: *orientation, yfov_rad, width: 1, height: 1 })
    }
}

impl Keyframe {
    fn direction(&self) -> DVec3 {
        (self.target_m - self.position_m).normalize()
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_1_SQRT_2;

    use super::*;

    fn key(time_s: f64, position: [f64; 3], direction: [f64; 3]) -> Keyframe {
        let position_m = DVec3::from(position);
        Keyframe { time_s, position_m, target_m: position_m + DVec3::from(direction) }
    }

    fn look(path: &CameraPath, time_s: f64) -> (DVec3, DVec3) {
        let camera = path.camera(time_s, 16, 9);
        (camera.position_m, camera.orientation * DVec3::NEG_Z)
    }

    #[test]
    fn position_is_linear_and_the_direction_turns_evenly() {
        let keys = vec![key(2.0, [0.0; 3], [0.0, 0.0, -9.0]), key(6.0, [8.0, 4.0, 0.0], [3.0, 0.0, 0.0])];
        let path = CameraPath::new("test", keys, 1.0).unwrap();
        assert_eq!(path.duration_s(), 4.0);
        for (time, position, direction) in [
            (-1.0, [0.0, 0.0, 0.0], [0.0, 0.0, -1.0]),
            (0.0, [0.0, 0.0, 0.0], [0.0, 0.0, -1.0]),
            (2.0, [4.0, 2.0, 0.0], [FRAC_1_SQRT_2, 0.0, -FRAC_1_SQRT_2]),
            (4.0, [8.0, 4.0, 0.0], [1.0, 0.0, 0.0]),
            (6.0, [4.0, 2.0, 0.0], [FRAC_1_SQRT_2, 0.0, -FRAC_1_SQRT_2]),
            (8.0, [0.0, 0.0, 0.0], [0.0, 0.0, -1.0]),
            (9.0, [2.0, 1.0, 0.0], [0.382_683_432, 0.0, -0.923_879_533]),
        ] {
            let (found_position, found_direction) = look(&path, time);
            assert!((found_position - DVec3::from(position)).length() < 1e-9, "{time} s: {found_position}");
            assert!((found_direction - DVec3::from(direction)).length() < 1e-8, "{time} s: {found_direction}");
        }
    }

    #[test]
    fn opposite_directions_turn_through_a_side() {
        let keys = vec![key(0.0, [0.0; 3], [0.0, 0.0, -1.0]), key(1.0, [0.0; 3], [0.0, 0.0, 1.0])];
        let (_, direction) = look(&CameraPath::new("test", keys, 1.0).unwrap(), 0.5);
        assert!(direction.is_normalized() && direction.z.abs() < 1e-6);
    }

    #[test]
    fn one_keyframe_stands_still() {
        let path = CameraPath::new("test", vec![key(5.0, [1.0, 2.0, 3.0], [1.0, 0.0, 0.0])], 1.0).unwrap();
        assert_eq!(look(&path, 0.0), look(&path, 77.0));
    }

    #[test]
    fn bad_keyframes_say_what_is_wrong() {
        let good = key(0.0, [0.0; 3], [1.0, 0.0, 0.0]);
        for (keys, yfov, reason) in [
            (vec![], 1.0, "0 keyframes"),
            (vec![good, good], 1.0, "not later"),
            (vec![key(0.0, [1.0; 3], [0.0; 3])], 1.0, "own position"),
            (vec![key(f64::NAN, [1.0; 3], [1.0; 3])], 1.0, "not finite"),
            (vec![key(0.0, [2e9, 0.0, 0.0], [1.0; 3])], 1.0, "beyond"),
            (vec![good], 0.0, "field of view"),
        ] {
            let found = CameraPath::new("test", keys, yfov).unwrap_err();
            assert!(found.contains(reason), "{found}");
        }
    }

    #[test]
    fn paths_are_parsed_by_name() {
        let keys = |x: f64| format!(r#"[{{"t": 0, "pos": [{x}, 0, 0], "target": [{x}, 0, -1]}}]"#);
        let text = format!(
            r#"{{"units": "m", "yfov_deg": 40, "camera_paths": {{
                "b": {{"keyframes": {}, "note": "x"}}, "a": {{"yfov_deg": 50, "keyframes": {}}}}}}}"#,
            keys(2.0),
            keys(1.0)
        );
        let parse = |name| CameraPath::parse(&text, name);
        assert_eq!(parse(None).unwrap().name(), "a");
        let (a, b) = (parse(Some("a")).unwrap(), parse(Some("b")).unwrap());
        assert_eq!((look(&a, 0.0).0.x, look(&b, 0.0).0.x), (1.0, 2.0));
        assert!((a.yfov_rad.to_degrees() - 50.0).abs() < 1e-9 && (b.yfov_rad.to_degrees() - 40.0).abs() < 1e-9);
        assert!(parse(Some("c")).unwrap_err().to_string().ends_with("it has a, b"));
        assert!(CameraPath::parse("{}", None).unwrap_err().to_string().contains("no camera path"));
        let number = CameraPath::parse("{\"camera_path\": 7}", None);
        assert!(matches!(number, Err(PathError::Malformed(_))));
    }
}
