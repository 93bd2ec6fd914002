//! Checks a [`Scene`]'s guarantees: after loading, and again after unpacking.

use std::{f32::consts::FRAC_PI_2, f64::consts::PI};

use glam::{Vec3, Vec4};
use thiserror::Error;

use super::{
    aabb::Aabb,
    material::{AlphaMode, Coordinates, Material},
    normals::triangle_normal,
    types::{Image, Light, LightKind, NamedCamera, Scene},
};
use crate::limits::{
    MAX_CAMERAS, MAX_DRAWS, MAX_IMAGE_SIDE_PX, MAX_IMAGES, MAX_IMAGES_PIXELS, MAX_LIGHTS, MAX_MATERIALS,
    MAX_NAME_BYTES, MAX_TRIANGLES, MAX_VERTICES, in_reach, is_legal_uv,
};

/// How far a unit vector's squared length may lie from 1: rounding to f32 moves it by less than 1e-6.
const UNIT_TOLERANCE: f32 = 1e-4;

/// The first guarantee that a [`Scene`] breaks.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct CheckError(String);

pub(super) fn ensure(holds: bool, fault: impl FnOnce() -> String) -> Result<(), CheckError> {
    if holds { Ok(()) } else { Err(CheckError(fault())) }
}

/// Errors at the first element for which `holds` is false.
pub(super) fn all<T: std::fmt::Debug>(
    what: &str,
    elements: &[T],
    holds: impl Fn(&T) -> bool,
) -> Result<(), CheckError> {
    match elements.iter().enumerate().find(|(_, element)| !holds(element)) {
        Some((index, element)) => Err(CheckError(format!("{what} {index} is {element:?}"))),
        None => Ok(()),
    }
}

pub(super) fn at_most(what: &str, count: usize, limit: u64) -> Result<(), CheckError> {
    ensure(count as u64 <= limit, || format!("{count} {what}, more than {limit}"))
}

/// Local coordinates are differences of two world coordinates.
fn is_local(position: Vec3) -> bool {
    in_reach(position.as_dvec3() / 2.0)
}

pub(super) fn is_unit(vector: Vec3) -> bool {
    (vector.length_squared() - 1.0).abs() <= UNIT_TOLERANCE
}

impl Scene {
    /// Checks everything that the type guarantees.
    ///
    /// # Errors
    /// Errors at the first broken guarantee.
    pub fn check(&self) -> Result<(), CheckError> {
        self.check_geometry()?;
        self.check_draws()?;
        at_most("materials", self.materials.len(), MAX_MATERIALS as u64 + 1)?;
        for (index, material) in self.materials.iter().enumerate() {
            self.check_material(index, material)?;
        }
        at_most("images", self.images.len(), MAX_IMAGES as u64)?;
        let pixels = |image: &Image| u64::from(image.width) * u64::from(image.height);
        let sides = 1..=MAX_IMAGE_SIDE_PX;
        for (index, image) in self.images.iter().enumerate() {
            let whole = sides.contains(&image.width)
                && sides.contains(&image.height)
                && image.rgba.len() as u64 == pixels(image) * 4;
            ensure(whole, || {
                format!("image {index} of {}×{} pixels has {} bytes", image.width, image.height, image.rgba.len())
            })?;
        }
        let pixels = self.images.iter().map(pixels).sum::<u64>();
        ensure(pixels <= MAX_IMAGES_PIXELS, || format!("{pixels} pixels, more than {MAX_IMAGES_PIXELS}"))?;
        ensure((1..=MAX_LIGHTS).contains(&self.lights.len()), || format!("{} lights", self.lights.len()))?;
        all("light", &self.lights, is_legal_light)?;
        at_most("cameras", self.cameras.len(), MAX_CAMERAS as u64)?;
        all("camera", &self.cameras, is_legal_camera)?;
        self.check_animation()
    }

