//! Materials with all their layers, their textures' places, and vertex colours and tangents.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

mod common;

use common::gltf_file::GltfFile;
use glam::{Vec2, Vec3, Vec4};
use gnomon_scene::{Coordinates, Filter, LoadOptions, Material, Scene, Texture};
use serde_json::{Value, json};

/// The triangle with `count` textures and this material.
fn with(count: u8, material: Value) -> GltfFile {
    let mut file = GltfFile::triangle();
    for number in 0..count {
        file.texture([number, 2, 3, 255]);
    }
    file.json["materials"][0] = material;
    file
}

fn load(file: &GltfFile) -> Scene {
    let (scene, told) = file.load();
    assert_eq!(told, "");
    scene
}

fn material(count: u8, material: Value) -> Material {
    load(&with(count, material)).materials[0].clone()
}

/// The red of the picture that a texture shows: its number in the file.
fn shows(scene: &Scene, texture: Option<Texture>) -> Option<u8> {
    texture.map(|texture| scene.images[texture.image as usize].rgba[0])
}

#[test]
fn metallic_roughness_and_its_maps() {
    let file = with(
        5,
        json!({
            "pbrMetallicRoughness": {
                "baseColorTexture": {"index": 0}, "metallicFactor": 0.25, "roughnessFactor": 0.5,
                "metallicRoughnessTexture": {"index": 1},
            },
            "normalTexture": {"index": 2, "scale": -0.5},
            "occlusionTexture": {"index": 3, "strength": 0.75},
            "emissiveTexture": {"index": 4}, "emissiveFactor": [1, 0.5, 0],
            "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 8}},
        }),
    );
    let scene = load(&file);
    let material = &scene.materials[0];
    assert_eq!((material.metallic, material.roughness), (0.25, 0.5));
    assert_eq!((material.normal_scale, material.occlusion_strength), (-0.5, 0.75));
    assert_eq!(material.emissive, Vec3::new(8.0, 4.0, 0.0));
    let textures = [
        material.base_color_texture,
        material.metallic_roughness_texture,
        material.normal_texture,
        material.occlusion_texture,
        material.emissive_texture,
    ];
    assert_eq!(textures.map(|texture| shows(&scene, texture)), [0, 1, 2, 3, 4].map(Some));
    // glTF's default material is metal.
    let plain = self::material(0, json!({}));
    assert_eq!((plain.metallic, plain.roughness, plain.ior, plain.unlit), (1.0, 1.0, 1.5, false));
}

#[test]
fn layers_of_extensions() {
    let texture = |index: usize| json!({"index": index});
    let file = with(
        9,
        json!({"extensions": {
            "KHR_materials_ior": {"ior": 1.25},
            "KHR_materials_specular": {
                "specularFactor": 0.5, "specularTexture": texture(0), "specularColorFactor": [2, 1, 0],
                "specularColorTexture": texture(1),
            },
            "KHR_materials_clearcoat": {
                "clearcoatFactor": 0.75, "clearcoatTexture": texture(2), "clearcoatRoughnessFactor": 0.125,
                "clearcoatRoughnessTexture": texture(3), "clearcoatNormalTexture": {"index": 4, "scale": 2},
            },
            "KHR_materials_sheen": {
                "sheenColorFactor": [0.25, 0.5, 1], "sheenColorTexture": texture(5), "sheenRoughnessFactor": 0.5,
                "sheenRoughnessTexture": texture(6),
            },
            "KHR_materials_transmission": {"transmissionFactor": 0.25, "transmissionTexture": texture(7)},
        }}),
    );
    let scene = load(&file);
    let Material { ior, specular, clearcoat, sheen, transmission, .. } = &scene.materials[0];
    assert_eq!((*ior, specular.strength, specular.color), (1.25, 0.5, Vec3::new(2.0, 1.0, 0.0)));
    assert_eq!((clearcoat.strength, clearcoat.roughness, clearcoat.normal_scale), (0.75, 0.125, 2.0));
    assert_eq!((sheen.color, sheen.roughness), (Vec3::new(0.25, 0.5, 1.0), 0.5));
    assert_eq!(transmission.factor, 0.25);
    let textures = [
        specular.strength_texture,
        specular.color_texture,
        clearcoat.strength_texture,
        clearcoat.roughness_texture,
        clearcoat.normal_texture,
        sheen.color_texture,
        sheen.roughness_texture,
        transmission.texture,
    ];
    assert_eq!(textures.map(|texture| shows(&scene, texture)), [0, 1, 2, 3, 4, 5, 6, 7].map(Some));
    // The ninth picture is used by nothing.
    assert_eq!(scene.images.len(), 8);
}

