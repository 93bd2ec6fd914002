//! Judges one pixel: the rules of `gnomon_server::visibility`, in f64, with doubts.

use glam::DVec3;
use gnomon_scene::{Light, LightKind, camera::Camera};

use super::{
    Point, Reference, Verdict,
    triangle::{Crossing, Ray},
};

/// Perturbation of a judgement: none, or by what f32 cannot resolve.
#[derive(Debug, Clone, Copy)]
struct Nudge {
    /// Moves the camera and the shadow ray's start, in metres.
    offset: DVec3,
    /// Moves alpha samples, in units of their rounding.
    alpha: f64,
    /// Moves limits (facing, range, cone, the light's end of a shadow ray), in units of their rounding.
    limit: f64,
}

/// Most ties that are judged; only a fan or heap of triangles has more in one point.
const MOST_TIES: usize = 8;

struct Nearest {
    first: (u32, Crossing),
    /// Other triangles within rounding of the first: f32 may see any of them.
    ties: Vec<(u32, Crossing)>,
}

struct Seen {
    triangle: u32,
    point: DVec3,
    /// Unit normal of the triangle's plane, towards the camera.
    geometric: DVec3,
    /// Interpolated normal, negated on back faces; any length.
    shading: DVec3,
}

/// Set if a decision came closer than rounding to the other outcome.
#[derive(Default)]
struct Doubt(bool);

impl Doubt {
    fn about(&mut self, close: bool) {
        self.0 |= close;
    }
}

impl Reference {
    pub(super) fn judge(&self, camera: &Camera, x: u32, y: u32) -> Verdict {
        let (position, direction) = camera.ray(x, y);
        let origin = position - self.origin_m;
        let mut doubt = Doubt::default();
        let mut verdict =
            self.judge_nudged(origin, direction, Nudge { offset: DVec3::ZERO, alpha: 0.0, limit: 0.0 }, &mut doubt);
        if doubt.0 {
            // A camera far outside the scene rounds more coarsely than the scene.
            let rounding_m = self.rounding_m.max(origin.abs().max_element() * 2.0_f64.powi(-21));
            for corner in 0..8_u32 {
                let sign = |bit: u32| if corner >> bit & 1 == 1 { 1.0 } else { -1.0 };
                let offset = DVec3::new(sign(0), sign(1), sign(2)) * rounding_m;
                let nudge = Nudge { offset, alpha: sign(0), limit: sign(1) };
                let other = self.judge_nudged(origin, direction, nudge, &mut Doubt::default());
                verdict.undecided |= (verdict.relevant ^ other.relevant) | (verdict.lit ^ other.lit) | other.undecided;
            }
        }
        verdict
    }

    /// The surface that a pixel's centre sees.
    pub(super) fn point(&self, camera: &Camera, x: u32, y: u32) -> Option<Point> {
        let (position, direction) = camera.ray(x, y);
        let ray = Ray::new(position - self.origin_m, direction);
        let nudge = Nudge { offset: DVec3::ZERO, alpha: 0.0, limit: 0.0 };
        let nearest = self.nearest(&ray, nudge, &mut Doubt::default())?.first;
        let seen = self.seen(&ray, nearest);
        Some(Point { place: seen.point, normal: seen.geometric, depth_m: nearest.1.t })
    }

    fn judge_nudged(&self, origin: DVec3, direction: DVec3, nudge: Nudge, doubt: &mut Doubt) -> Verdict {
        let ray = Ray::new(origin + nudge.offset, direction);
        let Some(nearest) = self.nearest(&ray, nudge, doubt) else { return Verdict::default() };
        let mut verdict = self.judge_point(&self.seen(&ray, nearest.first), nudge, doubt);
        for tie in nearest.ties {
            let other = self.judge_point(&self.seen(&ray, tie), nudge, &mut Doubt::default());
            verdict.undecided |= (verdict.relevant ^ other.relevant) | (verdict.lit ^ other.lit);
        }
        verdict
    }

    /// Rules 3 to 5.
    fn judge_point(&self, seen: &Seen, nudge: Nudge, doubt: &mut Doubt) -> Verdict {
        let mut verdict = Verdict { surface: true, ..Verdict::default() };
        for (k, light) in self.lights.iter().enumerate() {
            if !light.shines() || !self.relevant(light, seen, nudge, doubt) {
                continue;
            }
            verdict.relevant |= 1 << k;
            if self.reached(light, seen, nudge, doubt) {
                verdict.lit |= 1 << k;
            }
        }
        verdict
    }

