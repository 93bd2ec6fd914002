//! Changes to the scene from a file, a JSON line each.
//!
//! ```text
//! {"t": 0.5, "node": "door", "rotation": [0, 0.38, 0, 0.92]}
//! {"t": 1, "light": "lamp", "intensity": 0}
//! {"t": 2, "light": 0}
//! ```
//!
//! A node or a light has its name, or its number. What a line leaves out is as in the file again.

use std::path::{Path, PathBuf};

use glam::{DQuat, DVec3, Vec3};
use gnomon_scene::{AnimatedNode, Edit, LightEdit, NodeEdit, Scene};
use serde::Deserialize;

use crate::error::ClientError;

/// Most changes.
const MAX_LINES: usize = 1_000_000;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    /// Time on the path, in s.
    t: f64,
    node: Option<Named>,
    light: Option<Named>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
    shown: Option<bool>,
    position: Option<[f64; 3]>,
    direction: Option<[f64; 3]>,
    color: Option<[f32; 3]>,
    intensity: Option<f32>,
    range: Option<f32>,
    cone: Option<[f32; 2]>,
}

#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Named {
    Number(u32),
    Name(String),
}

/// A file that was read, before its scene is known.
#[derive(Debug)]
pub(super) struct Script {
    path: PathBuf,
    lines: Vec<(usize, Line)>,
}

/// Changes of a scene, the earliest last.
#[derive(Debug, Default)]
pub(super) struct Timeline(Vec<(f64, Edit)>);

impl Script {
    /// Errors if the file cannot be read, or a line is malformed.
    pub(super) fn read(path: &Path) -> Result<Self, ClientError> {
        let failed = |line, reason: String| ClientError::Edits { path: path.to_owned(), line, reason };
        let text = std::fs::read_to_string(path).map_err(|error| failed(1, error.to_string()))?;
        let numbered = (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty());
        let parse = |(number, line)| {
            let line: Line = serde_json::from_str(line).map_err(|error| failed(number, error.to_string()))?;
            if number > MAX_LINES || !line.t.is_finite() {
                return Err(failed(number, format!("at most {MAX_LINES} lines, each at a finite time")));
            }
            Ok((number, line))
        };
        Ok(Self { path: path.to_owned(), lines: numbered.map(parse).collect::<Result<_, _>>()? })
    }

    /// Finds what the lines name in a scene.
    /// Errors if something is not there, or may not be changed so.
    pub(super) fn of(self, scene: &Scene) -> Result<Timeline, ClientError> {
        let Self { path, lines } = self;
        let find = |(number, line): (usize, Line)| {
            let edit = line.edit(scene).and_then(|edit| match edit.check(scene) {
                Ok(()) => Ok((line.t, edit)),
                Err(error) => Err(error.to_string()),
            });
            edit.map_err(|reason| ClientError::Edits { path: path.clone(), line: number, reason })
        };
        let mut edits: Vec<(f64, Edit)> = lines.into_iter().map(find).collect::<Result<_, _>>()?;
        // Stable: of lines at one time the last counts.
        edits.sort_by(|one, other| one.0.total_cmp(&other.0));
        edits.reverse();
        Ok(Timeline(edits))
    }
}

impl Timeline {
    /// Takes the changes up to a time on the path, in s.
    pub(super) fn until(&mut self, time_s: f64) -> Vec<Edit> {
        let rest = self.0.iter().rposition(|(at_s, _)| *at_s > time_s).map_or(0, |last| last + 1);
        self.0.drain(rest..).rev().map(|(_, edit)| edit).collect()
    }
}

