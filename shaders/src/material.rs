//! Materials as the shading shaders read them. Their twins are in `wgsl/shading/`.

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec4};

use gnomon_scene::{AlphaMode, Material as SceneMaterial, Texture};

use crate::host::wrap;

/// Bits of `FEATURES` of `surface.wgsl`: what a material has. What it lacks is compiled out.
pub mod features {
    pub const BASE_COLOR: u32 = 1;
    pub const METALLIC_ROUGHNESS: u32 = 2;
    pub const NORMAL: u32 = 4;
    pub const OCCLUSION: u32 = 8;
    pub const EMISSIVE: u32 = 16;
    pub const COAT: u32 = 32;
    pub const COAT_NORMAL: u32 = 64;
    /// Colour and strength of what is mirrored, or colour and roughness of the sheen.
    pub const TINT: u32 = 128;
    pub const TRANSMISSION: u32 = 256;
    /// Some texture has coordinates of its own.
    pub const MAPPED: u32 = 512;
    /// Occlusion is in the red of the metallic-roughness texture.
    pub const OCCLUSION_IN_RED: u32 = 1024;
    pub const TANGENTS: u32 = 2048;
    pub const COLORS: u32 = 4096;
    /// Emits its base colour and answers no light.
    pub const UNLIT: u32 = 8192;

    /// Those that need more of a vertex than position, normal and first texture coordinates.
    pub const OF_VERTICES: u32 = MAPPED | TANGENTS | COLORS;
}

/// Textures of a material but the base colour's.
pub const MORE_TEXTURES: usize = 8;

/// Where a texture lies. Twin of `TextureMap` in `material.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct TextureMap {
    /// To be multiplied with (u, v, 1).
    pub u: Vec3,
    /// 1 if it reads the second texture coordinates.
    pub second: u32,
    /// As `u`.
    pub v: Vec3,
    pub unused: u32,
}

impl TextureMap {
    fn new(texture: Option<&Texture>) -> Self {
        let coordinates = texture.map(|texture| texture.coordinates).unwrap_or_default();
        let [u, v] = coordinates.map;
        Self { u, second: coordinates.second.into(), v, unused: 0 }
    }
}

/// A material's factors. Twin of `Material` in `material.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Material {
    /// Linear RGBA factor.
    pub base_color: Vec4,
    /// A MASK point is drawn if its alpha is at least this.
    pub alpha_cutoff: f32,
    /// Index into the table of finishes.
    pub index: u32,
    /// How u of the base colour wraps outside 0 to 1: 0 repeats, 1 repeats mirrored, 2 clamps to the edge.
    pub wrap_u: u32,
    /// How v wraps.
    pub wrap_v: u32,
    /// Emitted light, exposed.
    pub emissive: Vec3,
    pub metallic: f32,
    pub roughness: f32,
    pub normal_scale: f32,
    pub occlusion_strength: f32,
    pub coat: f32,
    pub coat_roughness: f32,
    pub coat_normal_scale: f32,
    pub transmission: f32,
    pub unused: f32,
    /// Of [`more_textures`].
    pub maps: [TextureMap; MORE_TEXTURES],
}

impl Material {
    /// `emissive` is the exposed radiance of an emissive factor of 1.
    #[must_use]
    pub fn new(material: &SceneMaterial, index: u32, emissive: f32) -> Self {
        let (wrap_u, wrap_v) =
            material.base_color_texture.map_or((0, 0), |texture| (wrap(texture.wrap_u), wrap(texture.wrap_v)));
        let alpha_cutoff = match material.alpha {
            AlphaMode::Mask { cutoff } => cutoff,
            AlphaMode::Opaque | AlphaMode::Blend => 0.0,
        };
        Self {
            base_color: material.base_color,
            alpha_cutoff,
            index,
            wrap_u,
            wrap_v,
            emissive: material.emissive * emissive,
            metallic: material.metallic,
            roughness: material.roughness,
            normal_scale: material.normal_scale,
            occlusion_strength: material.occlusion_strength,
            coat: material.clearcoat.strength,
            coat_roughness: material.clearcoat.roughness,
            coat_normal_scale: material.clearcoat.normal_scale,
            transmission: material.transmission.factor,
            unused: 0.0,
            maps: more_textures(material).map(|texture| TextureMap::new(texture.as_ref())),
        }
    }
}

/// A material's textures but the base colour's, in the order of their bindings in `surface.wgsl`.
///
/// There is one for the lacquer's strength and roughness, and one for the tint of what is mirrored or of the sheen:
/// that is what fits WebGPU's 16 textures. Where a file has two pictures, the second counts as white.
#[must_use]
pub fn more_textures(material: &SceneMaterial) -> [Option<Texture>; MORE_TEXTURES] {
    if material.unlit {
        return [None; MORE_TEXTURES];
    }
    let occlusion = material.occlusion_texture.filter(|_| material.occlusion_strength > 0.0);
    let coat = &material.clearcoat;
    let lacquered = coat.strength > 0.0;
    [
        material.metallic_roughness_texture,
        material.normal_texture,
        occlusion.filter(|_| !occlusion_in_red(material)),
        material.emissive_texture.filter(|_| material.emissive != Vec3::ZERO),
        coat.strength_texture.or(coat.roughness_texture).filter(|_| lacquered),
        coat.normal_texture.filter(|_| lacquered),
        tint(material).map(|(texture, _)| texture),
        material.transmission.texture.filter(|_| material.transmission.factor > 0.0),
    ]
}

