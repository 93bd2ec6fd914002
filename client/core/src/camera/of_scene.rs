//! Cameras that a scene's file brings along.

use gnomon_protocol::limits::YFOV_RANGE_RAD;
use gnomon_scene::NamedCamera;
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

/// Returns a path that stands at the camera with this name, or else this number counted from 1; at the first without.
///
/// # Errors
/// Names the cameras if there is no such one.
pub fn standing_at(cameras: &[NamedCamera], wanted: Option<&str>) -> Result<CameraPath, NoSuchCamera> {
    let first = cameras.first().ok_or(NoSuchCamera::None)?;
    let Some(wanted) = wanted else { return Ok(standing(first)) };
    let named = cameras.iter().position(|camera| camera.name == wanted);
    let numbered = || wanted.parse::<usize>().ok()?.checked_sub(1);
    let found = named.or_else(numbered).and_then(|index| cameras.get(index));
    found.map(standing).ok_or_else(|| {
        let mut found: Vec<String> =
            cameras.iter().enumerate().take(LISTED).map(|(index, camera)| label(index, camera)).collect();
        if cameras.len() > LISTED {
            found.push(format!("{} more", cameras.len() - LISTED));
        }
        NoSuchCamera::Unknown { wanted: wanted.to_owned(), found }
    })
}

/// Returns a path that stands at a camera.
#[must_use]
pub fn standing(camera: &NamedCamera) -> CameraPath {
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

    #[test]
    fn cameras_are_found_by_name_before_number() {
        let cameras = cameras();
        for (wanted, x) in [(None, 1.0), (Some("door"), 1.0), (Some("2"), 2.0), (Some("1"), 3.0), (Some("3"), 3.0)] {
            let camera = standing_at(&cameras, wanted).unwrap().camera(5.0, 16, 9);
            assert_eq!(camera.position_m.x, x, "{wanted:?}");
            // With its roll.
            assert!(camera.orientation.dot(cameras[0].orientation) > 1.0 - 1e-12);
        }
        assert_eq!(standing_at(&cameras, None).unwrap().camera(0.0, 16, 9).yfov_rad, 0.7);
        assert!(YFOV_RANGE_RAD.contains(&standing_at(&cameras, Some("3")).unwrap().camera(0.0, 16, 9).yfov_rad));
    }

    #[test]
    fn an_unknown_camera_lists_those_there_are() {
        for wanted in ["window", "0", "4", "-1"] {
            let error = standing_at(&cameras(), Some(wanted)).unwrap_err().to_string();
            assert!(error.contains(wanted) && error.ends_with("the scene has door, 2, 1"), "{error}");
        }
        assert!(standing_at(&[], Some("door")).unwrap_err().to_string().contains("no cameras"));
        let many: Vec<_> = cameras().into_iter().cycle().take(50).collect();
        assert!(standing_at(&many, Some("x")).unwrap_err().to_string().ends_with("30 more"));
    }
}
