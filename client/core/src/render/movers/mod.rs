//! What moves, on the adapter: its vertices and corners are written anew for each state of the scene, where the scene
//! has them that stands still then, but for rounding (`shaders/scene/docs/living.md`). Passes see ordinary triangles.

mod corners;
mod file_pose;
mod own;
mod poser;
#[cfg(test)]
mod tests;

use std::borrow::Cow;

use glam::{DMat4, DVec3, DVec4, Vec3};
use gnomon_scene::{Aabb, Animation, Light, Moment, Placement, Scene, SceneAt};
use gnomon_shaders::{gpu::Gpu, shading::Before};

pub(crate) use self::poser::Buffers;
use self::{corners::CornerWriter, file_pose::FilePose, poser::Poser};
use super::{
    error::RenderError,
    vertex::{MoreOfVertex, Vertex},
};

#[derive(Debug)]
pub(crate) struct Movers {
    /// The scene without what rests.
    stage: Scene,
    /// `None` if only lights may change.
    pieces: Option<Pieces>,
    now: Posed,
    /// The last other state that was drawn: that of a late mask.
    other: Option<Posed>,
    /// State of the vertices that the buffers hold once all that was encoded has run. `None`: those of the file.
    written_at: Option<SceneAt>,
    /// Bytes that were copied into the buffers so far.
    pub(crate) copied_bytes: u64,
}

#[derive(Debug)]
struct Pieces {
    poser: Poser,
    file_pose: FilePose,
    corners: CornerWriter,
    /// Their vertices in the scene's buffers.
    vertex_runs: Vec<VertexRun>,
}

/// What moves or was edited, in one state of the scene.
#[derive(Debug)]
struct Posed {
    /// `None` until there is one.
    scene: Option<SceneAt>,
    moment: Moment,
    /// The corners of a box around each piece. `None`: it is not shown.
    boxes: Vec<Option<[Vec3; 8]>>,
    /// Which pieces are shown and not where the file has them, and that on the adapter, once it was needed there.
    placed: Option<(Vec<bool>, wgpu::BindGroup)>,
}

/// What moves, in the pose of the file.
pub(crate) struct AtRest(Option<FilePose>);

impl AtRest {
    /// Puts what moves into the pose of the file, in vertices of the scene: where the host has it then.
    pub(crate) fn new(scene: &Scene, vertices: &mut [Vertex], more: &mut [MoreOfVertex]) -> Self {
        let has_pieces = scene.animation.as_ref().is_some_and(|animation| !animation.pieces.is_empty());
        Self(has_pieces.then(|| FilePose::new(scene, vertices, more)))
    }

    /// Whether something may move.
    pub(crate) fn has_pieces(&self) -> bool {
        self.0.is_some()
    }
}

/// Vertices that follow each other.
#[derive(Debug, Clone, Copy)]
struct VertexRun {
    first: u32,
    count: u32,
}

impl Movers {
    /// Takes what moves from a scene whose vertices are in these buffers. `None` if everything rests.
    ///
    /// # Errors
    /// If the adapter has no room for it.
    pub(crate) fn new(
        gpu: &Gpu,
        scene: &Scene,
        AtRest(file_pose): AtRest,
        buffers: Buffers<'_>,
    ) -> Result<Option<Self>, RenderError> {
        let animation = scene.animation.as_deref().filter(|animation| animation.has_parts());
        let Some(animation) = animation else { return Ok(None) };
        let mut vertex_runs: Vec<VertexRun> = Vec::new();
        for piece in &animation.pieces {
            match vertex_runs.last_mut() {
                Some(last) if last.first + last.count == piece.first_vertex => last.count += piece.vertices,
                _ => vertex_runs.push(VertexRun { first: piece.first_vertex, count: piece.vertices }),
            }
        }
        let pieces = match file_pose {
            None => None,
            Some(file_pose) => {
                let poser = Poser::new(gpu, scene, animation, buffers)?;
                Some(Pieces { poser, file_pose, corners: CornerWriter::new(scene, animation), vertex_runs })
            }
        };
        // The adapter has the vertices.
        let (positions, normals, tangents, deltas) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let animation = Animation { positions, normals, tangents, deltas, ..animation.clone() };
        let stage = Scene {
            animation: Some(Box::new(animation)),
            lights: scene.lights.clone(),
            origin_m: scene.origin_m,
            ..Scene::default()
        };
        Ok(Some(Self::with(stage, pieces)))
    }

    /// The lights of a scene in which nothing moves, for people to change.
    pub(crate) fn of_lights(lights: &[Light], origin_m: DVec3) -> Self {
        Self::with(Scene { lights: lights.to_vec(), origin_m, ..Scene::default() }, None)
    }

