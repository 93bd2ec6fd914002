//! What picking needs of a scene: its triangles in runs that share a box, and how holes are cut.

use std::cell::OnceCell;

use glam::{DMat3, DVec2, DVec3, Vec3};
use gnomon_scene::{Aabb, AlphaMode, AlphaPicture, Animation, Light, OwnVertices, Placement, Scene, SceneAt, Wrap};

use super::{
    Target,
    ray::{Met, Ray},
};

/// Triangles that share a box, at most.
const RUN: u32 = 512;

/// Boxes in f32 grow by this share of their coordinates: what a rounding to f32 may have moved.
const BOX_SLACK: f64 = 1e-6;

/// A scene without what only its look needs.
#[derive(Debug)]
pub struct Stage {
    scene: Scene,
    /// One for each material.
    holes: Vec<Option<AlphaPicture>>,
    /// Made with the first ray.
    runs: OnceCell<Vec<Run>>,
}

/// The scene in one state.
#[derive(Debug, Clone)]
pub struct Posed {
    pub at: SceneAt,
    /// One for each piece of the animation. `None`: it is not shown.
    pub pieces: Vec<Option<Placement>>,
    pub lights: Vec<Light>,
}

/// Triangles of one draw and one piece that follow each other.
#[derive(Debug)]
struct Run {
    first: u32,
    end: u32,
    material: u32,
    /// `None` if they rest.
    piece: Option<usize>,
    /// In the piece's own space, or in the scene's local space if they rest.
    bounds: Aabb,
}

/// What a ray meets first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// In lengths of the ray's direction.
    pub distance: f64,
    /// The node that may be edited, and that the surface moves with. `None` if there is none.
    pub node: Option<u32>,
}

impl Stage {
    #[must_use]
    pub fn new(mut scene: Scene) -> Self {
        let materials = 0..u32::try_from(scene.materials.len()).unwrap_or(u32::MAX);
        let holes: Vec<Option<AlphaPicture>> = materials.map(|material| scene.alpha_picture(material)).collect();
        if holes.iter().all(Option::is_none) {
            scene.uvs = Vec::new();
        }
        (scene.images, scene.normals, scene.uvs_1) = (Vec::new(), Vec::new(), Vec::new());
        (scene.tangents, scene.colors) = (Vec::new(), Vec::new());
        if let Some(animation) = &mut scene.animation {
            animation.tangents = Vec::new();
        }
        Self { scene, holes, runs: OnceCell::new() }
    }

    /// The scene, without pictures, normals, tangents and colours.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Returns everything that may be edited: nodes, then lights.
    pub fn targets(&self) -> impl Iterator<Item = Target> {
        let nodes = self.animation().map_or(&[][..], |animation| &animation.nodes);
        let nodes = (0..).zip(nodes).filter(|(_, node)| node.editable).map(|(number, _)| Target::Node(number));
        nodes.chain((0..).zip(&self.scene.lights).map(|(number, _)| Target::Light(number)))
    }

    /// Returns the name of a node or light, or its number.
    #[must_use]
    pub fn label(&self, target: Target) -> String {
        let (kind, number, name) = match target {
            Target::Node(node) => {
                let nodes = self.animation().map_or(&[][..], |animation| &animation.nodes);
                ("node", node, nodes.get(node as usize).map(|node| &node.name))
            }
            Target::Light(light) => ("light", light, self.scene.lights.get(light as usize).map(|light| &light.name)),
        };
        name.filter(|name| !name.is_empty()).cloned().unwrap_or_else(|| format!("{kind} {}", u64::from(number) + 1))
    }

    /// Returns the scene in a state.
    #[must_use]
    pub fn pose(&self, at: &SceneAt) -> Posed {
        let moment = self.scene.moment(at);
        let (pieces, lights) =
            moment.map_or_else(|| (Vec::new(), self.scene.lights.clone()), |moment| (moment.pieces, moment.lights));
        Posed { at: at.clone(), pieces, lights }
    }

    /// Returns the first surface that is drawn along `direction` from `from`, in the world.
    #[must_use]
    pub fn nearest(&self, from: DVec3, direction: DVec3, posed: &Posed) -> Option<Hit> {
        let own = self.animation().map(Animation::own_vertices).unwrap_or_default();
        let local = Ray { origin: from - self.scene.origin_m, direction };
        let mut nearest: Option<(f64, Option<usize>)> = None;
        for run in self.runs.get_or_init(|| runs_of(&self.scene)) {
            let limit = nearest.map_or(f64::INFINITY, |(distance, _)| distance);
            let distance = match run.piece {
                None => self.meet(run, &local, run.bounds, limit, |vertex| self.position(vertex), true),
                Some(piece) => {
                    let (Some(Some(placement)), Some(own)) = (posed.pieces.get(piece), own.get(piece)) else {
                        continue;
                    };
                    self.meet_piece(run, (from, direction), limit, (placement, own), piece)
                }
            };
            nearest = distance.map(|distance| (distance, run.piece)).or(nearest);
        }
        nearest.map(|(distance, piece)| Hit { distance, node: piece.and_then(|piece| self.editable_of(piece)) })
    }

