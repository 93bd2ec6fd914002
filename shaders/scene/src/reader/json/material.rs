//! A material's properties (glTF 2.0, §5.19) and those of its extensions, with the defaults filled in.

use serde::Deserialize;

/// A material, unchecked.
#[derive(Deserialize, Clone)]
#[serde(default, rename_all = "camelCase")]
pub(crate) struct Material {
    pub(crate) name: Option<String>,
    pub(crate) pbr_metallic_roughness: MetallicRoughness,
    pub(crate) normal_texture: Option<TextureInfo>,
    pub(crate) occlusion_texture: Option<TextureInfo>,
    pub(crate) emissive_texture: Option<TextureInfo>,
    pub(crate) emissive_factor: [f64; 3],
    pub(crate) alpha_mode: Option<String>,
    pub(crate) alpha_cutoff: f64,
    pub(crate) double_sided: bool,
    pub(crate) extensions: Extensions,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            name: None,
            pbr_metallic_roughness: MetallicRoughness::default(),
            normal_texture: None,
            occlusion_texture: None,
            emissive_texture: None,
            emissive_factor: [0.0; 3],
            alpha_mode: None,
            alpha_cutoff: 0.5,
            double_sided: false,
            extensions: Extensions::default(),
        }
    }
}

#[derive(Deserialize, Clone)]
#[serde(default, rename_all = "camelCase")]
pub(crate) struct MetallicRoughness {
    pub(crate) base_color_factor: [f64; 4],
    pub(crate) base_color_texture: Option<TextureInfo>,
    pub(crate) metallic_factor: f64,
    pub(crate) roughness_factor: f64,
    pub(crate) metallic_roughness_texture: Option<TextureInfo>,
}

impl Material {
    /// Every use of a texture.
    pub(crate) fn infos(&self) -> impl Iterator<Item = &TextureInfo> {
        let base = &self.pbr_metallic_roughness;
        let extensions = &self.extensions;
        let own = [
            base.base_color_texture.as_ref(),
            base.metallic_roughness_texture.as_ref(),
            self.normal_texture.as_ref(),
            self.occlusion_texture.as_ref(),
            self.emissive_texture.as_ref(),
        ];
        let specular = extensions.specular.as_ref();
        let specular = specular.map(|layer| [layer.specular_texture.as_ref(), layer.specular_color_texture.as_ref()]);
        let clearcoat = extensions.clearcoat.as_ref().map(|layer| {
            [
                layer.clearcoat_texture.as_ref(),
                layer.clearcoat_roughness_texture.as_ref(),
                layer.clearcoat_normal_texture.as_ref(),
            ]
        });
        let sheen = extensions.sheen.as_ref();
        let sheen = sheen.map(|layer| [layer.sheen_color_texture.as_ref(), layer.sheen_roughness_texture.as_ref()]);
        let transmission = extensions.transmission.as_ref().map(|layer| [layer.transmission_texture.as_ref()]);
        let glossy = extensions.specular_glossiness.as_ref();
        let glossy = glossy.map(|layer| [layer.diffuse_texture.as_ref(), layer.specular_glossiness_texture.as_ref()]);
        let layers = specular.into_iter().chain(sheen).chain(glossy).flatten();
        let layers = layers.chain(clearcoat.into_iter().flatten()).chain(transmission.into_iter().flatten());
        own.into_iter().chain(layers).flatten()
    }
}

impl Default for MetallicRoughness {
    fn default() -> Self {
        Self {
            base_color_factor: [1.0; 4],
            base_color_texture: None,
            metallic_factor: 1.0,
            roughness_factor: 1.0,
            metallic_roughness_texture: None,
        }
    }
}

/// A texture's use by a material.
#[derive(Deserialize, Clone)]
#[serde(rename_all = "camelCase")]
pub(crate) struct TextureInfo {
    pub(crate) index: u32,
    #[serde(default)]
    pub(crate) tex_coord: u32,
    /// Of a normal texture.
    pub(crate) scale: Option<f64>,
    /// Of an occlusion texture.
    pub(crate) strength: Option<f64>,
    #[serde(default)]
    pub(crate) extensions: InfoExtensions,
}

#[derive(Deserialize, Clone, Default)]
pub(crate) struct InfoExtensions {
    #[serde(rename = "KHR_texture_transform")]
    pub(crate) transform: Option<TextureTransform>,
}

/// KHR_texture_transform.
#[derive(Deserialize, Debug, Clone, Copy)]
#[serde(default, rename_all = "camelCase")]
pub(crate) struct TextureTransform {
    pub(crate) offset: [f64; 2],
    /// In radians, counter-clockwise with v pointing down.
    pub(crate) rotation: f64,
    pub(crate) scale: [f64; 2],
    /// Replaces the texture's own.
    pub(crate) tex_coord: Option<u32>,
}

