//! The scene on the adapter: vertices, indices, draws in their order, and one bind group for each material.

use glam::{DVec3, Vec3};
use gnomon_scene::{AlphaMode, Animation, Draw, Light, Material, Scene, SceneAt};
use gnomon_shaders::{
    gpu::Gpu,
    material::{features, features_of, is_layered},
};
use wgpu::util::DeviceExt as _;

use super::{
    error::RenderError,
    material,
    movers::{AtRest, Buffers, Movers},
    vertex::{ATTRIBUTES, MORE_ATTRIBUTES, MoreOfVertex, Vertex, more_of_vertices, vertices},
};

/// Triangles of one material, drawn together.
#[derive(Debug, Clone)]
pub(crate) struct Batch {
    pub(crate) material: usize,
    pub(crate) indices: std::ops::Range<u32>,
    pub(crate) alpha: AlphaMode,
    /// Whether some point fails the alpha test of a MASK material.
    has_holes: bool,
    pub(crate) double_sided: bool,
    /// Of [`features`].
    pub(crate) features: u32,
    /// Whether light passes it that colours what lies behind.
    pub(crate) transmissive: bool,
    /// Centre of the triangles; blended batches are sorted by it.
    pub(crate) centre: Vec3,
    /// Whether they move.
    pub(crate) moves: bool,
}

impl Batch {
    pub(crate) fn is_blended(&self) -> bool {
        matches!(self.alpha, AlphaMode::Blend)
    }

    pub(crate) fn is_masked(&self) -> bool {
        self.has_holes
    }
}

/// Triangles of one piece and one material that are not blended.
#[derive(Debug)]
pub(crate) struct PieceDraw {
    pub(crate) piece: usize,
    pub(crate) material: usize,
    pub(crate) indices: std::ops::Range<u32>,
    /// As a batch's.
    pub(crate) has_holes: bool,
}

#[derive(Debug)]
pub(crate) struct SceneUpload {
    vertices: wgpu::Buffer,
    /// Of [`MoreOfVertex`]: one for each vertex, or one for all.
    more: wgpu::Buffer,
    more_stride: u64,
    indices: wgpu::Buffer,
    /// OPAQUE and MASK ones sorted by pipeline and material, then BLEND ones in the scene's order.
    pub(crate) batches: Vec<Batch>,
    pub(crate) material_layout: wgpu::BindGroupLayout,
    /// One for each material of the scene.
    pub(crate) materials: Vec<wgpu::BindGroup>,
    /// [`gnomon_shaders::material::Finish`] of each material.
    pub(crate) finishes: wgpu::Buffer,
    /// Whether some material is more than metallic-roughness.
    pub(crate) layered: bool,
    /// Whether some material emits light.
    pub(crate) emits: bool,
    /// `None` if everything rests, and nothing was edited.
    movers: Option<Movers>,
    pub(crate) moves_with_time: bool,
    /// What moves or may be edited, piece by piece.
    pub(crate) piece_draws: Vec<PieceDraw>,
    /// BLEND batches that move, each with its piece and its centre in that one's space.
    blended_movers: Vec<(usize, usize, Vec3)>,
}

