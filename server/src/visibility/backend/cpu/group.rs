//! A group of up to 64 rays that share an origin or a direction, and so form a projection of the scene.
//!
//! Camera rays start at the camera. Shadow rays are traced backwards: they start at the light, or run along the sun's
//! direction. Seen from there a group's rays are points (x, y) of a projection plane, and a triangle is a triangle of
//! that plane. The signs of three edge functions tell whether a ray hits it, as in a rasteriser (Olano and Greer,
//! "Triangle Scan Conversion using 2D Homogeneous Coordinates", 1997). Two triangles compute a shared edge's function
//! from the same numbers with opposite signs, bit for bit, so no ray slips between them.
//!
//! The plane is a face of a cube around the origin. Each ray belongs to the face that its direction points to, so |x|,
//! |y| ≤ 1. A tile whose rays point to several faces makes several groups.

use glam::Vec3;

use super::simd::{F8, Simd};

/// Packets in a group; a packet is eight rays.
pub(super) const PACKETS: usize = 8;

/// A cube face: 2·axis, plus 1 for the negative side.
pub(super) type Face = u8;

/// The face that `direction` points to.
pub(super) fn face_of(direction: Vec3) -> Face {
    let a = direction.abs();
    let (axis, face) = if a.x >= a.y && a.x >= a.z {
        (0, 0)
    } else if a.y >= a.z {
        (1, 2)
    } else {
        (2, 4)
    };
    face + u8::from(direction[axis] < 0.0)
}

/// Maps scene points to the plane. Coordinates (u, v, w) are the scene's, permuted, with w mirrored on negative faces.
/// The frame stays right-handed, so normals keep their orientation.
#[derive(Debug, Clone, Copy)]
pub(super) struct Projection {
    /// The scene axes of u, v and w.
    pub(super) axes: [usize; 3],
    /// −1 on negative faces.
    pub(super) w_sign: f32,
    /// The apex, or a reference point in the scene for parallel rays: (u, v, w), w not mirrored.
    pub(super) origin: [f32; 3],
    /// Change of u and v along w, for parallel rays or the ray from a distant apex through the reference point; else 0.
    pub(super) shear: [f32; 2],
    /// One over a distant apex's distance along w, by which its rays spread along w; else 0.
    pub(super) spread: f32,
}

impl Projection {
    /// Rays that start at `apex` and point to `face`.
    pub(super) fn from_apex(apex: Vec3, face: Face) -> Self {
        let w = usize::from(face / 2);
        let negative = face % 2 == 1;
        let (u, v) = if negative { ((w + 2) % 3, (w + 1) % 3) } else { ((w + 1) % 3, (w + 2) % 3) };
        let w_sign = if negative { -1.0 } else { 1.0 };
        Self { axes: [u, v, w], w_sign, origin: [apex[u], apex[v], apex[w]], shear: [0.0; 2], spread: 0.0 }
    }

    /// Rays that run along `direction`.
    pub(super) fn along(direction: Vec3, reference: Vec3) -> Self {
        let this = Self::from_apex(reference, face_of(direction));
        let [u, v, w] = this.axes;
        let depth = direction[w].abs();
        Self { shear: [direction[u] / depth, direction[v] / depth], ..this }
    }

    /// Rays that start at `apex`, so far from `reference` that scene points relative to the apex would lose precision.
    /// They are projected onto the plane through the reference point, like parallel rays times a factor of almost 1.
    pub(super) fn from_distant(apex: Vec3, reference: Vec3) -> Self {
        let direction = reference - apex;
        let this = Self::along(direction, reference);
        Self { spread: 1.0 / direction[this.axes[2]].abs(), ..this }
    }

    /// Reorders three numbers by scene axis to (u, v, w).
    #[inline(always)]
    pub(super) fn permute<S: Simd>(&self, s: S, by_axis: [S::F; 3]) -> [S::F; 3] {
        let [u, v, w] = self.axes;
        [by_axis[u], by_axis[v], by_axis[w] * s.splat(self.w_sign)]
    }
}

