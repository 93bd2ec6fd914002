//! A scene at one time: where its pieces are, and how its lights and cameras are (`docs/living.md`).
//!
//! This is the only place that evaluates an animation. Server and client both use it, in f64.

mod deform;
mod node;

use std::{
    borrow::Cow,
    f64::consts::{FRAC_PI_2, PI},
};

use glam::{BVec3, DMat3, DMat4, DQuat, DVec3, DVec4, Vec3, Vec4};
use rayon::iter::{IndexedParallelIterator as _, IntoParallelRefIterator as _, ParallelIterator as _};

use self::deform::Form;
pub use self::node::NodeAt;
use crate::{
    Aabb, AnimatedCamera, AnimatedLight, AnimatedNode, Animation, Draw, Image, Light, LightKind, NamedCamera, NodeEdit,
    OwnVertices, Piece, Place, Scene, SceneAt, Track,
    light::f32_of,
    limits::in_reach,
    scene::normals::{normal_matrix, triangle_normal},
};

/// What moves or was edited in a scene, at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct Moment {
    /// One for each piece of the animation. `None`: it is not shown, or lies out of reach. Empty without an animation.
    pub pieces: Vec<Option<Placement>>,
    /// All lights of the scene. One that is not shown is off.
    pub lights: Vec<Light>,
}

/// Where a piece is, and which shape it has. [`Self::vertex`] says where its vertices are.
#[derive(Debug, Clone, PartialEq)]
pub struct Placement {
    /// Transform from the piece's space to the world's. Joints count instead where it has them.
    pub world_from_piece: DMat4,
    /// The scene's origin, in metres.
    pub origin_m: DVec3,
    /// Bounds around it in the scene's local space. It may be smaller.
    pub bounds: Aabb,
    /// The piece is inside out, compared with the pose of the file: two corners of each triangle change places.
    pub turned: bool,
    /// Takes normals to the world, up to their length.
    normals: DMat3,
    /// −1 if the transform mirrors.
    hand: f32,
    /// `None` if the piece is rigid.
    form: Option<Box<Form>>,
}

impl Placement {
    /// Whether the piece has a shape of this time.
    #[must_use]
    pub fn is_deformed(&self) -> bool {
        self.form.is_some()
    }

    /// Whether tangents change hands.
    #[must_use]
    pub fn is_mirrored(&self) -> bool {
        self.hand < 0.0
    }

    /// Returns the transforms of the piece's positions to the world, and of its normals, up to their length. Joints
    /// count instead where it has them.
    #[must_use]
    pub fn transforms(&self) -> (&DMat4, &DMat3) {
        (&self.world_from_piece, &self.normals)
    }

    /// Returns the world's transforms of the piece's joints. Empty without a skin.
    #[must_use]
    pub fn joints(&self) -> &[DMat4] {
        self.form.as_ref().map_or(&[], |form| form.joints())
    }

    /// Returns the morph targets that count, with their weights.
    #[must_use]
    pub fn targets(&self) -> &[(usize, f64)] {
        self.form.as_ref().map_or(&[], |form| form.targets())
    }

    /// Returns where one of the piece's vertices is in the scene's local space, and its unit normal.
    #[must_use]
    pub fn vertex(&self, own: &OwnVertices<'_>, vertex: usize) -> (Vec3, Vec3) {
        let [position, normal] = [own.positions, own.normals].map(|list| list.get(vertex).copied().unwrap_or_default());
        let Some(form) = &self.form else { return (self.position(position), self.normal(normal)) };
        let reshaped = |vertex: usize| {
            let (there, turned) = form.vertex(own, vertex, (&self.world_from_piece, &self.normals));
            ((there - self.origin_m).as_vec3(), turned)
        };
        if !own.shape.is_some_and(|shape| shape.flat) {
            let (there, turned) = reshaped(vertex);
            return (there, turned.map_or(normal, |turned| turned.as_vec3().normalize()));
        }
        let corners = [0, 1, 2].map(|corner| reshaped(vertex - vertex % 3 + corner).0);
        let [a, b, c] = self.corners(corners);
        let flat = triangle_normal(a, b, c).map_or(normal, |flat| flat.as_vec3().normalize());
        (corners[vertex % 3], flat)
    }