#[test]
fn unlit_materials_have_a_base_colour_alone() {
    let file = with(
        2,
        json!({
            "pbrMetallicRoughness": {"baseColorFactor": [0.5, 1, 1, 1], "baseColorTexture": {"index": 0}},
            "emissiveTexture": {"index": 1}, "emissiveFactor": [1, 1, 1],
            "extensions": {"KHR_materials_unlit": {}},
        }),
    );
    let scene = load(&file);
    let material = &scene.materials[0];
    assert!(material.unlit && material.base_color.x == 0.5);
    assert_eq!((material.textures().count(), material.emissive, scene.images.len()), (1, Vec3::ZERO, 1));
}

#[test]
fn samplers_filters() {
    let filters = |sampler: Value| {
        let mut file = with(1, json!({"emissiveTexture": {"index": 0}}));
        file.json["samplers"] = json!([sampler]);
        file.json["textures"][0]["sampler"] = json!(0);
        let texture = load(&file).materials[0].emissive_texture.unwrap();
        (texture.magnified, texture.minified, texture.mips)
    };
    let (nearest, linear) = (Filter::Nearest, Filter::Linear);
    assert_eq!(filters(json!({})), (linear, linear, Some(linear)));
    for (code, minified, mips) in [
        (9728, nearest, None),
        (9729, linear, None),
        (9984, nearest, Some(nearest)),
        (9985, linear, Some(nearest)),
        (9986, nearest, Some(linear)),
        (9987, linear, Some(linear)),
    ] {
        assert_eq!(filters(json!({"magFilter": 9728, "minFilter": code})), (nearest, minified, mips), "{code}");
    }
}

/// Where a texture's coordinates end up for each vertex.
fn placed(scene: &Scene, texture: Option<Texture>) -> Vec<Vec2> {
    let Coordinates { second, map: [u, v] } = texture.unwrap().coordinates;
    let uvs = if second { &scene.uvs_1 } else { &scene.uvs };
    uvs.iter().map(|uv| Vec2::new(u.dot(uv.extend(1.0)), v.dot(uv.extend(1.0)))).collect()
}

fn near(got: &[Vec2], expected: [[f32; 2]; 3]) {
    let close = got.iter().zip(expected).all(|(got, expected)| (*got - Vec2::from_array(expected)).length() < 1e-5);
    assert!(close, "{got:?} instead of {expected:?}");
}

#[test]
fn textures_lie_where_their_sets_and_transforms_say() {
    let info =
        |index: u32, transform: Value| json!({"index": index, "extensions": {"KHR_texture_transform": transform}});
    let base = json!({"offset": [0.5, 0], "rotation": 0.3, "scale": [2, 4]});
    let mut file = with(
        4,
        json!({
            "pbrMetallicRoughness": {
                "baseColorTexture": info(0, base.clone()), "metallicRoughnessTexture": info(1, base),
            },
            "normalTexture": info(2, json!({"scale": [3, 1], "offset": [0, 0.25]})),
            "occlusionTexture": info(3, json!({"texCoord": 1, "scale": [0.5, 1]})),
            "emissiveTexture": {"index": 3},
        }),
    );
    file.attribute("TEXCOORD_1", &[0.0, 0.5, 1.0, 0.5, 2.0, 1.0]);
    let scene = load(&file);
    let material = &scene.materials[0];
    // Same set and transform: exactly the base colour's coordinates.
    assert_eq!(material.metallic_roughness_texture.unwrap().coordinates, Coordinates::default());
    assert_eq!(material.base_color_texture.unwrap().coordinates, Coordinates::default());
    near(&placed(&scene, material.normal_texture), [[0.0, 0.25], [3.0, 0.25], [0.0, 1.25]]);
    near(&placed(&scene, material.emissive_texture), [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]);
    assert!(material.occlusion_texture.unwrap().coordinates.second);
    near(&placed(&scene, material.occlusion_texture), [[0.0, 0.5], [0.5, 0.5], [1.0, 1.0]]);
}