    fn check_geometry(&self) -> Result<(), CheckError> {
        let vertices = self.positions.len();
        at_most("vertices", vertices, MAX_VERTICES)?;
        at_most("triangles", self.triangles.len(), MAX_TRIANGLES)?;
        ensure(!self.triangles.is_empty(), || "no triangles".to_owned())?;
        ensure(self.normals.len() == vertices && self.uvs.len() == vertices, || {
            format!("{vertices} positions, {} normals and {} UVs", self.normals.len(), self.uvs.len())
        })?;
        let optional = [self.uvs_1.len(), self.tangents.len(), self.colors.len()];
        ensure(optional.iter().all(|count| *count == 0 || *count == vertices), || {
            let [uvs_1, tangents, colors] = optional;
            format!("{vertices} positions, {uvs_1} second UVs, {tangents} tangents and {colors} colours")
        })?;
        let origin = self.origin_m;
        ensure(in_reach(origin), || format!("the origin is {origin}"))?;
        all("position", &self.positions, |p| is_local(*p))?;
        all("normal", &self.normals, |normal| is_unit(*normal))?;
        all("UV", &self.uvs, |uv| is_legal_uv(*uv))?;
        all("second UV", &self.uvs_1, |uv| is_legal_uv(*uv))?;
        all("tangent", &self.tangents, |tangent| {
            *tangent == Vec4::ZERO || (is_unit(tangent.truncate()) && tangent.w.abs() == 1.0)
        })?;
        // A moving triangle may have no area in the file's pose: its own space counts.
        let moves = |corner: u32| self.animation.as_ref().is_some_and(|animation| animation.piece_of(corner).is_some());
        all("triangle", &self.triangles, |corners| {
            let [a, b, c] = corners.map(|corner| self.positions.get(corner as usize).copied());
            a.zip(b).zip(c).is_some_and(|((a, b), c)| triangle_normal(a, b, c).is_some() || moves(corners[0]))
        })?;
        let bounds = Aabb::of(self);
        ensure(self.bounds == bounds, || format!("bounds are {:?}, but say {:?}", bounds, self.bounds))
    }

    fn check_draws(&self) -> Result<(), CheckError> {
        at_most("draws", self.draws.len(), MAX_DRAWS)?;
        ensure(self.instances > 0, || "no instances".to_owned())?;
        let (mut next, mut order) = (0_u64, 0);
        for (index, draw) in self.draws.iter().enumerate() {
            let Some(material) = self.materials.get(draw.material as usize) else {
                return Err(CheckError(format!("draw {index} names material {}", draw.material)));
            };
            let follows =
                u64::from(draw.first_triangle) == next && draw.triangles > 0 && material.alpha.order() >= order;
            ensure(follows, || format!("draw {index} is {draw:?}, after triangle {next} of order {order}"))?;
            next += u64::from(draw.triangles);
            order = material.alpha.order();
        }
        let triangles = self.triangles.len();
        ensure(next == triangles as u64, || format!("draws cover {next} triangles of {triangles}"))
    }

    fn check_material(&self, index: usize, material: &Material) -> Result<(), CheckError> {
        let cutoff = match material.alpha {
            AlphaMode::Mask { cutoff } => cutoff,
            AlphaMode::Opaque | AlphaMode::Blend => 0.0,
        };
        let legal = material.base_color.to_array().iter().all(|v| (0.0..=1.0).contains(v))
            && material.emissive.to_array().iter().all(|v| *v >= 0.0 && v.is_finite())
            && cutoff >= 0.0
            && cutoff.is_finite()
            && has_legal_layers(material)
            && material.name.len() <= MAX_NAME_BYTES
            && material.base_color_texture.is_none_or(|texture| texture.coordinates == Coordinates::default())
            && material.textures().all(|texture| {
                (texture.image as usize) < self.images.len()
                    && texture.coordinates.map.iter().all(|row| row.is_finite())
                    && (!texture.coordinates.second || !self.uvs_1.is_empty())
            });
        ensure(legal, || format!("material {index} is {material:?}, with {} images", self.images.len()))
    }
}

fn has_legal_layers(material: &Material) -> bool {
    let shares = [
        material.metallic,
        material.roughness,
        material.occlusion_strength,
        material.specular.strength,
        material.clearcoat.strength,
        material.clearcoat.roughness,
        material.sheen.roughness,
        material.transmission.factor,
    ];
    let colors = [material.specular.color, material.sheen.color];
    shares.iter().all(|share| (0.0..=1.0).contains(share))
        && colors.iter().flat_map(Vec3::to_array).all(|v| v >= 0.0 && v.is_finite())
        && [material.normal_scale, material.clearcoat.normal_scale].iter().all(|scale| scale.is_finite())
        && (material.ior == 0.0 || material.ior >= 1.0)
        && material.ior.is_finite()
}

