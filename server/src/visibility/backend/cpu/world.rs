//! All data that tracing reads: geometry that rests, geometry that moves as it is at one time, and the lights.

use std::sync::{Arc, Mutex, PoisonError};

use glam::Vec3;
use gnomon_scene::{Aabb, AlphaMode, Animation, Light, Moment, Placement, Scene, SceneAt};
use rayon::iter::{
    IndexedParallelIterator, IntoParallelIterator, IntoParallelRefIterator, IntoParallelRefMutIterator,
    ParallelIterator,
};

use super::{
    alpha::Alpha,
    light::PreparedLight,
    surface::{AllCorners, Corners},
};
use crate::visibility::{
    backend::BackendError,
    hierarchy::{
        bvh::{TriangleFlags, WideBvh},
        moving::{Bounds, Forest},
    },
};

/// Vertices that a thread takes at once.
const RUN: usize = 512;

pub(super) struct World {
    pub(super) resting: Resting,
    moving: Option<Box<Moving>>,
    /// Without anything that moves.
    around: Around,
    bounds: Aabb,
    /// The scene's lights and origin alone.
    lights: Scene,
}

/// What never moves.
pub(super) struct Resting {
    pub(super) bvh: WideBvh,
    pub(super) corners: Vec<Corners>,
    pub(super) alpha: Alpha,
}

/// What moves, in its own spaces.
struct Moving {
    /// The scene's animation, lights and origin, without geometry.
    stage: Scene,
    alpha: Alpha,
    /// Moving triangles that stop rays, as indices into the animation's positions; the same of those that let light
    /// through, which only bound the scene.
    triangles: Vec<[u32; 3]>,
    through: Vec<[u32; 3]>,
    /// The piece of each of `triangles`.
    pieces: Vec<u32>,
    /// The end of each piece's vertices among the animation's.
    ends: Vec<usize>,
    /// The pieces' trees. Their triangles are indices into `triangles`.
    forest: Forest,
    spare: Arc<Spare>,
    /// Bounds of what rests, BLEND triangles too. `None` if nothing does.
    resting: Option<Bounds>,
}

/// Memory of frames that are done, for those that come: it is large, and new pages are slow.
type Spare = Mutex<Vec<Memory>>;

/// Most frames whose memory is kept.
const MOST_SPARE: usize = 2;

#[derive(Default)]
struct Memory {
    /// A copy of the forest, or nothing.
    bvh: WideBvh,
    corners: Vec<Corners>,
    vertices: Vec<(Vec3, Vec3)>,
}

/// What moves, as it is at one time.
pub struct Posed {
    memory: Memory,
    /// Where the memory goes afterwards.
    spare: Option<Arc<Spare>>,
    /// Triangles two of whose corners have changed places, by index. Empty if none has.
    turned: Vec<bool>,
    around: Around,
}

impl Drop for Posed {
    fn drop(&mut self) {
        let Some(spare) = &self.spare else { return };
        let mut spare = spare.lock().unwrap_or_else(PoisonError::into_inner);
        if spare.len() < MOST_SPARE {
            spare.push(std::mem::take(&mut self.memory));
        }
    }
}

/// Lights, and how large the scene is.
struct Around {
    lights: Vec<PreparedLight>,
    /// The origin of parallel rays: the middle of the scene.
    middle: Vec3,
    /// Bound on the distance of scene coordinates from the middle, even when sheared.
    size_m: f32,
}

/// A tree, and what its triangles are.
#[derive(Clone, Copy)]
pub(super) struct Geometry<'a> {
    pub(super) bvh: &'a WideBvh,
    pub(super) corners: &'a [Corners],
    pub(super) alpha: &'a Alpha,
    /// Index of the first triangle among all.
    pub(super) first: u32,
    /// See [`Posed::turned`].
    turned: &'a [bool],
}

impl Geometry<'_> {
    /// Returns whether corners 1 and 2 of a triangle have changed places.
    #[inline(always)]
    pub(super) fn is_turned(&self, triangle: u32) -> bool {
        self.turned.get(triangle as usize) == Some(&true)
    }
}

