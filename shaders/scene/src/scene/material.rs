//! How a surface answers light: glTF's metallic-roughness model (glTF 2.0, §3.9) and the layers that extensions add.
//!
//! Colours are linear. A texture multiplies its factor; where there is none, it counts as white.

use glam::{Vec3, Vec4};
use serde::{Deserialize, Serialize};

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
    /// RGBA factor, each 0 to 1.
    pub base_color: Vec4,
    /// sRGB colour, linear alpha. Its coordinates are [`Scene::uvs`](crate::Scene::uvs) as they are: tracers read them.
    pub base_color_texture: Option<Texture>,
    /// 0 for paint to 1 for metal.
    pub metallic: f32,
    /// 0 for a mirror to 1 for chalk. The square root of the α of GGX.
    pub roughness: f32,
    /// Roughness in green, metallic in blue.
    pub metallic_roughness_texture: Option<Texture>,
    /// Normals in tangent space, v pointing down in the picture.
    pub normal_texture: Option<Texture>,
    /// Multiplies the texture's x and y.
    pub normal_scale: f32,
    /// Share of the light around that arrives, in red.
    pub occlusion_texture: Option<Texture>,
    /// 0 ignores the occlusion texture, 1 takes all of it.
    pub occlusion_strength: f32,
    /// RGB light that it emits, strength included.
    pub emissive: Vec3,
    /// sRGB.
    pub emissive_texture: Option<Texture>,
    /// Shown in its base colour, whatever the light (KHR_materials_unlit).
    pub unlit: bool,
    /// Index of refraction (KHR_materials_ior): 1.5 for most things. 0 reflects like an ideal mirror at any angle.
    pub ior: f32,
    pub specular: Specular,
    pub clearcoat: Clearcoat,
    pub sheen: Sheen,
    pub transmission: Transmission,
    pub alpha: AlphaMode,
    /// Drawn from both sides. Back faces of other materials are not drawn, but cast shadows.
    pub double_sided: bool,
}

impl Default for Material {
    /// White, opaque, single-sided chalk. (The default material of glTF, §3.7.2.1, is metal.)
    fn default() -> Self {
        Self {
            name: String::new(),
            base_color: Vec4::ONE,
            base_color_texture: None,
            metallic: 0.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            normal_texture: None,
            normal_scale: 1.0,
            occlusion_texture: None,
            occlusion_strength: 1.0,
            emissive: Vec3::ZERO,
            emissive_texture: None,
            unlit: false,
            ior: 1.5,
            specular: Specular::default(),
            clearcoat: Clearcoat::default(),
            sheen: Sheen::default(),
            transmission: Transmission::default(),
            alpha: AlphaMode::Opaque,
            double_sided: false,
        }
    }
}

/// Strength and tint of what a dielectric reflects (KHR_materials_specular).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Specular {
    /// 0 to 1.
    pub strength: f32,
    /// In alpha.
    pub strength_texture: Option<Texture>,
    /// At normal incidence; may be above 1.
    pub color: Vec3,
    /// sRGB.
    pub color_texture: Option<Texture>,
}

impl Default for Specular {
    fn default() -> Self {
        Self { strength: 1.0, strength_texture: None, color: Vec3::ONE, color_texture: None }
    }
}

/// A clear lacquer over everything else (KHR_materials_clearcoat).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Clearcoat {
    /// 0, no lacquer, to 1.
    pub strength: f32,
    /// In red.
    pub strength_texture: Option<Texture>,
    pub roughness: f32,
    /// In green.
    pub roughness_texture: Option<Texture>,
    /// Without one, the lacquer has the surface's own normal, not the material's normal map.
    pub normal_texture: Option<Texture>,
    pub normal_scale: f32,
}

impl Default for Clearcoat {
    fn default() -> Self {
        Self {
            strength: 0.0,
            strength_texture: None,
            roughness: 0.0,
            roughness_texture: None,
            normal_texture: None,
            normal_scale: 1.0,
        }
    }
}