fn is_legal_camera(camera: &NamedCamera) -> bool {
    in_reach(camera.position_m)
        && (camera.orientation.length_squared() - 1.0).abs() <= f64::from(UNIT_TOLERANCE)
        && camera.yfov_rad > 0.0
        && camera.yfov_rad < PI
        && camera.name.len() <= MAX_NAME_BYTES
}

fn is_legal_light(light: &Light) -> bool {
    let cone = match light.kind {
        LightKind::Directional | LightKind::Point => true,
        LightKind::Spot { inner_cone_rad, outer_cone_rad } => {
            inner_cone_rad >= 0.0 && inner_cone_rad <= outer_cone_rad && outer_cone_rad <= FRAC_PI_2 + 1e-6
        }
    };
    cone && is_local(light.position)
        && is_unit(light.direction)
        && light.color.to_array().iter().all(|v| *v >= 0.0 && v.is_finite())
        && light.intensity >= 0.0
        && light.intensity.is_finite()
        && light.range_m > 0.0
        && light.name.len() <= MAX_NAME_BYTES
}

#[cfg(test)]
pub(crate) mod tests {
    use glam::{DMat4, DQuat, DVec3, Vec2};

    use super::*;
    use crate::{
        AnimatedLight, AnimatedNode, Animation, Delta, Draw, Influence, Interpolation, Joint, Piece, Place, Shape,
        Target, Texture, Track, Wrap,
    };