/// Everything at one time.
#[derive(Clone, Copy)]
pub(super) struct Stage<'a> {
    pub(super) resting: Geometry<'a>,
    pub(super) moving: Option<Geometry<'a>>,
    pub(super) lights: &'a [PreparedLight],
    pub(super) middle: Vec3,
    pub(super) size_m: f32,
}

impl<'a> Stage<'a> {
    /// What rests, and then what moves.
    #[inline(always)]
    pub(super) fn geometries(&self) -> impl Iterator<Item = Geometry<'a>> + use<'a> {
        [Some(self.resting), self.moving].into_iter().flatten()
    }

    pub(super) fn corners(&self) -> AllCorners<'a> {
        let moving = self.moving.map_or(&[][..], |moving| moving.corners);
        AllCorners { resting: self.resting.corners, moving }
    }
}

impl Around {
    fn new(lights: &[Light], Aabb { min, max }: Aabb) -> Self {
        let middle = (min + max) * 0.5;
        let size_m = (max - min).max_element() * 2.0;
        let lights = lights.iter().map(|light| PreparedLight::new(light, middle, size_m)).collect();
        Self { lights, middle, size_m }
    }
}

impl World {
    /// Builds the trees on the current rayon pool. Errors if the alpha picture of a MASK material is not decoded.
    pub(super) fn new(scene: &Scene) -> Result<Self, BackendError> {
        let rests = |corners: &[u32; 3]| !moves(scene, corners);
        let (flags, all) = (triangle_flags(scene), scene.tracing_triangles());
        let (triangles, flags): (Vec<[u32; 3]>, Vec<TriangleFlags>) =
            all.iter().zip(flags).filter(|(corners, _)| rests(corners)).unzip();
        let resting = Resting {
            bvh: WideBvh::build(&scene.positions, &triangles, &|t| flags[t as usize]),
            corners: Corners::of(scene, &triangles),
            alpha: Alpha::new(scene, &rests)?,
        };
        let moving = if scene.animation.is_some() { Some(Box::new(Moving::new(scene)?)) } else { None };
        let lights = Scene { lights: scene.lights.clone(), origin_m: scene.origin_m, ..Scene::default() };
        let (around, bounds) = (Around::new(&scene.lights, scene.bounds), scene.bounds);
        Ok(Self { resting, moving, around, bounds, lights })
    }

    pub(super) fn lights(&self) -> usize {
        self.around.lights.len()
    }

    pub(super) fn memory_bytes(&self) -> usize {
        let Resting { bvh, corners, alpha } = &self.resting;
        let moving = self.moving.iter().map(|moving| moving.memory_bytes()).sum::<usize>();
        bvh.memory_bytes() + size_of_val(&**corners) + alpha.memory_bytes() + moving
    }

    /// Puts what moves or was edited where it is, on the current rayon pool. `None` if all is as in the file.
    pub(super) fn pose(&self, at: &SceneAt) -> Option<Posed> {
        match &self.moving {
            Some(moving) => Some(moving.pose(at)),
            None => self.lights.moment(at).map(|moment| self.lit(&moment.lights)),
        }
    }

    /// Where nothing moves, lights are all that may be edited.
    fn lit(&self, lights: &[Light]) -> Posed {
        let around = Around::new(lights, self.bounds);
        Posed { memory: Memory::default(), spare: None, turned: Vec::new(), around }
    }

    /// Returns everything at the time of `posed`.
    pub(super) fn stage<'a>(&'a self, posed: Option<&'a Posed>) -> Stage<'a> {
        let Resting { bvh, corners, alpha } = &self.resting;
        let resting = Geometry { bvh, corners, alpha, first: 0, turned: &[] };
        // Fewer than 2^31 triangles: see `MAX_TRIANGLES`.
        let first = u32::try_from(corners.len()).unwrap_or(u32::MAX);
        let moving = posed.zip(self.moving.as_ref()).map(|(posed, moving)| {
            let Posed { memory: Memory { bvh, corners, .. }, turned, .. } = posed;
            Geometry { bvh, corners, alpha: &moving.alpha, first, turned }
        });
        let Around { lights, middle, size_m } = posed.map_or(&self.around, |posed| &posed.around);
        Stage { resting, moving, lights, middle: *middle, size_m: *size_m }
    }
}

