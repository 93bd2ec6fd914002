//! A ray against boxes and triangles, in f64.

use glam::DVec3;

#[derive(Debug, Clone, Copy)]
pub(super) struct Ray {
    pub(super) origin: DVec3,
    /// Distances are in lengths of it.
    pub(super) direction: DVec3,
}

/// Where a ray meets a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Met {
    pub(super) distance: f64,
    /// Weights of the second and the third corner.
    pub(super) weights: [f64; 2],
    /// The corners run counter-clockwise, seen from the ray's origin.
    pub(super) front: bool,
}

impl Ray {
    /// Returns whether the ray meets a box before `limit`.
    pub(super) fn meets_box(&self, [min, max]: [DVec3; 2], limit: f64) -> bool {
        // A zero would give 0 · ∞ for a side that contains the origin.
        let tiny = DVec3::splat(f64::MIN_POSITIVE);
        let slanted = DVec3::select(self.direction.cmpeq(DVec3::ZERO), tiny, self.direction);
        let inverse = slanted.recip().clamp(DVec3::splat(-f64::MAX), DVec3::splat(f64::MAX));
        let (one, other) = ((min - self.origin) * inverse, (max - self.origin) * inverse);
        let (enter, leave) = (one.min(other).max_element(), one.max(other).min_element());
        enter <= leave && leave >= 0.0 && enter < limit
    }

    /// Intersects a triangle (Möller and Trumbore, 1997). `None` behind the origin.
    pub(super) fn meet(&self, [corner, second, third]: [DVec3; 3]) -> Option<Met> {
        let (edge_1, edge_2) = (second - corner, third - corner);
        let across = self.direction.cross(edge_2);
        let determinant = edge_1.dot(across);
        if determinant == 0.0 {
            return None;
        }
        let offset = self.origin - corner;
        let u = offset.dot(across) / determinant;
        let around = offset.cross(edge_1);
        let v = self.direction.dot(around) / determinant;
        let distance = edge_2.dot(around) / determinant;
        let inside = u >= 0.0 && v >= 0.0 && u + v <= 1.0 && distance > 0.0;
        inside.then_some(Met { distance, weights: [u, v], front: determinant > 0.0 })
    }
}