/// Rays as points of the plane.
#[derive(Debug, Clone)]
pub(super) struct Group {
    pub(super) projection: Projection,
    /// x and y of each packet's rays.
    pub(super) x: [F8; PACKETS],
    pub(super) y: [F8; PACKETS],
    /// Bit i of `lanes[p]`: ray i of packet p is in the group.
    pub(super) lanes: [u8; PACKETS],
    /// Bit p: packet p has rays.
    pub(super) packets: u8,
    /// Lowest and highest x of each packet, packets side by side; then the same of y.
    pub(super) packet_x: [F8; 2],
    pub(super) packet_y: [F8; 2],
    /// Lowest and highest x of the group; then the same of y.
    pub(super) group_x: [f32; 2],
    pub(super) group_y: [f32; 2],
}

impl Group {
    pub(super) fn empty(projection: Projection) -> Self {
        let nothing = [F8([f32::INFINITY; 8]), F8([f32::NEG_INFINITY; 8])];
        Self {
            projection,
            x: [F8::default(); PACKETS],
            y: [F8::default(); PACKETS],
            lanes: [0; PACKETS],
            packets: 0,
            packet_x: nothing,
            packet_y: nothing,
            group_x: [f32::INFINITY, f32::NEG_INFINITY],
            group_y: [f32::INFINITY, f32::NEG_INFINITY],
        }
    }

    /// Fills packet `p`, which must be empty, with the rays in `lanes`, at least one.
    #[inline(always)]
    pub(super) fn set_packet<S: Simd>(&mut self, s: S, p: usize, x: S::F, y: S::F, lanes: u8) {
        let active = s.mask(lanes);
        let (low, high) = (s.splat(f32::INFINITY), s.splat(f32::NEG_INFINITY));
        s.store(x, &mut self.x[p]);
        s.store(y, &mut self.y[p]);
        self.lanes[p] = lanes;
        self.packets |= 1 << p;
        let lowest = [s.lowest(s.select(active, x, low)), s.lowest(s.select(active, y, low))];
        let highest = [s.highest(s.select(active, x, high)), s.highest(s.select(active, y, high))];
        (self.packet_x[0].0[p], self.packet_x[1].0[p]) = (lowest[0], highest[0]);
        (self.packet_y[0].0[p], self.packet_y[1].0[p]) = (lowest[1], highest[1]);
        self.group_x = [self.group_x[0].min(lowest[0]), self.group_x[1].max(highest[0])];
        self.group_y = [self.group_y[0].min(lowest[1]), self.group_y[1].max(highest[1])];
    }

    /// The longer side of the group's bounds.
    #[inline(always)]
    pub(super) fn side(&self) -> f32 {
        (self.group_x[1] - self.group_x[0]).max(self.group_y[1] - self.group_y[0])
    }

    /// The longest side of a packet's bounds.
    #[inline(always)]
    pub(super) fn widest_packet<S: Simd>(&self, s: S) -> f32 {
        let width = s.load(&self.packet_x[1]) - s.load(&self.packet_x[0]);
        let height = s.load(&self.packet_y[1]) - s.load(&self.packet_y[0]);
        // Packets without rays have inverted bounds.
        s.highest(s.max(width, height))
    }

    /// Shrinks the group's bounds to the remaining packets.
    #[inline(always)]
    pub(super) fn shrink<S: Simd>(&mut self, s: S) {
        let left = s.mask(self.packets);
        let (low, high) = (s.splat(f32::INFINITY), s.splat(f32::NEG_INFINITY));
        self.group_x = [
            s.lowest(s.select(left, s.load(&self.packet_x[0]), low)),
            s.highest(s.select(left, s.load(&self.packet_x[1]), high)),
        ];
        self.group_y = [
            s.lowest(s.select(left, s.load(&self.packet_y[0]), low)),
            s.highest(s.select(left, s.load(&self.packet_y[1]), high)),
        ];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_face_is_seen_in_a_right_handed_frame() {
        for face in 0..6 {
            let projection = Projection::from_apex(Vec3::ZERO, face);
            let [u, v, w] = projection.axes.map(|axis| Vec3::AXES[axis]);
            let towards = w * projection.w_sign;
            assert_eq!(u.cross(v), towards);
            assert_eq!(face_of(towards), face);
            assert_eq!(face_of(towards + (u - v) * 0.9), face);
        }
    }
}
