//! The materials that a scene uses.

use std::collections::HashMap;

use gltf::json::mesh::{Primitive, Semantic};
use serde_json::Value;

use super::{
    coordinates::{Plan, set},
    material::MaterialReader,
    texture::Images,
};
use crate::{
    Material, Texture,
    error::{SceneError, place, within},
    limits::MAX_MATERIALS,
    reader::{
        json::{self, Document, TEXCOORDS, attribute},
        report::LoadReport,
    },
};

/// Materials and images that the scene uses, in the order of their first use. A material whose primitives do not all
/// have the texture coordinates that it needs is there more than once, with and without the textures.
#[derive(Default)]
pub(crate) struct Materials {
    pub(crate) materials: Vec<Material>,
    /// One for each material.
    plans: Vec<Plan>,
    pub(crate) images: Images,
    by_use: HashMap<(Option<usize>, u32), u32>,
    /// The chosen variant of KHR_materials_variants.
    pub(crate) variant: Option<usize>,
}

impl Materials {
    /// Returns the scene's index of a primitive's material. Without one it has the default material (§3.7.2.1).
    /// Errors if there are too many.
    pub(crate) fn get(
        &mut self,
        document: &Document,
        primitive: &Primitive,
        report: &mut LoadReport,
    ) -> Result<u32, SceneError> {
        let index = self.varied(document, primitive).or(primitive.material.map(|index| index.value()));
        let fallback = json::Material::default();
        let found = index.and_then(|index| document.materials.get(index));
        let source = found.unwrap_or(&fallback);
        let there = |set: &u32| attribute(primitive, Semantic::TexCoords(*set)).is_some();
        let bit = |set: u32| 1_u32.checked_shl(set).unwrap_or(0);
        let needed = source.infos().fold(0, |sets, info| sets | bit(set(info)));
        let sets = TEXCOORDS.filter(there).fold(0, |sets, set| sets | bit(set)) & needed;
        if let Some(known) = self.by_use.get(&(index, sets)) {
            return Ok(*known);
        }
        within("materials with and without their textures", self.materials.len() as u64, MAX_MATERIALS as u64)?;
        let place = match index {
            Some(index) => place("material", index, source.name.as_deref()),
            None => "the default material".to_owned(),
        };
        let images = &mut self.images;
        let mut reader = MaterialReader { document, images, report, sets, place: &place, plan: Plan::default() };
        let material = reader.read(source);
        self.plans.push(reader.plan);
        let number = u32::try_from(self.materials.len()).unwrap_or(u32::MAX);
        self.materials.push(material);
        self.by_use.insert((index, sets), number);
        Ok(number)
    }

    /// Returns what a material reads of its primitives' vertices.
    pub(crate) fn plan(&self, material: u32) -> Plan {
        self.plans.get(material as usize).copied().unwrap_or_default()
    }

    /// Returns the material that the chosen variant gives a primitive.
    fn varied(&self, document: &Document, primitive: &Primitive) -> Option<usize> {
        let variant = self.variant?;
        let extension = primitive.extensions.as_ref()?.others.get("KHR_materials_variants")?;
        let index = |value: &Value| value.as_u64().and_then(|index| usize::try_from(index).ok());
        let mapping = extension.get("mappings")?.as_array()?.iter().find(|mapping| {
            let variants = mapping.get("variants").and_then(Value::as_array);
            variants.is_some_and(|variants| variants.iter().any(|number| index(number) == Some(variant)))
        })?;
        index(mapping.get("material")?).filter(|material| *material < document.materials.len())
    }

    /// Returns the materials with the images' final indices. Textures whose image is `None` are left out.
    pub(crate) fn finish(mut self, images: &[Option<u32>]) -> Vec<Material> {
        for material in &mut self.materials {
            let emissive = material.emissive_texture.is_some();
            for slot in material.textures_mut() {
                *slot = slot.and_then(|texture| {
                    let image = images.get(texture.image as usize).copied().flatten()?;
                    Some(Texture { image, ..texture })
                });
            }
            if emissive && material.emissive_texture.is_none() {
                material.emissive = glam::Vec3::ZERO;
            }
        }
        self.materials
    }
}

/// Returns the variant that a user names, by name or by number.
/// Errors if there is none, and lists the names.
pub(crate) fn variant(document: &Document, wanted: &str) -> Result<usize, SceneError> {
    let names: Vec<&str> = document.variants.iter().map(|variant| variant.name.as_deref().unwrap_or("")).collect();
    choose("variant", wanted, &names)
}

/// Returns the index of the thing that a user names, by name or by number.
/// Errors if there is none, and lists what there is.
pub(crate) fn choose(kind: &'static str, wanted: &str, names: &[&str]) -> Result<usize, SceneError> {
    let number = || wanted.parse().ok().filter(|number| *number < names.len());
    names.iter().position(|name| *name == wanted).or_else(number).ok_or_else(|| SceneError::NoSuch {
        kind,
        wanted: wanted.chars().take(100).collect(),
        names: listed(names),
    })
}

/// Returns the first of many names, as messages show them.
pub(crate) fn listed(names: &[&str]) -> String {
    const SHOWN: usize = 16;
    let shown: Vec<String> = names.iter().take(SHOWN).map(|name| format!("{name:.64?}")).collect();
    match (names.len(), names.len().saturating_sub(SHOWN)) {
        (0, _) => "none".to_owned(),
        (_, 0) => shown.join(", "),
        (_, more) => format!("{} and {more} more", shown.join(", ")),
    }
}
