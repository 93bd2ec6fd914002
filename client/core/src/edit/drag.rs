//! What a drag of a handle means in the world.

use glam::{DVec2, DVec3};

use super::{
    handles::{Axis, Gizmo, Handle, ring},
    view::View,
};

/// A ring seen so much from its side that the pointer's ray says little about the angle. Sine of the angle.
const TOO_FLAT: f64 = 0.15;

/// Least share of a ring's radius in pixels that a radian counts as where the ring is seen from its side: near its ends
/// it runs towards the camera, and a pixel would be a large turn.
const LEAST_PACE: f64 = 0.7;

/// Scales at once, at least and at most.
const SCALES: [f64; 2] = [0.01, 100.0];

/// A handle that is held.
#[derive(Debug, Clone, Copy)]
pub(super) struct Drag {
    handle: Handle,
    /// Where it was held first.
    from_px: DVec2,
    /// The place of the handle there, in the world.
    grabbed: DVec3,
    pivot: DVec3,
    radius_m: f64,
}

/// What a drag has done since it began.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Motion {
    /// In the world, in metres.
    Move(DVec3),
    /// Around an axis of the world, in radians.
    Turn(DVec3, f64),
    Scale(f64),
}

impl Drag {
    /// Begins at a pixel. `None` if the handle is nowhere there.
    pub(super) fn begin(view: &View, gizmo: &Gizmo, handle: Handle, px: DVec2) -> Option<Self> {
        let pivot = gizmo.pivot;
        let grabbed = match handle {
            Handle::Move(axis) => pivot + axis.direction() * along(view, pivot, axis.direction(), px)?,
            Handle::Slide => on_plane(view, pivot, view.forward(), px)?,
            Handle::Turn(axis) if is_flat(view, pivot, axis) => {
                // The nearer half has all that the other shows.
                let near =
                    ring(pivot, gizmo.radius_m, axis).filter(|point| view.depth_m(*point) <= view.depth_m(pivot));
                let seen = near.filter_map(|point| Some((view.project(point)?.distance_squared(px), point)));
                seen.min_by(|one, other| one.0.total_cmp(&other.0))?.1
            }
            Handle::Turn(axis) => on_plane(view, pivot, axis.direction(), px)?,
            Handle::Scale => pivot,
        };
        Some(Self { handle, from_px: px, grabbed, pivot, radius_m: gizmo.radius_m })
    }

    pub(super) fn handle(&self) -> Handle {
        self.handle
    }

    /// Returns what the drag has done when the pointer is at a pixel. `None` if that says nothing: beyond a horizon.
    pub(super) fn motion(&self, view: &View, px: DVec2) -> Option<Motion> {
        match self.handle {
            Handle::Move(axis) => {
                let direction = axis.direction();
                along(view, self.grabbed, direction, px).map(|by| Motion::Move(direction * by))
            }
            Handle::Slide => {
                let there = on_plane(view, self.grabbed, view.forward(), px)?;
                Some(Motion::Move(there - self.grabbed))
            }
            Handle::Turn(axis) => Some(Motion::Turn(axis.direction(), self.angle_rad(view, axis, px)?)),
            Handle::Scale => {
                let middle = view.project(self.pivot)?;
                let factor = px.distance(middle) / self.from_px.distance(middle);
                factor.is_finite().then_some(Motion::Scale(factor.clamp(SCALES[0], SCALES[1])))
            }
        }
    }

    fn angle_rad(&self, view: &View, axis: Axis, px: DVec2) -> Option<f64> {
        let (axis_, offset) = (axis.direction(), self.grabbed - self.pivot);
        if is_flat(view, self.pivot, axis) {
            let tangent = axis_.cross(offset).try_normalize()?;
            let pace = view.pace(self.grabbed, tangent) * self.radius_m;
            let least = view.px_per_m(view.depth_m(self.pivot)) * self.radius_m * LEAST_PACE;
            return Some((px - self.from_px).dot(pace) / pace.length_squared().max(least * least));
        }
        let there = on_plane(view, self.pivot, axis_, px)? - self.pivot;
        Some(offset.cross(there).dot(axis_).atan2(offset.dot(there)))
    }
}

