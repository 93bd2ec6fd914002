//! Profiles drawn along curves: mouldings, ribs, bars, ropes and branches.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};

use super::mesh::Soup;
use super::shapes::part;

/// Sharper joints than this are cut short instead of running out into a needle.
const MAX_MITRE: f64 = 2.0;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ends {
    /// The path runs into other solids: no caps.
    Open,
    Capped,
    /// The path's end meets its beginning.
    Loop,
}

/// Draws `profile` along `path`, with mitred joints. `up` is perpendicular to the path's plane; the profile's x lies
/// along tangent × up, its y along up. Looking along the path, the profile runs counter-clockwise around the solid; its
/// last point joins its first when `closed`. Texture in units of `metres`.
pub(crate) fn moulding(path: &[DVec3], up: DVec3, profile: &[DVec2], closed: bool, ends: Ends, metres: f64) -> Soup {
    let sides: Vec<DVec3> = (0..path.len()).map(|i| mitre(path, up, i, ends)).collect();
    rings(path, profile, closed, ends, metres, |i, p| path[i] + sides[i] * p.x + up * p.y)
}

/// A round bar along `path` with a radius for each fraction of its length.
pub(crate) fn tube(path: &[DVec3], sides: usize, ends: Ends, radius: impl Fn(f64) -> f64) -> Soup {
    let last = path.len() - 1;
    let mut frames: Vec<(DVec3, DVec3)> = Vec::new();
    let mut side = tangent(path, 0, ends).any_orthonormal_vector();
    for i in 0..path.len() {
        // Carries the frame along without twist (Bishop 1975).
        let forward = tangent(path, i, ends);
        side = (side - forward * side.dot(forward)).try_normalize().unwrap_or_else(|| forward.any_orthonormal_vector());
        frames.push((side, side.cross(forward)));
    }
    let circle: Vec<DVec2> = (0..sides).map(|k| DVec2::from_angle(TAU * part(k, sides))).collect();
    rings(path, &circle, true, ends, 0.5, |i, p| {
        let (right, up) = frames[i];
        path[i] + (right * p.x + up * p.y) * radius(part(i, last))
    })
}

/// The points of a circle around `centre` for a looped path. `a` and `b` span it and carry the radius.
pub(crate) fn circle(centre: DVec3, a: DVec3, b: DVec3, steps: usize) -> Vec<DVec3> {
    (0..steps).map(|i| TAU * part(i, steps)).map(|t| centre + a * t.cos() + b * t.sin()).collect()
}

fn rings(
    path: &[DVec3],
    profile: &[DVec2],
    closed: bool,
    ends: Ends,
    metres: f64,
    place: impl Fn(usize, DVec2) -> DVec3,
) -> Soup {
    let lengths = |points: Vec<f64>| {
        points.into_iter().fold(vec![0.0], |mut sums, d| {
            sums.push(sums[sums.len() - 1] + d / metres);
            sums
        })
    };
    let around = profile.len();
    let columns = if ends == Ends::Loop { path.len() } else { path.len() - 1 };
    let rows = if closed { around } else { around - 1 };
    let u = lengths((0..columns).map(|i| path[i].distance(path[(i + 1) % path.len()])).collect());
    let widths = (0..rows).map(|k| place(0, profile[k]).distance(place(0, profile[(k + 1) % around])));
    let v = lengths(widths.collect());
    let mut soup = Soup::default();
    soup.grid(columns, rows, |column, row| {
        (place(column % path.len(), profile[row % around]), DVec2::new(u[column], v[row]))
    });
    if ends == Ends::Capped {
        let last = path.len() - 1;
        for k in 1..around - 1 {
            let at = |i: usize, k: usize| (place(i, profile[k]), profile[k] / metres);
            soup.triangle(at(0, 0), at(0, k), at(0, k + 1));
            soup.triangle(at(last, 0), at(last, k + 1), at(last, k));
        }
    }
    soup
}

fn neighbours(path: &[DVec3], i: usize, ends: Ends) -> (DVec3, DVec3) {
    let count = path.len();
    if ends == Ends::Loop {
        (path[(i + count - 1) % count], path[(i + 1) % count])
    } else {
        (path[i.saturating_sub(1)], path[(i + 1).min(count - 1)])
    }
}

fn tangent(path: &[DVec3], i: usize, ends: Ends) -> DVec3 {
    let (before, after) = neighbours(path, i, ends);
    let arriving = (path[i] - before).normalize_or_zero();
    let leaving = (after - path[i]).normalize_or_zero();
    (arriving + leaving).try_normalize().unwrap_or(leaving)
}

/// The direction of the profile's x at point `i`, long enough that both neighbouring pieces keep their width.
fn mitre(path: &[DVec3], up: DVec3, i: usize, ends: Ends) -> DVec3 {
    let (before, after) = neighbours(path, i, ends);
    let forward = tangent(path, i, ends);
    let piece = (after - path[i]).try_normalize().or_else(|| (path[i] - before).try_normalize()).unwrap_or(forward);
    let side = forward.cross(up).normalize_or_zero();
    let half_turn_cos = side.dot(piece.cross(up).normalize_or_zero());
    side * (1.0 / half_turn_cos.max(1e-6)).min(MAX_MITRE)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn volume(soup: &Soup) -> f64 {
        let mesh = soup.weld(30.0);
        let at = |i: u32| mesh.positions[i as usize].as_dvec3();
        mesh.indices.chunks(3).map(|t| at(t[0]).dot(at(t[1]).cross(at(t[2]))) / 6.0).sum()
    }

    #[test]
    fn a_mitred_frame_has_the_volume_of_a_frame() {
        let path = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, z)| DVec3::new(x, 5.0, z));
        let square = [(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)].map(|(x, y)| DVec2::new(x, y));
        let frame = moulding(&path, DVec3::Y, &square, true, Ends::Loop, 1.0);
        // Outer square 2.2² less inner 1.8², 0.2 high.
        assert!((volume(&frame) - (2.2 * 2.2 - 1.8 * 1.8) * 0.2).abs() < 1e-3, "{}", volume(&frame));
    }

    #[test]
    fn a_capped_bar_and_a_ring_are_closed_and_face_outwards() {
        let bar = tube(&[DVec3::ZERO, DVec3::X, DVec3::X * 2.0], 32, Ends::Capped, |_| 0.5);
        assert!((volume(&bar) - TAU * 0.25).abs() < 0.03, "{}", volume(&bar));
        let ring = tube(&circle(DVec3::ZERO, DVec3::X, DVec3::Z, 64), 16, Ends::Loop, |_| 0.1);
        assert!((volume(&ring) - TAU * TAU * 0.5 * 0.01).abs() < 0.02, "{}", volume(&ring));
    }
}