impl Moving {
    fn new(scene: &Scene) -> Result<Self, BackendError> {
        let alpha = Alpha::new(scene, &|corners| moves(scene, corners))?;
        let animation = scene.animation.clone().unwrap_or_default();
        let firsts = animation.first_positions();
        let own = |corners: &[u32; 3]| {
            let piece = animation.piece_of(corners[0])?;
            let (first, before) = (firsts.get(piece)?, animation.pieces.get(piece)?.first_vertex);
            // Moving vertices are at most as many as the scene's, whose number fits.
            let index = |corner: u32| u32::try_from(first + (corner - before) as usize).unwrap_or(u32::MAX);
            Some((piece, corners.map(index)))
        };
        let (flags, all) = (triangle_flags(scene), scene.tracing_triangles());
        let (mut triangles, mut of_pieces) = (Vec::new(), vec![Vec::new(); animation.pieces.len()]);
        for (corners, flags) in all.iter().zip(flags) {
            if let Some((piece, corners)) = own(corners) {
                of_pieces[piece].push((triangles.len(), corners, flags));
                triangles.push(corners);
            }
        }
        let through = scene.triangles[all.len()..].iter().filter_map(|corners| Some(own(corners)?.1)).collect();
        let build = |members: Vec<(usize, [u32; 3], TriangleFlags)>| {
            let (corners, flags): (Vec<[u32; 3]>, Vec<TriangleFlags>) =
                members.iter().map(|(_, corners, flags)| (*corners, *flags)).unzip();
            let mut bvh = WideBvh::build(&animation.positions, &corners, &|t| flags[t as usize]);
            for triangle in bvh.leaves.iter_mut().flat_map(|leaf| &mut leaf.triangles) {
                let index = members.get(*triangle as usize).map_or(0, |(index, ..)| *index);
                *triangle = u32::try_from(index).unwrap_or(u32::MAX);
            }
            bvh
        };
        let mut pieces = vec![0; triangles.len()];
        for (number, members) in (0..).zip(&of_pieces) {
            members.iter().for_each(|(triangle, ..)| pieces[*triangle] = number);
        }
        let forest = Forest::new(of_pieces.into_iter().map(build).collect());
        let vertices = animation.pieces.iter().map(|piece| piece.vertices as usize);
        let ends = firsts.iter().zip(vertices).map(|(first, vertices)| first + vertices).collect();
        let corners = scene.triangles.iter().filter(|corners| !moves(scene, corners)).flatten();
        let mut positions = corners.map(|corner| scene.positions[*corner as usize]);
        let resting = positions
            .next()
            .map(|first| positions.fold([first; 2], |[min, max], position| [min.min(position), max.max(position)]));
        let (lights, origin_m) = (scene.lights.clone(), scene.origin_m);
        let stage = Scene { animation: Some(animation), lights, origin_m, ..Scene::default() };
        let spare = Arc::default();
        Ok(Self { stage, alpha, triangles, through, pieces, ends, forest, spare, resting })
    }

    fn memory_bytes(&self) -> usize {
        let animation = self.stage.animation.iter();
        let vertices = animation.map(|animation| {
            let shapes = size_of_val(&*animation.influences) + size_of_val(&*animation.deltas);
            size_of_val(&*animation.positions) * 2 + shapes
        });
        let vertices = vertices.sum::<usize>();
        let triangles = self.triangles.len() * size_of::<([u32; 3], u32)>();
        let moved = self.ends.last().map_or(0, |vertices| vertices * size_of::<(Vec3, Vec3)>());
        let posed = self.forest.memory_bytes() + self.triangles.len() * size_of::<Corners>() + moved;
        self.alpha.memory_bytes() + vertices + triangles + self.forest.memory_bytes() + posed
    }

