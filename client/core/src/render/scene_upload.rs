//! The scene on the adapter: vertices, indices, draws in their order, and one bind group for each material.

use glam::{Vec2, Vec3};
use gnomon_scene::{AlphaMode, Material, Scene};
use gnomon_shaders::{
    gpu::Gpu,
    material::{features, features_of, is_layered},
};
use wgpu::util::DeviceExt as _;

use super::{error::RenderError, material};

/// A vertex as the shaders read it.
#[repr(C)]
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Vertex {
    position: Vec3,
    /// Of the normal, and the lean.
    normal: [i16; 4],
    uv: Vec2,
}

const ATTRIBUTES: [wgpu::VertexAttribute; 3] = wgpu::vertex_attr_array![0 => Float32x3, 1 => Snorm16x4, 2 => Float32x2];

/// What few scenes have of their vertices.
#[repr(C)]
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct MoreOfVertex {
    uv_1: Vec2,
    tangent: [i16; 4],
    color: [u16; 4],
}

const MORE_ATTRIBUTES: [wgpu::VertexAttribute; 3] =
    wgpu::vertex_attr_array![3 => Float32x2, 4 => Snorm16x4, 5 => Unorm16x4];

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
}

impl Batch {
    pub(crate) fn is_blended(&self) -> bool {
        matches!(self.alpha, AlphaMode::Blend)
    }

    pub(crate) fn is_masked(&self) -> bool {
        self.has_holes
    }
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
        let vertices: Vec<Vertex> = (scene.positions.iter().zip(&scene.normals).zip(&scene.uvs).zip(leans(scene)))
            .map(|(((position, normal), uv), lean)| Vertex {
                position: *position,
                normal: normal.extend(lean).to_array().map(snorm),
                uv: *uv,
            })
            .collect();
        let more = more_of_vertices(scene);
        let material_layout = material::layout(gpu);
        Ok(Self {
            vertices: buffer("vertices", bytemuck::cast_slice(&vertices), wgpu::BufferUsages::VERTEX)?,
            // A stride of 0 gives every vertex the same.
            more_stride: if more.len() == 1 { 0 } else { size_of::<MoreOfVertex>() as u64 },
            more: buffer("more of vertices", bytemuck::cast_slice(&more), wgpu::BufferUsages::VERTEX)?,
            indices: buffer("indices", bytemuck::cast_slice(&scene.triangles), wgpu::BufferUsages::INDEX)?,
            batches: batches(scene),
            materials: material::groups(gpu, scene, &material_layout, anisotropy)?,
            material_layout,
            finishes: material::finishes(gpu, scene),
            layered: scene.materials.iter().any(is_layered),
            emits: scene.materials.iter().any(|material| material.unlit || material.emissive != Vec3::ZERO),
        })
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

#[expect(clippy::cast_possible_truncation, reason = "values from −1 to 1")]
fn snorm(value: f32) -> i16 {
    (value * f32::from(i16::MAX)).round() as i16
}

/// Facets that lean more than this, 20°, keep their steps: softened, light would end too early.
const MOST_LEAN: f32 = 0.35;

/// For each vertex, the sine of the greatest angle between its normal and those of its triangles.
fn leans(scene: &Scene) -> Vec<f32> {
    let mut leans = vec![0.0; scene.positions.len()];
    for corners in &scene.triangles {
        let [a, b, c] = corners.map(|index| scene.positions[index as usize]);
        let plane = (b - a).cross(c - a).normalize_or_zero();
        for index in corners {
            let sine = plane.cross(scene.normals[*index as usize]).length();
            let lean: &mut f32 = &mut leans[*index as usize];
            // What rounding leans is flat.
            *lean = if sine > 0.01 { lean.max(sine.min(MOST_LEAN)) } else { *lean };
        }
    }
    leans
}

/// One element for all vertices where the scene has nothing more of them.
fn more_of_vertices(scene: &Scene) -> Vec<MoreOfVertex> {
    let plain = MoreOfVertex { uv_1: Vec2::ZERO, tangent: [0; 4], color: [u16::MAX; 4] };
    if scene.uvs_1.is_empty() && scene.tangents.is_empty() && scene.colors.is_empty() {
        return vec![plain];
    }
    let vertex = |place: usize| MoreOfVertex {
        uv_1: scene.uvs_1.get(place).copied().unwrap_or(plain.uv_1),
        tangent: scene.tangents.get(place).map_or(plain.tangent, |tangent| tangent.to_array().map(snorm)),
        color: scene.colors.get(place).copied().unwrap_or(plain.color),
    };
    // A scene of one vertex has no triangle; nothing is read then.
    (0..scene.positions.len()).map(vertex).collect()
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
        if let Some(last) = batches.last_mut()
            && last.material == draw.material as usize
            && last.indices.end == indices.start
            && !last.is_blended()
        {
            last.indices.end = indices.end;
            continue;
        }
        let corners = &scene.triangles[draw.first_triangle as usize..][..draw.triangles as usize];
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for index in corners.as_flattened() {
            low = low.min(scene.positions[*index as usize]);
            high = high.max(scene.positions[*index as usize]);
        }
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
            centre: (low + high) * 0.5,
        });
    }
    // Stable: blended ones keep their order.
    batches.sort_by_key(|batch| match batch.alpha {
        AlphaMode::Blend => (2, false, 0, 0),
        _ => (u8::from(batch.has_holes), batch.double_sided, batch.features, batch.material),
    });
    batches
}
