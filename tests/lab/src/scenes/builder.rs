//! Scenes built in code from rectangles, boxes and spheres, which closed forms can judge.

use glam::{DVec3, Vec2, Vec3, Vec4};
use gnomon_scene::{
    Aabb, AlphaMode, AnimatedLight, AnimatedNode, Animation, Draw, Image, Interpolation, Light, LightKind, Material,
    Piece, Place, Scene, Texture, Track, Wrap,
};

/// Returns a track in rounds of its last key's time.
pub fn track(interpolation: Interpolation, times_s: &[f32], values: &[f32]) -> Option<Track> {
    let period_s = times_s.last().copied().map_or(0.0, f64::from);
    Some(Track { period_s, interpolation, times_s: times_s.to_vec(), values: values.to_vec() })
}

/// Groups triangles by material.
#[derive(Debug)]
pub struct SceneBuilder {
    scene: Scene,
}

impl Default for SceneBuilder {
    fn default() -> Self {
        Self::new()
    }
}

impl SceneBuilder {
    /// Returns an empty scene whose current material is white, opaque and double-sided.
    pub fn new() -> Self {
        let scene = Scene {
            origin_m: DVec3::ZERO,
            bounds: Aabb { min: Vec3::ZERO, max: Vec3::ZERO },
            instances: 1,
            ..Scene::default()
        };
        Self { scene }.material(AlphaMode::Opaque, true)
    }

    /// Moves the local origin; positions stay relative to it.
    pub fn origin(mut self, origin_m: DVec3) -> Self {
        self.scene.origin_m = origin_m;
        self
    }

    /// Starts a white material. OPAQUE materials must come before MASK, those before BLEND.
    pub fn material(mut self, alpha: AlphaMode, double_sided: bool) -> Self {
        self.scene.materials.push(Material { base_color: Vec4::ONE, alpha, double_sided, ..Material::default() });
        self
    }

    /// Gives the current material a texture with these alpha values, row by row.
    pub fn alpha_picture(mut self, width: u32, alpha: &[u8], wrap: Wrap) -> Self {
        let rgba: Vec<_> = alpha.iter().flat_map(|&a| [255, 255, 255, a]).collect();
        let height = u32::try_from(alpha.len()).unwrap_or(u32::MAX) / width;
        let mut encoded = std::io::Cursor::new(Vec::new());
        let written = image::RgbaImage::from_raw(width, height, rgba.clone())
            .map(|picture| picture.write_to(&mut encoded, image::ImageFormat::Png));
        debug_assert!(matches!(written, Some(Ok(()))), "{width} does not divide {} texels", alpha.len());
        let image = u32::try_from(self.scene.images.len()).unwrap_or(u32::MAX);
        self.scene.images.push(Image { encoded: encoded.into_inner(), width, height, rgba });
        if let Some(material) = self.scene.materials.last_mut() {
            material.base_color_texture = Some(Texture::new(image, wrap, wrap));
        }
        self
    }

    /// Adds a triangle, counter-clockwise from its front, with its own normals and texture coordinates.
    pub fn triangle(mut self, corners: [Vec3; 3], normals: [Vec3; 3], uvs: [Vec2; 3]) -> Self {
        let scene = &mut self.scene;
        let first = u32::try_from(scene.positions.len()).unwrap_or(u32::MAX);
        scene.positions.extend(corners);
        scene.normals.extend(normals);
        scene.uvs.extend(uvs);
        let material = u32::try_from(scene.materials.len() - 1).unwrap_or(u32::MAX);
        match scene.draws.last_mut() {
            Some(draw) if draw.material == material => draw.triangles += 1,
            _ => {
                let first_triangle = u32::try_from(scene.triangles.len()).unwrap_or(u32::MAX);
                scene.draws.push(Draw { first_triangle, triangles: 1, material });
            }
        }
        scene.triangles.push([first, first + 1, first + 2]);
        self
    }

