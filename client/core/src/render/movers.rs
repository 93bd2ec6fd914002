//! What moves, on the adapter: its vertices and corners are written anew for each state of the scene, as the scene has
//! them that stands still then (`shaders/scene/docs/living.md`). Passes see ordinary triangles.

use glam::{DMat4, DVec3, DVec4, Vec3};
use gnomon_scene::{Aabb, Animation, Light, Moment, OwnVertices, Placement, Scene, SceneAt};
use gnomon_shaders::shading::Before;
use rayon::prelude::*;
use wgpu::util::DeviceExt as _;

use super::vertex::{MoreOfVertex, Vertex};

/// Vertices that a thread takes at once.
const RUN: usize = 512;

#[derive(Debug)]
pub(crate) struct Movers {
    /// The scene without what rests.
    stage: Scene,
    /// Where each piece's vertices begin in the lists below.
    firsts: Vec<usize>,
    /// In the pose of the file, piece by piece.
    vertices: Vec<Vertex>,
    /// Empty if nothing more of them turns.
    more: Vec<MoreOfVertex>,
    /// The pieces' vertices in the scene's buffers, in the order of the pieces.
    vertex_runs: Vec<VertexRun>,
    triangle_runs: Vec<TriangleRun>,
    now: Posed,
    /// The last other state that was drawn: that of a late mask.
    other: Option<Posed>,
    /// State of the vertices that the buffers hold once all that was encoded has run. `None`: those of the file.
    written_at: Option<SceneAt>,
    /// How the corners are that they hold then, one for each piece.
    written: Vec<Corners>,
    /// Bytes that were copied into the buffers so far.
    pub(crate) copied_bytes: u64,
}

/// What moves or was edited, in one state of the scene.
#[derive(Debug)]
struct Posed {
    /// `None` until there is one.
    scene: Option<SceneAt>,
    moment: Moment,
    vertices: Vec<Vertex>,
    more: Vec<MoreOfVertex>,
    /// What each piece's vertices lie within. `None`: it is not shown.
    bounds: Vec<Option<Aabb>>,
    /// Both lists on the adapter, once they were needed there.
    staged: Option<[wgpu::Buffer; 2]>,
}

/// Vertices that follow each other, also in [`Movers::vertices`].
#[derive(Debug, Clone, Copy)]
struct VertexRun {
    first: u32,
    count: u32,
}

/// Triangles of one piece that follow each other.
#[derive(Debug)]
struct TriangleRun {
    first: u32,
    piece: usize,
    corners: Vec<[u32; 3]>,
}

/// How the corners of a piece's triangles are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Corners {
    AsInFile,
    Turned,
    /// Nothing is drawn.
    Hidden,
}

impl Corners {
    fn of(placement: Option<&Placement>) -> Self {
        match placement {
            None => Self::Hidden,
            Some(placement) if placement.turned => Self::Turned,
            Some(_) => Self::AsInFile,
        }
    }
}

/// The scene's buffers.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Buffers<'a> {
    pub(crate) vertices: &'a wgpu::Buffer,
    pub(crate) more: &'a wgpu::Buffer,
    pub(crate) indices: &'a wgpu::Buffer,
}