impl Default for TextureTransform {
    fn default() -> Self {
        Self { offset: [0.0; 2], rotation: 0.0, scale: [1.0; 2], tex_coord: None }
    }
}

#[derive(Deserialize, Clone, Default)]
#[serde(default)]
pub(crate) struct Extensions {
    #[serde(rename = "KHR_materials_emissive_strength")]
    pub(crate) emissive_strength: Option<EmissiveStrength>,
    #[serde(rename = "KHR_materials_unlit")]
    pub(crate) unlit: bool,
    #[serde(rename = "KHR_materials_ior")]
    pub(crate) ior: Option<Ior>,
    #[serde(rename = "KHR_materials_specular")]
    pub(crate) specular: Option<Specular>,
    #[serde(rename = "KHR_materials_clearcoat")]
    pub(crate) clearcoat: Option<Clearcoat>,
    #[serde(rename = "KHR_materials_sheen")]
    pub(crate) sheen: Option<Sheen>,
    #[serde(rename = "KHR_materials_transmission")]
    pub(crate) transmission: Option<Transmission>,
    #[serde(rename = "KHR_materials_pbrSpecularGlossiness")]
    pub(crate) specular_glossiness: Option<SpecularGlossiness>,
    #[serde(rename = "KHR_materials_anisotropy")]
    pub(crate) anisotropy: bool,
    #[serde(rename = "KHR_materials_diffuse_transmission")]
    pub(crate) diffuse_transmission: bool,
    #[serde(rename = "KHR_materials_dispersion")]
    pub(crate) dispersion: bool,
    #[serde(rename = "KHR_materials_iridescence")]
    pub(crate) iridescence: bool,
    #[serde(rename = "KHR_materials_volume")]
    pub(crate) volume: bool,
}

impl Extensions {
    /// Returns the extensions of the material that are not drawn.
    pub(crate) fn not_drawn(&self) -> impl Iterator<Item = &'static str> {
        [
            (self.anisotropy, "KHR_materials_anisotropy"),
            (self.diffuse_transmission, "KHR_materials_diffuse_transmission"),
            (self.dispersion, "KHR_materials_dispersion"),
            (self.iridescence, "KHR_materials_iridescence"),
            (self.volume, "KHR_materials_volume"),
        ]
        .into_iter()
        .filter_map(|(there, name)| there.then_some(name))
    }
}

#[derive(Deserialize, Clone)]
#[serde(rename_all = "camelCase")]
pub(crate) struct EmissiveStrength {
    pub(crate) emissive_strength: Option<f64>,
}

#[derive(Deserialize, Clone)]
pub(crate) struct Ior {
    pub(crate) ior: Option<f64>,
}

#[derive(Deserialize, Clone, Default)]
#[serde(default, rename_all = "camelCase")]
pub(crate) struct Specular {
    pub(crate) specular_factor: Option<f64>,
    pub(crate) specular_texture: Option<TextureInfo>,
    pub(crate) specular_color_factor: Option<[f64; 3]>,
    pub(crate) specular_color_texture: Option<TextureInfo>,
}

#[derive(Deserialize, Clone, Default)]
#[serde(default, rename_all = "camelCase")]
pub(crate) struct Clearcoat {
    pub(crate) clearcoat_factor: f64,
    pub(crate) clearcoat_texture: Option<TextureInfo>,
    pub(crate) clearcoat_roughness_factor: f64,
    pub(crate) clearcoat_roughness_texture: Option<TextureInfo>,
    pub(crate) clearcoat_normal_texture: Option<TextureInfo>,
}

#[derive(Deserialize, Clone, Default)]
#[serde(default, rename_all = "camelCase")]
pub(crate) struct Sheen {
    pub(crate) sheen_color_factor: [f64; 3],
    pub(crate) sheen_color_texture: Option<TextureInfo>,
    pub(crate) sheen_roughness_factor: f64,
    pub(crate) sheen_roughness_texture: Option<TextureInfo>,
}

#[derive(Deserialize, Clone, Default)]
#[serde(default, rename_all = "camelCase")]
pub(crate) struct Transmission {
    pub(crate) transmission_factor: f64,
    pub(crate) transmission_texture: Option<TextureInfo>,
}

#[derive(Deserialize, Clone, Default)]
#[serde(default, rename_all = "camelCase")]
pub(crate) struct SpecularGlossiness {
    pub(crate) diffuse_factor: Option<[f64; 4]>,
    pub(crate) diffuse_texture: Option<TextureInfo>,
    pub(crate) specular_factor: Option<[f64; 3]>,
    pub(crate) glossiness_factor: Option<f64>,
    pub(crate) specular_glossiness_texture: Option<TextureInfo>,
}