    /// Returns the corners of a box around the piece in the scene's local space. `own` has its vertices in their own
    /// space. The box of a rigid piece turns with it.
    #[must_use]
    pub fn box_around(&self, own: &Aabb) -> [Vec3; 8] {
        let Aabb { min, max } = if self.is_deformed() { &self.bounds } else { own };
        std::array::from_fn(|number| {
            let corner = Vec3::select(BVec3::new(number & 1 == 1, number & 2 == 2, number & 4 == 4), *max, *min);
            if self.is_deformed() { corner } else { self.position(corner) }
        })
    }

    /// Returns a vertex's tangent, as [`Scene::tangents`] has it.
    #[must_use]
    pub fn tangent_of(&self, own: &OwnVertices<'_>, vertex: usize) -> Vec4 {
        let tangent = own.tangents.get(vertex).copied().unwrap_or_default();
        let Some(form) = &self.form else { return self.tangent(tangent) };
        let turned = form.tangent(own, vertex, &self.world_from_piece);
        turned.map_or(Vec4::ZERO, |turned| turned.as_vec3().normalize().extend(tangent.w * self.hand))
    }

    /// Returns a position in the scene's local space. It is rounded once, as those of what rests are.
    fn position(&self, position: Vec3) -> Vec3 {
        (self.world_from_piece.transform_point3(position.as_dvec3()) - self.origin_m).as_vec3()
    }

    /// Returns a unit normal. A transform that flattens the piece may leave none: then it stays as it is.
    fn normal(&self, normal: Vec3) -> Vec3 {
        let turned = (self.normals * normal.as_dvec3()).try_normalize();
        turned.map_or(normal, |turned| turned.as_vec3().normalize())
    }

    /// Returns a tangent as [`Scene::tangents`] has it.
    fn tangent(&self, tangent: Vec4) -> Vec4 {
        let turned = self.world_from_piece.transform_vector3(tangent.truncate().as_dvec3()).try_normalize();
        turned.map_or(Vec4::ZERO, |turned| turned.as_vec3().normalize().extend(tangent.w * self.hand))
    }

    /// Returns a triangle's corners, counter-clockwise seen from the front.
    #[must_use]
    pub fn corners<T>(&self, [a, b, c]: [T; 3]) -> [T; 3] {
        if self.turned { [a, c, b] } else { [a, b, c] }
    }
}

/// Nodes or pieces that a thread takes at once.
const RUN: usize = 32;

/// A node at one time.
#[derive(Clone, Copy)]
struct World {
    world_from_node: DMat4,
    visible: bool,
}

/// When to look at an animation.
#[derive(Clone, Copy)]
enum When<'a> {
    /// In the file's pose, without any track or edit.
    File,
    At(&'a SceneAt),
}

impl When<'_> {
    fn time_s(self) -> Option<f64> {
        match self {
            Self::File => None,
            Self::At(at) => Some(at.time_s),
        }
    }

    fn sample<const N: usize>(self, track: Option<&Track>) -> Option<[f64; N]> {
        match self {
            Self::File => None,
            Self::At(at) => track.map(|track| track.sample(at.time_s)),
        }
    }

    fn edit(self, node: usize) -> NodeEdit {
        match self {
            Self::File => NodeEdit::default(),
            // There are fewer nodes than 2³².
            Self::At(at) => at.edits.node(u32::try_from(node).unwrap_or(u32::MAX)),
        }
    }
}

impl Scene {
    /// Returns what moves or was edited, at a time in seconds. `None` if everything is as in the file.
    #[must_use]
    pub fn moment(&self, at: impl Into<SceneAt>) -> Option<Moment> {
        let at = at.into();
        (!self.rests(&at)).then(|| self.moment_of(When::At(&at)))
    }

    /// Returns what may move or be edited, in the pose of the file.
    #[must_use]
    pub fn moment_at_rest(&self) -> Moment {
        self.moment_of(When::File)
    }

    /// Returns the cameras at a time in seconds.
    #[must_use]
    pub fn cameras_at(&self, at: impl Into<SceneAt>) -> Vec<NamedCamera> {
        self.cameras_of(&at.into())
    }

