//! A camera path for the small scene of `gnomon_scene::testing`.

use std::{fs, path::Path};

use gnomon_client::camera_path::{CameraPath, PathSpec};
use serde_json::json;

/// Writes the path into `folder` and loads it.
pub(crate) fn path(folder: &Path) -> CameraPath {
    let keyframe = |t: f64| json!({ "t": t, "pos": [0.1 * t, 2.5, 0.5], "target": [0.0, 0.0, 0.0] });
    let path = json!({ "yfov_deg": 60.0, "camera_path": { "keyframes": [keyframe(0.0), keyframe(30.0)] } });
    let file = folder.join("path.json");
    fs::write(&file, path.to_string()).unwrap();
    file.to_str().unwrap().parse::<PathSpec>().unwrap().load().unwrap()
}