impl Movers {
    /// Takes what moves from the scene's vertices. `None` if everything rests.
    pub(crate) fn new(scene: &Scene, vertices: &[Vertex], more: &[MoreOfVertex]) -> Option<Self> {
        let animation = scene.animation.as_deref().filter(|animation| animation.has_parts())?;
        let range = |first: u32, count: u32| first as usize..first as usize + count as usize;
        let turns = !scene.tangents.is_empty() && more.len() == vertices.len();
        let mut vertex_runs: Vec<VertexRun> = Vec::new();
        let (mut own, mut own_more) = (Vec::new(), Vec::new());
        for piece in &animation.pieces {
            let of_piece = range(piece.first_vertex, piece.vertices);
            own.extend_from_slice(vertices.get(of_piece.clone()).unwrap_or_default());
            own_more.extend_from_slice(more.get(of_piece).filter(|_| turns).unwrap_or_default());
            match vertex_runs.last_mut() {
                Some(last) if last.first + last.count == piece.first_vertex => last.count += piece.vertices,
                _ => vertex_runs.push(VertexRun { first: piece.first_vertex, count: piece.vertices }),
            }
        }
        let stage = Scene {
            animation: Some(Box::new(animation.clone())),
            lights: scene.lights.clone(),
            origin_m: scene.origin_m,
            ..Scene::default()
        };
        let (now, other, written_at) = (Posed::nothing(), None, None);
        let (firsts, triangle_runs) = (animation.first_positions(), triangle_runs(scene, animation));
        let written = vec![Corners::AsInFile; animation.pieces.len()];
        let (vertices, more) = (own, own_more);
        let copied_bytes = 0;
        Some(Self {
            stage,
            firsts,
            vertices,
            more,
            vertex_runs,
            triangle_runs,
            now,
            other,
            written_at,
            written,
            copied_bytes,
        })
    }

    /// The lights of a scene in which nothing moves, for people to change.
    pub(crate) fn of_lights(lights: &[Light], origin_m: DVec3) -> Self {
        Self {
            stage: Scene { lights: lights.to_vec(), origin_m, ..Scene::default() },
            firsts: Vec::new(),
            vertices: Vec::new(),
            more: Vec::new(),
            vertex_runs: Vec::new(),
            triangle_runs: Vec::new(),
            now: Posed::nothing(),
            other: None,
            written_at: None,
            written: Vec::new(),
            copied_bytes: 0,
        }
    }

    /// The present state.
    pub(crate) fn scene(&self) -> SceneAt {
        self.now.scene.clone().unwrap_or_default()
    }

    /// Moves to a state. Returns whether it is another one.
    pub(crate) fn set_time(&mut self, scene: &SceneAt) -> bool {
        let is_other = !self.now.is_of(scene);
        if is_other {
            self.now = self.pose(scene);
        }
        is_other
    }

    /// What moves, now.
    pub(crate) fn moment(&self) -> &Moment {
        &self.now.moment
    }

    /// Returns where a vertex of the scene is now. `None` if it rests, or is not shown.
    pub(crate) fn position(&self, vertex: u32) -> Option<Vec3> {
        let animation = self.stage.animation.as_deref()?;
        let piece = animation.piece_of(vertex)?;
        self.now.moment.pieces.get(piece)?.as_ref()?;
        let at = self.firsts.get(piece)? + (vertex - animation.pieces.get(piece)?.first_vertex) as usize;
        self.now.vertices.get(at).map(|vertex| vertex.position)
    }

    /// What moves or was edited, in this state.
    pub(crate) fn moment_at(&self, scene: &SceneAt) -> Moment {
        let as_in_file = || Moment { lights: self.stage.lights.clone(), ..nothing() };
        let moment = || self.stage.moment(scene).unwrap_or_else(as_in_file);
        self.posed(scene).map_or_else(moment, |posed| posed.moment.clone())
    }

    /// What each piece lies within in the buffers, once all that was encoded has run. `None`: it is not shown.
    pub(crate) fn bounds(&self) -> &[Option<Aabb>] {
        let written = self.written_at.as_ref().and_then(|written| self.posed(written));
        written.map_or(&[], |posed| &posed.bounds)
    }

    fn posed(&self, scene: &SceneAt) -> Option<&Posed> {
        [Some(&self.now), self.other.as_ref()].into_iter().flatten().find(|posed| posed.is_of(scene))
    }

    /// Whether a piece changes its shape.
    pub(crate) fn deforms(&self) -> bool {
        self.stage.animation.as_ref().is_some_and(|animation| !animation.shapes.is_empty())
    }