    /// Two triangles: one OPAQUE, one MASK with a picture of 2 × 1 pixels; a point and a spot light.
    pub(crate) fn scene() -> Scene {
        let mut encoded = Vec::new();
        let rgba = vec![255, 0, 0, 0, 0, 255, 0, 255];
        let picture = image::RgbaImage::from_raw(2, 1, rgba.clone()).unwrap();
        picture.write_to(&mut std::io::Cursor::new(&mut encoded), image::ImageFormat::Png).unwrap();
        let material = |texture, alpha| Material {
            name: "matter".to_owned(),
            base_color: Vec4::ONE,
            base_color_texture: texture,
            alpha,
            double_sided: false,
            ..Material::default()
        };
        let texture = Texture::new(0, Wrap::Repeat, Wrap::ClampToEdge);
        let light = |kind| Light {
            name: "lamp".to_owned(),
            kind,
            position: Vec3::Y,
            direction: Vec3::NEG_Y,
            color: Vec3::ONE,
            intensity: 5.0,
            range_m: f32::INFINITY,
        };
        Scene {
            origin_m: DVec3::new(1e6, 0.0, -0.5),
            bounds: Aabb { min: Vec3::ZERO, max: Vec3::new(1.0, 1.0, 0.0) },
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::new(1.0, 1.0, 0.0)],
            normals: vec![Vec3::Z; 4],
            uvs: vec![Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::ONE],
            uvs_1: vec![Vec2::splat(0.25); 4],
            tangents: vec![Vec4::new(1.0, 0.0, 0.0, -1.0), Vec4::ZERO, Vec4::X + Vec4::W, Vec4::ZERO],
            colors: vec![[1, 2, 3, 65535]; 4],
            triangles: vec![[0, 1, 2], [1, 3, 2]],
            draws: vec![
                Draw { first_triangle: 0, triangles: 1, material: 0 },
                Draw { first_triangle: 1, triangles: 1, material: 1 },
            ],
            materials: vec![
                material(None, AlphaMode::Opaque),
                material(Some(texture), AlphaMode::Mask { cutoff: 0.5 }),
            ],
            images: vec![Image { encoded, width: 2, height: 1, rgba }],
            lights: vec![
                light(LightKind::Point),
                light(LightKind::Spot { inner_cone_rad: 0.0, outer_cone_rad: FRAC_PI_2 }),
            ],
            cameras: vec![NamedCamera {
                name: "door".to_owned(),
                position_m: DVec3::new(1e6, 1.0, 2.0),
                orientation: DQuat::from_rotation_y(1.0),
                yfov_rad: 0.7,
            }],
            instances: 2,
            animation: None,
        }
    }

    /// The scene with its first triangle on a node that rises by 2 m a second, and its first light on one below that
    /// blinks.
    pub(crate) fn moving() -> Scene {
        let mut scene = scene();
        let track = |values: &[f32]| {
            let values = values.to_vec();
            Track { period_s: 2.0, interpolation: Interpolation::Linear, times_s: vec![0.0, 2.0], values }
        };
        let node =
            AnimatedNode { translation_track: Some(track(&[0.0, 0.0, 0.0, 0.0, 4.0, 0.0])), ..AnimatedNode::default() };
        let below = AnimatedNode {
            parent: Some(0),
            translation_track: None,
            visible_track: Some(Track { interpolation: Interpolation::Step, ..track(&[1.0, 0.0]) }),
            ..node.clone()
        };
        // No triangle shares a vertex with what rests.
        scene.triangles[1] = [4, 3, 5];
        scene.positions.extend_from_within(1..3);
        scene.normals = vec![Vec3::Z; 6];
        scene.uvs = vec![Vec2::ZERO; 6];
        scene.uvs_1 = vec![Vec2::ZERO; 6];
        scene.tangents = vec![Vec4::new(1.0, 0.0, 0.0, -1.0); 6];
        scene.colors = vec![[9, 9, 9, 65535]; 6];
        let own = [Vec3::ZERO, Vec3::X, Vec3::Y];
        let bounds = Aabb::around(&own);
        scene.animation = Some(Box::new(Animation {
            name: "up".to_owned(),
            nodes: vec![node, below],
            pieces: vec![Piece { node: 0, first_vertex: 0, vertices: 3, bounds, mirrored: false }],
            positions: own.to_vec(),
            normals: vec![Vec3::Z; 3],
            tangents: vec![Vec4::new(1.0, 0.0, 0.0, -1.0); 3],
            lights: vec![AnimatedLight {
                light: 0,
                place: Some(Place { node: 1, node_from_own: DMat4::IDENTITY }),
                intensity_track: Some(track(&[1.0, 3.0])),
                ..AnimatedLight::default()
            }],
            ..Animation::default()
        }));
        scene
    }

    /// The moving scene, whose piece follows two joints and a morph target.
    pub(crate) fn reshaped() -> Scene {
        let mut scene = moving();
        let animation = scene.animation.as_mut().unwrap();
        let joint =
            |node, positions: &[Vec3]| Joint { node, node_from_own: DMat4::IDENTITY, bounds: Aabb::around(positions) };
        let influence = |joint, weights| Influence { joints: [0, joint, 0, 0], weights };
        animation.influences = vec![
            influence(1, [0.5, 0.5, 0.0, 0.0]),
            influence(0, [1.0, 0.0, 0.0, 0.0]),
            influence(1, [0.0, 2.0, 0.0, 0.0]),
        ];
        let delta = Delta { position: Vec3::Z, normal: Vec3::X, tangent: Vec3::Y };
        animation.deltas = vec![delta, Delta::default(), Delta { position: Vec3::NEG_Y, ..delta }];
        let bounds = Aabb::around(&[Vec3::Z, Vec3::ZERO, Vec3::NEG_Y]);
        let times_s = vec![0.0, 2.0];
        let weights_track =
            Track { period_s: 2.0, interpolation: Interpolation::Linear, times_s, values: vec![0.0, 1.0] };
        animation.shapes = vec![Shape {
            piece: 0,
            node_from_own: DMat4::IDENTITY,
            joints: vec![joint(Some(0), &[Vec3::ZERO, Vec3::X]), joint(None, &[Vec3::ZERO, Vec3::Y])],
            sets: 1,
            targets: vec![Target { weight: 0.25, bounds }],
            weights_track: Some(weights_track),
            flat: false,
        }];
        scene
    }

    /// A change that breaks one guarantee of what moves.
    type MovingBreak = (&'static str, fn(&mut Animation));

    const MOVING_BREAKS: [MovingBreak; 21] = [
        ("an animation of nothing", |a| (a.pieces, a.lights) = Default::default()),
        ("animated node 1", |a| a.nodes[1].parent = Some(1)),
        ("animated node 0", |a| a.nodes[0].above.x_axis.x = f64::NAN),
        ("animated node 0", |a| a.nodes[0].scale.y = f64::INFINITY),
        ("animated node 0", |a| a.nodes[0].rotation.w = 2.0),
        ("track", |a| a.nodes[0].translation_track.as_mut().unwrap().times_s.clear()),
        ("track", |a| a.nodes[0].translation_track.as_mut().unwrap().times_s[0] = 3.0),
        ("track", |a| a.nodes[0].translation_track.as_mut().unwrap().values[5] = f32::NAN),
        ("track", |a| a.nodes[0].translation_track.as_mut().unwrap().period_s = -1.0),
        ("track", |a| a.nodes[0].translation_track.as_mut().unwrap().interpolation = Interpolation::CubicSpline),
        ("moving piece 0", |a| a.pieces[0].node = 2),
        ("moving piece 0", |a| a.pieces[0].first_vertex = 4),
        ("moving piece 0", |a| a.pieces[0].vertices = 0),
        ("moving piece 0", |a| a.pieces[0].bounds.max.x = 2.0),
        ("moving position 1", |a| a.positions[1].x = f32::NAN),
        ("moving normal 1", |a| a.normals[1] = Vec3::ZERO),
        ("positions, normals and tangents", |a| a.tangents.clear()),
        ("triangle 0", |a| a.pieces[0].vertices = 2),
        ("triangle 0", |a| a.positions[2] = Vec3::X),
        ("that is not there", |a| a.lights[0].light = 2),
        ("hangs on an animated node", |a| a.lights[0].place.as_mut().unwrap().node = 7),
    ];

    #[test]
    fn every_broken_guarantee_of_what_moves_is_found() {
        assert_eq!(moving().check(), Ok(()));
        for (index, (says, break_it)) in MOVING_BREAKS.iter().enumerate() {
            let mut scene = moving();
            let animation = scene.animation.as_mut().unwrap();
            break_it(animation);
            let of_pieces: usize = animation.pieces.iter().map(|piece| piece.vertices as usize).sum();
            if *says == "triangle 0" {
                animation.positions.truncate(of_pieces);
                animation.normals.truncate(of_pieces);
                animation.tangents.truncate(of_pieces);
                animation.pieces[0].bounds = Aabb::around(&animation.positions);
            }
            let fault = scene.check().expect_err(&format!("break {index} ({says}) went unseen")).to_string();
            assert!(fault.contains(says), "break {index}: {fault:?} does not say {says:?}");
        }
    }

    const SHAPE_BREAKS: [MovingBreak; 15] = [
        ("names a piece that is not there", |a| a.shapes[0].piece = 1),
        ("names a piece that is not there", |a| a.shapes = vec![a.shapes[0].clone(); 2]),
        ("the shape of piece 0", |a| a.shapes[0].joints[0].node = Some(2)),
        ("the shape of piece 0", |a| a.shapes[0].joints[1].node_from_own.x_axis.x = f64::NAN),
        ("the shape of piece 0", |a| a.shapes[0].node_from_own.w_axis.x = 1e40),
        ("the shape of piece 0", |a| a.shapes[0].sets = 5),
        ("the shape of piece 0", |a| a.shapes[0].sets = 0),
        ("the shape of piece 0", |a| a.shapes[0].targets[0].weight = f32::NAN),
        ("track", |a| a.shapes[0].weights_track.as_mut().unwrap().values.truncate(1)),
        ("influences and deltas", |a| a.influences.truncate(2)),
        ("influences and deltas", |a| a.deltas.clear()),
        ("change by a morph target 1", |a| a.deltas[1].normal.x = f32::INFINITY),
        ("follow joints that are not there", |a| a.influences[1].joints[3] = 2),
        ("follow joints that are not there", |a| a.influences[1].weights = [0.0; 4]),
        ("other bounds", |a| a.shapes[0].joints[1].bounds.max.x = 7.0),
    ];

    #[test]
    fn every_broken_guarantee_of_shapes_is_found() {
        assert_eq!(reshaped().check(), Ok(()));
        for (index, (says, break_it)) in SHAPE_BREAKS.iter().enumerate() {
            let mut scene = reshaped();
            break_it(scene.animation.as_mut().unwrap());
            let fault = scene.check().expect_err(&format!("break {index} ({says}) went unseen")).to_string();
            assert!(fault.contains(says), "break {index}: {fault:?} does not say {says:?}");
        }
    }

    /// A change that breaks one guarantee, and a part of what the error says.
    type Break = (&'static str, fn(&mut Scene));

    const BREAKS: [Break; 43] = [
        ("normals", |s| s.normals.truncate(3)),
        ("UVs", |s| s.uvs.push(Vec2::ZERO)),
        ("3 second UVs", |s| s.uvs_1.truncate(3)),
        ("second UV 1", |s| s.uvs_1[1].x = f32::INFINITY),
        ("tangent 2", |s| s.tangents[2].w = 0.5),
        ("5 colours", |s| s.colors.push([0; 4])),
        ("material 0", |s| s.materials[0].roughness = 1.5),
        ("material 0", |s| s.materials[0].ior = 0.5),
        ("material 1", |s| s.materials[1].base_color_texture.as_mut().unwrap().coordinates.second = true),
        ("material 1", |s| s.materials[1].clearcoat.normal_texture = Some(Texture::new(1, Wrap::Repeat, Wrap::Repeat))),
        ("camera 0", |s| s.cameras[0].yfov_rad = 0.0),
        ("position 1", |s| s.positions[1].x = f32::NAN),
        ("position 1", |s| s.positions[1].y = f32::INFINITY),
        ("position 2", |s| s.positions[2].y = 3e9),
        ("normal 3", |s| s.normals[3] = Vec3::ZERO),
        ("normal 3", |s| s.normals[3].z = f32::NAN),
        ("UV 0", |s| s.uvs[0].y = f32::NAN),
        ("UV 0", |s| s.uvs[0].y = 1e6),
        ("origin", |s| s.origin_m.x = f64::NAN),
        ("triangle 1", |s| s.triangles[1][2] = 4),
        ("triangle 1", |s| s.triangles[1][2] = 3),
        ("no triangles", |s| s.triangles.clear()),
        ("bounds", |s| s.bounds.max.x = 2.0),
        ("bounds", |s| s.bounds.min.x = f32::NAN),
        ("no instances", |s| s.instances = 0),
        ("draws cover 1", |s| s.draws.truncate(1)),
        ("draw 1", |s| s.draws[1].first_triangle = 0),
        ("draw 1", |s| s.draws[1].triangles = 0),
        ("draw 1 names material 2", |s| s.draws[1].material = 2),
        ("draw 1", |s| s.materials.swap(0, 1)),
        ("material 1", |s| s.images.clear()),
        ("material 0", |s| s.materials[0].base_color.w = 1.5),
        ("material 0", |s| s.materials[0].emissive.x = f32::INFINITY),
        ("material 1", |s| s.materials[1].alpha = AlphaMode::Mask { cutoff: f32::NAN }),
        ("material 0", |s| s.materials[0].name = "n".repeat(257)),
        ("image 0", |s| s.images[0].rgba.truncate(7)),
        ("image 0", |s| s.images[0].width = 0),
        ("0 lights", |s| s.lights.clear()),
        ("33 lights", |s| s.lights = vec![s.lights[0].clone(); 33]),
        ("light 0", |s| s.lights[0].direction = Vec3::ZERO),
        ("light 0", |s| s.lights[0].position.z = f32::NAN),
        ("light 1", |s| s.lights[1].kind = LightKind::Spot { inner_cone_rad: 1.0, outer_cone_rad: 0.5 }),
        ("light 0", |s| s.lights[0].range_m = f32::NAN),
    ];

    #[test]
    fn every_broken_guarantee_is_found() {
        assert_eq!(scene().check(), Ok(()));
        for (index, (says, break_it)) in BREAKS.iter().enumerate() {
            let mut scene = scene();
            break_it(&mut scene);
            let fault = scene.check().expect_err(&format!("break {index} ({says}) went unseen")).to_string();
            assert!(fault.contains(says), "break {index}: {fault:?} does not say {says:?}");
        }
    }
}