    fn meet_piece(
        &self,
        run: &Run,
        (origin, direction): (DVec3, DVec3),
        limit: f64,
        (placement, own): (&Placement, &OwnVertices<'_>),
        piece: usize,
    ) -> Option<f64> {
        let first = self.animation()?.pieces.get(piece)?.first_vertex;
        if placement.is_deformed() {
            let local = Ray { origin: origin - self.scene.origin_m, direction };
            let corner = |vertex: u32| placement.vertex(own, (vertex - first) as usize).0;
            return self.meet(run, &local, placement.bounds, limit, corner, !placement.turned);
        }
        // Distances along a ray stay the same in the piece's own space. One that is flat has none.
        let piece_from_world = placement.world_from_piece.inverse();
        if !piece_from_world.is_finite() {
            return None;
        }
        let ray = Ray {
            origin: piece_from_world.transform_point3(origin),
            direction: piece_from_world.transform_vector3(direction),
        };
        let corner = |vertex: u32| own.positions.get((vertex - first) as usize).copied().unwrap_or_default();
        let mirrors = DMat3::from_mat4(placement.world_from_piece).determinant() < 0.0;
        self.meet(run, &ray, run.bounds, limit, corner, placement.turned == mirrors)
    }

    /// Returns how far the first triangle of a run is that is drawn, if it is nearer than `limit`. `as_given`: corners
    /// run as the scene lists them.
    fn meet(
        &self,
        run: &Run,
        ray: &Ray,
        bounds: Aabb,
        limit: f64,
        corner: impl Fn(u32) -> Vec3,
        as_given: bool,
    ) -> Option<f64> {
        let (min, max) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
        let slack = min.abs().max(max.abs()) * BOX_SLACK;
        if !ray.meets_box([min - slack, max + slack], limit) {
            return None;
        }
        let material = self.scene.materials.get(run.material as usize)?;
        let triangles = self.scene.triangles.get(run.first as usize..run.end as usize)?;
        let met = triangles.iter().filter_map(|corners| {
            let met = ray.meet(corners.map(|vertex| corner(vertex).as_dvec3()))?;
            let drawn = met.front == as_given || material.double_sided;
            (drawn && met.distance < limit && self.is_solid(run.material, corners, &met)).then_some(met.distance)
        });
        met.reduce(f64::min)
    }

    /// Whether a material has no hole there.
    fn is_solid(&self, material: u32, corners: &[u32; 3], met: &Met) -> bool {
        let Some(Some(picture)) = self.holes.get(material as usize) else { return true };
        let Some(material) = self.scene.materials.get(material as usize) else { return true };
        let (AlphaMode::Mask { cutoff }, Some(texture)) = (material.alpha, material.base_color_texture) else {
            return true;
        };
        let [a, b, c] = corners.map(|vertex| self.scene.uvs.get(vertex as usize).copied().unwrap_or_default());
        let [second, third] = met.weights;
        let place = a.as_dvec2() * (1.0 - second - third) + b.as_dvec2() * second + c.as_dvec2() * third;
        let alpha = texel(picture, place, (texture.wrap_u, texture.wrap_v));
        f32::from(alpha) / 255.0 * material.base_color.w >= cutoff
    }

    fn position(&self, vertex: u32) -> Vec3 {
        self.scene.positions.get(vertex as usize).copied().unwrap_or_default()
    }

    fn animation(&self) -> Option<&Animation> {
        self.scene.animation.as_deref()
    }

    /// The node that carries a piece: that of its first joint, if a skin bends it.
    fn carrier(&self, piece: usize) -> Option<u32> {
        let animation = self.animation()?;
        let joint = animation.shape_of(piece).and_then(|shape| shape.joints.first()).and_then(|joint| joint.node);
        joint.or_else(|| animation.pieces.get(piece).map(|piece| piece.node))
    }

    /// The node itself and those above it.
    fn line(&self, node: u32) -> impl Iterator<Item = u32> {
        let nodes = self.animation().map_or(&[][..], |animation| &animation.nodes);
        std::iter::successors(Some(node), |node| nodes.get(*node as usize)?.parent)
    }

    fn editable_of(&self, piece: usize) -> Option<u32> {
        let nodes = &self.animation()?.nodes;
        self.line(self.carrier(piece)?).find(|node| nodes.get(*node as usize).is_some_and(|node| node.editable))
    }

    /// Returns the next node above that may be edited.
    #[must_use]
    pub fn above(&self, node: u32) -> Option<u32> {
        let nodes = &self.animation()?.nodes;
        self.line(node).skip(1).find(|node| nodes.get(*node as usize).is_some_and(|node| node.editable))
    }

    /// Returns the corners, in the world, of a box around all that moves with a node and is shown; its sides are those
    /// of the node's own space. Bit 0 of a corner's number is along x, bit 1 along y, bit 2 along z. `None` if there is
    /// nothing, or the node is flat.
    #[must_use]
    pub fn outline(&self, node: u32, posed: &Posed) -> Option<[DVec3; 8]> {
        let world_from_node = self.scene.node_at(node, &posed.at)?.world_from_node();
        let node_from_world = world_from_node.inverse();
        let pieces = self.animation()?.pieces.iter().zip(&posed.pieces).enumerate();
        let mut bounds: Option<[DVec3; 2]> = None;
        for (number, (piece, placement)) in pieces {
            let Some(placement) = placement else { continue };
            if !self.carrier(number).is_some_and(|carrier| self.line(carrier).any(|above| above == node)) {
                continue;
            }
            for number in 0..8 {
                let there = if placement.is_deformed() {
                    corner_of(&placement.bounds, number) + self.scene.origin_m
                } else {
                    placement.world_from_piece.transform_point3(corner_of(&piece.bounds, number))
                };
                let there = node_from_world.transform_point3(there);
                let [min, max] = bounds.unwrap_or([there, there]);
                bounds = Some([min.min(there), max.max(there)]);
            }
        }
        let [min, max] = bounds.filter(|[min, max]| min.is_finite() && max.is_finite())?;
        let corner = |number: usize| {
            let pick = DVec3::from_array([0, 1, 2].map(|axis| f64::from(u8::from(number >> axis & 1 == 1))));
            world_from_node.transform_point3(min + (max - min) * pick)
        };
        Some(std::array::from_fn(corner))
    }
}

fn corner_of(bounds: &Aabb, number: usize) -> DVec3 {
    let pick = |axis: usize, low: f32, high: f32| if number >> axis & 1 == 1 { high } else { low };
    let (min, max) = (bounds.min, bounds.max);
    Vec3::new(pick(0, min.x, max.x), pick(1, min.y, max.y), pick(2, min.z, max.z)).as_dvec3()
}

fn runs_of(scene: &Scene) -> Vec<Run> {
    let animation = scene.animation.as_deref();
    let mut runs: Vec<Run> = Vec::new();
    let firsts = animation.map(Animation::first_positions).unwrap_or_default();
    for draw in &scene.draws {
        let mut current: Option<Run> = None;
        for number in draw.first_triangle..draw.first_triangle.saturating_add(draw.triangles) {
            let Some(corners) = scene.triangles.get(number as usize) else { break };
            // Neighbours mostly are of one piece, and its vertices follow each other.
            let pieces = animation.map_or(&[][..], |animation| &animation.pieces);
            let holds =
                |piece: usize| pieces.get(piece).is_some_and(|p| corners[0].wrapping_sub(p.first_vertex) < p.vertices);
            let same = current.as_ref().and_then(|run| run.piece).filter(|piece| holds(*piece));
            let piece = same.or_else(|| animation.and_then(|animation| animation.piece_of(corners[0])));
            let own = |vertex: u32| {
                let Some(piece) = piece else { return scene.positions.get(vertex as usize).copied() };
                let within = vertex.checked_sub(pieces.get(piece)?.first_vertex)? as usize;
                animation?.positions.get(firsts.get(piece)? + within).copied()
            };
            let [a, b, c] = corners.map(|vertex| own(vertex).unwrap_or_default());
            let fits = current.as_ref().is_some_and(|run| run.piece == piece && number - run.first < RUN);
            if !fits {
                let bounds = Aabb { min: a, max: a };
                let begun = Run { first: number, end: number, material: draw.material, piece, bounds };
                runs.extend(current.replace(begun));
            }
            if let Some(run) = &mut current {
                run.end = number + 1;
                run.bounds.min = run.bounds.min.min(a).min(b).min(c);
                run.bounds.max = run.bounds.max.max(a).max(b).max(c);
            }
        }
        runs.extend(current);
    }
    runs
}

/// Returns the nearest texel's alpha.
fn texel(picture: &AlphaPicture, place: DVec2, (wrap_u, wrap_v): (Wrap, Wrap)) -> u8 {
    let index = |along: f64, wrap: Wrap, side: u32| {
        let within = match wrap {
            Wrap::Repeat => along.rem_euclid(1.0),
            Wrap::ClampToEdge => along,
            Wrap::MirroredRepeat => 1.0 - (along.rem_euclid(2.0) - 1.0).abs(),
        };
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the picture")]
        let texel = (within * f64::from(side)).clamp(0.0, f64::from(side.max(1) - 1)) as usize;
        texel
    };
    let (x, y) = (index(place.x, wrap_u, picture.width), index(place.y, wrap_v, picture.height));
    picture.alpha.get(y * picture.width as usize + x).copied().unwrap_or(u8::MAX)
}
