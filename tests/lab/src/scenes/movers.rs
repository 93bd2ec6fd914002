//! Real scenes with many things that move through them: balls of 1,000 triangles and 502 vertices, each on a way of its
//! own, rigid or bent by a skin.

use glam::{DMat4, DQuat, DVec3, Vec2, Vec3, Vec4};
use gnomon_scene::{
    Aabb, AlphaMode, AnimatedNode, Animation, Draw, Influence, Interpolation, Joint, Material, Piece, Scene, Shape,
};

use super::builder::{SceneBuilder, track};

/// Triangles of a mover: 2 · SECTORS · (RINGS − 1).
pub const TRIANGLES: u32 = 1000;
const SECTORS: u32 = 25;
const RINGS: u32 = 21;

/// A round of a mover's way, in seconds, and its corners.
const ROUND_S: f32 = 8.0;
const CORNERS: u8 = 4;

/// Returns the scene with `count` movers. Their radius is a share of its shortest side; all ways stay within it.
/// Vertices of skinned ones follow four joints each.
pub fn with_movers(scene: &Scene, count: u32, skinned: bool) -> Scene {
    let mut scene = scene.clone();
    let (low, size) = (scene.bounds.min, scene.bounds.max - scene.bounds.min);
    let radius = size.min_element() / 40.0;
    let (ball, faces) = ball(radius);
    let mut random = Random(1);
    let mut animation = scene.animation.take().unwrap_or_default();
    let material = index(scene.materials.len());
    scene.materials.push(Material { alpha: AlphaMode::Opaque, double_sided: false, ..Material::default() });
    let mut triangles = Vec::with_capacity((count * TRIANGLES) as usize);
    for mover in 0..count {
        let first_vertex = index(scene.positions.len());
        let way: Vec<Vec3> = (0..CORNERS).map(|_| low + (random.point() * 0.8 + 0.1) * size).collect();
        let turn = |corner: u8| DQuat::from_axis_angle(DVec3::Y, f64::from(corner) * 1.3 + f64::from(mover)).as_quat();
        let closed = || (0..=CORNERS).map(|corner| corner % CORNERS);
        let times: Vec<f32> = (0..=CORNERS).map(|key| f32::from(key) * ROUND_S / f32::from(CORNERS)).collect();
        let places: Vec<f32> = closed().flat_map(|corner| way[usize::from(corner)].to_array()).collect();
        let turns: Vec<f32> = closed().flat_map(|corner| turn(corner).to_array()).collect();
        let node = index(animation.nodes.len());
        animation.nodes.push(AnimatedNode {
            above: DMat4::from_translation(scene.origin_m),
            translation_m: way[0].as_dvec3(),
            translation_track: track(Interpolation::Linear, &times, &places),
            rotation_track: track(Interpolation::Linear, &times, &turns),
            ..SceneBuilder::node(None)
        });
        if skinned {
            let piece = index(animation.pieces.len());
            skin(&mut animation, (node, piece), &ball, radius);
        }
        let bounds = Aabb::around(&ball);
        animation.pieces.push(Piece { node, first_vertex, vertices: index(ball.len()), bounds, mirrored: false });
        for position in &ball {
            animation.positions.push(*position);
            animation.normals.push(*position / radius);
            scene.positions.push(*position + way[0]);
            scene.normals.push(*position / radius);
            scene.uvs.push(Vec2::ZERO);
        }
        triangles.extend(faces.iter().map(|face| face.map(|corner| first_vertex + corner)));
    }
    let vertices = scene.positions.len();
    fill(&mut scene.uvs_1, vertices, Vec2::ZERO);
    fill(&mut scene.tangents, vertices, Vec4::ZERO);
    fill(&mut scene.colors, vertices, [u16::MAX; 4]);
    let moving = animation.positions.len();
    fill(&mut animation.tangents, moving, Vec4::ZERO);
    // OPAQUE draws come first.
    let added = index(triangles.len());
    scene.draws.iter_mut().for_each(|draw| draw.first_triangle += added);
    if added > 0 {
        scene.draws.insert(0, Draw { first_triangle: 0, triangles: added, material });
    }
    triangles.append(&mut scene.triangles);
    scene.triangles = triangles;
    scene.animation = (!animation.is_empty()).then_some(animation);
    scene
}