    fn cameras_of(&self, at: &SceneAt) -> Vec<NamedCamera> {
        let mut cameras = self.cameras.clone();
        let Some(animation) = &self.animation else { return cameras };
        let when = When::At(at);
        let worlds = worlds(animation, when);
        for moving in &animation.cameras {
            if let Some(camera) = cameras.get_mut(moving.camera as usize) {
                move_camera(camera, moving, &worlds, when);
            }
        }
        cameras
    }

    /// Returns the scene as it stands at a time in seconds: one in which everything rests. It may have no triangles.
    #[must_use]
    pub fn still_at(&self, at: impl Into<SceneAt>) -> Self {
        self.still(self.images.clone(), When::At(&at.into()))
    }

    /// Returns the scene as [`Self::still_at`] does, for those who read no pictures: a copy has none. There is no copy
    /// if everything rests.
    #[must_use]
    pub fn bare_at(&self, at: impl Into<SceneAt>) -> Cow<'_, Self> {
        let at = at.into();
        if self.rests(&at) {
            return Cow::Borrowed(self);
        }
        Cow::Owned(self.still(Vec::new(), When::At(&at)))
    }

    /// Returns the scene in the pose of the file: one in which everything rests. It may have no triangles.
    #[must_use]
    pub fn at_rest(&self) -> Self {
        self.still(self.images.clone(), When::File)
    }

    fn rests(&self, at: &SceneAt) -> bool {
        self.animation.is_none() && at.edits.is_empty()
    }

    fn moment_of(&self, when: When<'_>) -> Moment {
        let none = Animation::default();
        let animation = self.animation.as_deref().unwrap_or(&none);
        let worlds = worlds(animation, when);
        let pieces = animation.pieces.par_iter().zip(animation.own_vertices()).with_min_len(RUN);
        let pieces = pieces.map(|(piece, own)| placement((piece, &own), &worlds, self.origin_m, when)).collect();
        let mut lights = self.lights.clone();
        let mut off = Vec::new();
        for moving in &animation.lights {
            if let Some(light) = lights.get_mut(moving.light as usize)
                && !move_light(light, moving, &worlds, self.origin_m, when)
            {
                off.push(moving.light);
            }
        }
        if let When::At(at) = when {
            for (number, edit) in at.edits.lights() {
                if let Some(light) = lights.get_mut(number as usize) {
                    edit.apply(light, self.origin_m);
                }
            }
        }
        for number in off {
            if let Some(light) = lights.get_mut(number as usize) {
                light.intensity = 0.0;
            }
        }
        Moment { pieces, lights }
    }

    fn still(&self, images: Vec<Image>, when: When<'_>) -> Self {
        // Field by field: pictures and animations are large.
        let mut scene = Self {
            origin_m: self.origin_m,
            bounds: self.bounds,
            positions: self.positions.clone(),
            normals: self.normals.clone(),
            uvs: self.uvs.clone(),
            uvs_1: self.uvs_1.clone(),
            tangents: self.tangents.clone(),
            colors: self.colors.clone(),
            triangles: self.triangles.clone(),
            draws: self.draws.clone(),
            materials: self.materials.clone(),
            images,
            lights: self.lights.clone(),
            cameras: self.cameras.clone(),
            instances: self.instances,
            animation: None,
        };
        let moment = self.moment_of(when);
        scene.lights = moment.lights;
        let Some(animation) = &self.animation else { return scene };
        if let When::At(at) = when {
            scene.cameras = self.cameras_of(at);
        }
        let pieces = animation.pieces.iter().zip(animation.own_vertices());
        for ((piece, own), placement) in pieces.zip(&moment.pieces) {
            let Some(placement) = placement else { continue };
            for from in 0..own.positions.len() {
                let to = piece.first_vertex as usize + from;
                let (position, normal) = placement.vertex(&own, from);
                set(&mut scene.positions, to, Some(position));
                set(&mut scene.normals, to, Some(normal));
                set(&mut scene.tangents, to, (!own.tangents.is_empty()).then(|| placement.tangent_of(&own, from)));
            }
        }
        let (mut triangles, mut draws) = (Vec::with_capacity(scene.triangles.len()), Vec::new());
        for draw in &scene.draws {
            let first_triangle = triangles.len();
            let of_draw = draw.first_triangle as usize..(draw.first_triangle + draw.triangles) as usize;
            for corners in scene.triangles.get(of_draw).unwrap_or_default() {
                let corners = match animation.piece_of(corners[0]).map(|piece| moment.pieces.get(piece)) {
                    Some(Some(Some(placement))) => placement.corners(*corners),
                    Some(_) => continue,
                    None => *corners,
                };
                let [a, b, c] = corners.map(|corner| scene.positions.get(corner as usize).copied().unwrap_or_default());
                if triangle_normal(a, b, c).is_some() {
                    triangles.push(corners);
                }
            }
            if triangles.len() > first_triangle {
                // Both are below the numbers that the scene's own triangles have.
                let [first_triangle, end] =
                    [first_triangle, triangles.len()].map(|count| u32::try_from(count).unwrap_or(u32::MAX));
                draws.push(Draw { first_triangle, triangles: end - first_triangle, material: draw.material });
            }
        }
        (scene.triangles, scene.draws) = (triangles, draws);
        scene.bounds = Aabb::of(&scene);
        scene
    }
}