fn is_flat(view: &View, pivot: DVec3, axis: Axis) -> bool {
    let along = (pivot - view.camera.position_m).normalize_or_zero();
    along.dot(axis.direction()).abs() < TOO_FLAT
}

/// Returns how far to go along a line from `base`, in metres, to be seen nearest to a pixel: where the line meets the
/// plane through the pixel that is square to it on the screen.
fn along(view: &View, base: DVec3, direction: DVec3, px: DVec2) -> Option<f64> {
    let square = view.pace(base, direction).perp();
    let normal = view.ray(px).cross(view.ray(px + square.try_normalize()?));
    let by = normal.dot(view.camera.position_m - base) / normal.dot(direction);
    (by.is_finite() && view.depth_m(base + direction * by) >= view.near_m).then_some(by)
}

/// Returns where a pixel's ray meets a plane.
fn on_plane(view: &View, on: DVec3, normal: DVec3, px: DVec2) -> Option<DVec3> {
    let (from, ray) = (view.camera.position_m, view.ray(px));
    let distance = (on - from).dot(normal) / ray.dot(normal);
    (distance.is_finite() && distance >= view.near_m).then(|| from + ray * distance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edit::handles::tests::{ALL, view};

    const PIVOT: DVec3 = DVec3::new(0.4, 0.3, -1.0);

    fn held(handle: Handle, px: DVec2) -> Drag {
        let view = view();
        Drag::begin(&view, &Gizmo::around(&view, PIVOT, 90.0, ALL).unwrap(), handle, px).unwrap()
    }

    fn place_of(handle: Handle) -> DVec2 {
        let gizmo = Gizmo::around(&view(), PIVOT, 90.0, ALL).unwrap();
        let drawn = gizmo.handles.into_iter().find(|drawn| drawn.handle == handle).unwrap();
        drawn.points[drawn.points.len() / 2].0
    }

    /// Coordinates of at most 10 m are rounded by 2⁻⁵⁰ m a few times, and a metre is about 100 pixels: 1e-12 pixels.
    /// The directions of the plane of an arrow are pixels apart, a thousandth of the ray: 1e-9 pixels.
    const ROUNDING_PX: f64 = 1e-8;

    #[test]
    fn a_drag_moves_by_what_projects_to_its_pixels() {
        let view = view();
        let by_px = DVec2::new(37.0, -21.0);
        let middle = view.project(PIVOT).unwrap();
        for (handle, direction) in [
            (Handle::Slide, None),
            (Handle::Move(Axis::X), Some(DVec3::X)),
            (Handle::Move(Axis::Y), Some(DVec3::Y)),
            (Handle::Move(Axis::Z), Some(DVec3::Z)),
        ] {
            // Held in the middle, so that the pivot is the point that follows.
            let Some(Motion::Move(by)) = held(handle, middle).motion(&view, middle + by_px) else { panic!() };
            let moved_px = view.project(PIVOT + by).unwrap() - middle;
            match direction {
                None => {
                    assert!(moved_px.distance(by_px) < ROUNDING_PX, "{moved_px}");
                    assert!((view.depth_m(PIVOT + by) - view.depth_m(PIVOT)).abs() < 1e-12);
                }
                Some(direction) => {
                    assert!(by.cross(direction).length() < 1e-12, "{by}");
                    // As far along the arrow as the pointer has gone along it.
                    let on_screen = view.pace(PIVOT, direction).normalize();
                    assert!((moved_px - by_px).dot(on_screen).abs() < ROUNDING_PX, "{moved_px}");
                }
            }
        }
    }

    #[test]
    fn a_drag_that_returns_does_nothing() {
        let view = view();
        for handle in Axis::ALL.map(Handle::Move).into_iter().chain(Axis::ALL.map(Handle::Turn)).chain([Handle::Slide])
        {
            let px = place_of(handle);
            let by = match held(handle, px).motion(&view, px).unwrap() {
                Motion::Move(by) => by.length(),
                Motion::Turn(_, angle_rad) => angle_rad.abs(),
                Motion::Scale(factor) => (factor - 1.0).abs(),
            };
            assert!(by < 1e-10, "{handle:?}: {by}");
        }
        let px = place_of(Handle::Scale);
        assert_eq!(held(Handle::Scale, px).motion(&view, px), Some(Motion::Scale(1.0)));
        let middle = view.project(PIVOT).unwrap();
        let twice = held(Handle::Scale, px).motion(&view, middle + (px - middle) * 2.0);
        let Some(Motion::Scale(factor)) = twice else { panic!() };
        assert!((factor - 2.0).abs() < 1e-12);
    }

    #[test]
    fn a_ring_follows_the_pointer_around() {
        let view = view();
        for axis in Axis::ALL {
            let (one, other) = axis.direction().any_orthonormal_pair();
            let on_ring = |angle_rad: f64| PIVOT + one * angle_rad.cos() * 0.4 + other * angle_rad.sin() * 0.4;
            let px = |angle_rad: f64| view.project(on_ring(angle_rad)).unwrap();
            // Right-handed, if the pair is.
            let hand = one.cross(other).dot(axis.direction());
            for (from, to) in [(0.1, 0.9), (0.1, 3.0), (2.0, -0.5)] {
                let Some(Motion::Turn(around, angle_rad)) = held(Handle::Turn(axis), px(from)).motion(&view, px(to))
                else {
                    panic!()
                };
                assert_eq!(around, axis.direction());
                assert!((angle_rad - (to - from) * hand).abs() < 1e-9, "{axis:?} {angle_rad}");
            }
        }
    }

    #[test]
    fn a_ring_from_its_side_turns_along_the_screen() {
        // Looking along −z from the height of the pivot: the ring around y is a line.
        let mut view = view();
        (view.camera.position_m, view.camera.orientation) = (PIVOT + DVec3::Z * 5.0, glam::DQuat::IDENTITY);
        let gizmo = Gizmo::around(&view, PIVOT, 90.0, ALL).unwrap();
        let middle = view.project(PIVOT).unwrap();
        let drag = Drag::begin(&view, &gizmo, Handle::Turn(Axis::Y), middle + DVec2::new(1.0, 0.0)).unwrap();
        let Some(Motion::Turn(_, angle_rad)) = drag.motion(&view, middle + DVec2::new(46.0, 0.0)) else { panic!() };
        // Its nearest point is held, where a radian of a ring of 90 px is seen larger. The corner that is held is half
        // a side of 64 off at most, where the cosine is 0.9988.
        let pace_px = 90.0 * 5.0 / (5.0 - gizmo.radius_m);
        assert!((angle_rad.abs() * pace_px / 45.0 - 1.0).abs() < 0.002, "{angle_rad}");
        // Up and down is not along the ring.
        let up = drag.motion(&view, middle + DVec2::new(1.0, -45.0));
        let Some(Motion::Turn(_, angle_rad)) = up else { panic!() };
        assert!(angle_rad.abs() < 0.05, "{angle_rad}");
    }

    #[test]
    fn beyond_the_horizon_nothing_moves() {
        let view = view();
        let drag = held(Handle::Move(Axis::Z), view.project(PIVOT).unwrap());
        // The arrow's vanishing point, and what lies behind it.
        let far = view.project(PIVOT - DVec3::Z * 1e7).unwrap();
        let beyond = far + (far - view.project(PIVOT).unwrap()) * 0.5;
        assert_eq!(drag.motion(&view, beyond), None);
    }
}