    /// For each piece, the way from where its points are now to where they were then. Those of a piece that changes its
    /// shape have ways of their own, which count if they are `drawn`.
    pub(crate) fn before(&self, then: &Moment, drawn: bool) -> Vec<Before> {
        let way = |(now, then): (&Option<Placement>, &Option<Placement>)| {
            let ((now, then), origin_m) = (now.as_ref().zip(then.as_ref())?, self.stage.origin_m);
            if now.is_deformed() {
                return drawn.then_some(Before::DRAWN);
            }
            // Local space has the scene's origin.
            let (there, back) = (DMat4::from_translation(-origin_m), DMat4::from_translation(origin_m));
            let way = there * then.world_from_piece * now.world_from_piece.inverse() * back;
            let [x, y, z] = [way.row(0), way.row(1), way.row(2)].map(DVec4::as_vec4);
            (x.is_finite() && y.is_finite() && z.is_finite()).then_some(Before { x, y, z })
        };
        let pieces = self.now.moment.pieces.iter().zip(&then.pieces);
        pieces.map(|pair| way(pair).unwrap_or_default()).collect()
    }

    /// Copies the vertices of what moves to their places in another buffer.
    pub(crate) fn copy_vertices(&self, encoder: &mut wgpu::CommandEncoder, from: &wgpu::Buffer, to: &wgpu::Buffer) {
        let stride = size_of::<Vertex>() as u64;
        for run in &self.vertex_runs {
            let (first, bytes) = (u64::from(run.first) * stride, u64::from(run.count) * stride);
            encoder.copy_buffer_to_buffer(from, first, to, first, bytes);
        }
    }

    fn pose(&self, scene: &SceneAt) -> Posed {
        let moment = self.moment_at(scene);
        let none = Animation::default();
        let animation = self.stage.animation.as_deref().unwrap_or(&none);
        let own = animation.own_vertices();
        // Without `self`, whose buffers a browser keeps to one thread.
        let (resting, more_of, firsts) = (&self.vertices, &self.more, &self.firsts);
        let pieces = || own.par_iter().zip(firsts).zip(&moment.pieces);
        let vertices = pieces().flat_map(|((own, first), placement)| {
            (0..own.positions.len()).into_par_iter().with_min_len(RUN).map(move |at| {
                let vertex = resting[first + at];
                let moved = placement.as_ref().map(|placement| placement.vertex(own, at));
                moved.map_or(vertex, |(position, normal)| vertex.moved(position, normal))
            })
        });
        let vertices: Vec<Vertex> = vertices.collect();
        let more = if more_of.is_empty() {
            Vec::new()
        } else {
            let more = pieces().flat_map(|((own, first), placement)| {
                (0..own.positions.len()).into_par_iter().with_min_len(RUN).map(move |at| {
                    let turned = placement.as_ref().map(|placement| placement.tangent_of(own, at));
                    turned.map_or(more_of[first + at], |tangent| more_of[first + at].moved(tangent))
                })
            });
            more.collect()
        };
        let within = |((own, first), placement): ((&OwnVertices<'_>, &usize), &Option<Placement>)| {
            placement.as_ref()?;
            let own = vertices.get(*first..first + own.positions.len())?;
            Some(Aabb::around(own.iter().map(|vertex| &vertex.position)))
        };
        let bounds = pieces().map(within).collect();
        Posed { scene: Some(scene.clone()), moment, vertices, more, bounds, staged: None }
    }

    /// Writes what the buffers lack of a state, before what `encoder` does next.
    pub(crate) fn write(
        &mut self,
        device: &wgpu::Device,
        encoder: &mut wgpu::CommandEncoder,
        buffers: Buffers<'_>,
        scene: &SceneAt,
    ) {
        if self.written_at.as_ref() == Some(scene) {
            return;
        }
        if !self.now.is_of(scene) && self.other.as_ref().is_none_or(|other| !other.is_of(scene)) {
            self.other = Some(self.pose(scene));
        }
        let posed = match &mut self.other {
            Some(other) if other.is_of(scene) => other,
            _ => &mut self.now,
        };
        let [vertices, more] = posed.staged.get_or_insert_with(|| {
            [bytemuck::cast_slice(&posed.vertices), bytemuck::cast_slice(&posed.more)].map(|list| staged(device, list))
        });
        let mut writer = Writer { device, encoder, copied_bytes: &mut self.copied_bytes };
        writer.runs::<Vertex>(vertices, buffers.vertices, &self.vertex_runs);
        if !posed.more.is_empty() {
            writer.runs::<MoreOfVertex>(more, buffers.more, &self.vertex_runs);
        }
        let wanted: Vec<Corners> =
            posed.moment.pieces.iter().map(|placement| Corners::of(placement.as_ref())).collect();
        for run in &self.triangle_runs {
            let (before, after) = (self.written.get(run.piece), wanted.get(run.piece));
            if let Some(corners) = after.filter(|_| before != after) {
                writer.corners(buffers.indices, run, *corners);
            }
        }
        (self.written, self.written_at) = (wanted, Some(scene.clone()));
    }
}

impl Posed {
    fn nothing() -> Self {
        let (vertices, more, bounds) = (Vec::new(), Vec::new(), Vec::new());
        Self { scene: None, moment: nothing(), vertices, more, bounds, staged: None }
    }