    /// Adds a parallelogram from a corner along two sides. Its front is in the direction of `side_u × side_v`; (u, v)
    /// runs from 0 to 1 along the sides.
    pub fn quad(self, corner: Vec3, side_u: Vec3, side_v: Vec3) -> Self {
        self.face([corner, corner + side_u, corner + side_u + side_v, corner + side_v])
    }

    /// Adds a flat quadrilateral, counter-clockwise from its front.
    fn face(self, [a, b, c, d]: [Vec3; 4]) -> Self {
        let normals = [(b - a).cross(d - a).normalize(); 3];
        self.triangle([a, b, c], normals, [Vec2::ZERO, Vec2::X, Vec2::ONE]).triangle(
            [a, c, d],
            normals,
            [Vec2::ZERO, Vec2::ONE, Vec2::Y],
        )
    }

    pub fn cuboid(self, min: Vec3, max: Vec3) -> Self {
        // Corners are selected, not computed, so that faces share them to the last bit.
        let at = |x: bool, y: bool, z: bool| Vec3::select(glam::BVec3::new(x, y, z), max, min);
        let (o, i) = (false, true);
        self.face([at(o, o, o), at(o, i, o), at(i, i, o), at(i, o, o)])
            .face([at(o, o, o), at(o, o, i), at(o, i, i), at(o, i, o)])
            .face([at(o, o, o), at(i, o, o), at(i, o, i), at(o, o, i)])
            .face([at(i, i, i), at(o, i, i), at(o, o, i), at(i, o, i)])
            .face([at(i, i, i), at(i, o, i), at(i, o, o), at(i, i, o)])
            .face([at(i, i, i), at(i, i, o), at(o, i, o), at(o, i, i)])
    }

    /// Adds a sphere with outward fronts and smooth normals, of `rings` × 2·`rings` patches with corners on the sphere.
    pub fn sphere(mut self, centre: Vec3, radius: f32, rings: u16) -> Self {
        let at = |ring: u16, sector: u16| {
            // Seam and poles come from equal arguments, so that the sphere is closed to the last bit.
            let sector = if ring == 0 || ring == rings { 0 } else { sector % (2 * rings) };
            let polar = f32::from(ring) / f32::from(rings) * std::f32::consts::PI;
            let azimuth = f32::from(sector) / f32::from(rings) * std::f32::consts::PI;
            Vec3::new(polar.sin() * azimuth.cos(), polar.cos(), -polar.sin() * azimuth.sin())
        };
        for ring in 0..rings {
            for sector in 0..2 * rings {
                let n = [(ring, sector), (ring + 1, sector), (ring + 1, sector + 1), (ring, sector + 1)]
                    .map(|(ring, sector)| at(ring, sector));
                let p = n.map(|n| centre + n * radius);
                if ring + 1 < rings {
                    self = self.triangle([p[0], p[1], p[2]], [n[0], n[1], n[2]], [Vec2::ZERO; 3]);
                }
                if ring > 0 {
                    self = self.triangle([p[0], p[2], p[3]], [n[0], n[2], n[3]], [Vec2::ZERO; 3]);
                }
            }
        }
        self
    }

    pub fn point_light(self, position: Vec3, range_m: f32) -> Self {
        self.light(LightKind::Point, position, Vec3::NEG_Y, range_m)
    }

    /// Adds a directional light that travels along `direction`.
    pub fn sun(self, direction: Vec3) -> Self {
        self.light(LightKind::Directional, Vec3::ZERO, direction, f32::INFINITY)
    }

    pub fn spot_light(self, position: Vec3, direction: Vec3, outer_cone_rad: f32) -> Self {
        let kind = LightKind::Spot { inner_cone_rad: outer_cone_rad * 0.5, outer_cone_rad };
        self.light(kind, position, direction, f32::INFINITY)
    }

    fn light(mut self, kind: LightKind, position: Vec3, direction: Vec3, range_m: f32) -> Self {
        self.scene.lights.push(Light {
            name: String::new(),
            kind,
            position,
            direction: direction.normalize(),
            color: Vec3::ONE,
            intensity: 1.0,
            range_m,
        });
        self
    }