/// Cloth fibres that shine at grazing angles (KHR_materials_sheen).
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Sheen {
    /// Black without sheen.
    pub color: Vec3,
    /// sRGB.
    pub color_texture: Option<Texture>,
    pub roughness: f32,
    /// In alpha.
    pub roughness_texture: Option<Texture>,
}

/// Light that passes a thin surface (KHR_materials_transmission).
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Transmission {
    /// Share of the light that is not reflected, 0 to 1.
    pub factor: f32,
    /// In red.
    pub texture: Option<Texture>,
}

/// A picture, how it repeats, how it is filtered, and where it lies on the surface. Alpha tests read the full-size
/// picture bilinearly, whatever the filters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Texture {
    pub image: u32,
    pub wrap_u: Wrap,
    pub wrap_v: Wrap,
    /// Between texels where the picture is enlarged.
    pub magnified: Filter,
    /// Between texels of a mip where the picture is reduced.
    pub minified: Filter,
    /// Between mips. `None` reads the full-size picture alone.
    pub mips: Option<Filter>,
    pub coordinates: Coordinates,
}

impl Texture {
    /// Returns a texture with smooth filters that lies where [`Scene::uvs`](crate::Scene::uvs) say.
    #[must_use]
    pub fn new(image: u32, wrap_u: Wrap, wrap_v: Wrap) -> Self {
        Self {
            image,
            wrap_u,
            wrap_v,
            magnified: Filter::Linear,
            minified: Filter::Linear,
            mips: Some(Filter::Linear),
            coordinates: Coordinates::default(),
        }
    }
}

/// How a texture continues outside 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Wrap {
    Repeat,
    MirroredRepeat,
    ClampToEdge,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Filter {
    Nearest,
    Linear,
}

/// Where a texture lies: an affine map of one of a vertex's texture coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Coordinates {
    /// Reads [`Scene::uvs_1`](crate::Scene::uvs_1) instead of [`Scene::uvs`](crate::Scene::uvs).
    pub second: bool,
    /// A row for u and one for v, each to be multiplied with (u, v, 1).
    pub map: [Vec3; 2],
}

impl Coordinates {
    /// Whether texture coordinates are used as they are.
    #[must_use]
    pub fn is_identity(&self) -> bool {
        self.map == [Vec3::X, Vec3::Y]
    }
}

impl Default for Coordinates {
    fn default() -> Self {
        Self { second: false, map: [Vec3::X, Vec3::Y] }
    }
}

impl Material {
    /// Every texture of the material, the base colour's first.
    pub fn textures(&self) -> impl Iterator<Item = &Texture> {
        [
            &self.base_color_texture,
            &self.metallic_roughness_texture,
            &self.normal_texture,
            &self.occlusion_texture,
            &self.emissive_texture,
            &self.specular.strength_texture,
            &self.specular.color_texture,
            &self.clearcoat.strength_texture,
            &self.clearcoat.roughness_texture,
            &self.clearcoat.normal_texture,
            &self.sheen.color_texture,
            &self.sheen.roughness_texture,
            &self.transmission.texture,
        ]
        .into_iter()
        .flatten()
    }

    /// The places of all textures, in the same order.
    pub(crate) fn textures_mut(&mut self) -> [&mut Option<Texture>; 13] {
        [
            &mut self.base_color_texture,
            &mut self.metallic_roughness_texture,
            &mut self.normal_texture,
            &mut self.occlusion_texture,
            &mut self.emissive_texture,
            &mut self.specular.strength_texture,
            &mut self.specular.color_texture,
            &mut self.clearcoat.strength_texture,
            &mut self.clearcoat.roughness_texture,
            &mut self.clearcoat.normal_texture,
            &mut self.sheen.color_texture,
            &mut self.sheen.roughness_texture,
            &mut self.transmission.texture,
        ]
    }
}
