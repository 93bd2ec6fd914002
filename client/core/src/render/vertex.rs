//! Vertices as the shaders read them.

use glam::{Vec2, Vec3, Vec4};
use gnomon_scene::Scene;

#[repr(C)]
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
pub(crate) struct Vertex {
    pub(crate) position: Vec3,
    /// Of the normal, and the lean.
    normal: [i16; 4],
    uv: Vec2,
}

pub(crate) const ATTRIBUTES: [wgpu::VertexAttribute; 3] =
    wgpu::vertex_attr_array![0 => Float32x3, 1 => Snorm16x4, 2 => Float32x2];

/// What few scenes have of their vertices.
#[repr(C)]
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
pub(crate) struct MoreOfVertex {
    uv_1: Vec2,
    tangent: [i16; 4],
    color: [u16; 4],
}

pub(crate) const MORE_ATTRIBUTES: [wgpu::VertexAttribute; 3] =
    wgpu::vertex_attr_array![3 => Float32x2, 4 => Snorm16x4, 5 => Unorm16x4];

impl Vertex {
    /// The same one elsewhere. Its lean stays, for a rigid motion does not change it.
    pub(crate) fn moved(&self, position: Vec3, normal: Vec3) -> Self {
        let [x, y, z] = normal.to_array().map(snorm);
        Self { position, normal: [x, y, z, self.normal[3]], uv: self.uv }
    }
}

impl MoreOfVertex {
    /// The same one, turned.
    pub(crate) fn moved(&self, tangent: Vec4) -> Self {
        Self { tangent: tangent.to_array().map(snorm), ..*self }
    }
}

#[cfg(test)]
impl Vertex {
    pub(crate) fn unit_normal(&self) -> Vec3 {
        let [x, y, z, _] = self.normal;
        Vec3::from_array([x, y, z].map(unit))
    }
}

#[cfg(test)]
impl MoreOfVertex {
    pub(crate) fn unit_tangent(&self) -> Vec4 {
        Vec4::from_array(self.tangent.map(unit))
    }
}

#[cfg(test)]
fn unit(value: i16) -> f32 {
    f32::from(value) / f32::from(i16::MAX)
}

pub(crate) fn vertices(scene: &Scene) -> Vec<Vertex> {
    (scene.positions.iter().zip(&scene.normals).zip(&scene.uvs).zip(leans(scene)))
        .map(|(((position, normal), uv), lean)| Vertex {
            position: *position,
            normal: normal.extend(lean).to_array().map(snorm),
            uv: *uv,
        })
        .collect()
}

/// One element for all vertices where the scene has nothing more of them.
pub(crate) fn more_of_vertices(scene: &Scene) -> Vec<MoreOfVertex> {
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
