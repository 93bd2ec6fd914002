//! Scenes built in code for the tests of this module.

use std::f32::consts::{PI, TAU};

use glam::{DMat4, DVec3, Quat, Vec2, Vec3};
use gnomon_scene::{
    Aabb, AlphaMode, AnimatedLight, AnimatedNode, Animation, Draw, Image, Interpolation, Light, LightKind, Material,
    Piece, Place, Scene, Texture, Track, Wrap,
};

/// Materials of [`TestScene`], one for each kind of surface.
pub(crate) const DOUBLE_SIDED: u32 = 0;
pub(crate) const SINGLE_SIDED: u32 = 1;
pub(crate) const LEAF: u32 = 2;
pub(crate) const GLASS: u32 = 3;

/// Collects triangles by material, and lights.
#[derive(Default)]
pub(crate) struct TestScene {
    triangles: [Vec<[(Vec3, Vec3, Vec2); 3]>; 4],
    lights: Vec<Light>,
    origin_m: DVec3,
}

impl TestScene {
    pub(crate) fn origin(mut self, origin_m: DVec3) -> Self {
        self.origin_m = origin_m;
        self
    }

    pub(crate) fn triangle(mut self, material: u32, corners: [Vec3; 3]) -> Self {
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
        self.triangles[material as usize].push(corners.map(|corner| (corner, normal, Vec2::ZERO)));
        self
    }

    /// A parallelogram from `corner` along `u` and `v`, facing along u × v. Its texture repeats three times.
    pub(crate) fn quad(mut self, material: u32, corner: Vec3, u: Vec3, v: Vec3) -> Self {
        let normal = u.cross(v).normalize();
        let at = |s: f32, t: f32| (corner + u * s + v * t, normal, Vec2::new(3.0 * s - 0.7, 3.0 * t + 0.2));
        let list = &mut self.triangles[material as usize];
        list.push([at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0)]);
        list.push([at(0.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)]);
        self
    }

    /// A box that faces outwards, or inwards if `inside`.
    pub(crate) fn cuboid(mut self, material: u32, min: Vec3, max: Vec3, inside: bool) -> Self {
        let size = max - min;
        for axis in 0..3 {
            let (mut u, mut v, mut n) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
            u[(axis + 1) % 3] = size[(axis + 1) % 3];
            v[(axis + 2) % 3] = size[(axis + 2) % 3];
            n[axis] = size[axis];
            let (near, far) = if inside { ((u, v), (v, u)) } else { ((v, u), (u, v)) };
            self = self.quad(material, min, near.0, near.1).quad(material, min + n, far.0, far.1);
        }
        self
    }

    /// A closed sphere with smooth normals that faces outwards, or inwards if `inside`.
    pub(crate) fn sphere(mut self, material: u32, centre: Vec3, radius: f32, rings: u16, inside: bool) -> Self {
        let turn = if inside { -1.0 } else { 1.0 };
        // Every use of a corner rounds alike, and each pole is one point: the mesh has no gaps.
        let at = |ring: u16, sector: u16| {
            let sectors = 2 * rings;
            let (polar, around) =
                (PI * f32::from(ring) / f32::from(rings), TAU * f32::from(sector % sectors) / f32::from(sectors));
            let direction = match ring {
                0 => Vec3::Y,
                _ if ring == rings => Vec3::NEG_Y,
                _ => Vec3::new(polar.sin() * around.cos(), polar.cos(), polar.sin() * around.sin()),
            };
            (centre + direction * radius, direction * turn, Vec2::ZERO)
        };
        let mut add = |corners: [(Vec3, Vec3, Vec2); 3]| {
            let [a, b, c] = corners;
            self.triangles[material as usize].push(if inside { [a, c, b] } else { [a, b, c] });
        };
        for ring in 0..rings {
            for sector in 0..2 * rings {
                let (a, b) = (at(ring, sector), at(ring, sector + 1));
                let (c, d) = (at(ring + 1, sector), at(ring + 1, sector + 1));
                if ring > 0 {
                    add([a, b, d]);
                }
                if ring + 1 < rings {
                    add([a, d, c]);
                }
            }
        }
        self
    }

    pub(crate) fn light(mut self, kind: LightKind, position: Vec3, direction: Vec3, range_m: f32) -> Self {
        let direction = direction.normalize();
        let light =
            Light { name: String::new(), kind, position, direction, color: Vec3::ONE, intensity: 10.0, range_m };
        self.lights.push(light);
        self
    }

    pub(crate) fn point(self, position: Vec3) -> Self {
        self.light(LightKind::Point, position, Vec3::NEG_Y, f32::INFINITY)
    }

    pub(crate) fn build(self) -> Scene {
        let material = |alpha, double_sided, texture| Material {
            base_color_texture: texture,
            alpha,
            double_sided,
            ..Material::default()
        };
        let texture = Texture::new(0, Wrap::MirroredRepeat, Wrap::Repeat);
        let mut scene = Scene {
            origin_m: self.origin_m,
            bounds: Aabb { min: Vec3::splat(-20.0), max: Vec3::splat(20.0) },
            materials: vec![
                material(AlphaMode::Opaque, true, None),
                material(AlphaMode::Opaque, false, None),
                material(AlphaMode::Mask { cutoff: 0.5 }, true, Some(texture)),
                material(AlphaMode::Blend, true, None),
            ],
            images: vec![disc()],
            lights: self.lights,
            instances: 1,
            ..Scene::default()
        };
        for (material, triangles) in (0..).zip(self.triangles) {
            let first_triangle = u32::try_from(scene.triangles.len()).unwrap();
            for corners in &triangles {
                let first = u32::try_from(scene.positions.len()).unwrap();
                scene.positions.extend(corners.map(|corner| corner.0));
                scene.normals.extend(corners.map(|corner| corner.1));
                scene.uvs.extend(corners.map(|corner| corner.2));
                scene.triangles.push([first, first + 1, first + 2]);
            }
            let triangles = u32::try_from(triangles.len()).unwrap();
            if triangles > 0 {
                scene.draws.push(Draw { first_triangle, triangles, material });
            }
        }
        scene
    }
}

