//! A scene's parts: geometry, materials, pictures and lights.

use glam::{DVec3, Vec2, Vec3, Vec4};
use serde::{Deserialize, Serialize};

/// A loaded scene. The loader and [`Scene::unpack`] guarantee: every index is in range, every position, normal and UV is
/// finite, normals and light directions are unit vectors, and there are 1 to 32 lights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scene {
    /// World position of the local origin, in metres.
    pub origin_m: DVec3,
    /// Bounds of all triangles in local space, in metres.
    pub bounds: Aabb,
    /// Vertex positions in local space, in metres.
    pub positions: Vec<Vec3>,
    /// Unit shading normals, one a vertex.
    pub normals: Vec<Vec3>,
    /// Base colour texture coordinates, one a vertex, texture transform applied; (0, 0) is the picture's upper left.
    pub uvs: Vec<Vec2>,
    /// Vertex indices; counter-clockwise seen from the front. No zero-area triangles.
    pub triangles: Vec<[u32; 3]>,
    /// Runs of triangles with one material: OPAQUE ones first, then MASK, then BLEND. They cover `triangles` in order.
    pub draws: Vec<Draw>,
    /// Materials that draws name.
    pub materials: Vec<Material>,
    /// Base colour pictures that textures name.
    pub images: Vec<Image>,
    /// Lights, in the order of the mask's planes.
    pub lights: Vec<Light>,
    /// Mesh instances that were flattened.
    pub instances: u32,
}

/// An axis-aligned box.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Aabb {
    /// Lowest corner.
    pub min: Vec3,
    /// Highest corner.
    pub max: Vec3,
}

impl Aabb {
    /// The bounds of a scene's triangles; all zeros when there are none, or where they name no vertex.
    pub(crate) fn of(scene: &Scene) -> Self {
        let corners = scene.triangles.iter().flatten();
        let mut positions = corners.filter_map(|corner| scene.positions.get(*corner as usize));
        let Some(first) = positions.next() else { return Self { min: Vec3::ZERO, max: Vec3::ZERO } };
        let (min, max) =
            positions.fold((*first, *first), |(min, max), position| (min.min(*position), max.max(*position)));
        Self { min, max }
    }
}

/// A run of triangles of one instance with one material.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Draw {
    /// Index of the first triangle.
    pub first_triangle: u32,
    /// Number of triangles.
    pub triangles: u32,
    /// Index of the material.
    pub material: u32,
}

/// How a material treats alpha (glTF 2.0, §3.9.4).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum AlphaMode {
    /// Alpha is ignored.
    Opaque,
    /// A point is there when its alpha is at least the cutoff; elsewhere rays pass.
    Mask {
        /// The cutoff.
        cutoff: f32,
    },
    /// Drawn over what lies behind it; neither stops rays nor has visibility of its own.
    Blend,
}

/// A surface's look.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// Name in the file, or empty.
    pub name: String,
    /// Linear RGBA factor.
    pub base_color: Vec4,
    /// Texture that multiplies the factor: sRGB colour, linear alpha.
    pub base_color_texture: Option<Texture>,
    /// Linear RGB light of its own.
    pub emissive: Vec3,
    /// Treatment of alpha.
    pub alpha: AlphaMode,
    /// Seen from both sides; otherwise back faces are not drawn (they still cast shadows).
    pub double_sided: bool,
}

/// A picture and how it repeats. Filtering is bilinear; alpha tests read the full-size picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Texture {
    /// Index of the image.
    pub image: u32,
    /// Repetition along u.
    pub wrap_u: Wrap,
    /// Repetition along v.
    pub wrap_v: Wrap,
}

/// What a texture does outside 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Wrap {
    /// Starts again.
    Repeat,
    /// Starts again, mirrored every other time.
    MirroredRepeat,
    /// Holds its edge.
    ClampToEdge,
}

/// A PNG or JPEG picture.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Image {
    /// The file's bytes, which travel.
    pub encoded: Vec<u8>,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Decoded RGBA, 8 bits a channel, row by row from the top. Does not travel.
    #[serde(skip)]
    pub rgba: Vec<u8>,
}

/// A punctual light (KHR_lights_punctual).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Light {
    /// Name in the file, or empty.
    pub name: String,
    /// Its kind.
    pub kind: LightKind,
    /// Position in local space, in metres; ignored for directional lights.
    pub position: Vec3,
    /// Unit vector in which the light travels; ignored for point lights.
    pub direction: Vec3,
    /// Linear RGB colour.
    pub color: Vec3,
    /// Candela for point and spot lights, lux for directional ones.
    pub intensity: f32,
    /// Distance beyond which the light ends, in metres; infinite when the file gives none, and for directional lights.
    pub range_m: f32,
}

impl Light {
    /// Whether any light comes from it: one of no intensity, or of black, is switched off.
    #[must_use]
    pub fn shines(&self) -> bool {
        self.intensity > 0.0 && self.color.max_element() > 0.0
    }
}

/// The kinds of punctual light.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum LightKind {
    /// Infinitely far away.
    Directional,
    /// Shines everywhere.
    Point,
    /// Shines into a cone around its direction.
    Spot {
        /// Angle from the axis up to which it shines fully, in radians.
        inner_cone_rad: f32,
        /// Angle from the axis beyond which it does not shine, in radians.
        outer_cone_rad: f32,
    },
}

impl Scene {
    /// Triangles that stop rays: those of OPAQUE and MASK draws, which come first.
    #[must_use]
    pub fn tracing_triangles(&self) -> &[[u32; 3]] {
        let end = self
            .draws
            .iter()
            .find(|draw| matches!(self.materials[draw.material as usize].alpha, AlphaMode::Blend))
            .map_or(self.triangles.len(), |draw| draw.first_triangle as usize);
        &self.triangles[..end]
    }
}
