//! Tests every triangle against every ray in f64, sharing only the scene with the back end. On real scenes it skips
//! runs of neighbouring triangles if the ray misses their bounding box.

use glam::{DVec2, DVec3};
use gnomon_scene::{AlphaMode, Light, LightKind, Scene, Wrap, camera::Camera};

pub(super) struct Brute<'a> {
    scene: &'a Scene,
    /// Corners and material of each triangle that stops rays.
    triangles: Vec<([DVec3; 3], usize)>,
    /// Boxes around each [`RUN`] triangles, grown by a micrometre.
    boxes: Vec<[DVec3; 2]>,
}

const RUN: usize = 128;

pub(super) struct Point {
    point: DVec3,
    geometric: DVec3,
    shading: DVec3,
}

impl<'a> Brute<'a> {
    pub(super) fn new(scene: &'a Scene) -> Self {
        let mut triangles = Vec::new();
        for draw in &scene.draws {
            let first = draw.first_triangle as usize;
            for corners in &scene.triangles[first..first + draw.triangles as usize] {
                if !matches!(scene.materials[draw.material as usize].alpha, AlphaMode::Blend) {
                    let corners = corners.map(|i| scene.positions[i as usize].as_dvec3());
                    triangles.push((corners, draw.material as usize));
                }
            }
        }
        let boxes = triangles.chunks(RUN).map(|run| {
            let corners = || run.iter().flat_map(|(corners, _)| corners);
            let min = corners().fold(DVec3::INFINITY, |min, corner| min.min(*corner));
            let max = corners().fold(DVec3::NEG_INFINITY, |max, corner| max.max(*corner));
            [min - 1e-6, max + 1e-6]
        });
        Self { scene, boxes: boxes.collect(), triangles }
    }

    /// Returns the triangles of all boxes that the ray passes through.
    fn candidates(&self, from: DVec3, way: DVec3) -> impl Iterator<Item = usize> {
        let passes = move |[min, max]: &[DVec3; 2]| {
            let (mut enter, mut leave) = (0.0_f64, f64::INFINITY);
            for axis in 0..3 {
                let ends = [(min[axis] - from[axis]) / way[axis], (max[axis] - from[axis]) / way[axis]];
                // A ray in a side's plane gives a NaN, which these ignore.
                enter = enter.max(ends[0].min(ends[1]));
                leave = leave.min(ends[0].max(ends[1]));
            }
            enter <= leave
        };
        let passed = self.boxes.iter().enumerate().filter(move |(_, bounds)| passes(bounds));
        passed.flat_map(|(run, _)| run * RUN..((run + 1) * RUN).min(self.triangles.len()))
    }

    /// Distance along the ray and the corners' weights, if the ray hits triangle `t` and passes its alpha test.
    fn intersect(&self, t: usize, from: DVec3, way: DVec3) -> Option<(f64, DVec3)> {
        let ([a, b, c], material) = self.triangles[t];
        // from + distance·way = a + v·(b − a) + w·(c − a), solved by Cramer's rule.
        let (to_b, to_c, from_a) = (b - a, c - a, from - a);
        let across = way.cross(to_c);
        let determinant = to_b.dot(across);
        let v = from_a.dot(across) / determinant;
        // A zero determinant gives a NaN or an infinity, which fails every comparison.
        if !(0.0..=1.0).contains(&v) {
            return None;
        }
        let along = from_a.cross(to_b);
        let weights = DVec3::new(1.0 - v - way.dot(along) / determinant, v, way.dot(along) / determinant);
        let distance = to_c.dot(along) / determinant;
        let hit = weights.min_element() >= 0.0 && distance > 0.0 && self.passes_alpha(t, material, weights);
        hit.then_some((distance, weights))
    }