/// A picture of 16×12 texels with a disc in it.
fn disc() -> Image {
    let mut rgba = Vec::new();
    for y in 0..12 {
        for x in 0..16 {
            let off_centre = Vec2::new(x as f32 - 7.0, y as f32 - 5.5).length();
            rgba.extend([90, 160, 60, if off_centre < 4.5 { 255 } else { 0 }]);
        }
    }
    Image { encoded: Vec::new(), width: 16, height: 12, rgba }
}

/// A closed room with boxes, a smooth ball, a leaf with holes, a one-sided screen, a pane, and each kind of light.
pub(crate) fn room() -> Scene {
    let tilt = Quat::from_rotation_y(0.4) * Quat::from_rotation_x(-0.3);
    TestScene::default()
        .cuboid(SINGLE_SIDED, Vec3::new(-5.0, 0.0, -4.0), Vec3::new(5.0, 4.0, 4.0), true)
        .cuboid(DOUBLE_SIDED, Vec3::new(-3.0, 0.0, -2.0), Vec3::new(-2.5, 3.0, -1.5), false)
        .cuboid(SINGLE_SIDED, Vec3::new(1.0, 0.0, -3.0), Vec3::new(1.4, 4.0, -2.6), false)
        .cuboid(SINGLE_SIDED, Vec3::new(0.1, 0.0, 1.1), Vec3::new(1.0, 0.7, 2.0), false)
        .sphere(SINGLE_SIDED, Vec3::new(2.5, 1.0, -0.5), 0.8, 12, false)
        .quad(LEAF, Vec3::new(-1.5, 1.0, -1.0), tilt * Vec3::X * 2.0, tilt * Vec3::Y * 1.5)
        .quad(SINGLE_SIDED, Vec3::new(3.0, 0.5, 2.0), Vec3::Z * 1.5, Vec3::Y * 1.5)
        .quad(GLASS, Vec3::new(-4.0, 0.5, 1.0), Vec3::X * 2.0, Vec3::Y * 2.0)
        .point(Vec3::new(0.3, 3.1, 0.2))
        .light(LightKind::Point, Vec3::new(-4.0, 1.5, 3.0), Vec3::NEG_Y, 5.0)
        .light(
            LightKind::Spot { inner_cone_rad: 0.3, outer_cone_rad: 0.7 },
            Vec3::new(3.5, 3.5, 3.0),
            Vec3::new(-0.6, -1.0, -0.9),
            f32::INFINITY,
        )
        .light(LightKind::Directional, Vec3::ZERO, Vec3::new(0.3, -1.0, 0.2), f32::INFINITY)
        .point(Vec3::new(3.9, 0.4, 2.7))
        .build()
}

