//! A camera as a link has it: `x,y,z,yaw,pitch,fov`, in metres and degrees.

use std::f64::consts::FRAC_PI_2;

use glam::{DQuat, DVec3};
use gnomon_protocol::limits::{MAX_POSITION_M, YFOV_RANGE_RAD};
use gnomon_scene::camera::Camera;

/// Writes where `camera` stands and looks, to a millimetre and a hundredth of a degree. A roll is left out.
#[must_use]
pub fn written(camera: &Camera) -> String {
    let forward = camera.orientation * DVec3::NEG_Z;
    let yaw = (-forward.x).atan2(-forward.z).to_degrees();
    let pitch = forward.y.clamp(-1.0, 1.0).asin().to_degrees();
    let DVec3 { x, y, z } = camera.position_m;
    format!("{x:.3},{y:.3},{z:.3},{yaw:.2},{pitch:.2},{:.2}", camera.yfov_rad.to_degrees())
}

/// Reads what [`written`] wrote. `None` if it is no view.
#[must_use]
pub fn read(text: &str, width: u32, height: u32) -> Option<Camera> {
    let numbers: Vec<f64> = text.split(',').map(str::parse).collect::<Result<_, _>>().ok()?;
    let &[x, y, z, yaw, pitch, fov] = numbers.as_slice() else { return None };
    let (position_m, yfov_rad) = (DVec3::new(x, y, z), fov.to_radians());
    let valid = position_m.abs().max_element() <= MAX_POSITION_M
        && position_m.is_finite()
        && yaw.is_finite()
        && pitch.to_radians().abs() <= FRAC_PI_2
        && YFOV_RANGE_RAD.contains(&yfov_rad);
    let orientation = DQuat::from_rotation_y(yaw.to_radians()) * DQuat::from_rotation_x(pitch.to_radians());
    valid.then_some(Camera { position_m, orientation, yfov_rad, width, height })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_is_found_again() {
        let camera = Camera::looking_at(DVec3::new(1.25, -3.0, 70_000.5), DVec3::new(0.0, -2.0, 70_004.0), 1.0, 4, 3);
        let again = read(&written(&camera), 4, 3).unwrap();
        assert!(again.position_m.distance(camera.position_m) < 1e-3, "{again:?}");
        assert!(again.orientation.angle_between(camera.orientation) < 2e-4, "{again:?}");
        assert!((again.yfov_rad - camera.yfov_rad).abs() < 1e-4);
    }

    #[test]
    fn other_texts_are_no_views() {
        for text in [
            "",
            "1,2,3",
            "1,2,3,4,5,6,7",
            "a,2,3,4,5,60",
            "inf,0,0,0,0,60",
            "1e300,0,0,0,0,60",
            "0,0,0,0,91,60",
            "0,0,0,0,0,0",
            "0,0,0,NaN,0,60",
        ] {
            assert_eq!(read(text, 4, 3), None, "{text:?}");
        }
    }
}
