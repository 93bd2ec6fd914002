//! Reads materials and the textures of their base colours (glTF 2.0, §3.9).
//!
//! Only base colour, emission, alpha and sidedness are read. A material with an emissive *texture* does not emit: its
//! factor alone would make the whole surface glow, where the texture lights a few spots.

use std::collections::HashMap;

use glam::{Vec3, Vec4};
use gltf::json::{self, Index, texture::WrappingMode, validation::Checked};

use super::image::originals;
use crate::{
    AlphaMode, Material, Texture, Wrap,
    error::{SceneError, place},
    light::{f32_of, short_name},
    reader::json::{Document, Factors, source},
};

/// Extensions that bring pictures in formats that are not read.
const OTHER_FORMATS: [&str; 2] = ["EXT_texture_avif", "MSFT_texture_dds"];

/// Materials and images that the scene uses, in the order of their first use.
#[derive(Default)]
pub(crate) struct Materials {
    pub(crate) materials: Vec<Material>,
    pub(crate) images: Vec<Index<json::Image>>,
    /// See [`originals`].
    originals: Vec<Index<json::Image>>,
    by_index: HashMap<Option<Index<json::Material>>, u32>,
}

impl Materials {
    /// Returns the scene's index of a material of the file. `None` is the default material (§3.7.2.1).
    /// Errors if it is malformed, or its picture has a format that is not read.
    pub(crate) fn get(&mut self, document: &Document, index: Option<Index<json::Material>>) -> Result<u32, SceneError> {
        if let Some(known) = self.by_index.get(&index) {
            return Ok(*known);
        }
        let fallback = (json::Material::default(), Factors::default());
        let found = index.and_then(|index| Some((document.json.get(index)?, document.factors.get(index.value())?)));
        let (source, factors) = found.unwrap_or((&fallback.0, &fallback.1));
        let here = match index {
            Some(index) => place("material", index.value(), source.name.as_deref()),
            None => "the default material".to_owned(),
        };
        let texture = source.pbr_metallic_roughness.base_color_texture.as_ref();
        let texture = match texture {
            Some(info) => Some(self.texture(document, info.index)?),
            None => None,
        };
        let material = read(source, factors, texture, &here)?;
        // At most one more than the document has, which is bounded.
        let number = u32::try_from(self.materials.len()).unwrap_or(u32::MAX);
        self.materials.push(material);
        self.by_index.insert(index, number);
        Ok(number)
    }

    fn texture(&mut self, document: &Document, index: Index<json::Texture>) -> Result<Texture, SceneError> {
        let here = || place("texture", index.value(), None);
        let Some(texture) = document.json.get(index) else {
            return Err(SceneError::invalid(here(), "there is no such texture"));
        };
        let Some(source) = source(texture) else {
            let others = texture.extensions.as_ref().map(|extensions| &extensions.others);
            let there = |name: &&str| others.is_some_and(|others| others.contains_key(*name));
            return Err(match OTHER_FORMATS.into_iter().find(there) {
                Some(name) => SceneError::unsupported(here(), name),
                None => SceneError::invalid(here(), "it has no source image"),
            });
        };
        let wrap = |mode: Option<Checked<WrappingMode>>| match mode.unwrap_or_default() {
            Checked::Valid(WrappingMode::Repeat) => Ok(Wrap::Repeat),
            Checked::Valid(WrappingMode::MirroredRepeat) => Ok(Wrap::MirroredRepeat),
            Checked::Valid(WrappingMode::ClampToEdge) => Ok(Wrap::ClampToEdge),
            Checked::Invalid => {
                Err(SceneError::invalid(here(), "its sampler's wrap mode is not one of 10497, 33071 and 33648"))
            }
        };
        let sampler = texture.sampler.and_then(|sampler| document.json.get(sampler));
        let wrap_u = wrap(sampler.map(|sampler| sampler.wrap_s))?;
        let wrap_v = wrap(sampler.map(|sampler| sampler.wrap_t))?;
        if self.originals.is_empty() {
            self.originals = originals(&document.json);
        }
        let source = self.originals.get(source.value()).copied().unwrap_or(source);
        let known = self.images.iter().position(|image| *image == source);
        let image = known.unwrap_or_else(|| {
            self.images.push(source);
            self.images.len() - 1
        });
        Ok(Texture::new(u32::try_from(image).unwrap_or(u32::MAX), wrap_u, wrap_v))
    }
}

/// Checks every material of the file, used or not.
/// Errors if one is malformed.
pub(crate) fn check(document: &Document) -> Result<(), SceneError> {
    for (index, (material, factors)) in document.json.materials.iter().zip(&document.factors).enumerate() {
        read(material, factors, None, &place("material", index, material.name.as_deref()))?;
    }
    Ok(())
}

fn read(
    source: &json::Material,
    factors: &Factors,
    texture: Option<Texture>,
    here: &str,
) -> Result<Material, SceneError> {
    let invalid = |fault: String| SceneError::invalid(here, fault);
    let color = factors.base_color;
    if !color.iter().all(|v| (0.0..=1.0).contains(v)) {
        return Err(invalid(format!("its base colour factor {color:?} does not lie in 0 to 1")));
    }
    let (emissive, strength) = (factors.emissive, factors.emissive_strength);
    if !emissive.iter().all(|v| (0.0..=1.0).contains(v)) || !(0.0..=f64::from(f32::MAX)).contains(&strength) {
        return Err(invalid(format!("its emissive factor {emissive:?} or strength {strength} is out of range")));
    }
    let emissive = if factors.has_emissive_texture { [0.0; 3] } else { emissive.map(|v| v * strength) };
    let cutoff = factors.alpha_cutoff;
    if !(0.0..=f64::from(f32::MAX)).contains(&cutoff) {
        return Err(invalid(format!("its alpha cutoff {cutoff} is out of range")));
    }
    let alpha = match source.alpha_mode {
        Checked::Valid(json::material::AlphaMode::Opaque) => AlphaMode::Opaque,
        Checked::Valid(json::material::AlphaMode::Mask) => AlphaMode::Mask { cutoff: f32_of(cutoff) },
        Checked::Valid(json::material::AlphaMode::Blend) => AlphaMode::Blend,
        Checked::Invalid => return Err(invalid("its alpha mode is not OPAQUE, MASK or BLEND".to_owned())),
    };
    Ok(Material {
        name: short_name(source.name.as_deref()),
        base_color: Vec4::from_array(color.map(f32_of)),
        base_color_texture: texture,
        emissive: Vec3::from_array(emissive.map(f32_of)),
        alpha,
        double_sided: source.double_sided,
        ..Material::default()
    })
}
