//! Solids to build with: boxes, prisms, turned shapes.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};

use super::mesh::Soup;

pub(crate) fn part(index: usize, count: usize) -> f64 {
    index as f64 / count as f64
}

/// A box between two corners, without texture coordinates.
pub(crate) fn block(low: DVec3, high: DVec3) -> Soup {
    bevelled(low, high, 0.0)
}

/// A box between two corners whose twelve edges are cut by `bevel` metres; map it with [`Soup::box_mapped`].
pub(crate) fn bevelled(low: DVec3, high: DVec3, bevel: f64) -> Soup {
    let centre = (low + high) * 0.5;
    let half = (high - low) * 0.5;
    let mut soup = Soup::default();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for side in [-1.0, 1.0] {
            let at = |a: f64, b: f64, c: f64| {
                let mut p = DVec3::ZERO;
                p[axis] = side * a;
                p[u] = side * b;
                p[v] = c;
                (centre + p, DVec2::ZERO)
            };
            let (a, b, c) = (half[axis], half[u] - bevel, half[v] - bevel);
            soup.quad(at(a, -b, -c), at(a, b, -c), at(a, b, c), at(a, -b, c));
            if bevel > 0.0 {
                // The cut edge towards each side of `u`; the corner triangle where three of them meet.
                for end in [-1.0, 1.0] {
                    let (u_edge, a_edge) = (half[u], half[axis] - bevel);
                    let quad = [
                        at(a, end * b, -c),
                        at(a_edge, end * u_edge, -c),
                        at(a_edge, end * u_edge, c),
                        at(a, end * b, c),
                    ];
                    if end > 0.0 {
                        soup.quad(quad[0], quad[1], quad[2], quad[3]);
                    } else {
                        soup.quad(quad[3], quad[2], quad[1], quad[0]);
                    }
                }
            }
        }
    }
    if bevel > 0.0 {
        for corner in 0..8u32 {
            let sign = DVec3::new(
                if corner & 1 == 0 { -1.0 } else { 1.0 },
                if corner & 2 == 0 { -1.0 } else { 1.0 },
                if corner & 4 == 0 { -1.0 } else { 1.0 },
            );
            let inner = half - bevel;
            let at = |p: DVec3| (centre + sign * p, DVec2::ZERO);
            let (a, b, c) = (
                at(DVec3::new(half.x, inner.y, inner.z)),
                at(DVec3::new(inner.x, half.y, inner.z)),
                at(DVec3::new(inner.x, inner.y, half.z)),
            );
            if sign.x * sign.y * sign.z > 0.0 { soup.triangle(a, b, c) } else { soup.triangle(a, c, b) }
        }
    }
    soup
}

/// A block over a four-sided ground plan (counter-clockwise seen from above, x and z), without texture coordinates.
/// `sides[i]` says whether the wall from corner i to i + 1 is there.
pub(crate) fn prism(plan: [DVec2; 4], low: [f64; 4], high: [f64; 4], sides: [bool; 4]) -> Soup {
    let at = |i: usize, y: f64| (DVec3::new(plan[i].x, y, plan[i].y), DVec2::ZERO);
    let mut soup = Soup::default();
    soup.quad(at(0, high[0]), at(1, high[1]), at(2, high[2]), at(3, high[3]));
    soup.quad(at(3, low[3]), at(2, low[2]), at(1, low[1]), at(0, low[0]));
    for i in 0..4 {
        let j = (i + 1) % 4;
        if sides[i] {
            soup.quad(at(i, low[i]), at(j, low[j]), at(j, high[j]), at(i, high[i]));
        }
    }
    soup
}

/// A turned solid around +Y: `profile` gives (radius, height) from the bottom up; texture in units of `metres`.
pub(crate) fn lathe(profile: &[DVec2], segments: usize, metres: f64) -> Soup {
    shaped_lathe(profile, segments, metres, |_, _| 1.0)
}

