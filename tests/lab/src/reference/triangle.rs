//! Watertight ray-triangle intersection in f64, with the ray's distance from the triangle's edges.
//!
//! Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013. Edge functions are evaluated on
//! coordinates that depend on one vertex alone, so triangles that share an edge agree about its side.

use glam::DVec3;

/// A ray prepared for intersection: its largest direction component is the new z axis, and a shear makes it (0, 0, 1).
#[derive(Debug, Clone, Copy)]
pub(super) struct Ray {
    /// Origin, in metres.
    pub(super) origin: DVec3,
    /// Direction, not normalised; distances along the ray are in units of its length.
    pub(super) direction: DVec3,
    /// Reciprocal of each direction component, for boxes.
    pub(super) inverse: DVec3,
    axes: [usize; 3],
    shear: [f64; 3],
}

/// The intersection of a ray with a triangle's plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Crossing {
    /// Distance in units of the direction's length. On a miss, clamped to the corners' distances.
    pub(super) t: f64,
    pub(super) weights: [f64; 3],
    /// Distance to the nearest edge in metres, measured across the ray; negative outside.
    pub(super) inside_m: f64,
}

impl Ray {
    pub(super) fn new(origin: DVec3, direction: DVec3) -> Self {
        let magnitude = direction.abs();
        let z = if magnitude.x >= magnitude.y && magnitude.x >= magnitude.z {
            0
        } else if magnitude.y >= magnitude.z {
            1
        } else {
            2
        };
        // The winding is not kept: both signs of the determinant are accepted.
        let axes = [(z + 1) % 3, (z + 2) % 3, z];
        let scale = 1.0 / direction[z];
        let shear = [direction[axes[0]] * scale, direction[axes[1]] * scale, scale];
        Self { origin, direction, inverse: direction.recip(), axes, shear }
    }

    pub(super) fn at(&self, t: f64) -> DVec3 {
        self.origin + self.direction * t
    }

    /// Returns the crossing with a triangle: inside if `inside_m >= 0`. `None` if the triangle is exactly edge-on.
    pub(super) fn cross(&self, corners: &[DVec3; 3]) -> Option<Crossing> {
        let [x, y, z] = self.axes;
        let [a, b, c] = corners.map(|corner| {
            let p = corner - self.origin;
            DVec3::new(p[x] - self.shear[0] * p[z], p[y] - self.shear[1] * p[z], p[z] * self.shear[2])
        });
        let edge = |p: DVec3, q: DVec3| p.x * q.y - p.y * q.x;
        let areas = [edge(b, c), edge(c, a), edge(a, b)];
        let determinant = areas[0] + areas[1] + areas[2];
        if determinant == 0.0 {
            return None;
        }
        let weights = areas.map(|area| area / determinant);
        let sign = determinant.signum();
        let distance = |area: f64, p: DVec3, q: DVec3| sign * area / (q - p).truncate().length();
        let inside_m = if areas.iter().all(|area| area * sign >= 0.0) {
            distance(areas[0], b, c).min(distance(areas[1], c, a)).min(distance(areas[2], a, b)).max(0.0)
        } else {
            // A zero-length edge gives 0/0 and drops out of `min`.
            let outside = distance(areas[0], b, c).min(distance(areas[1], c, a)).min(distance(areas[2], a, b));
            if outside < 0.0 { outside } else { -f64::MIN_POSITIVE }
        };
        let t = weights[0] * a.z + weights[1] * b.z + weights[2] * c.z;
        let (low, high) = (a.z.min(b.z).min(c.z), a.z.max(b.z).max(c.z));
        Some(Crossing { t: t.clamp(low, high), weights, inside_m })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: [DVec3; 3] = [DVec3::new(0.0, 0.0, 5.0), DVec3::new(4.0, 0.0, 5.0), DVec3::new(0.0, 3.0, 5.0)];

    #[test]
    fn crossings_have_the_distance_weights_and_margin_of_the_plane_geometry() {
        let ray = Ray::new(DVec3::new(1.0, 1.0, 1.0), DVec3::new(0.0, 0.0, 2.0));
        let crossing = ray.cross(&TRIANGLE).unwrap();
        assert!((crossing.t - 2.0).abs() < 1e-15);
        for (weight, expected) in crossing.weights.iter().zip([5.0 / 12.0, 0.25, 1.0 / 3.0]) {
            assert!((weight - expected).abs() < 1e-15);
        }
        // (1, 1) lies 1 from both legs of the right angle and (12 − 7)/5 = 1 from the hypotenuse.
        assert!((crossing.inside_m - 1.0).abs() < 1e-15);
        let outside = Ray::new(DVec3::new(-0.5, 1.0, 9.0), DVec3::NEG_Z).cross(&TRIANGLE).unwrap();
        assert!((outside.inside_m + 0.5).abs() < 1e-15 && (outside.t - 4.0).abs() < 1e-15);
    }

    #[test]
    fn a_triangle_seen_edge_on_is_missed() {
        assert_eq!(Ray::new(DVec3::new(-1.0, 1.0, 5.0), DVec3::X).cross(&TRIANGLE), None);
    }

    #[test]
    fn no_ray_slips_between_triangles_that_share_an_edge_or_a_corner() {
        // A fan around an awkward centre; rays aim at the centre and at points of the spokes.
        let centre = DVec3::new(0.1, 0.7, 0.3);
        let rim: Vec<_> = (0..7)
            .map(|k| {
                let angle = f64::from(k) / 7.0 * std::f64::consts::TAU;
                centre + DVec3::new(angle.cos(), angle.sin() * 1.3, 0.2 * (3.0 * angle).sin())
            })
            .collect();
        for eye in 0..500 {
            let phase = f64::from(eye) * 0.618;
            let from = DVec3::new(phase.cos() * 0.9, phase.sin() * 0.8, 3.0 + 0.01 * f64::from(eye));
            for (k, end) in rim.iter().enumerate() {
                for share in [0.0, 1.0 / 3.0, 0.77] {
                    let ray = Ray::new(from, centre.lerp(*end, share) - from);
                    let hits = (0..7).filter(|&i| {
                        let corners = [centre, rim[i], rim[(i + 1) % 7]];
                        ray.cross(&corners).is_some_and(|crossing| crossing.inside_m >= 0.0)
                    });
                    assert!(hits.count() > 0, "eye {eye}, spoke {k}, share {share}");
                }
            }
        }
    }
}
