//! Materials, and the textures of their base colours (glTF 2.0, §3.9).
//!
//! Not read: everything but base colour, emission, alpha and sidedness. A material with an emissive *texture* does not
//! shine: its factor alone would make the whole surface glow where the texture lets a few spots do so.

use std::collections::HashMap;

use glam::{Vec3, Vec4};

use crate::reader::json::document::{self, Document};
use crate::{
    AlphaMode, Material, Texture, Wrap,
    error::{SceneError, place},
    light::{f32_of, short_name},
};

/// Materials and images that the drawn triangles use, in the order of their first use.
#[derive(Default)]
pub(crate) struct Materials {
    /// Read materials.
    pub(crate) materials: Vec<Material>,
    /// Images in the JSON that they use.
    pub(crate) images: Vec<u32>,
    by_index: HashMap<Option<u32>, u32>,
}

impl Materials {
    /// The scene's index of a material of the file; None is the default material (§3.7.2.1).
    ///
    /// # Errors
    /// When it is malformed, or its picture has a format that is not read.
    pub(crate) fn get(&mut self, document: &Document<'_>, index: Option<u32>) -> Result<u32, SceneError> {
        if let Some(known) = self.by_index.get(&index) {
            return Ok(*known);
        }
        let fallback = document::Material::default();
        let source = index.and_then(|index| document.materials.get(index as usize)).unwrap_or(&fallback);
        let here = match index {
            Some(index) => place("material", index as usize, source.name.as_deref()),
            None => "the default material".to_owned(),
        };
        let texture = source.pbr_metallic_roughness.base_color_texture.as_ref();
        let texture = match texture {
            Some(info) => Some(self.texture(document, info.index)?),
            None => None,
        };
        let material = read(source, texture, &here)?;
        // At most one more than the document has, which is bounded.
        let number = u32::try_from(self.materials.len()).unwrap_or(u32::MAX);
        self.materials.push(material);
        self.by_index.insert(index, number);
        Ok(number)
    }

    fn texture(&mut self, document: &Document<'_>, index: u32) -> Result<Texture, SceneError> {
        let here = || place("texture", index as usize, None);
        let Some(texture) = document.textures.get(index as usize) else {
            return Err(SceneError::invalid(here(), "there is no such texture"));
        };
        let Some(source) = texture.source else {
            let extensions = &texture.extensions;
            let other = [
                (extensions.basisu, "KHR_texture_basisu"),
                (extensions.webp, "EXT_texture_webp"),
                (extensions.avif, "EXT_texture_avif"),
                (extensions.dds, "MSFT_texture_dds"),
            ];
            return Err(match other.iter().find(|(there, _)| there.is_some()) {
                Some((_, name)) => SceneError::unsupported(here(), *name),
                None => SceneError::invalid(here(), "it has no source image"),
            });
        };
        let wrap = |code: Option<u32>| match code {
            None | Some(10497) => Ok(Wrap::Repeat),
            Some(33648) => Ok(Wrap::MirroredRepeat),
            Some(33071) => Ok(Wrap::ClampToEdge),
            Some(code) => Err(SceneError::invalid(here(), format!("its sampler's wrap mode {code} does not exist"))),
        };
        let sampler = texture.sampler.and_then(|sampler| document.samplers.get(sampler as usize));
        let wrap_u = wrap(sampler.and_then(|sampler| sampler.wrap_s))?;
        let wrap_v = wrap(sampler.and_then(|sampler| sampler.wrap_t))?;
        let known = self.images.iter().position(|image| *image == source);
        let image = known.unwrap_or_else(|| {
            self.images.push(source);
            self.images.len() - 1
        });
        Ok(Texture { image: u32::try_from(image).unwrap_or(u32::MAX), wrap_u, wrap_v })
    }
}

/// Checks every material of the file, used or not.
///
/// # Errors
/// When one is malformed.
pub(crate) fn check(document: &Document<'_>) -> Result<(), SceneError> {
    for (index, material) in document.materials.iter().enumerate() {
        read(material, None, &place("material", index, material.name.as_deref()))?;
    }
    Ok(())
}

fn read(source: &document::Material, texture: Option<Texture>, here: &str) -> Result<Material, SceneError> {
    let invalid = |fault: String| SceneError::invalid(here, fault);
    let color = source.pbr_metallic_roughness.base_color_factor.unwrap_or([1.0; 4]);
    if !color.iter().all(|v| (0.0..=1.0).contains(v)) {
        return Err(invalid(format!("its base colour factor {color:?} does not lie in 0 to 1")));
    }
    let emissive = source.emissive_factor.unwrap_or([0.0; 3]);
    let strength = source.extensions.emissive_strength.as_ref().and_then(|e| e.emissive_strength).unwrap_or(1.0);
    if !emissive.iter().all(|v| (0.0..=1.0).contains(v)) || !(0.0..=f64::from(f32::MAX)).contains(&strength) {
        return Err(invalid(format!("its emissive factor {emissive:?} or strength {strength} is out of range")));
    }
    let emissive = if source.emissive_texture.is_some() { [0.0; 3] } else { emissive.map(|v| v * strength) };
    let cutoff = source.alpha_cutoff.unwrap_or(0.5);
    if !(0.0..=f64::from(f32::MAX)).contains(&cutoff) {
        return Err(invalid(format!("its alpha cutoff {cutoff} is out of range")));
    }
    let alpha = match source.alpha_mode.as_deref() {
        None | Some("OPAQUE") => AlphaMode::Opaque,
        Some("MASK") => AlphaMode::Mask { cutoff: f32_of(cutoff) },
        Some("BLEND") => AlphaMode::Blend,
        Some(other) => return Err(invalid(format!("its alpha mode {other:.32?} does not exist"))),
    };
    Ok(Material {
        name: short_name(source.name.as_deref()),
        base_color: Vec4::from_array(color.map(f32_of)),
        base_color_texture: texture,
        emissive: Vec3::from_array(emissive.map(f32_of)),
        alpha,
        double_sided: source.double_sided,
    })
}
