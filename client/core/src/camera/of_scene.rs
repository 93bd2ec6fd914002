//! Cameras that a scene's file brings along.

use std::sync::Arc;

use gnomon_protocol::limits::YFOV_RANGE_RAD;
use gnomon_scene::{Animation, NamedCamera, Scene};
use thiserror::Error;

use super::path::CameraPath;

/// Most cameras that a message lists.
const LISTED: usize = 20;

#[derive(Debug, Error)]
pub enum NoSuchCamera {
    #[error("the scene has no cameras")]
    None,
    #[error("no camera {wanted:?}: the scene has {}", found.join(", "))]
    Unknown { wanted: String, found: Vec<String> },
}

/// Returns what a camera is called: its name, or its number, counted from 1.
#[must_use]
pub fn label(index: usize, camera: &NamedCamera) -> String {
    if camera.name.is_empty() { (index + 1).to_string() } else { camera.name.clone() }
}

/// Returns the path of the camera with this name, or else this number counted from 1; of the first without. It stands
/// unless the camera moves.
///
/// # Errors
/// Names the cameras if there is no such one.
pub fn path_of(scene: &Scene, wanted: Option<&str>) -> Result<CameraPath, NoSuchCamera> {
    let index = find(&scene.cameras, wanted)?;
    paths(scene).into_iter().nth(index).ok_or(NoSuchCamera::None)
}

/// Returns the paths of all cameras.
#[must_use]
pub fn paths(scene: &Scene) -> Vec<CameraPath> {
    let Some(animation) = &scene.animation else { return scene.cameras.iter().map(standing).collect() };
    let (nodes, cameras) = (animation.nodes.clone(), animation.cameras.clone());
    let moving = Box::new(Animation { nodes, cameras, ..Animation::default() });
    let stage = Arc::new(Scene { cameras: scene.cameras.clone(), animation: Some(moving), ..Scene::default() });
    let moves = |index| animation.cameras.iter().any(|moving| moving.camera as usize == index);
    let path = |(index, camera)| {
        let path = standing(camera);
        if moves(index) { path.of_moving(Arc::clone(&stage), index) } else { path }
    };
    scene.cameras.iter().enumerate().map(path).collect()
}

fn find(cameras: &[NamedCamera], wanted: Option<&str>) -> Result<usize, NoSuchCamera> {
    if cameras.is_empty() {
        return Err(NoSuchCamera::None);
    }
    let Some(wanted) = wanted else { return Ok(0) };
    let named = cameras.iter().position(|camera| camera.name == wanted);
    let numbered = || wanted.parse::<usize>().ok()?.checked_sub(1);
    named.or_else(numbered).filter(|index| *index < cameras.len()).ok_or_else(|| {
        let mut found: Vec<String> =
            cameras.iter().enumerate().take(LISTED).map(|(index, camera)| label(index, camera)).collect();
        if cameras.len() > LISTED {
            found.push(format!("{} more", cameras.len() - LISTED));
        }
        NoSuchCamera::Unknown { wanted: wanted.to_owned(), found }
    })
}

/// Returns a path that stands at a camera.
fn standing(camera: &NamedCamera) -> CameraPath {
    let yfov_rad = camera.yfov_rad.clamp(*YFOV_RANGE_RAD.start(), *YFOV_RANGE_RAD.end());
    let name = if camera.name.is_empty() { "scene" } else { &camera.name };
    CameraPath::standing_as(name, camera.position_m, camera.orientation, yfov_rad)
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};

    use super::*;

    fn cameras() -> Vec<NamedCamera> {
        let camera = |name: &str, x: f64, yfov_rad| NamedCamera {
            name: name.to_owned(),
            position_m: DVec3::X * x,
            orientation: DQuat::from_rotation_z(0.3) * DQuat::from_rotation_y(0.5),
            yfov_rad,
        };
        vec![camera("door", 1.0, 0.7), camera("", 2.0, 0.7), camera("1", 3.0, 3.1)]
    }

    fn scene(cameras: Vec<NamedCamera>) -> Scene {
        Scene { cameras, ..Scene::default() }
    }

    #[test]
    fn cameras_are_found_by_name_before_number() {
        let scene = scene(cameras());
        for (wanted, x) in [(None, 1.0), (Some("door"), 1.0), (Some("2"), 2.0), (Some("1"), 3.0), (Some("3"), 3.0)] {
            let camera = path_of(&scene, wanted).unwrap().camera(5.0, 16, 9);
            assert_eq!(camera.position_m.x, x, "{wanted:?}");
            // With its roll.
            assert!(camera.orientation.dot(scene.cameras[0].orientation) > 1.0 - 1e-12);
        }
        assert_eq!(path_of(&scene, None).unwrap().camera(0.0, 16, 9).yfov_rad, 0.7);
        assert!(YFOV_RANGE_RAD.contains(&path_of(&scene, Some("3")).unwrap().camera(0.0, 16, 9).yfov_rad));
    }

    #[test]
    fn an_unknown_camera_lists_those_there_are() {
        for wanted in ["window", "0", "4", "-1"] {
            let error = path_of(&scene(cameras()), Some(wanted)).unwrap_err().to_string();
            assert!(error.contains(wanted) && error.ends_with("the scene has door, 2, 1"), "{error}");
        }
        assert!(path_of(&scene(Vec::new()), Some("door")).unwrap_err().to_string().contains("no cameras"));
        let many: Vec<_> = cameras().into_iter().cycle().take(50).collect();
        assert!(path_of(&scene(many), Some("x")).unwrap_err().to_string().ends_with("30 more"));
    }
}