fn set<T>(list: &mut [T], at: usize, value: Option<T>) {
    if let (Some(place), Some(value)) = (list.get_mut(at), value) {
        *place = value;
    }
}

/// Returns the animated nodes' transforms. Parents come first.
fn worlds(animation: &Animation, when: When<'_>) -> Vec<World> {
    let of_node = |(number, node): (usize, &AnimatedNode)| {
        let edit = when.edit(number);
        (own(node, &edit, when), edit.shown.unwrap_or_else(|| shown(node, when)))
    };
    let all: Vec<(DMat4, bool)> = animation.nodes.par_iter().enumerate().with_min_len(RUN).map(of_node).collect();
    let mut worlds: Vec<World> = Vec::with_capacity(animation.nodes.len());
    for (node, (own, shown)) in animation.nodes.iter().zip(all) {
        let above = node.parent.and_then(|parent| worlds.get(parent as usize).copied());
        let above = above.unwrap_or(World { world_from_node: DMat4::IDENTITY, visible: true });
        worlds
            .push(World { world_from_node: above.world_from_node * node.above * own, visible: above.visible && shown });
    }
    worlds
}

/// Whether a node is shown, unless it is edited.
fn shown(node: &AnimatedNode, when: When<'_>) -> bool {
    when.sample::<1>(node.visible_track.as_ref()).map_or(node.visible, |[shown]| shown != 0.0)
}

/// Returns scale, rotation and translation of a node's own transform.
fn parts(node: &AnimatedNode, edit: &NodeEdit, when: When<'_>) -> (DVec3, DQuat, DVec3) {
    let vector = |track: &Option<Track>, fixed| when.sample(track.as_ref()).map_or(fixed, DVec3::from_array);
    let rotation = match (when, &node.rotation_track) {
        (When::At(at), Some(track)) => track.rotation(at.time_s),
        _ => node.rotation,
    };
    let (scale, translation_m) =
        (vector(&node.scale_track, node.scale), vector(&node.translation_track, node.translation_m));
    (
        edit.scale.unwrap_or(scale),
        edit.rotation.map_or(rotation, DQuat::normalize),
        edit.translation_m.unwrap_or(translation_m),
    )
}

fn own(node: &AnimatedNode, edit: &NodeEdit, when: When<'_>) -> DMat4 {
    let (scale, rotation, translation_m) = parts(node, edit, when);
    DMat4::from_scale_rotation_translation(scale, rotation, translation_m)
}