impl SceneUpload {
    pub(crate) fn new(gpu: &Gpu, scene: &Scene, anisotropy: u16) -> Result<Self, RenderError> {
        let device = &gpu.device;
        let limit = device.limits().max_buffer_size;
        let buffer = |what, bytes: &[u8], usage| {
            if bytes.len() as u64 > limit {
                return Err(RenderError::TooLarge { what, needed: bytes.len() as u64, limit });
            }
            // An empty scene still shows the sky, but an empty buffer cannot be bound.
            let contents = if bytes.is_empty() { &[0; size_of::<Vertex>()] } else { bytes };
            Ok(device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: Some(what), contents, usage }))
        };
        let (mut vertices, mut more) = (vertices(scene), more_of_vertices(scene));
        let at_rest = AtRest::new(scene, &mut vertices, &mut more);
        let batches = batches(scene);
        let if_moves = |usage| if at_rest.has_pieces() { usage } else { wgpu::BufferUsages::empty() };
        // Written by the host and a kernel; read to be kept, and by tests.
        let written = if_moves(wgpu::BufferUsages::COPY_DST);
        let posed =
            wgpu::BufferUsages::VERTEX | written | if_moves(wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC);
        // A stride of 0 gives every vertex the same.
        let more_stride = if more.len() == 1 { 0 } else { size_of::<MoreOfVertex>() as u64 };
        let vertices = buffer("vertices", bytemuck::cast_slice(&vertices), posed)?;
        let more = buffer("more of vertices", bytemuck::cast_slice(&more), posed)?;
        let indices = buffer("indices", bytemuck::cast_slice(&scene.triangles), wgpu::BufferUsages::INDEX | written)?;
        let movers = Movers::new(gpu, scene, at_rest, Buffers { vertices: &vertices, more: &more })?;
        let (blended_movers, piece_draws) = match movers {
            Some(_) => (blended_movers(scene, &batches), piece_draws(scene)),
            None => (Vec::new(), Vec::new()),
        };
        let material_layout = material::layout(gpu);
        Ok(Self {
            vertices,
            more_stride,
            more,
            indices,
            batches,
            materials: material::groups(gpu, scene, &material_layout, anisotropy)?,
            material_layout,
            finishes: material::finishes(gpu, scene),
            layered: scene.materials.iter().any(is_layered),
            emits: scene.materials.iter().any(|material| material.unlit || material.emissive != Vec3::ZERO),
            movers,
            moves_with_time: scene.animation.as_deref().is_some_and(Animation::moves_scene),
            piece_draws,
            blended_movers,
        })
    }

    /// What moves or was edited. `None` if there is nothing.
    pub(crate) fn movers(&self) -> Option<&Movers> {
        self.movers.as_ref()
    }

    /// How far a point of what moves may be from where it is in another state, in metres.
    pub(crate) fn farthest_m(&mut self, then: &SceneAt) -> f32 {
        self.movers.as_mut().map_or(0.0, |movers| movers.farthest_m(then))
    }

    /// Lets people change the lights of a scene in which nothing moves. `lights` are those of the file.
    pub(crate) fn follow_edits(&mut self, lights: &[Light], origin_m: DVec3) {
        self.movers.get_or_insert_with(|| Movers::of_lights(lights, origin_m));
    }

    /// Puts what moves or was edited where it is in this state of the scene. Returns the lights if it is another one.
    pub(crate) fn set_time(&mut self, scene: &SceneAt) -> Option<Vec<Light>> {
        let movers = self.movers.as_mut()?;
        if !movers.set_time(scene) {
            return None;
        }
        for (batch, piece, own) in &self.blended_movers {
            if let (Some(batch), Some(centre)) = (self.batches.get_mut(*batch), movers.centre(*piece, *own)) {
                batch.centre = centre;
            }
        }
        Some(movers.moment().lights.clone())
    }

    /// Ensures that what `encoder` draws next is the scene as it is now.
    pub(crate) fn show_now(&mut self, device: &wgpu::Device, encoder: &mut wgpu::CommandEncoder) {
        if let Some(scene) = self.movers.as_ref().map(Movers::scene) {
            self.show(device, encoder, &scene);
        }
    }

    /// Ensures that what `encoder` draws next is this state of the scene. [`Self::show_now`] is to follow.
    pub(crate) fn show(&mut self, device: &wgpu::Device, encoder: &mut wgpu::CommandEncoder, scene: &SceneAt) {
        let Self { vertices, more, indices, movers, .. } = self;
        if let Some(movers) = movers {
            movers.write(device, encoder, (Buffers { vertices, more }, indices), scene);
        }
    }

    /// Returns a buffer that has room for the scene's vertices, for [`Self::keep_vertices`]. `None` unless the shape of
    /// something changes.
    pub(crate) fn room_for_vertices(&self, device: &wgpu::Device) -> Option<wgpu::Buffer> {
        self.movers.as_ref().filter(|movers| movers.deforms())?;
        Some(device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("vertices of another time"),
            size: self.vertices.size(),
            usage: wgpu::BufferUsages::VERTEX | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        }))
    }

    /// Copies the vertices of what moves, as `encoder` has them now.
    pub(crate) fn keep_vertices(&self, encoder: &mut wgpu::CommandEncoder, to: &wgpu::Buffer) {
        if let Some(movers) = &self.movers {
            movers.copy_vertices(encoder, &self.vertices, to);
        }
    }

    /// The scene's vertices as they are now.
    pub(crate) fn vertices(&self) -> &wgpu::Buffer {
        &self.vertices
    }

    #[cfg(test)]
    pub(crate) fn more(&self) -> &wgpu::Buffer {
        &self.more
    }

    /// Layouts of the buffers that [`Self::bind`] binds.
    pub(crate) fn vertex_layouts(&self) -> [Option<wgpu::VertexBufferLayout<'static>>; 2] {
        let layout = |array_stride, attributes| {
            Some(wgpu::VertexBufferLayout { array_stride, step_mode: wgpu::VertexStepMode::Vertex, attributes })
        };
        [layout(size_of::<Vertex>() as u64, &ATTRIBUTES), layout(self.more_stride, &MORE_ATTRIBUTES)]
    }

    /// Binds vertices and indices.
    pub(crate) fn bind(&self, pass: &mut wgpu::RenderPass<'_>) {
        pass.set_vertex_buffer(0, self.vertices.slice(..));
        pass.set_vertex_buffer(1, self.more.slice(..));
        pass.set_index_buffer(self.indices.slice(..), wgpu::IndexFormat::Uint32);
    }
}