    fn passes_alpha(&self, t: usize, material: usize, weights: DVec3) -> bool {
        let material = &self.scene.materials[material];
        let AlphaMode::Mask { cutoff } = material.alpha else { return true };
        let mut alpha = f64::from(material.base_color.w);
        if let Some(texture) = material.base_color_texture {
            let image = &self.scene.images[texture.image as usize];
            let corners = self.scene.triangles[t].map(|i| self.scene.uvs[i as usize].as_dvec2());
            let uv: DVec2 = corners.iter().zip(weights.to_array()).map(|(uv, weight)| *uv * weight).sum();
            let place = uv * DVec2::new(f64::from(image.width), f64::from(image.height)) - 0.5;
            let texel = |i: f64, size: u32, wrap: Wrap| {
                let size = f64::from(size);
                match wrap {
                    Wrap::Repeat => i.rem_euclid(size),
                    Wrap::MirroredRepeat if i.rem_euclid(2.0 * size) < size => i.rem_euclid(size),
                    Wrap::MirroredRepeat => size - 1.0 - i.rem_euclid(size),
                    Wrap::ClampToEdge => i.clamp(0.0, size - 1.0),
                }
            };
            let mut sum = 0.0;
            for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
                let low = place.floor();
                let share = (1.0 - (place.x - low.x - dx).abs()) * (1.0 - (place.y - low.y - dy).abs());
                let x = texel(low.x + dx, image.width, texture.wrap_u);
                let y = texel(low.y + dy, image.height, texture.wrap_v);
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a texel of the picture")]
                let (x, y) = (x as usize, y as usize);
                sum += share * f64::from(image.rgba[(y * image.width as usize + x) * 4 + 3]) / 255.0;
            }
            alpha *= sum;
        }
        alpha >= f64::from(cutoff)
    }

    /// Returns the surface point that pixel (x, y) sees.
    pub(super) fn surface(&self, camera: &Camera, x: u32, y: u32) -> Option<Point> {
        let (eye, way) = camera.ray(x, y);
        let eye = eye - self.scene.origin_m;
        let mut nearest: Option<(f64, Point)> = None;
        for t in self.candidates(eye, way) {
            let Some((distance, weights)) = self.intersect(t, eye, way) else { continue };
            let ([a, b, c], material) = self.triangles[t];
            let normal = (b - a).cross(c - a).normalize();
            let back = normal.dot(way) > 0.0;
            if nearest.as_ref().is_some_and(|(least, _)| *least <= distance)
                || back && !self.scene.materials[material].double_sided
            {
                continue;
            }
            let sign = if back { -1.0 } else { 1.0 };
            let normals = self.scene.triangles[t].map(|i| self.scene.normals[i as usize].as_dvec3());
            let shading = normals[0] * weights.x + normals[1] * weights.y + normals[2] * weights.z;
            let point = Point { point: eye + way * distance, geometric: normal * sign, shading: shading * sign };
            nearest = Some((distance, point));
        }
        nearest.map(|(_, point)| point)
    }

    /// Returns `None` if the light is irrelevant, else whether it reaches the point, and whether that needs a ray.
    pub(super) fn visible(&self, at: &Point, light: &Light) -> Option<(bool, bool)> {
        let towards = match light.kind {
            LightKind::Directional => -light.direction.as_dvec3(),
            LightKind::Point | LightKind::Spot { .. } => light.position.as_dvec3() - at.point,
        };
        let directional = light.kind == LightKind::Directional;
        let mut relevant = at.shading.dot(towards) > 0.0;
        relevant &= directional || towards.length() <= f64::from(light.range_m);
        if let LightKind::Spot { outer_cone_rad, .. } = light.kind {
            relevant &= (-towards).angle_between(light.direction.as_dvec3()) <= f64::from(outer_cone_rad);
        }
        if !relevant {
            return None;
        }
        if at.geometric.dot(towards) <= 0.0 {
            return Some((false, false));
        }
        let from = at.point + at.geometric * 1e-5;
        let way = if directional { towards } else { light.position.as_dvec3() - from };
        let stopped = self
            .candidates(from, way)
            .any(|t| self.intersect(t, from, way).is_some_and(|(distance, _)| directional || distance < 1.0));
        Some((!stopped, true))
    }
}
