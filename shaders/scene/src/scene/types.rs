//! A scene's parts: geometry, materials, pictures and lights.
//!
//! Positions are f32, relative to [`Scene::origin_m`], which is f64. Nothing moves, so everything is flattened: node
//! transforms are applied, shared meshes are repeated, strips and fans become lists, mirrored nodes keep their front
//! faces.

use glam::{DVec3, Vec2, Vec3, Vec4};
use serde::{Deserialize, Serialize};

/// A loaded scene. [`Scene::check`] holds for it: every index is in range, every position, normal and UV is finite,
/// normals and light directions are unit vectors, and there are 1 to 32 lights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scene {
    /// World position of the local origin, in metres.
    pub origin_m: DVec3,
    /// Bounds of all triangles in local space, in metres.
    pub bounds: Aabb,
    /// Vertex positions in local space, in metres.
    pub positions: Vec<Vec3>,
    /// Unit shading normals, one for each vertex.
    pub normals: Vec<Vec3>,
    /// Base colour texture coordinates, one for each vertex, transform applied. (0, 0) is the picture's upper left.
    pub uvs: Vec<Vec2>,
    /// Vertex indices, counter-clockwise seen from the front. No zero-area triangles.
    pub triangles: Vec<[u32; 3]>,
    /// Ranges of triangles with one material: OPAQUE first, then MASK, then BLEND. They cover `triangles` in order.
    pub draws: Vec<Draw>,
    pub materials: Vec<Material>,
    pub images: Vec<Image>,
    /// Lights, in the order of a mask's planes.
    pub lights: Vec<Light>,
    /// Number of mesh instances in the file.
    pub instances: u32,
}

/// An axis-aligned box, in metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Aabb {
    pub min: Vec3,
    pub max: Vec3,
}

impl Aabb {
    /// Returns the bounds of a scene's triangles. All zeros if there are none, or if they name no vertex.
    pub(crate) fn of(scene: &Scene) -> Self {
        let corners = scene.triangles.iter().flatten();
        let mut positions = corners.filter_map(|corner| scene.positions.get(*corner as usize));
        let Some(first) = positions.next() else { return Self { min: Vec3::ZERO, max: Vec3::ZERO } };
        let (min, max) =
            positions.fold((*first, *first), |(min, max), position| (min.min(*position), max.max(*position)));
        Self { min, max }
    }
}

/// A range of one instance's triangles with one material.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Draw {
    pub first_triangle: u32,
    pub triangles: u32,
    pub material: u32,
}

/// How a material treats alpha (glTF 2.0, §3.9.4).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum AlphaMode {
    Opaque,
    /// A point is solid if its alpha is at least the cutoff. Rays pass elsewhere.
    Mask {
        cutoff: f32,
    },
    /// Blended over what lies behind it. It stops no rays and has no visibility of its own.
    Blend,
}

impl AlphaMode {
    /// Position in the order of draws: OPAQUE, MASK, BLEND.
    pub(crate) fn order(self) -> usize {
        match self {
            Self::Opaque => 0,
            Self::Mask { .. } => 1,
            Self::Blend => 2,
        }
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// Name in the file, or empty.
    pub name: String,
    /// Linear RGBA factor, each 0 to 1.
    pub base_color: Vec4,
    /// Multiplies the factor: sRGB colour, linear alpha.
    pub base_color_texture: Option<Texture>,
    /// Linear RGB light that it emits.
    pub emissive: Vec3,
    pub alpha: AlphaMode,
    /// Drawn from both sides. Back faces of other materials are not drawn, but cast shadows.
    pub double_sided: bool,
}

/// A picture and how it repeats. Filtering is bilinear. Alpha tests read the full-size picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Texture {
    pub image: u32,
    pub wrap_u: Wrap,
    pub wrap_v: Wrap,
}

/// How a texture continues outside 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Wrap {
    Repeat,
    MirroredRepeat,
    ClampToEdge,
}

/// A PNG or JPEG picture, with its size in pixels.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Image {
    /// The file's bytes, which are sent.
    pub encoded: Vec<u8>,
    pub width: u32,
    pub height: u32,
    /// Decoded RGBA, 8 bits a channel, row by row from the top. Not sent.
    #[serde(skip)]
    pub rgba: Vec<u8>,
}

/// A punctual light (KHR_lights_punctual).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Light {
    /// Name in the file, or empty.
    pub name: String,
    pub kind: LightKind,
    /// Position in local space, in metres. Ignored for directional lights.
    pub position: Vec3,
    /// Unit vector in which the light travels. Ignored for point lights.
    pub direction: Vec3,
    /// Linear RGB.
    pub color: Vec3,
    /// Candela for point and spot lights, lux for directional ones.
    pub intensity: f32,
    /// Distance at which the light ends, in metres. Infinite for directional lights and if the file gives none.
    pub range_m: f32,
}

impl Light {
    /// Returns whether the light is on: neither its intensity nor its colour is zero.
    #[must_use]
    pub fn shines(&self) -> bool {
        self.intensity > 0.0 && self.color.max_element() > 0.0
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum LightKind {
    Directional,
    Point,
    /// Shines into a cone around its direction. Angles are from the cone's axis, in radians.
    Spot {
        /// Full intensity up to here.
        inner_cone_rad: f32,
        /// No light beyond here.
        outer_cone_rad: f32,
    },
}

impl Scene {
    /// Returns the triangles that may stop rays: those of OPAQUE and MASK draws, which come first.
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
