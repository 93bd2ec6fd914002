//! The palette: pictures and materials of the scene.

use image::ImageError;
use serde_json::{Value, json};

use super::glb::{Glb, Id};
use super::textures::{cloth, leaves, metal, stone};

pub(crate) struct Palette {
    pub(crate) ashlar: Id,
    pub(crate) stone: Id,
    pub(crate) plaster: Id,
    pub(crate) vault: Id,
    pub(crate) flagstone: Id,
    pub(crate) joint: Id,
    pub(crate) tile: Id,
    pub(crate) glaze: Id,
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

fn metal(name: &str, factor: [f64; 3], roughness: f64) -> Value {
    let mut material = plain(name, factor, None);
    material["pbrMetallicRoughness"]["metallicFactor"] = json!(1.0);
    material["pbrMetallicRoughness"]["roughnessFactor"] = json!(roughness);
    material
}

fn embossed(mut material: Value, relief: Id) -> Value {
    material["normalTexture"] = json!({ "index": relief });
    material
}

/// Stone that feet have polished.
fn worn_smooth(mut material: Value) -> Value {
    material["pbrMetallicRoughness"]["roughnessFactor"] = json!(0.55);
    material
}

/// Adds an extension of glTF's.
fn with(mut material: Value, extension: &str, value: Value) -> Value {
    material["extensions"][extension] = value;
    material
}

/// Wool: bright where it is seen from the side.
fn woollen(material: Value) -> Value {
    let sheen = json!({ "sheenColorFactor": [0.30, 0.27, 0.22], "sheenRoughnessFactor": 0.45 });
    with(double_sided(material), "KHR_materials_sheen", sheen)
}

/// Under a clear layer: varnish or glaze.
fn lacquered(material: Value, strength: f64, roughness: f64) -> Value {
    let lacquer = json!({ "clearcoatFactor": strength, "clearcoatRoughnessFactor": roughness });
    with(material, "KHR_materials_clearcoat", lacquer)
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
    let (ashlar, flagstones, clay, wood) = (stone::ashlar(), stone::flagstones(), stone::clay(), stone::wood());
    // Joints of the walls are 6 mm deep; 2.1 m are a picture's width.
    let ashlar_relief = glb.image("ashlar relief", JPEG, &ashlar.relief(0.012).jpeg()?);
    let flagstone_relief = glb.image("flagstone relief", JPEG, &flagstones.relief(0.010).jpeg()?);
    let clay_relief = glb.image("clay relief", JPEG, &clay.relief(0.012).jpeg()?);
    let wood_relief = glb.image("wood relief", JPEG, &wood.relief(0.012).jpeg()?);
    let ashlar = glb.image("ashlar", JPEG, &ashlar.jpeg()?);
    let limestone = glb.image("limestone", JPEG, &stone::stone().jpeg()?);
    let plaster = glb.image("plaster", JPEG, &stone::plaster().jpeg()?);
    let flagstones = glb.image("flagstones", JPEG, &flagstones.jpeg()?);
    let clay = glb.image("clay", JPEG, &clay.jpeg()?);
    let grass = glb.image("grass", JPEG, &stone::grass().jpeg()?);
    let wood = glb.image("wood", JPEG, &wood.jpeg()?);
    let teal = glb.image("teal cloth", JPEG, &cloth::teal().jpeg()?);
    let ochre = glb.image("ochre cloth", JPEG, &cloth::ochre().jpeg()?);
    let leaves = glb.image("leaves", "image/png", &leaves::atlas().png()?);
    let bronze_image = glb.image("bronze", JPEG, &metal::bronze().jpeg()?);
    let bronze_surface = glb.image("bronze surface", JPEG, &metal::bronze_surface().jpeg()?);
    let mut bronze = plain("bronze", WHITE, Some(bronze_image));
    bronze["pbrMetallicRoughness"]["metallicRoughnessTexture"] = json!({ "index": bronze_surface });
    bronze["pbrMetallicRoughness"]["metallicFactor"] = json!(1.0);
    bronze["pbrMetallicRoughness"]["roughnessFactor"] = json!(1.0);
    let mut flame = blended("flame", [1.0, 0.75, 0.35, 0.85]);
    flame["emissiveFactor"] = json!([1.0, 0.62, 0.22]);
    let flame = with(flame, "KHR_materials_emissive_strength", json!({ "emissiveStrength": 2.5 }));
    let mut glass = double_sided(plain("lantern glass", [0.96, 0.88, 0.70], None));
    glass["pbrMetallicRoughness"]["roughnessFactor"] = json!(0.08);
    let glass = with(glass, "KHR_materials_transmission", json!({ "transmissionFactor": 0.9 }));
    Ok(Palette {
        ashlar: glb.material(embossed(plain("ashlar", WHITE, Some(ashlar)), ashlar_relief)),
        stone: glb.material(plain("limestone", WHITE, Some(limestone))),
        plaster: glb.material(plain("plaster", WHITE, Some(plaster))),
        vault: glb.material(double_sided(plain("vault plaster", [1.06f64.min(1.0), 0.98, 0.95], Some(plaster)))),
        flagstone: glb.material(worn_smooth(embossed(plain("flagstones", WHITE, Some(flagstones)), flagstone_relief))),
        joint: glb.material(plain("joints", [0.16, 0.14, 0.11], None)),
        tile: glb.material(embossed(double_sided(plain("roof tiles", WHITE, Some(clay))), clay_relief)),
        glaze: glb.material(lacquered(plain("glazed clay", [0.62, 0.92, 0.80], Some(clay)), 1.0, 0.12)),
        tile_bed: glb.material(plain("roof bed", [0.20, 0.10, 0.065], None)),
        grass: glb.material(plain("grass", WHITE, Some(grass))),
        soil: glb.material(plain("soil", [0.065, 0.042, 0.028], None)),
        wood: glb.material(lacquered(embossed(plain("oak", WHITE, Some(wood)), wood_relief), 0.5, 0.3)),
        bark: glb.material(embossed(plain("bark", [0.62, 0.60, 0.58], Some(wood)), wood_relief)),
        iron: glb.material(metal("wrought iron", [0.11, 0.11, 0.12], 0.5)),
        bronze: glb.material(bronze),
        lead: glb.material(metal("lead", [0.34, 0.35, 0.37], 0.6)),
        rope: glb.material(plain("rope", [0.46, 0.36, 0.22], None)),
        wax: glb.material(plain("wax", [0.86, 0.80, 0.66], None)),
        teal: glb.material(woollen(plain("teal cloth", WHITE, Some(teal)))),
        ochre: glb.material(woollen(plain("ochre cloth", WHITE, Some(ochre)))),
        leaf: glb.material(masked(plain("leaves", WHITE, Some(leaves)))),
        olive: glb.material(masked(plain("olive leaves", [0.86, 0.96, 0.92], Some(leaves)))),
        water: glb.material(blended("water", [0.05, 0.17, 0.18, 0.62])),
        glass: glb.material(glass),
        flame: glb.material(flame),
    })
}
