//! The palette: pictures and materials of the scene.

use image::ImageError;
use serde_json::{Value, json};

use super::glb::{Glb, Id};
use super::textures::{cloth, leaves, stone};

pub(crate) struct Palette {
    pub(crate) ashlar: Id,
    pub(crate) stone: Id,
    pub(crate) plaster: Id,
    pub(crate) vault: Id,
    pub(crate) flagstone: Id,
    pub(crate) joint: Id,
    pub(crate) tile: Id,
    pub(crate) tile_bed: Id,
    pub(crate) grass: Id,
    pub(crate) soil: Id,
    pub(crate) wood: Id,
    pub(crate) bark: Id,
    pub(crate) iron: Id,
    pub(crate) bronze: Id,
    pub(crate) lead: Id,
    pub(crate) rope: Id,
    pub(crate) wax: Id,
    pub(crate) teal: Id,
    pub(crate) ochre: Id,
    pub(crate) leaf: Id,
    pub(crate) olive: Id,
    pub(crate) water: Id,
    pub(crate) glass: Id,
    pub(crate) flame: Id,
}

/// An opaque material: linear colour that multiplies a picture, if there is one.
fn plain(name: &str, factor: [f64; 3], image: Option<Id>) -> Value {
    let [r, g, b] = factor;
    let mut surface = json!({ "baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.9 });
    if let Some(image) = image {
        surface["baseColorTexture"] = json!({ "index": image });
    }
    json!({ "name": name, "pbrMetallicRoughness": surface })
}

fn double_sided(mut material: Value) -> Value {
    material["doubleSided"] = json!(true);
    material
}

fn masked(material: Value) -> Value {
    let mut material = double_sided(material);
    material["alphaMode"] = json!("MASK");
    material["alphaCutoff"] = json!(0.5);
    material
}

fn blended(name: &str, factor: [f64; 4]) -> Value {
    json!({ "name": name, "alphaMode": "BLEND", "doubleSided": true,
        "pbrMetallicRoughness": { "baseColorFactor": factor, "metallicFactor": 0.0, "roughnessFactor": 0.1 } })
}

pub(crate) fn add(glb: &mut Glb) -> Result<Palette, ImageError> {
    const JPEG: &str = "image/jpeg";
    const WHITE: [f64; 3] = [1.0; 3];
    let ashlar = glb.image("ashlar", JPEG, &stone::ashlar().jpeg()?);
    let limestone = glb.image("limestone", JPEG, &stone::stone().jpeg()?);
    let plaster = glb.image("plaster", JPEG, &stone::plaster().jpeg()?);
    let flagstones = glb.image("flagstones", JPEG, &stone::flagstones().jpeg()?);
    let clay = glb.image("clay", JPEG, &stone::clay().jpeg()?);
    let grass = glb.image("grass", JPEG, &stone::grass().jpeg()?);
    let wood = glb.image("wood", JPEG, &stone::wood().jpeg()?);
    let teal = glb.image("teal cloth", JPEG, &cloth::teal().jpeg()?);
    let ochre = glb.image("ochre cloth", JPEG, &cloth::ochre().jpeg()?);
    let leaves = glb.image("leaves", "image/png", &leaves::atlas().png()?);
    let mut flame = blended("flame", [1.0, 0.75, 0.35, 0.85]);
    flame["emissiveFactor"] = json!([1.0, 0.62, 0.22]);
    Ok(Palette {
        ashlar: glb.material(plain("ashlar", WHITE, Some(ashlar))),
        stone: glb.material(plain("limestone", WHITE, Some(limestone))),
        plaster: glb.material(plain("plaster", WHITE, Some(plaster))),
        vault: glb.material(double_sided(plain("vault plaster", [1.06f64.min(1.0), 0.98, 0.95], Some(plaster)))),
        flagstone: glb.material(plain("flagstones", WHITE, Some(flagstones))),
        joint: glb.material(plain("joints", [0.16, 0.14, 0.11], None)),
        tile: glb.material(double_sided(plain("roof tiles", WHITE, Some(clay)))),
        tile_bed: glb.material(plain("roof bed", [0.20, 0.10, 0.065], None)),
        grass: glb.material(plain("grass", WHITE, Some(grass))),
        soil: glb.material(plain("soil", [0.065, 0.042, 0.028], None)),
        wood: glb.material(plain("oak", WHITE, Some(wood))),
        bark: glb.material(plain("bark", [0.62, 0.60, 0.58], Some(wood))),
        iron: glb.material(plain("wrought iron", [0.028, 0.028, 0.032], None)),
        bronze: glb.material(plain("bronze", [0.42, 0.27, 0.10], None)),
        lead: glb.material(plain("lead", [0.16, 0.165, 0.175], None)),
        rope: glb.material(plain("rope", [0.46, 0.36, 0.22], None)),
        wax: glb.material(plain("wax", [0.86, 0.80, 0.66], None)),
        teal: glb.material(double_sided(plain("teal cloth", WHITE, Some(teal)))),
        ochre: glb.material(double_sided(plain("ochre cloth", WHITE, Some(ochre)))),
        leaf: glb.material(masked(plain("leaves", WHITE, Some(leaves)))),
        olive: glb.material(masked(plain("olive leaves", [0.86, 0.96, 0.92], Some(leaves)))),
        water: glb.material(blended("water", [0.05, 0.17, 0.18, 0.62])),
        glass: glb.material(blended("lantern glass", [0.85, 0.72, 0.45, 0.16])),
        flame: glb.material(flame),
    })
}