#[test]
fn without_a_base_colour_the_first_textures_set_is_read_as_it_is() {
    let mut file = with(
        2,
        json!({
            "normalTexture": {"index": 0, "texCoord": 1, "extensions": {"KHR_texture_transform": {"scale": [2, 2]}}},
            "emissiveTexture": {"index": 1},
        }),
    );
    file.attribute("TEXCOORD_1", &[0.0, 0.5, 1.0, 0.5, 2.0, 1.0]);
    let scene = load(&file);
    assert_eq!(scene.uvs, [Vec2::new(0.0, 0.5), Vec2::new(1.0, 0.5), Vec2::new(2.0, 1.0)]);
    near(&placed(&scene, scene.materials[0].normal_texture), [[0.0, 1.0], [2.0, 1.0], [4.0, 2.0]]);
    near(&placed(&scene, scene.materials[0].emissive_texture), [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]);
}

#[test]
fn a_base_colour_of_scale_0_and_a_third_set() {
    let flat = json!({"index": 0, "extensions": {"KHR_texture_transform": {"scale": [0, 1]}}});
    let file = with(
        2,
        json!({
            "pbrMetallicRoughness": {"baseColorTexture": flat}, "emissiveTexture": {"index": 1},
        }),
    );
    let scene = load(&file);
    near(&placed(&scene, scene.materials[0].emissive_texture), [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]);

    let mut file = with(
        3,
        json!({
            "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}},
            "normalTexture": {"index": 1, "texCoord": 1}, "emissiveTexture": {"index": 2, "texCoord": 5},
            "occlusionTexture": {"index": 2, "texCoord": 1},
        }),
    );
    for name in ["TEXCOORD_1", "TEXCOORD_5"] {
        file.attribute(name, &[0.25; 6]);
    }
    let (scene, told) = file.load();
    assert!(told.contains("a third set of texture coordinates in one material (material 0)"), "{told}");
    let material = &scene.materials[0];
    assert!(material.emissive_texture.is_none() && material.occlusion_texture.is_some());
}

#[test]
fn a_material_is_doubled_where_a_primitive_lacks_coordinates() {
    let mut file = with(1, json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}));
    let bare = json!({"attributes": {"POSITION": 0}, "material": 0});
    file.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(bare);
    let (scene, told) = file.load();
    assert!(told.contains("a texture without texture coordinates (material 0)"), "{told}");
    let textured: Vec<bool> = scene.materials.iter().map(|material| material.base_color_texture.is_some()).collect();
    assert_eq!(textured, [true, false]);
    assert_eq!([scene.draws[0].material, scene.draws[1].material], [0, 1]);
}

#[test]
fn specular_glossiness_becomes_dielectric() {
    let glossy = json!({"extensions": {"KHR_materials_pbrSpecularGlossiness": {
        "diffuseFactor": [0.5, 0.25, 1, 1], "specularFactor": [0.25, 0.5, 1], "glossinessFactor": 0.5,
    }}});
    let plain = material(0, glossy.clone());
    assert_eq!(plain.base_color, Vec4::new(0.5, 0.25, 1.0, 1.0));
    assert_eq!((plain.metallic, plain.roughness, plain.ior), (0.0, 0.5, 0.0));
    assert_eq!(plain.specular.color, Vec3::new(0.25, 0.5, 1.0));

    let mut file = with(0, glossy);
    file.json["materials"][0]["extensions"]["KHR_materials_pbrSpecularGlossiness"]["specularGlossinessTexture"] =
        json!({"index": 0});
    file.texture([10, 20, 30, 204]);
    file.json["extensionsRequired"] = json!(["KHR_materials_pbrSpecularGlossiness"]);
    let scene = load(&file);
    let material = &scene.materials[0];
    assert_eq!(shows(&scene, material.specular.color_texture), Some(10));
    assert_eq!((material.roughness, scene.images.len()), (1.0, 2));
    // Glossiness 204 / 255 · 0.5 leaves a roughness of 0.6, in green.
    let baked = &scene.images[material.metallic_roughness_texture.unwrap().image as usize];
    assert_eq!(baked.rgba, [0, 153, 0, 255]);
}