/// A bilinear mean of texels may round to this much less than the least of them.
const ROUNDING: f32 = 1e-5;

/// For each material, whether some point may fail its alpha test. Many files say MASK of all their materials.
fn holes(scene: &Scene) -> Vec<bool> {
    let fading = scene.vertex_alpha_materials();
    let has_holes = |(index, material): (u32, &Material)| {
        let AlphaMode::Mask { cutoff } = material.alpha else { return false };
        let picture = scene.alpha_picture(index);
        let least = picture.map_or(1.0, |picture| f32::from(picture.alpha.into_iter().min().unwrap_or(0)) / 255.0);
        let fades = fading.get(index as usize).is_some_and(|fades| *fades);
        fades || least * material.base_color.w < cutoff + ROUNDING
    };
    (0..).zip(&scene.materials).map(has_holes).collect()
}

fn batches(scene: &Scene) -> Vec<Batch> {
    let holes = holes(scene);
    let mut batches: Vec<Batch> = Vec::new();
    for draw in scene.draws.iter().filter(|draw| draw.triangles > 0) {
        let material = &scene.materials[draw.material as usize];
        let indices = draw.first_triangle * 3..(draw.first_triangle + draw.triangles) * 3;
        // A draw is one instance's, so all of it moves or rests.
        let first = scene.triangles[draw.first_triangle as usize][0];
        let moves = scene.animation.as_ref().is_some_and(|animation| animation.piece_of(first).is_some());
        if let Some(last) = batches.last_mut()
            && last.material == draw.material as usize
            && last.indices.end == indices.start
            && last.moves == moves
            && !last.is_blended()
        {
            last.indices.end = indices.end;
            continue;
        }
        let corners = &scene.triangles[draw.first_triangle as usize..][..draw.triangles as usize];
        let positions = corners.as_flattened().iter().map(|index| scene.positions[*index as usize]);
        let mut found = features_of(material);
        if !scene.tangents.is_empty() && found & (features::NORMAL | features::COAT_NORMAL) != 0 {
            found |= features::TANGENTS;
        }
        if !scene.colors.is_empty() {
            found |= features::COLORS;
        }
        batches.push(Batch {
            material: draw.material as usize,
            indices,
            alpha: material.alpha,
            has_holes: holes[draw.material as usize],
            double_sided: material.double_sided,
            features: found,
            transmissive: material.transmission.factor > 0.0 && !material.unlit,
            centre: centre(positions).unwrap_or_default(),
            moves,
        });
    }
    // Stable: blended ones keep their order.
    batches.sort_by_key(|batch| match batch.alpha {
        AlphaMode::Blend => (2, false, 0, 0),
        _ => (u8::from(batch.has_holes), batch.double_sided, batch.features, batch.material),
    });
    batches
}

/// The middle of the bounds. `None` if there is nothing.
fn centre(positions: impl Iterator<Item = Vec3>) -> Option<Vec3> {
    let bounds = positions.map(|position| (position, position));
    let bounds = bounds.reduce(|(low, high), (more, _)| (low.min(more), high.max(more)));
    bounds.map(|(low, high)| (low + high) * 0.5)
}

fn piece_draws(scene: &Scene) -> Vec<PieceDraw> {
    let (holes, animation) = (holes(scene), scene.animation.as_deref());
    let draw = |draw: &Draw| {
        let material = draw.material as usize;
        let first = scene.triangles.get(draw.first_triangle as usize).filter(|_| draw.triangles > 0)?;
        let piece = animation?.piece_of(first[0])?;
        let indices = draw.first_triangle * 3..(draw.first_triangle + draw.triangles) * 3;
        let is_blended = matches!(scene.materials.get(material)?.alpha, AlphaMode::Blend);
        (!is_blended).then_some(PieceDraw { piece, material, indices, has_holes: *holes.get(material)? })
    };
    scene.draws.iter().filter_map(draw).collect()
}

fn blended_movers(scene: &Scene, batches: &[Batch]) -> Vec<(usize, usize, Vec3)> {
    let Some(animation) = scene.animation.as_deref() else { return Vec::new() };
    let firsts = animation.first_positions();
    let moving = batches.iter().enumerate().filter(|(_, batch)| batch.moves && batch.is_blended());
    // A batch of blended triangles is one draw, and so of one piece.
    let placed = |(number, batch): (usize, &Batch)| {
        let indices = batch.indices.start as usize..batch.indices.end as usize;
        let vertices = scene.triangles.as_flattened().get(indices)?;
        let piece = animation.piece_of(*vertices.first()?)?;
        let (first, of_scene) = (firsts.get(piece)?, animation.pieces.get(piece)?.first_vertex);
        let own = |vertex: &u32| animation.positions.get(first + vertex.checked_sub(of_scene)? as usize);
        Some((number, piece, centre(vertices.iter().filter_map(own).copied())?))
    };
    moving.filter_map(placed).collect()
}