/// Whether occlusion and roughness are read from one picture at one place.
fn occlusion_in_red(material: &SceneMaterial) -> bool {
    material.occlusion_texture.is_some() && material.occlusion_texture == material.metallic_roughness_texture
}

/// The texture that tints, and what its texels are.
fn tint(material: &SceneMaterial) -> Option<(Texture, u32)> {
    let (specular, sheen) = (&material.specular, &material.sheen);
    let sheen_texture = sheen.color_texture.or(sheen.roughness_texture).filter(|_| sheen.color != Vec3::ZERO);
    // The lacquer's normal has the place in the G-buffer.
    if has_coat_normal(material) {
        return None;
    }
    let specular_texture = specular.color_texture.or(specular.strength_texture);
    specular_texture
        .map(|texture| (texture, Finish::SPECULAR))
        .or(sheen_texture.map(|texture| (texture, Finish::SHEEN)))
}

fn has_coat_normal(material: &SceneMaterial) -> bool {
    let coat = &material.clearcoat;
    coat.strength > 0.0 && (coat.normal_texture.is_some() || material.normal_texture.is_some())
}

/// The [`features`] that follow from the material alone, without those of its vertices.
#[must_use]
pub fn features_of(material: &SceneMaterial) -> u32 {
    let textures = more_textures(material);
    let mut found = if material.base_color_texture.is_some() { features::BASE_COLOR } else { 0 };
    for (place, texture) in textures.iter().enumerate() {
        let Some(texture) = texture else { continue };
        found |= features::METALLIC_ROUGHNESS << place;
        if texture.coordinates.second || !texture.coordinates.is_identity() {
            found |= features::MAPPED;
        }
    }
    if material.unlit {
        found |= features::UNLIT;
    } else if occlusion_in_red(material) && material.occlusion_strength > 0.0 {
        found |= features::OCCLUSION_IN_RED;
    }
    found
}

/// A material's constants that shading reads. Twin of `Finish` in `finish.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Finish {
    /// What a dielectric mirrors at normal incidence, before `strength`.
    pub mirrored: Vec3,
    /// Of what a dielectric mirrors.
    pub strength: f32,
    pub sheen: Vec3,
    pub sheen_roughness: f32,
    /// What the last word of the G-buffer's surface holds.
    pub last: u32,
    pub unused: [u32; 3],
}

impl Finish {
    const COAT_NORMAL: u32 = 1;
    const SPECULAR: u32 = 2;
    const SHEEN: u32 = 3;

    #[must_use]
    pub fn new(material: &SceneMaterial) -> Self {
        if material.unlit {
            return Self::zeroed();
        }
        // KHR_materials_ior: 0 mirrors everything.
        let normal = if material.ior > 0.0 { ((material.ior - 1.0) / (material.ior + 1.0)).powi(2) } else { 1.0 };
        let last = if has_coat_normal(material) { Self::COAT_NORMAL } else { tint(material).map_or(0, |(_, of)| of) };
        Self {
            mirrored: material.specular.color * normal,
            strength: material.specular.strength,
            sheen: material.sheen.color,
            sheen_roughness: material.sheen.roughness,
            last,
            unused: [0; 3],
        }
    }
}

/// Whether the shaders need more than metallic-roughness for this material.
#[must_use]
pub fn is_layered(material: &SceneMaterial) -> bool {
    let layers = material.clearcoat.strength > 0.0 || material.sheen.color != Vec3::ZERO || tint(material).is_some();
    layers && !material.unlit
}

#[cfg(test)]
mod tests {
    use gnomon_scene::Wrap;

    use super::*;

    #[test]
    fn a_material_has_the_features_that_it_uses() {
        let texture = Some(Texture::new(0, Wrap::Repeat, Wrap::Repeat));
        let mut material =
            SceneMaterial { normal_texture: texture, emissive_texture: texture, ..SceneMaterial::default() };
        assert_eq!(features_of(&material), features::NORMAL);
        material.emissive = Vec3::ONE;
        assert_eq!(features_of(&material), features::NORMAL | features::EMISSIVE);
        material.metallic_roughness_texture = texture;
        material.occlusion_texture = texture;
        let together = features::METALLIC_ROUGHNESS | features::OCCLUSION_IN_RED;
        assert_eq!(features_of(&material), features::NORMAL | features::EMISSIVE | together);
        material.occlusion_texture = Some(Texture::new(1, Wrap::Repeat, Wrap::Repeat));
        let apart = features::METALLIC_ROUGHNESS | features::OCCLUSION;
        assert_eq!(features_of(&material), features::NORMAL | features::EMISSIVE | apart);
        material.unlit = true;
        assert_eq!(features_of(&material), features::UNLIT);
    }

    #[test]
    fn glass_mirrors_a_twenty_fifth_and_diamond_a_sixth() {
        let mirrored = |ior| Finish::new(&SceneMaterial { ior, ..SceneMaterial::default() }).mirrored.x;
        assert!((mirrored(1.5) - 0.04).abs() < 1e-6);
        assert!((mirrored(2.42) - (1.42_f32 / 3.42).powi(2)).abs() < 1e-6);
        assert_eq!(mirrored(0.0), 1.0);
    }
}