/// Gives a ball a skin: four joints below its node, from bottom to top, of which the upper ones turn.
fn skin(animation: &mut Animation, (node, piece): (u32, u32), ball: &[Vec3], radius: f32) {
    const JOINTS: u8 = 4;
    // How much each joint counts: the nearer it is, the more.
    let weights =
        |at: &Vec3| [0_u8, 1, 2, 3].map(|joint| 1.0 / (0.1 + (at.y / radius - f32::from(joint) / 1.5 + 1.0).abs()));
    let turn = |angle: f64| DQuat::from_rotation_z(angle).as_quat().to_array();
    let mut joint = |number: u8| {
        let below = index(animation.nodes.len());
        let most = f64::from(number) * 0.1;
        animation.nodes.push(AnimatedNode {
            rotation_track: track(
                Interpolation::Linear,
                &[0.0, 1.0, 2.0],
                &[turn(most), turn(-most), turn(most)].concat(),
            ),
            ..SceneBuilder::node(Some(node))
        });
        Joint { node: Some(below), node_from_own: DMat4::IDENTITY, bounds: Aabb::around(ball) }
    };
    let joints = (0..JOINTS).map(&mut joint).collect();
    animation.influences.extend(ball.iter().map(|at| Influence { joints: [0, 1, 2, 3], weights: weights(at) }));
    animation.shapes.push(Shape {
        piece,
        node_from_own: DMat4::IDENTITY,
        joints,
        sets: 1,
        targets: Vec::new(),
        weights_track: None,
        flat: false,
    });
}

/// Vertices and faces of a closed ball around the origin.
fn ball(radius: f32) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    use std::f32::consts::{PI, TAU};
    let mut vertices = vec![Vec3::Y * radius];
    for ring in 1..RINGS {
        let (sine, height) = (PI * ring as f32 / RINGS as f32).sin_cos();
        for sector in 0..SECTORS {
            let (z, x) = (TAU * sector as f32 / SECTORS as f32).sin_cos();
            vertices.push(Vec3::new(x * sine, height, z * sine) * radius);
        }
    }
    vertices.push(Vec3::NEG_Y * radius);
    let at = |ring: u32, sector: u32| match ring {
        0 => 0,
        RINGS => 1 + (RINGS - 1) * SECTORS,
        _ => 1 + (ring - 1) * SECTORS + sector % SECTORS,
    };
    let mut faces = Vec::with_capacity(TRIANGLES as usize);
    for ring in 0..RINGS {
        for sector in 0..SECTORS {
            let [a, b] = [at(ring, sector), at(ring, sector + 1)];
            let [c, d] = [at(ring + 1, sector), at(ring + 1, sector + 1)];
            if ring > 0 {
                faces.push([a, b, d]);
            }
            if ring + 1 < RINGS {
                faces.push([a, d, c]);
            }
        }
    }
    (vertices, faces)
}

/// Lists that are not empty have an entry a vertex.
fn fill<T: Clone>(list: &mut Vec<T>, count: usize, value: T) {
    if !list.is_empty() {
        list.resize(count, value);
    }
}

fn index(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}

struct Random(u32);

impl Random {
    /// Each coordinate from 0 to 1.
    fn point(&mut self) -> Vec3 {
        Vec3::from_array(std::array::from_fn(|_| {
            self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (self.0 >> 8) as f32 / (1 << 24) as f32
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn movers_are_closed_balls_of_a_thousand_triangles_that_move() {
        let still = SceneBuilder::new().cuboid(Vec3::ZERO, Vec3::new(4.0, 2.0, 3.0)).sun(Vec3::NEG_Y).build();
        assert_eq!(with_movers(&still, 0, false).animation, None);
        let bent = with_movers(&still, 3, true);
        assert_eq!(bent.check(), Ok(()));
        let scene = with_movers(&still, 3, false);
        assert_eq!(scene.check(), Ok(()));
        assert_ne!(bent.still_at(2.0).positions, scene.still_at(2.0).positions);
        assert_eq!(scene.triangles.len(), still.triangles.len() + 3 * TRIANGLES as usize);
        let (vertices, faces) = ball(1.0);
        let volume: f32 = faces
            .iter()
            .map(|face| face.map(|corner| vertices[corner as usize]))
            .map(|[a, b, c]| a.dot(b.cross(c)) / 6.0)
            .sum();
        assert!((4.0..4.19).contains(&volume), "outwards: {volume}");
        let (one, other) = (scene.still_at(0.0), scene.still_at(2.9));
        assert_eq!(one.triangles.len(), scene.triangles.len());
        assert_ne!(one.positions, other.positions);
        assert!(other.bounds.min.cmpge(still.bounds.min).all() && other.bounds.max.cmple(still.bounds.max).all());
    }
}