/// A turned solid whose radius is multiplied by `shape(profile index, angle)`.
pub(crate) fn shaped_lathe(profile: &[DVec2], segments: usize, metres: f64, shape: impl Fn(usize, f64) -> f64) -> Soup {
    let mut along = vec![0.0];
    for pair in profile.windows(2) {
        along.push(along[along.len() - 1] + pair[0].distance(pair[1]));
    }
    let widest = profile.iter().fold(0.0, |widest: f64, p| widest.max(p.x));
    // A whole number of repeats, so that the seam does not show.
    let repeats = (TAU * widest / metres).round().max(1.0);
    let mut soup = Soup::default();
    soup.grid(segments, profile.len() - 1, |column, row| {
        let angle = TAU * part(column % segments, segments);
        let p = profile[row];
        let radius = p.x * shape(row, angle);
        let position = DVec3::new(radius * angle.sin(), p.y, radius * angle.cos());
        (position, DVec2::new(repeats * part(column, segments), -along[row] / metres))
    });
    soup
}

/// A profile of (radius, height) points for [`lathe`].
pub(crate) fn profile(points: &[(f64, f64)]) -> Vec<DVec2> {
    points.iter().map(|&(r, y)| DVec2::new(r, y)).collect()
}

/// A smooth curve through `points` (Catmull & Rom 1974), `steps` pieces between neighbours.
pub(crate) fn smooth(points: &[DVec3], steps: usize) -> Vec<DVec3> {
    let at = |i: usize| points[i.min(points.len() - 1)];
    let mut curve = Vec::new();
    for i in 0..points.len() - 1 {
        let (b, c, d) = (at(i), at(i + 1), at(i + 2));
        let a = if i == 0 { b } else { at(i - 1) };
        for step in 0..steps {
            let t = part(step, steps);
            let (t2, t3) = (t * t, t * t * t);
            curve.push(
                (b * 2.0 + (c - a) * t + (a * 2.0 - b * 5.0 + c * 4.0 - d) * t2 + (b * 3.0 - a - c * 3.0 + d) * t3)
                    * 0.5,
            );
        }
    }
    curve.push(at(points.len() - 1));
    curve
}

/// A smooth turned profile through (radius, height) points.
pub(crate) fn smooth_profile(points: &[(f64, f64)], steps: usize) -> Vec<DVec2> {
    let points: Vec<DVec3> = points.iter().map(|&(r, y)| DVec3::new(r, y, 0.0)).collect();
    smooth(&points, steps).into_iter().map(|p| DVec2::new(p.x.max(0.0), p.y)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloister::mesh::Mesh;

    /// Six times the volume by the divergence theorem: positive when the solid is closed and faces outwards.
    fn volume(mesh: &Mesh) -> f64 {
        mesh.indices
            .chunks(3)
            .map(|t| {
                let [a, b, c] = [0, 1, 2].map(|k| mesh.positions[t[k] as usize].as_dvec3());
                a.dot(b.cross(c)) / 6.0
            })
            .sum()
    }

    #[test]
    fn boxes_are_closed_and_face_outwards() {
        let far = DVec3::new(10.0, 20.0, 30.0);
        let plain = block(far, far + DVec3::new(1.0, 2.0, 3.0)).weld(10.0);
        assert!((volume(&plain) - 6.0).abs() < 1e-2, "{}", volume(&plain));
        let cut = bevelled(far, far + DVec3::ONE, 0.1).weld(10.0);
        // A unit cube less twelve edges (half of 0.1² each, 0.8 long) and eight corners (5/6 of 0.1³ each).
        let expected = 1.0 - 12.0 * 0.8 * 0.005 - 8.0 * 5.0 / 6.0 * 0.001;
        assert!((volume(&cut) - expected).abs() < 1e-2, "{} {expected}", volume(&cut));
    }

    #[test]
    fn turned_solids_and_prisms_face_outwards() {
        let cylinder = lathe(&profile(&[(0.0, 0.0), (1.0, 0.0), (1.0, 2.0), (0.0, 2.0)]), 64, 1.0).weld(10.0);
        assert!((volume(&cylinder) - TAU).abs() < 0.02, "{}", volume(&cylinder));
        let plan = [(0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0)].map(|(x, z)| DVec2::new(x, z));
        assert!((volume(&prism(plan, [0.0; 4], [1.0; 4], [true; 4]).weld(10.0)) - 1.0).abs() < 1e-6);
    }
}
