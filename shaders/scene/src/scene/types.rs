//! A scene's parts: geometry, materials, pictures and lights.
//!
//! Positions are f32, relative to [`Scene::origin_m`], which is f64. Everything is flattened: node transforms are
//! applied, shared meshes are repeated, strips and fans become lists, mirrored nodes keep their front faces. What moves
//! is flattened in the pose of the file, and [`Scene::animation`] has it in its own space as well.

use glam::{DQuat, DVec3, Vec2, Vec3, Vec4};
use serde::{Deserialize, Serialize};

use super::{
    aabb::Aabb,
    animation::Animation,
    material::{AlphaMode, Material},
};

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
    /// Second texture coordinates, one for each vertex. Empty if no material reads them.
    pub uvs_1: Vec<Vec2>,
    /// Unit tangents and their handedness, ±1, one for each vertex; all zeros where the file has none. Empty if no
    /// vertex has one.
    pub tangents: Vec<Vec4>,
    /// Linear RGBA that multiplies the base colour, one for each vertex; 65535 is 1. Empty if all are white.
    pub colors: Vec<[u16; 4]>,
    /// Vertex indices, counter-clockwise seen from the front. No zero-area triangles.
    pub triangles: Vec<[u32; 3]>,
    /// Ranges of triangles with one material: OPAQUE first, then MASK, then BLEND. They cover `triangles` in order.
    pub draws: Vec<Draw>,
    pub materials: Vec<Material>,
    pub images: Vec<Image>,
    /// Lights, in the order of a mask's planes.
    pub lights: Vec<Light>,
    /// Cameras of the file, in the order of its nodes.
    pub cameras: Vec<NamedCamera>,
    /// Number of mesh instances in the file.
    pub instances: u32,
    /// What moves. The other fields have it in the pose of the file. `None` if everything rests.
    #[serde(skip)]
    pub animation: Option<Box<Animation>>,
}

/// A perspective camera of the file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NamedCamera {
    /// Name in the file, or empty.
    pub name: String,
    /// Position in world space, in metres.
    pub position_m: DVec3,
    /// Rotation from camera to world space, a unit quaternion.
    pub orientation: DQuat,
    /// Full vertical field of view, in radians.
    pub yfov_rad: f64,
}

impl Aabb {
    /// Returns the bounds of a scene's triangles. All zeros if there are none, or if they name no vertex.
    pub(crate) fn of(scene: &Scene) -> Self {
        let corners = scene.triangles.iter().flatten();
        Self::around(corners.filter_map(|corner| scene.positions.get(*corner as usize)))
    }
}

/// A range of one instance's triangles with one material.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Draw {
    pub first_triangle: u32,
    pub triangles: u32,
    pub material: u32,
}

/// A PNG, JPEG or WebP picture, with its size in pixels.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Image {
    /// The bytes that are sent: the file's, unless it had to be converted or scaled down.
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

impl Default for Scene {
    /// Returns a scene of nothing, which is not legal yet.
    fn default() -> Self {
        Self {
            origin_m: DVec3::ZERO,
            bounds: Aabb { min: Vec3::ZERO, max: Vec3::ZERO },
            positions: Vec::new(),
            normals: Vec::new(),
            uvs: Vec::new(),
            uvs_1: Vec::new(),
            tangents: Vec::new(),
            colors: Vec::new(),
            triangles: Vec::new(),
            draws: Vec::new(),
            materials: Vec::new(),
            images: Vec::new(),
            lights: Vec::new(),
            cameras: Vec::new(),
            instances: 0,
            animation: None,
        }
    }
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