impl Line {
    fn edit(&self, scene: &Scene) -> Result<Edit, String> {
        let of_node = self.translation.is_some() || self.rotation.is_some() || self.scale.is_some();
        let of_node = of_node || self.shown.is_some();
        let of_light = self.position.is_some() || self.direction.is_some() || self.color.is_some();
        let of_light = of_light || self.intensity.is_some() || self.range.is_some() || self.cone.is_some();
        match (&self.node, &self.light) {
            (Some(node), None) if !of_light => {
                let nodes = scene.animation.as_ref().map_or(&[][..], |animation| &animation.nodes);
                let names = |node: &AnimatedNode| if node.editable { node.name.clone() } else { String::new() };
                let node = node.find("node that may be edited", nodes.iter().map(names))?;
                let (translation_m, scale) = (self.translation.map(DVec3::from), self.scale.map(DVec3::from));
                let (rotation, shown) = (self.rotation.map(DQuat::from_array), self.shown);
                Ok(Edit::Node(node, NodeEdit { translation_m, rotation, scale, shown }))
            }
            (None, Some(light)) if !of_node => {
                let light = light.find("light", scene.lights.iter().map(|light| light.name.clone()))?;
                let (position_m, direction) = (self.position.map(DVec3::from), self.direction.map(DVec3::from));
                let (color, intensity) = (self.color.map(Vec3::from), self.intensity);
                let (range_m, cone_rad) = (self.range, self.cone);
                Ok(Edit::Light(light, LightEdit { position_m, direction, color, intensity, range_m, cone_rad }))
            }
            (Some(_), None) => Err("a node has translation, rotation, scale and shown".to_owned()),
            (None, Some(_)) => Err("a light has position, direction, color, intensity, range and cone".to_owned()),
            _ => Err("a line has either node or light".to_owned()),
        }
    }
}

impl Named {
    fn find(&self, kind: &str, mut names: impl Iterator<Item = String>) -> Result<u32, String> {
        let (found, wanted) = match self {
            Self::Number(number) => (names.nth(*number as usize).map(|_| *number as usize), number.to_string()),
            Self::Name(wanted) => (names.position(|name| name == *wanted), format!("{wanted:?}")),
        };
        found.and_then(|place| u32::try_from(place).ok()).ok_or_else(|| format!("there is no {kind} {wanted:.100}"))
    }
}

#[cfg(test)]
mod tests {
    use gnomon_scene::{Light, LightKind};

    use super::*;

    fn scene() -> Scene {
        let lamp = |name: &str| Light {
            name: name.to_owned(),
            kind: LightKind::Point,
            position: Vec3::ZERO,
            direction: Vec3::NEG_Y,
            color: Vec3::ONE,
            intensity: 1.0,
            range_m: f32::INFINITY,
        };
        Scene { lights: vec![lamp("sun"), lamp("lamp")], ..Scene::default() }
    }

    fn timeline(text: &str) -> Result<Timeline, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("edits.jsonl");
        std::fs::write(&path, text).unwrap();
        let read = Script::read(&path).and_then(|script| script.of(&scene()));
        read.map_err(|error| error.to_string().rsplit_once("edits.jsonl, ").unwrap().1.to_owned())
    }

    #[test]
    fn edits_are_due_in_the_order_of_their_times() {
        let text = "{\"t\": 2, \"light\": 0}\n\n{\"t\": 1, \"light\": \"lamp\", \"intensity\": 0.5}\n\
            {\"t\": 1, \"light\": \"lamp\", \"range\": 3, \"position\": [1, 2, 3]}\n";
        let mut timeline = timeline(text).unwrap();
        assert!(timeline.until(0.99).is_empty());
        let dim = LightEdit { intensity: Some(0.5), ..LightEdit::default() };
        let moved =
            LightEdit { position_m: Some(DVec3::new(1.0, 2.0, 3.0)), range_m: Some(3.0), ..LightEdit::default() };
        assert_eq!(timeline.until(1.5), [Edit::Light(1, dim), Edit::Light(1, moved)]);
        assert_eq!(timeline.until(2.0), [Edit::Light(0, LightEdit::default())]);
        assert!(timeline.until(1e9).is_empty());
    }

    #[test]
    fn faults_name_their_lines() {
        let good = "{\"t\": 0, \"light\": 0}\n";
        for (bad, part) in [
            ("{\"t\": 0}", "either node or light"),
            ("{\"t\": 0, \"light\": 2}", "there is no light 2"),
            ("{\"t\": 0, \"light\": \"moon\"}", "there is no light \"moon\""),
            ("{\"t\": 0, \"node\": \"door\"}", "there is no node that may be edited \"door\""),
            ("{\"t\": 0, \"light\": 0, \"shown\": true}", "a light has position"),
            ("{\"t\": 0, \"light\": 0, \"intensity\": -1}", "the intensity is out of range"),
            ("{\"t\": 0, \"light\": 0, \"brightness\": 1}", "unknown field"),
            ("{\"light\": 0}", "missing field `t`"),
            ("light", "expected value"),
        ] {
            let error = timeline(&format!("{good}{bad}")).unwrap_err();
            assert!(error.starts_with("line 2: ") && error.contains(part), "{error}");
        }
    }
}