    /// Adds what `add` adds, in the space of a node that moves. Without `node`, the last one.
    pub fn moving(mut self, node: Option<AnimatedNode>, add: impl FnOnce(Self) -> Self) -> Self {
        let (first, lights) = (self.scene.positions.len(), self.scene.lights.len());
        self.scene.animation.get_or_insert_default().nodes.extend(node);
        let mut this = add(self);
        let Scene { positions, normals, lights: all, animation, .. } = &mut this.scene;
        let Some(animation) = animation else { return this };
        let index = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
        let node = index(animation.nodes.len() - 1);
        for (light, added) in all.iter().enumerate().skip(lights) {
            let turn = glam::Quat::from_rotation_arc(Vec3::NEG_Z, added.direction).as_dquat();
            let node_from_own = glam::DMat4::from_rotation_translation(turn, added.position.as_dvec3());
            let place = Some(Place { node, node_from_own });
            animation.lights.push(AnimatedLight { light: index(light), place, ..AnimatedLight::default() });
        }
        if let Some(added @ [_, ..]) = positions.get(first..) {
            let (first_vertex, vertices, bounds) = (index(first), index(added.len()), Aabb::around(added));
            animation.pieces.push(Piece { node, first_vertex, vertices, bounds, mirrored: false });
            animation.positions.extend_from_slice(added);
            animation.normals.extend_from_slice(&normals[first..]);
        }
        this
    }

    /// Returns a node that stands where its parent does, and changes nothing.
    pub fn node(parent: Option<u32>) -> AnimatedNode {
        AnimatedNode { parent, ..AnimatedNode::default() }
    }

    pub fn build(mut self) -> Scene {
        let mut points = self.scene.positions.iter().copied();
        let first = points.next().unwrap_or(Vec3::ZERO);
        self.scene.bounds =
            points.fold(Aabb { min: first, max: first }, |b, p| Aabb { min: b.min.min(p), max: b.max.max(p) });
        // The loader makes no materials without triangles, so neither does this.
        debug_assert!(!self.scene.lights.is_empty(), "a scene has at least one light");
        if let Some(Animation { nodes, .. }) = self.scene.animation.as_deref_mut() {
            // Nodes move about the world's origin.
            let origin_m = self.scene.origin_m;
            nodes.iter_mut().filter(|node| node.parent.is_none()).for_each(|node| {
                node.above = glam::DMat4::from_translation(origin_m) * node.above;
            });
        }
        self.scene
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_and_spheres_are_closed_and_face_outwards() {
        for scene in [
            SceneBuilder::new().cuboid(Vec3::new(1.0, 2.0, 3.0), Vec3::new(4.0, 6.0, 8.0)).sun(Vec3::NEG_Y).build(),
            SceneBuilder::new().sphere(Vec3::new(1.0, 2.0, 3.0), 2.0, 24).sun(Vec3::NEG_Y).build(),
        ] {
            // By Gauss's theorem a closed surface with outward fronts has this signed volume, and its area vectors
            // cancel.
            let (mut volume, mut area) = (0.0, DVec3::ZERO);
            for triangle in &scene.triangles {
                let [a, b, c] = triangle.map(|i| scene.positions[i as usize].as_dvec3());
                volume += a.dot(b.cross(c)) / 6.0;
                area += (b - a).cross(c - a) * 0.5;
                let normal = triangle.iter().map(|&i| scene.normals[i as usize].as_dvec3()).sum::<DVec3>();
                assert!(normal.dot((b - a).cross(c - a)) > 0.0);
            }
            let expected = if scene.triangles.len() == 12 { 60.0 } else { 4.0 / 3.0 * std::f64::consts::PI * 8.0 };
            assert!((volume / expected - 1.0).abs() < 0.02, "{volume}, not {expected}");
            assert!(area.length() < 1e-5);
        }
    }
}