/// The room, in which half of a box turns and carries a lamp, its other half is hidden at times, the leaf is turned
/// inside out, and the pane moves, which stops no ray.
pub(crate) fn living_room() -> Scene {
    let mut scene = room();
    let track = |interpolation, times_s: &[f32], values: &[f32]| {
        let period_s = times_s.last().copied().map_or(0.0, f64::from);
        Some(Track { period_s, interpolation, times_s: times_s.to_vec(), values: values.to_vec() })
    };
    let still = AnimatedNode::default();
    let turn = |angle: f32| Quat::from_rotation_y(angle).to_array();
    let turning = AnimatedNode {
        translation_track: track(Interpolation::Linear, &[0.0, 2.0], &[0.0, 0.0, 0.0, 3.0, 0.2, 1.0]),
        rotation_track: track(Interpolation::Linear, &[0.0, 2.0], &[turn(0.0), turn(1.1)].concat()),
        ..still.clone()
    };
    let hidden = AnimatedNode {
        visible_track: track(Interpolation::Step, &[0.0, 0.5, 1.0], &[1.0, 0.0, 1.0]),
        scale_track: track(Interpolation::Linear, &[0.0, 1.0], &[1.0, 1.0, 1.0, 1.3, 0.8, 1.0]),
        ..still.clone()
    };
    let inside_out = AnimatedNode {
        scale_track: track(Interpolation::Linear, &[0.0, 1.5], &[1.0, 1.0, 1.0, -1.2, 1.0, 0.9]),
        ..still.clone()
    };
    let drifting = AnimatedNode {
        translation_track: track(Interpolation::Linear, &[0.0, 1.0], &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]),
        ..still
    };
    let mut animation = Animation { nodes: vec![turning, hidden, inside_out, drifting], ..Animation::default() };
    let vertices = |material: u32| {
        let draw = scene.draws.iter().find(|draw| draw.material == material).unwrap();
        3 * draw.first_triangle..3 * (draw.first_triangle + draw.triangles)
    };
    let (boxed, leaf, pane) = (vertices(DOUBLE_SIDED), vertices(LEAF), vertices(GLASS));
    let half = boxed.start + 18;
    for (node, vertices) in [(0, boxed.start..half), (1, half..boxed.end), (2, leaf), (3, pane)] {
        let (from, to) = (vertices.start as usize, vertices.end as usize);
        let positions = &scene.positions[from..to];
        let min = positions.iter().copied().reduce(Vec3::min).unwrap();
        let max = positions.iter().copied().reduce(Vec3::max).unwrap();
        animation.pieces.push(Piece {
            node,
            first_vertex: vertices.start,
            vertices: vertices.end - vertices.start,
            bounds: Aabb { min, max },
            mirrored: false,
        });
        animation.positions.extend_from_slice(positions);
        animation.normals.extend_from_slice(&scene.normals[from..to]);
    }
    let node_from_own = DMat4::from_translation(scene.lights[0].position.as_dvec3());
    animation.lights.push(AnimatedLight {
        light: 0,
        place: Some(Place { node: 0, node_from_own }),
        ..AnimatedLight::default()
    });
    scene.animation = Some(Box::new(animation));
    let (first, others) = scene.positions.split_first().unwrap();
    scene.bounds = others.iter().fold(Aabb { min: *first, max: *first }, |Aabb { min, max }, position| Aabb {
        min: min.min(*position),
        max: max.max(*position),
    });
    assert_eq!(scene.check(), Ok(()));
    scene
}