    fn pose(&self, at: &SceneAt) -> Posed {
        let nothing = || Moment { pieces: Vec::new(), lights: Vec::new() };
        let Moment { pieces: placements, lights } = self.stage.moment(at).unwrap_or_else(nothing);
        let mut memory = self.spare.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default();
        let Memory { bvh, corners, vertices } = &mut memory;
        if bvh.nodes.is_empty() {
            *bvh = self.forest.copy();
        }
        self.move_vertices(&placements, vertices);
        let placement_of = |piece: u32| placements.get(piece as usize)?.as_ref();
        let placed = |(corners, piece): (&[u32; 3], &u32)| {
            let [a, b, c] = corners.map(|corner| vertices[corner as usize]);
            let [a, b, c] = placement_of(*piece).map(|it| it.corners([a, b, c])).unwrap_or_default();
            Corners::new([a.0, b.0, c.0], [a.1, b.1, c.1])
        };
        self.triangles.par_iter().zip(&self.pieces).with_min_len(RUN).map(placed).collect_into_vec(corners);
        let any = placements.iter().flatten().any(|placement| placement.turned);
        let is_turned = |piece: &u32| placement_of(*piece).is_some_and(|placement| placement.turned);
        let turned = if any { self.pieces.iter().map(is_turned).collect() } else { Vec::new() };
        let shown = |piece: usize| placements.get(piece).is_some_and(Option::is_some);
        let moved = self.forest.refit(bvh, shown, |triangle| corners[triangle as usize].placed());
        let through = self.through.iter().filter(|corners| shown(self.piece_of(corners[0])));
        let through = through.map(|corners| {
            let [a, b, c] = corners.map(|corner| vertices[corner as usize].0);
            [a.min(b).min(c), a.max(b).max(c)]
        });
        let all = self.resting.into_iter().chain(moved).chain(through);
        let bounds = all.reduce(|one, other| [one[0].min(other[0]), one[1].max(other[1])]);
        let [min, max] = bounds.unwrap_or_default();
        Posed { memory, spare: Some(Arc::clone(&self.spare)), turned, around: Around::new(&lights, Aabb { min, max }) }
    }

    /// Puts each piece's vertices, in the order of the pieces, where they are. Those that are not shown stay where
    /// another frame had them.
    fn move_vertices(&self, placements: &[Option<Placement>], vertices: &mut Vec<(Vec3, Vec3)>) {
        vertices.resize(self.ends.last().copied().unwrap_or(0), (Vec3::ZERO, Vec3::Y));
        let own = self.stage.animation.as_deref().map(Animation::own_vertices).unwrap_or_default();
        let mut left = &mut vertices[..];
        let each = own.into_iter().zip(placements).filter_map(|(own, placement)| {
            let of_piece = left.split_off_mut(..own.positions.len())?;
            Some((own, placement.as_ref()?, of_piece))
        });
        each.collect::<Vec<_>>().into_par_iter().for_each(|(own, placement, of_piece)| {
            let moved = of_piece.par_iter_mut().with_min_len(RUN).enumerate();
            moved.for_each(|(at, vertex)| *vertex = placement.vertex(&own, at));
        });
    }

    fn piece_of(&self, vertex: u32) -> usize {
        self.ends.partition_point(|end| *end <= vertex as usize)
    }
}

/// Returns whether a triangle moves.
fn moves(scene: &Scene, corners: &[u32; 3]) -> bool {
    scene.animation.as_ref().is_some_and(|animation| animation.piece_of(corners[0]).is_some())
}

/// How each triangle's material treats rays.
fn triangle_flags(scene: &Scene) -> Vec<TriangleFlags> {
    let vertex_alpha = scene.vertex_alpha_materials();
    let mut flags = Vec::with_capacity(scene.tracing_triangles().len());
    for draw in &scene.draws {
        let material = &scene.materials[draw.material as usize];
        if material.alpha == AlphaMode::Blend {
            break;
        }
        // Without a picture or vertices that are see-through alpha is constant: a triangle that passes needs no test.
        let varies = material.base_color_texture.is_some()
            || vertex_alpha.get(draw.material as usize).is_some_and(|counts| *counts);
        let masked = matches!(material.alpha, AlphaMode::Mask { cutoff } if varies || material.base_color.w < cutoff);
        let of_draw = TriangleFlags { single_sided: !material.double_sided, masked };
        flags.extend(std::iter::repeat_n(of_draw, draw.triangles as usize));
    }
    flags
}
