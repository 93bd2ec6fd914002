//! Reads materials (glTF 2.0, §3.9) and their extensions. Factors out of range are brought into it; a texture that
//! cannot be placed is left out.

use glam::{Vec3, Vec4};
use gltf::json::Index;

use super::{
    coordinates::{Plan, set},
    texture::{ImageSource, Images},
};
use crate::{
    AlphaMode, Clearcoat, Material, Sheen, Specular, Texture, Transmission,
    light::{f32_of, short_name},
    reader::{
        json::{self, Document, SpecularGlossiness, TextureInfo},
        report::LoadReport,
    },
};

/// Reads one material.
pub(crate) struct MaterialReader<'a> {
    pub(crate) document: &'a Document,
    pub(crate) images: &'a mut Images,
    pub(crate) report: &'a mut LoadReport,
    /// A bit for each set of texture coordinates that the primitive has.
    pub(crate) sets: u32,
    pub(crate) place: &'a str,
    pub(crate) plan: Plan,
}

impl MaterialReader<'_> {
    /// Returns the material. What it reads of the vertices is in `plan` afterwards.
    pub(crate) fn read(&mut self, source: &json::Material) -> Material {
        let extensions = &source.extensions;
        for name in extensions.not_drawn() {
            self.report.not_drawn(name, self.place);
        }
        let base = &source.pbr_metallic_roughness;
        let mut material = Material {
            name: short_name(source.name.as_deref()),
            alpha: self.alpha(source),
            double_sided: source.double_sided,
            unlit: extensions.unlit,
            ..Material::default()
        };
        match &extensions.specular_glossiness {
            Some(other) => self.specular_glossiness(other, &mut material),
            None => {
                material.base_color = Vec4::from_array(base.base_color_factor.map(|v| self.share(v)));
                material.base_color_texture = self.base_color(base.base_color_texture.as_ref());
            }
        }
        if material.unlit {
            return material;
        }
        if extensions.specular_glossiness.is_none() {
            material.metallic = self.share(base.metallic_factor);
            material.roughness = self.share(base.roughness_factor);
            material.metallic_roughness_texture = self.texture(base.metallic_roughness_texture.as_ref());
            self.specular(source, &mut material);
        }
        material.normal_texture = self.texture(source.normal_texture.as_ref());
        material.normal_scale = normal_scale(source.normal_texture.as_ref());
        material.occlusion_texture = self.texture(source.occlusion_texture.as_ref());
        let strength = source.occlusion_texture.as_ref().and_then(|info| info.strength);
        material.occlusion_strength = strength.map_or(1.0, |strength| self.share(strength));
        material.emissive_texture = self.texture(source.emissive_texture.as_ref());
        // The factor alone would make the whole surface glow, where a lost texture lights a few spots.
        if source.emissive_texture.is_none() || material.emissive_texture.is_some() {
            material.emissive = self.emissive(source);
        }
        self.layers(source, &mut material);
        self.plan.tangents = material.normal_texture.is_some() || material.clearcoat.normal_texture.is_some();
        material
    }

    fn alpha(&mut self, source: &json::Material) -> AlphaMode {
        match source.alpha_mode.as_deref() {
            None | Some("OPAQUE") => AlphaMode::Opaque,
            Some("MASK") => AlphaMode::Mask { cutoff: self.amount(source.alpha_cutoff) },
            Some("BLEND") => AlphaMode::Blend,
            Some(_) => {
                self.report.mended("an alpha mode that is not OPAQUE, MASK or BLEND: taken for OPAQUE", self.place);
                AlphaMode::Opaque
            }
        }
    }

    fn emissive(&mut self, source: &json::Material) -> Vec3 {
        if source.emissive_factor.iter().any(|v| *v > 1.0) {
            self.report.mended("an emissive factor above 1: kept, as if by emissive strength", self.place);
        }
        let strength = source.extensions.emissive_strength.as_ref().and_then(|extension| extension.emissive_strength);
        let strength = strength.unwrap_or(1.0);
        Vec3::from_array(source.emissive_factor.map(|v| self.amount(v.max(0.0) * strength)))
    }

    fn specular(&mut self, source: &json::Material, material: &mut Material) {
        if let Some(ior) = source.extensions.ior.as_ref().and_then(|extension| extension.ior) {
            // 0 has a meaning of its own.
            if ior != 0.0 && ior < 1.0 {
                self.report.mended("an index of refraction below 1: taken for 1", self.place);
            }
            material.ior = if ior == 0.0 { 0.0 } else { f32_of(ior.clamp(1.0, f64::from(f32::MAX))) };
        }
        let Some(specular) = &source.extensions.specular else { return };
        material.specular = Specular {
            strength: specular.specular_factor.map_or(1.0, |v| self.share(v)),
            strength_texture: self.texture(specular.specular_texture.as_ref()),
            color: specular.specular_color_factor.map_or(Vec3::ONE, |color| self.color(color)),
            color_texture: self.texture(specular.specular_color_texture.as_ref()),
        };
    }

    /// KHR_materials_pbrSpecularGlossiness. An index of refraction of 0 lets the specular colour be the reflectance at
    /// normal incidence. Roughness is 1 − glossiness; where a texture has the glossiness, one of roughness is made.
    fn specular_glossiness(&mut self, source: &SpecularGlossiness, material: &mut Material) {
        material.base_color = Vec4::from_array(source.diffuse_factor.unwrap_or([1.0; 4]).map(|v| self.share(v)));
        material.base_color_texture = self.base_color(source.diffuse_texture.as_ref());
        let glossiness = self.share(source.glossiness_factor.unwrap_or(1.0));
        material.ior = 0.0;
        material.roughness = 1.0 - glossiness;
        material.specular.color = source.specular_factor.map_or(Vec3::ONE, |color| self.color(color));
        if material.unlit {
            return;
        }
        let Some(texture) = self.texture(source.specular_glossiness_texture.as_ref()) else { return };
        material.specular.color_texture = Some(texture);
        let baked = ImageSource::Roughness { image: texture.image, glossiness: glossiness.to_bits() };
        material.roughness = 1.0;
        material.metallic_roughness_texture =
            Some(Texture { image: self.images.index(self.document, baked), ..texture });
    }

    fn layers(&mut self, source: &json::Material, material: &mut Material) {
        let extensions = &source.extensions;
        if let Some(clearcoat) = &extensions.clearcoat {
            material.clearcoat = Clearcoat {
                strength: self.share(clearcoat.clearcoat_factor),
                strength_texture: self.texture(clearcoat.clearcoat_texture.as_ref()),
                roughness: self.share(clearcoat.clearcoat_roughness_factor),
                roughness_texture: self.texture(clearcoat.clearcoat_roughness_texture.as_ref()),
                normal_texture: self.texture(clearcoat.clearcoat_normal_texture.as_ref()),
                normal_scale: normal_scale(clearcoat.clearcoat_normal_texture.as_ref()),
            };
        }
        if let Some(sheen) = &extensions.sheen {
            material.sheen = Sheen {
                color: self.color(sheen.sheen_color_factor),
                color_texture: self.texture(sheen.sheen_color_texture.as_ref()),
                roughness: self.share(sheen.sheen_roughness_factor),
                roughness_texture: self.texture(sheen.sheen_roughness_texture.as_ref()),
            };
        }
        if let Some(transmission) = &extensions.transmission {
            material.transmission = Transmission {
                factor: self.share(transmission.transmission_factor),
                texture: self.texture(transmission.transmission_texture.as_ref()),
            };
        }
    }

    fn base_color(&mut self, info: Option<&TextureInfo>) -> Option<Texture> {
        let info = info?;
        let texture = self.sampled(info)?;
        self.plan.place_base(info);
        Some(texture)
    }

    fn texture(&mut self, info: Option<&TextureInfo>) -> Option<Texture> {
        let info = info?;
        let before = self.plan;
        let texture = self.sampled(info)?;
        match self.plan.place(info) {
            Ok(coordinates) => Some(Texture { coordinates, ..texture }),
            Err(fault) => {
                self.plan = before;
                self.report.left_out(fault, self.place);
                None
            }
        }
    }

    /// Returns a texture without its place. `None` if the primitive lacks its coordinates, or it has no picture.
    fn sampled(&mut self, info: &TextureInfo) -> Option<Texture> {
        if 1_u32.checked_shl(set(info)).is_none_or(|bit| self.sets & bit == 0) {
            self.report.left_out("a texture without texture coordinates", self.place);
            return None;
        }
        self.images.texture(self.document, Index::new(info.index), self.report)
    }

    /// Brings a factor into 0 to 1.
    fn share(&mut self, value: f64) -> f32 {
        if !(0.0..=1.0).contains(&value) {
            self.report.mended("a material's factor outside 0 to 1: the nearest end", self.place);
        }
        f32_of(value.clamp(0.0, 1.0))
    }

    /// Brings a number into 0 to the largest f32.
    fn amount(&mut self, value: f64) -> f32 {
        let most = f64::from(f32::MAX);
        if !(0.0..=most).contains(&value) {
            self.report.mended("a material's number that is negative or too large: the nearest end", self.place);
        }
        f32_of(value.clamp(0.0, most))
    }

    fn color(&mut self, color: [f64; 3]) -> Vec3 {
        Vec3::from_array(color.map(|v| self.amount(v)))
    }
}

fn normal_scale(info: Option<&TextureInfo>) -> f32 {
    let most = f64::from(f32::MAX);
    f32_of(info.and_then(|info| info.scale).unwrap_or(1.0).clamp(-most, most))
}
