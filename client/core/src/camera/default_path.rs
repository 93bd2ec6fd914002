//! The camera path used when none is given: around an object, or through a room.
//!
//! Ray casts against the scene's largest triangles decide. Inside walls, the camera moves along a long free line with
//! an open view; otherwise it goes half way around the scene, looking at its centre.

use std::f32::consts::{FRAC_PI_4, TAU};

use glam::{DVec3, Vec3};
use gnomon_scene::Scene;

use crate::{
    camera::path::{CameraPath, Keyframe},
    occluders::Occluders,
};

/// Directions tried around a position.
const DIRECTIONS: u8 = 16;

/// A position is inside if at least this share of the directions hit a wall.
const INSIDE: f32 = 0.7;

/// Candidate ways that are tested against all triangles.
const PROMISING: usize = 24;

/// Vertical field of view.
const YFOV_RAD: f64 = 1.0;

const DURATION_S: f64 = 8.0;

#[must_use]
pub fn default_path(scene: &Scene, occluders: &Occluders) -> CameraPath {
    let local = walk_inside(scene, occluders).unwrap_or_else(|| orbit(scene));
    let last = local.len().saturating_sub(1).max(1);
    let keyframes = (local.into_iter().enumerate())
        .map(|(index, (position, target))| Keyframe {
            time_s: DURATION_S * index as f64 / last as f64,
            position_m: scene.origin_m + position.as_dvec3(),
            target_m: scene.origin_m + target.as_dvec3(),
        })
        .collect();
    let origin = Keyframe { time_s: 0.0, position_m: DVec3::ZERO, target_m: DVec3::NEG_Z };
    CameraPath::new("default", keyframes, YFOV_RAD)
        // The keyframes are invalid only if the scene is empty or a single point: there is nothing to show.
        .unwrap_or_else(|_| CameraPath::standing("default", origin, YFOV_RAD))
}

/// Half a circle around the scene, slightly from above.
fn orbit(scene: &Scene) -> Vec<(Vec3, Vec3)> {
    let middle = (scene.bounds.min + scene.bounds.max) * 0.5;
    let radius = (scene.bounds.max - scene.bounds.min).length() * 0.5;
    (0..=16_u8)
        .map(|step| {
            let angle = FRAC_PI_4 + TAU * 0.5 * f32::from(step) / 16.0;
            let away = Vec3::new(angle.cos(), 0.45, angle.sin()).normalize();
            (middle + away * radius * 2.1, middle)
        })
        .collect()
}

/// A straight way to walk, found with the largest triangles alone.
struct Way {
    start: Vec3,
    forward: Vec3,
    /// Distance to the first wall ahead of the start.
    free: f32,
}

fn walk_inside(scene: &Scene, occluders: &Occluders) -> Option<Vec<(Vec3, Vec3)>> {
    let (low, size) = (scene.bounds.min, scene.bounds.max - scene.bounds.min);
    let reach = size.length();
    let shares = [0.25, 0.5, 0.75];
    let mut ways = Vec::new();
    for (x, z) in shares.iter().flat_map(|x| shares.iter().map(move |z| (*x, *z))) {
        let above = low + size * Vec3::new(x, 0.5, z);
        // Eye level above the floor there, but not above the scene's vertical centre.
        let Some(floor) = occluders.nearest(above, Vec3::NEG_Y, size.y).filter(|floor| floor.visible) else { continue };
        let height = floor.distance;
        let position = above - Vec3::Y * (height - 1.6_f32.min(height * 0.9)).max(0.0);
        ways.extend(ways_from(position, reach, occluders));
    }
    ways.sort_by(|one, other| other.free.total_cmp(&one.free));
    ways.truncate(PROMISING);
    // From here on small triangles count too: the path must not start behind a column.
    let all = Occluders::all_of(scene);
    let (view, way) = (ways.into_iter().map(|way| (free_view(&way, reach, &all), way)))
        .max_by(|(one, _), (other, _)| one.total_cmp(other))?;
    let target = way.forward * view.max(reach * 1e-3) - Vec3::Y * (view * 0.02);
    let end = way.start + way.forward * view * 0.5;
    (view > reach * 1e-2).then(|| vec![(way.start, way.start + target), (end, end + target)])
}