#[test]
fn vertex_colours_of_every_type() {
    let colors = |component: u32, shape: &str, bytes: &[u8]| {
        let mut file = GltfFile::triangle();
        let accessor = file.accessor(component, shape, 3, bytes);
        file.json["accessors"][accessor]["normalized"] = json!(component != 5126);
        file.primitive()["attributes"]["COLOR_0"] = json!(accessor);
        load(&file).colors
    };
    let bytes = colors(5121, "VEC3", &[0, 255, 128, 1, 2, 3, 255, 255, 255]);
    assert_eq!(bytes, [[0, 65535, 128 * 257, 65535], [257, 514, 771, 65535], [65535; 4]]);
    let words: Vec<u8> = [1_u16, 2, 3, 4].repeat(3).iter().flat_map(|word| word.to_le_bytes()).collect();
    assert_eq!(colors(5123, "VEC4", &words), [[1, 2, 3, 4]; 3]);
    let floats = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let clamped = colors(5126, "VEC4", &floats(&[0.5, 2.0, -1.0, f32::NAN].repeat(3)));
    assert_eq!(clamped, [[32768, 65535, 0, 65535]; 3]);
    // White multiplies nothing.
    assert!(colors(5126, "VEC3", &floats(&[1.0; 9])).is_empty());
}

#[test]
fn one_coloured_mesh_among_others_leaves_them_white() {
    let mut file = GltfFile::triangle();
    file.attribute("COLOR_0", &[0.0, 0.0, 0.0, 1.0].repeat(3));
    // Without normals each triangle has its own vertices.
    let flat = json!({"attributes": {"POSITION": 0, "COLOR_0": 3}, "material": 0});
    let plain = json!({"attributes": {"POSITION": 0, "NORMAL": 1}, "material": 0});
    let first = file.primitive().clone();
    file.json["meshes"][0]["primitives"] = json!([plain, first, flat, plain]);
    let scene = load(&file);
    let (white, black) = ([65535; 4], [0, 0, 0, 65535]);
    assert_eq!(scene.colors, [[white; 3], [black; 3], [black; 3], [white; 3]].concat());
}

#[test]
fn tangents_turn_with_their_nodes_and_mirrors_flip_them() {
    let tangents = |node: Value, normal_map: bool| {
        let mut file = with(1, if normal_map { json!({"normalTexture": {"index": 0}}) } else { json!({}) });
        file.attribute("TANGENT", &[2.0, 0.0, 0.0, 1.0].repeat(3));
        file.json["nodes"][0] = node;
        file.json["nodes"][0]["mesh"] = json!(0);
        load(&file).tangents
    };
    let quarter = std::f64::consts::FRAC_1_SQRT_2;
    let turned = tangents(json!({"rotation": [0, 0, quarter, quarter]}), true);
    assert!(turned.iter().all(|tangent| (*tangent - Vec4::new(0.0, 1.0, 0.0, 1.0)).length() < 1e-6), "{turned:?}");
    // Mirrored in x: normal +Z, tangent −X, bitangent still +Y = w · (n × t).
    assert_eq!(tangents(json!({"scale": [-1, 1, 1]}), true), [Vec4::new(-1.0, 0.0, 0.0, -1.0); 3]);
    assert_eq!(tangents(json!({"scale": [-1, -1, 1]}), true), [Vec4::new(-1.0, 0.0, 0.0, 1.0); 3]);
    assert!(tangents(json!({}), false).is_empty());
}

#[test]
fn variants_are_chosen_by_name_or_number() {
    let mut file = GltfFile::triangle();
    file.json["materials"] = json!([{"name": "plain"}, {"name": "red"}, {"name": "blue"}]);
    file.json["extensionsRequired"] = json!(["KHR_materials_variants"]);
    file.json["extensions"] =
        json!({"KHR_materials_variants": {"variants": [{"name": "rot"}, {"name": "blau"}, {"name": "none"}]}});
    file.primitive()["extensions"] = json!({"KHR_materials_variants": {"mappings": [
        {"material": 1, "variants": [0]}, {"material": 2, "variants": [1]},
    ]}});
    let shown = |variant: Option<&str>| {
        let options = LoadOptions { variant: variant.map(str::to_owned), ..LoadOptions::default() };
        let loaded = file.load_with(&options);
        loaded.map(|(scene, report)| (scene.materials[0].name.clone(), report.to_string()))
    };
    let (plain, told) = shown(None).unwrap();
    assert!(plain == "plain" && told.contains("--variant NAME: \"rot\", \"blau\", \"none\""), "{told}");
    for (wanted, material) in [("rot", "red"), ("blau", "blue"), ("1", "blue"), ("none", "plain")] {
        assert_eq!(shown(Some(wanted)).unwrap().0, material, "{wanted}");
    }
    for wanted in ["gelb", "3"] {
        let error = shown(Some(wanted)).unwrap_err().to_string();
        assert!(error.contains(wanted) && error.contains("\"rot\", \"blau\", \"none\""), "{error}");
    }
}