    fn with(stage: Scene, pieces: Option<Pieces>) -> Self {
        Self { stage, pieces, now: Posed::nothing(), other: None, written_at: None, copied_bytes: 0 }
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

    /// Returns where a point of a piece is now, from its own space; the middle of one that changes its shape. `None` if
    /// the piece is not shown.
    pub(crate) fn centre(&self, piece: usize, own: Vec3) -> Option<Vec3> {
        let placement = self.now.moment.pieces.get(piece)?.as_ref()?;
        let [low, .., high] = placement.box_around(&Aabb { min: own, max: own });
        Some(low.midpoint(high))
    }

    /// What moves or was edited, in this state.
    pub(crate) fn moment_at(&self, scene: &SceneAt) -> Cow<'_, Moment> {
        match self.posed(scene) {
            Some(posed) => Cow::Borrowed(&posed.moment),
            None => Cow::Owned(self.evaluate(scene)),
        }
    }

    fn evaluate(&self, scene: &SceneAt) -> Moment {
        let as_in_file = || Moment { lights: self.stage.lights.clone(), ..nothing() };
        self.stage.moment(scene).unwrap_or_else(as_in_file)
    }

    /// The corners of a box around each piece, as the buffers have it once all that was encoded has run. `None`: it is
    /// not shown.
    pub(crate) fn boxes(&self) -> &[Option<[Vec3; 8]>] {
        let written = self.written_at.as_ref().and_then(|written| self.posed(written));
        written.map_or(&[], |posed| &posed.boxes)
    }

    /// How far a point of a piece may be from where it is in another state, in metres.
    pub(crate) fn farthest_m(&mut self, then: &SceneAt) -> f32 {
        self.prepare(then);
        let then = self.posed(then).map_or(&[][..], |posed| &posed.boxes);
        let mut farthest_m = 0.0_f32;
        for ((now, then), placement) in self.now.boxes.iter().zip(then).zip(&self.now.moment.pieces) {
            let (Some(now), Some(then), Some(placement)) = (now, then, placement) else { continue };
            for (number, corner) in now.iter().enumerate() {
                // Points of a rigid piece move as its corners do; those of another, anywhere between the boxes.
                let others = if placement.is_deformed() { 0..then.len() } else { number..number + 1 };
                for other in &then[others] {
                    farthest_m = farthest_m.max(corner.distance(*other));
                }
            }
        }
        farthest_m
    }

    /// Ensures that a state is evaluated.
    fn prepare(&mut self, scene: &SceneAt) {
        if self.posed(scene).is_none() {
            self.other = Some(self.pose(scene));
        }
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
        for run in self.pieces.iter().flat_map(|pieces| &pieces.vertex_runs) {
            let (first, bytes) = (u64::from(run.first) * stride, u64::from(run.count) * stride);
            encoder.copy_buffer_to_buffer(from, first, to, first, bytes);
        }
    }

    fn pose(&self, scene: &SceneAt) -> Posed {
        let moment = self.evaluate(scene);
        let animation = self.stage.animation.iter();
        let own = animation.flat_map(|animation| &animation.pieces).zip(&moment.pieces);
        let boxes = own.map(|(piece, placement)| Some(placement.as_ref()?.box_around(&piece.bounds))).collect();
        Posed { scene: Some(scene.clone()), moment, boxes, placed: None }
    }

    /// Writes what the buffers lack of a state, before what `encoder` does next.
    pub(crate) fn write(
        &mut self,
        device: &wgpu::Device,
        encoder: &mut wgpu::CommandEncoder,
        (buffers, indices): (Buffers<'_>, &wgpu::Buffer),
        scene: &SceneAt,
    ) {
        if self.written_at.as_ref() == Some(scene) {
            return;
        }
        self.prepare(scene);
        let posed = match &mut self.other {
            Some(other) if other.is_of(scene) => other,
            _ => &mut self.now,
        };
        if let Some(Pieces { poser, file_pose, corners, .. }) = &mut self.pieces {
            let (moved, state) = match &posed.placed {
                Some(placed) => placed,
                None => {
                    let moved = file_pose.moved(&posed.moment);
                    let (state, bytes) = poser.state(device, &posed.moment, &moved);
                    self.copied_bytes += bytes;
                    posed.placed.insert((moved, state))
                }
            };
            self.copied_bytes += file_pose.put_back(device, encoder, buffers, (&posed.moment, moved));
            if moved.contains(&true) {
                poser.encode(encoder, state);
            }
            self.copied_bytes += corners.write(device, encoder, indices, &posed.moment);
        }
        self.written_at = Some(scene.clone());
    }
}

impl Posed {
    fn nothing() -> Self {
        Self { scene: None, moment: nothing(), boxes: Vec::new(), placed: None }
    }

    fn is_of(&self, scene: &SceneAt) -> bool {
        self.scene.as_ref() == Some(scene)
    }
}

fn nothing() -> Moment {
    Moment { pieces: Vec::new(), lights: Vec::new() }
}