    fn is_of(&self, scene: &SceneAt) -> bool {
        self.scene.as_ref() == Some(scene)
    }
}

fn nothing() -> Moment {
    Moment { pieces: Vec::new(), lights: Vec::new() }
}

fn triangle_runs(scene: &Scene, animation: &Animation) -> Vec<TriangleRun> {
    let mut runs: Vec<TriangleRun> = Vec::new();
    for (number, corners) in (0..).zip(&scene.triangles) {
        let Some(piece) = animation.piece_of(corners[0]) else { continue };
        match runs.last_mut() {
            Some(last) if last.piece == piece && last.first as usize + last.corners.len() == number as usize => {
                last.corners.push(*corners);
            }
            _ => runs.push(TriangleRun { first: number, piece, corners: vec![*corners] }),
        }
    }
    runs
}

/// Copies in the order of the encoder's commands, so that a submission may draw several times of the scene.
struct Writer<'a> {
    device: &'a wgpu::Device,
    encoder: &'a mut wgpu::CommandEncoder,
    copied_bytes: &'a mut u64,
}

fn staged(device: &wgpu::Device, bytes: &[u8]) -> wgpu::Buffer {
    device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
        label: Some("what moves"),
        contents: bytes,
        usage: wgpu::BufferUsages::COPY_SRC,
    })
}

impl Writer<'_> {
    fn runs<T>(&mut self, staged: &wgpu::Buffer, to: &wgpu::Buffer, runs: &[VertexRun]) {
        let stride = size_of::<T>() as u64;
        let mut from = 0;
        for run in runs {
            let bytes = u64::from(run.count) * stride;
            self.encoder.copy_buffer_to_buffer(staged, from, to, u64::from(run.first) * stride, bytes);
            from += bytes;
        }
        *self.copied_bytes += from;
    }

    fn corners(&mut self, to: &wgpu::Buffer, run: &TriangleRun, corners: Corners) {
        let arranged = |[a, b, c]: [u32; 3]| match corners {
            Corners::AsInFile => [a, b, c],
            Corners::Turned => [a, c, b],
            Corners::Hidden => [a; 3],
        };
        let triangles: Vec<[u32; 3]> = run.corners.iter().map(|corners| arranged(*corners)).collect();
        let staged = staged(self.device, bytemuck::cast_slice(&triangles));
        let offset = u64::from(run.first) * size_of::<[u32; 3]>() as u64;
        self.encoder.copy_buffer_to_buffer(&staged, 0, to, offset, staged.size());
        *self.copied_bytes += staged.size();
    }
}
