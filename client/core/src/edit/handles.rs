//! What a person drags: arrows, rings and knobs around the chosen thing, as large on the screen at any distance.

use glam::{DVec2, DVec3};

use super::view::View;

/// An axis of the world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    X,
    Y,
    Z,
}

impl Axis {
    pub const ALL: [Self; 3] = [Self::X, Self::Y, Self::Z];

    #[must_use]
    pub fn direction(self) -> DVec3 {
        match self {
            Self::X => DVec3::X,
            Self::Y => DVec3::Y,
            Self::Z => DVec3::Z,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Handle {
    /// Moves along an axis.
    Move(Axis),
    /// Moves in the plane parallel to the screen.
    Slide,
    /// Turns around an axis.
    Turn(Axis),
    /// Scales evenly.
    Scale,
}

/// Which handles there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Kinds {
    pub moves: bool,
    pub turns: bool,
    pub scales: bool,
}

/// From and to where an arrow reaches, in radii of the rings.
const ARROW: [f64; 2] = [0.2, 0.8];

/// Radius of the knob in the middle.
const KNOB: f64 = 0.13;

/// Where the knob that scales is, right of the middle and above.
const SCALE_AT: f64 = 0.85;

/// An arrow that points at the camera or away is left out: its pixels say little of where it is. Cosine of the angle.
const TOO_STEEP: f64 = 0.97;

/// Sides of a ring.
const SIDES: u32 = 64;

/// A handle on the screen: a line, or one point.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawn {
    pub handle: Handle,
    /// In pixels; `true` for those behind the pivot.
    pub points: Vec<(DVec2, bool)>,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Gizmo {
    /// In the world; what is turned and scaled keeps this place.
    pub pivot: DVec3,
    /// Radius of the rings, in metres.
    pub radius_m: f64,
    pub radius_px: f64,
    pub handles: Vec<Drawn>,
}

impl Gizmo {
    /// Returns the handles around a point of the world. `None` if it is not before the camera.
    #[must_use]
    pub fn around(view: &View, pivot: DVec3, radius_px: f64, kinds: Kinds) -> Option<Self> {
        let middle = view.project(pivot)?;
        let radius_m = radius_px / view.px_per_m(view.depth_m(pivot));
        let mut handles = Vec::new();
        let along = (pivot - view.camera.position_m).normalize_or_zero();
        for axis in Axis::ALL {
            let steep = axis.direction().dot(along).abs() > TOO_STEEP;
            let ends = ARROW.map(|end| view.project(pivot + axis.direction() * radius_m * end));
            if let ([Some(from), Some(to)], true, false) = (ends, kinds.moves, steep) {
                handles.push(Drawn { handle: Handle::Move(axis), points: vec![(from, false), (to, false)] });
            }
            let corner = |point| Some((view.project(point)?, view.depth_m(point) > view.depth_m(pivot)));
            let ring: Option<Vec<_>> = ring(pivot, radius_m, axis).map(corner).collect();
            if let (Some(points), true) = (ring, kinds.turns) {
                handles.push(Drawn { handle: Handle::Turn(axis), points });
            }
        }
        if kinds.moves {
            handles.push(Drawn { handle: Handle::Slide, points: vec![(middle, false)] });
        }
        if kinds.scales {
            let at = middle + DVec2::new(radius_px, -radius_px) * SCALE_AT;
            handles.push(Drawn { handle: Handle::Scale, points: vec![(at, false)] });
        }
        Some(Self { pivot, radius_m, radius_px, handles })
    }

    /// Radius of the knob in the middle, in pixels.
    fn knob_px(&self) -> f64 {
        self.radius_px * KNOB
    }

    /// Returns the handle that is nearest to a pixel, if it is within `reach_px`.
    #[must_use]
    pub fn at(&self, px: DVec2, reach_px: f64) -> Option<Handle> {
        let near = self.handles.iter().filter_map(|drawn| {
            let distance = distance_px(&drawn.points, px);
            // Rings seen from their side go through the knob in the middle, which lies on top.
            if drawn.handle == Handle::Slide && distance <= self.knob_px() {
                return Some((-1.0, drawn.handle));
            }
            (distance <= reach_px).then_some((distance, drawn.handle))
        });
        near.min_by(|one, other| one.0.total_cmp(&other.0)).map(|(_, handle)| handle)
    }
}

/// Returns the corners of a ring, in the world. The last is the first.
pub(super) fn ring(pivot: DVec3, radius_m: f64, axis: Axis) -> impl Iterator<Item = DVec3> {
    let (one, other) = axis.direction().any_orthonormal_pair();
    (0..=SIDES).map(move |side| {
        let (sin, cos) = (f64::from(side) / f64::from(SIDES) * std::f64::consts::TAU).sin_cos();
        pivot + (one * cos + other * sin) * radius_m
    })
}

fn distance_px(points: &[(DVec2, bool)], px: DVec2) -> f64 {
    if let [(only, _)] = points {
        return only.distance(px);
    }
    let of_segment = |[(from, _), (to, _)]: &[(DVec2, bool); 2]| {
        let along = *to - *from;
        let share = ((px - *from).dot(along) / along.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        (*from + along * share).distance(px)
    };
    points.array_windows().map(of_segment).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
pub(super) mod tests {
    use gnomon_scene::camera::Camera;

    use super::*;

    pub(in crate::edit) const ALL: Kinds = Kinds { moves: true, turns: true, scales: true };

    pub(in crate::edit) fn view() -> View {
        let (from, to) = (DVec3::new(3.0, 2.0, 6.0), DVec3::new(0.0, 0.5, 0.0));
        View { camera: Camera::looking_at(from, to, 1.0, 1280, 720), near_m: 0.005 }
    }

    #[test]
    fn handles_are_as_large_at_any_distance_and_each_is_found() {
        for distance in [0.5, 4.0, 300.0] {
            let view = view();
            let pivot = view.camera.position_m + view.ray(DVec2::new(600.0, 400.0)) * distance;
            let gizmo = Gizmo::around(&view, pivot, 90.0, ALL).unwrap();
            let kinds = gizmo.handles.iter().map(|drawn| drawn.handle);
            assert_eq!(kinds.clone().count(), 8, "{:?}", kinds.collect::<Vec<_>>());
            for Drawn { handle, points } in &gizmo.handles {
                // A place of its own: the tip of an arrow, a point of a ring that no other ring meets.
                let place = if matches!(handle, Handle::Turn(_)) { points[11].0 } else { points[points.len() - 1].0 };
                assert_eq!(gizmo.at(place, 6.0), Some(*handle), "{distance}");
                for (px, _) in points {
                    // A ring's near half looks larger, by at most its radius over the distance.
                    let most = 90.0 * 2.0_f64.sqrt() * 1.3;
                    assert!(px.distance(DVec2::new(600.0, 400.0)) < most, "{handle:?} {px}");
                }
            }
            assert_eq!(gizmo.at(DVec2::new(600.0, 400.0) + 200.0, 6.0), None);
        }
    }

    #[test]
    fn what_is_behind_the_camera_or_has_no_use_is_left_out() {
        let view = view();
        let behind = view.camera.position_m - view.forward();
        assert_eq!(Gizmo::around(&view, behind, 90.0, ALL), None);
        let before = view.camera.position_m + view.forward();
        let turns = Gizmo::around(&view, before, 90.0, Kinds { moves: false, turns: true, scales: false }).unwrap();
        assert!(turns.handles.iter().all(|drawn| matches!(drawn.handle, Handle::Turn(_))));
        // Looking along −z, the arrow along z is a point.
        let along = View { camera: Camera { orientation: glam::DQuat::IDENTITY, ..view.camera }, ..view };
        let ahead = Gizmo::around(&along, along.camera.position_m + DVec3::NEG_Z * 3.0, 90.0, ALL).unwrap();
        assert!(!ahead.handles.iter().any(|drawn| drawn.handle == Handle::Move(Axis::Z)));
    }
}