    /// Rule 1.
    fn nearest(&self, ray: &Ray, nudge: Nudge, doubt: &mut Doubt) -> Option<Nearest> {
        let slack = 4.0 * self.rounding_m / ray.direction.length();
        let mut nearest: Option<(u32, Crossing)> = None;
        let mut nearest_doubt = f64::INFINITY;
        let mut ties = Vec::new();
        self.bvh.walk(ray, f64::INFINITY, |triangle| {
            let end = nearest.map_or(f64::INFINITY, |(_, crossing)| crossing.t);
            // A triangle whose plane contains the camera is never hit, however the camera is moved.
            let meeting =
                self.meet(ray, triangle, nudge, true).filter(|_| !self.holds(triangle, ray.origin - nudge.offset));
            if meeting.is_some_and(|(crossing, ..)| crossing.t.abs() <= slack) {
                nearest_doubt = 0.0;
            }
            if let Some((crossing, there, close)) = meeting.filter(|(crossing, ..)| crossing.t > 0.0) {
                if close || there && (crossing.t - end).abs() <= slack {
                    nearest_doubt = nearest_doubt.min(crossing.t);
                }
                if crossing.t <= end + slack {
                    ties.push((triangle, crossing));
                }
                if there && crossing.t < end {
                    nearest = Some((triangle, crossing));
                    return crossing.t + slack;
                }
            }
            end + slack
        });
        let end = nearest.as_ref().map_or(f64::INFINITY, |(_, crossing)| crossing.t);
        doubt.about(nearest_doubt.is_finite() && nearest_doubt <= end + slack);
        let first = nearest?;
        // Anything farther ahead lies behind the nearest.
        let own = self.corners[first.0 as usize];
        ties.retain(|(triangle, crossing)| {
            // A duplicated triangle has the same verdict.
            self.corners[*triangle as usize] != own && (crossing.t - end).abs() <= slack
        });
        ties.truncate(MOST_TIES);
        Some(Nearest { first, ties })
    }

    /// Rule 2.
    fn seen(&self, ray: &Ray, (triangle, crossing): (u32, Crossing)) -> Seen {
        let [a, b, c] = self.corners[triangle as usize];
        let normal = (b - a).cross(c - a).normalize();
        let [na, nb, nc] = self.surfaces[triangle as usize].normals;
        let [wa, wb, wc] = crossing.weights;
        let shading = na * wa + nb * wb + nc * wc;
        let side = if normal.dot(ray.direction) > 0.0 { -1.0 } else { 1.0 };
        Seen { triangle, point: ray.at(crossing.t), geometric: normal * side, shading: shading * side }
    }

    /// Returns where the ray hits the triangle, whether it is opaque there, and whether that is in doubt. `None` for
    /// certain misses.
    fn meet(&self, ray: &Ray, triangle: u32, nudge: Nudge, sides_matter: bool) -> Option<(Crossing, bool, bool)> {
        let corners = &self.corners[triangle as usize];
        let crossing = ray.cross(corners)?;
        let margin = 4.0 * self.rounding_m;
        if crossing.inside_m < -margin {
            return None;
        }
        let surface = &self.surfaces[triangle as usize];
        let sheet = &self.materials[surface.material as usize];
        let mut there = crossing.inside_m >= 0.0;
        let mut close = crossing.inside_m <= margin;
        if sides_matter && !sheet.double_sided {
            let [a, b, c] = *corners;
            // A triangle so edge-on that its side is in doubt is narrower than the margin, so `close` covers it.
            there &= (b - a).cross(c - a).dot(ray.direction) < 0.0;
        }
        if let Some(alpha) = &sheet.alpha {
            let mut uv = [0.0; 2];
            for (weight, corner) in crossing.weights.iter().zip(surface.uvs) {
                uv = [uv[0] + weight * corner[0], uv[1] + weight * corner[1]];
            }
            let [of_a, of_b, of_c] = surface.alphas;
            let [wa, wb, wc] = crossing.weights;
            let vertices = if surface.alphas == [1.0; 3] { 1.0 } else { of_a * wa + of_b * wb + of_c * wc };
            let (above, rounding) = alpha.margin(uv[0], uv[1], vertices);
            there &= above + nudge.alpha * rounding >= 0.0;
            // Moving the ray moves the sample too; the eight nudges show whether that matters.
            close |= above.abs() <= rounding + self.alpha_slope(triangle) * margin;
        }
        (there || close).then_some((crossing, there, close))
    }

    /// Greatest change of alpha per metre on a triangle. One full step per texel is its bound, so only texels per metre
    /// count, from the edges' texture coordinates, and the vertices' alpha.
    fn alpha_slope(&self, triangle: u32) -> f64 {
        let corners = &self.corners[triangle as usize];
        let surface = &self.surfaces[triangle as usize];
        let texels = self.materials[surface.material as usize].alpha.as_ref().map_or(0.0, super::AlphaTest::side_px);
        let mut slope = 0.0_f64;
        for (i, j) in [(0, 1), (1, 2), (2, 0)] {
            let [u, v] = [0, 1].map(|axis| surface.uvs[j][axis] - surface.uvs[i][axis]);
            let step = u.hypot(v) * texels + (surface.alphas[j] - surface.alphas[i]).abs();
            slope = slope.max(step / corners[i].distance(corners[j]));
        }
        slope
    }