fn placement(
    (piece, own): (&Piece, &OwnVertices<'_>),
    worlds: &[World],
    origin_m: DVec3,
    when: When<'_>,
) -> Option<Placement> {
    let world = worlds.get(piece.node as usize).filter(|world| world.visible)?;
    let world_from_node = |node: u32| worlds.get(node as usize).map(|world| world.world_from_node);
    let form = own.shape.map(|shape| Form::of(shape, world_from_node, when.time_s()));
    let (world_from_piece, bounds) = match own.shape.zip(form.as_ref()) {
        Some((shape, form)) => {
            let world_from_own = world.world_from_node * shape.node_from_own;
            (world_from_own, form.bounds(shape, piece.bounds, &world_from_own)?)
        }
        None => {
            let own = [piece.bounds.min, piece.bounds.max].map(Vec3::as_dvec3);
            (world.world_from_node, deform::bounds(own, &world.world_from_node)?)
        }
    };
    let [min, max] = bounds.map(|corner| (corner - origin_m).as_vec3());
    let linear = DMat3::from_mat4(world_from_piece);
    let skin_mirrors = form.as_ref().and_then(|form| form.mirrors(own));
    let mirrors = skin_mirrors.unwrap_or_else(|| linear.determinant() < 0.0);
    Some(Placement {
        world_from_piece,
        origin_m,
        bounds: Aabb { min, max },
        turned: mirrors != piece.mirrored,
        normals: normal_matrix(&linear),
        hand: if mirrors { -1.0 } else { 1.0 },
        form: form.map(Box::new),
    })
}

/// Where something on a node is, and whether it is shown. `None` if it lies nowhere.
fn hung(place: &Place, worlds: &[World]) -> Option<(DMat4, bool)> {
    let world = worlds.get(place.node as usize)?;
    let there = world.world_from_node * place.node_from_own;
    (there.is_finite() && in_reach(there.w_axis.truncate())).then_some((there, world.visible))
}

/// Returns whether the light is shown.
fn move_light(light: &mut Light, moving: &AnimatedLight, worlds: &[World], origin_m: DVec3, when: When<'_>) -> bool {
    let positive = |track: &Option<Track>| when.sample::<1>(track.as_ref()).map(|[v]| f32_of(v.clamp(0.0, MOST)));
    if let Some(color) = when.sample::<3>(moving.color_track.as_ref()) {
        light.color = Vec3::from_array(color.map(|v| f32_of(v.clamp(0.0, MOST))));
    }
    light.intensity = positive(&moving.intensity_track).unwrap_or(light.intensity);
    if let Some(range_m) = positive(&moving.range_track).filter(|_| light.kind != LightKind::Directional) {
        light.range_m = if range_m > 0.0 { range_m } else { f32::INFINITY };
    }
    if let LightKind::Spot { inner_cone_rad, outer_cone_rad } = &mut light.kind {
        let angle =
            |track: &Option<Track>| when.sample::<1>(track.as_ref()).map(|[angle]| f32_of(angle.clamp(0.0, FRAC_PI_2)));
        *outer_cone_rad = angle(&moving.outer_cone_track).unwrap_or(*outer_cone_rad);
        *inner_cone_rad = angle(&moving.inner_cone_track).unwrap_or(*inner_cone_rad).min(*outer_cone_rad);
    }
    let Some(place) = &moving.place else { return true };
    let Some((there, visible)) = hung(place, worlds) else { return false };
    if light.kind != LightKind::Directional {
        light.position = (there.w_axis.truncate() - origin_m).as_vec3();
    }
    if light.kind != LightKind::Point {
        // Under a scale of 0 the axis has no length: the light keeps the file's.
        let axis = there.transform_vector3(DVec3::NEG_Z).try_normalize();
        light.direction = axis.map_or(light.direction, |axis| axis.as_vec3().normalize());
    }
    visible
}

/// Largest value of a light, which becomes an f32.
const MOST: f64 = f32::MAX as f64;

fn move_camera(camera: &mut NamedCamera, moving: &AnimatedCamera, worlds: &[World], when: When<'_>) {
    let zoomed = when.sample::<1>(moving.yfov_track.as_ref()).map(|[yfov]| yfov);
    camera.yfov_rad = zoomed.filter(|yfov| *yfov > 0.0 && *yfov < PI).unwrap_or(camera.yfov_rad);
    let Some((there, _)) = moving.place.as_ref().and_then(|place| hung(place, worlds)) else { return };
    camera.position_m = there.w_axis.truncate();
    let [y, z] = [there.y_axis, there.z_axis].map(DVec4::truncate);
    camera.orientation = orthonormal(y, z).unwrap_or(camera.orientation);
}

/// Returns the rotation whose third axis is `z` and whose second lies as near to `y` as it can. `None` if the vectors
/// have no length, or one direction.
pub(crate) fn orthonormal(y: DVec3, z: DVec3) -> Option<DQuat> {
    let z = z.try_normalize()?;
    let x = y.try_normalize()?.cross(z).try_normalize()?;
    Some(DQuat::from_mat3(&DMat3::from_cols(x, z.cross(x), z)).normalize())
}