/// Returns ways along the floor if visible sides of walls surround `position`; back sides mean the inside of an object.
fn ways_from(position: Vec3, reach: f32, occluders: &Occluders) -> Vec<Way> {
    let directions = (0..DIRECTIONS).map(|index| {
        let angle = TAU * f32::from(index) / f32::from(DIRECTIONS);
        Vec3::new(angle.cos(), 0.0, angle.sin())
    });
    let met: Vec<_> = directions.map(|direction| (direction, occluders.nearest(position, direction, reach))).collect();
    let walls = met.iter().filter(|(_, met)| met.is_some_and(|met| met.visible)).count();
    if (walls as f32) < INSIDE * f32::from(DIRECTIONS) {
        return Vec::new();
    }
    (met.iter().zip(met.iter().cycle().skip(met.len() / 2)))
        .filter_map(|((forward, ahead), (_, behind))| {
            let back = behind.map_or(0.0, |met| met.distance) * 0.6;
            Some(Way { start: position - *forward * back, forward: *forward, free: ahead.as_ref()?.distance + back })
        })
        .collect()
}

/// Returns the distance to the nearest hit around the centre of the view.
fn free_view(way: &Way, reach: f32, all: &Occluders) -> f32 {
    let side = way.forward.cross(Vec3::Y);
    [(0.0, 0.0), (0.12, 0.0), (-0.12, 0.0), (0.25, 0.05), (-0.25, 0.05), (0.0, -0.05)]
        .into_iter()
        .map(|(across, up)| {
            let direction = (way.forward + side * across + Vec3::Y * up).normalize();
            all.nearest(way.start, direction, reach).map_or(reach, |met| met.distance)
        })
        .fold(reach, f32::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::testing::floor_and_lights;

    #[test]
    fn an_open_scene_is_orbited() {
        let scene = floor_and_lights();
        let path = default_path(&scene, &Occluders::largest_of(&scene));
        let middle = scene.origin_m + DVec3::new(0.0, 0.5, 0.0);
        let radius = 2.1 * f64::from((scene.bounds.max - scene.bounds.min).length()) / 2.0;
        for time in 0..8 {
            let camera = path.camera(f64::from(time), 16, 9);
            assert!((camera.position_m.distance(middle) / radius - 1.0).abs() < 0.02, "{time} s");
        }
        let (first, last) = (path.camera(0.0, 1, 1).position_m, path.camera(8.0, 1, 1).position_m);
        assert!(first.distance(last) > radius);
    }

    #[test]
    fn a_room_is_walked_through_without_meeting_a_wall() {
        // A closed room of 10 × 3 × 4 m.
        let mut scene = floor_and_lights();
        let (low, high) = (Vec3::new(-5.0, 0.0, -2.0), Vec3::new(5.0, 3.0, 2.0));
        scene.positions = (0..8_u8)
            .map(|corner| {
                let pick = |bit: u8, low, high| if corner >> bit & 1 == 1 { high } else { low };
                Vec3::new(pick(0, low.x, high.x), pick(1, low.y, high.y), pick(2, low.z, high.z))
            })
            .collect();
        scene.triangles = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]
            .into_iter()
            .flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]])
            .collect();
        scene.draws.truncate(1);
        scene.draws[0].triangles = 12;
        scene.materials[0].double_sided = true;
        (scene.bounds.min, scene.bounds.max) = (low, high);
        let path = default_path(&scene, &Occluders::largest_of(&scene));
        for step in 0..80 {
            let position = (path.camera(f64::from(step) * 0.1, 16, 9).position_m - scene.origin_m).as_vec3();
            assert!(position.cmpgt(low + 0.2).all() && position.cmplt(high - 0.2).all(), "{position}");
        }
        let (first, last) = (path.camera(0.0, 1, 1).position_m, path.camera(8.0, 1, 1).position_m);
        assert!(first.distance(last) > 3.0, "{first} {last}");
        // The same box with only its outside drawn is an object.
        scene.materials[0].double_sided = false;
        scene.triangles.iter_mut().for_each(|corners| {
            let [a, b, c] = corners.map(|index| scene.positions[index as usize]);
            if (b - a).cross(c - a).dot(a + b + c - (low + high) * 1.5) < 0.0 {
                corners.swap(0, 1);
            }
        });
        let around = default_path(&scene, &Occluders::largest_of(&scene)).camera(0.0, 16, 9).position_m;
        assert!((around - scene.origin_m).length() > f64::from((high - low).length()));
    }
}