    /// Rule 3.
    fn relevant(&self, light: &Light, seen: &Seen, nudge: Nudge, doubt: &mut Doubt) -> bool {
        let margin = 4.0 * self.rounding_m;
        let to_light = towards(light, seen.point);
        // Compares `above` with 0, within its rounding.
        let mut within = |above: f64, rounding: f64| {
            doubt.about(above.abs() <= rounding);
            above + nudge.limit * rounding >= 0.0
        };
        let facing_margin = self.dot_margin(light, to_light) * seen.shading.length();
        let facing = seen.shading.dot(to_light);
        // In the surface's own plane, which its shading follows: dark either way.
        if facing.abs().max(seen.geometric.dot(to_light).abs()) <= self.exact_m {
            return false;
        }
        let mut relevant = within(facing, facing_margin) && (facing != 0.0 || nudge.limit > 0.0);
        if light.kind != LightKind::Directional {
            let distance = to_light.length();
            let far = distance * 4.0 * f64::from(f32::EPSILON);
            relevant &= within(f64::from(light.range_m) - distance, margin + far);
            if let LightKind::Spot { outer_cone_rad, .. } = light.kind {
                let along = -to_light.dot(light.direction.as_dvec3());
                relevant &= within(along - distance * f64::from(outer_cone_rad).cos(), margin + far);
            }
        }
        relevant
    }

    /// Rules 4 and 5.
    fn reached(&self, light: &Light, seen: &Seen, nudge: Nudge, doubt: &mut Doubt) -> bool {
        let to_light = towards(light, seen.point);
        let facing = seen.geometric.dot(to_light);
        // Rule 4 is certain that a light in the surface's own plane is not above it.
        if facing.abs() <= self.exact_m {
            return false;
        }
        let margin = self.dot_margin(light, to_light);
        doubt.about(facing.abs() <= margin);
        if facing + nudge.limit * margin <= 0.0 {
            return false;
        }
        // Back ends push starts up by more than rounding, so doubt moves a start along the surface and up, never down.
        let down = seen.geometric * nudge.offset.dot(seen.geometric).min(0.0);
        let start = seen.point + seen.geometric * self.push_m + (nudge.offset - down);
        let (direction, end) = if light.kind == LightKind::Directional {
            (to_light, f64::INFINITY)
        } else {
            (light.position.as_dvec3() - start, 1.0)
        };
        let ray = Ray::new(start, direction);
        let slack = 4.0 * self.rounding_m / direction.length();
        let (mut stopped, mut close) = (false, false);
        self.bvh.walk(&ray, end + slack, |triangle| {
            if triangle == seen.triangle {
                return end + slack;
            }
            if let Some((crossing, there, in_doubt)) = self.meet(&ray, triangle, nudge, false) {
                if light.kind != LightKind::Directional && self.holds(triangle, light.position.as_dvec3()) {
                    return end + slack;
                }
                let near_light = (crossing.t - end).abs() <= slack;
                let before_light = if near_light { crossing.t < end + nudge.limit * slack } else { crossing.t < end };
                let inside = there && crossing.t > 0.0 && before_light;
                let near_an_end = crossing.t.abs() <= slack || near_light;
                if inside && !in_doubt && !near_an_end {
                    (stopped, close) = (true, false);
                    return -1.0;
                }
                stopped |= inside;
                close |= near_an_end || in_doubt && crossing.t > 0.0 && crossing.t < end;
            }
            end + slack
        });
        doubt.about(close);
        !stopped
    }

    /// Returns whether a triangle's plane contains a point, up to f64 rounding.
    fn holds(&self, triangle: u32, point: DVec3) -> bool {
        let [a, b, c] = self.corners[triangle as usize];
        let normal = (b - a).cross(c - a);
        normal.dot(point - a).abs() <= self.exact_m * normal.length()
    }

    /// Rounding of a unit vector's dot product with `to_light`.
    fn dot_margin(&self, light: &Light, to_light: DVec3) -> f64 {
        let rounding = 8.0 * f64::from(f32::EPSILON);
        if light.kind == LightKind::Directional {
            rounding
        } else {
            4.0 * self.rounding_m + rounding * to_light.length()
        }
    }
}

/// Vector from a point to a light; of unit length for directional lights.
fn towards(light: &Light, point: DVec3) -> DVec3 {
    match light.kind {
        LightKind::Directional => -light.direction.as_dvec3(),
        LightKind::Point | LightKind::Spot { .. } => light.position.as_dvec3() - point,
    }
}
