//! Builds small glTF files with a data URI.
#![allow(dead_code, reason = "each test file uses what it needs")]

use base64::{Engine as _, prelude::BASE64_STANDARD};
use gnomon_scene::{LoadOptions, LoadReport, Scene, SceneError};
use serde_json::{Value, json};

pub(crate) struct GltfFile {
    pub(crate) json: Value,
    bytes: Vec<u8>,
}

impl GltfFile {
    /// A triangle (0,0,0), (1,0,0), (0,1,0) with normals along +Z and TEXCOORD_0 = (x, y), material 0, in node 0.
    pub(crate) fn triangle() -> Self {
        let mut file = Self {
            json: json!({
                "asset": {"version": "2.0"},
                "scene": 0,
                "scenes": [{"nodes": [0]}],
                "nodes": [{"mesh": 0}],
                "meshes": [{"primitives": [{"attributes": {}, "material": 0}]}],
                "materials": [{}],
                "accessors": [],
                "bufferViews": [],
            }),
            bytes: Vec::new(),
        };
        for (name, values) in [
            ("POSITION", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0][..]),
            ("NORMAL", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0]),
            ("TEXCOORD_0", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0]),
        ] {
            file.attribute(name, values);
        }
        file
    }

    /// The triangle with everything that the reader reads: skinned, morphed, in instances, animated, with all layers of
    /// material.
    pub(crate) fn of_every_kind() -> Self {
        let mut file = Self::triangle();
        for number in 0..3 {
            file.texture([number, 100, 200, 128]);
        }
        file.attribute("TEXCOORD_1", &[0.0, 0.5, 1.0, 0.5, 2.0, 1.0]);
        file.attribute("TANGENT", &[1.0, 0.0, 0.0, 1.0].repeat(3));
        file.attribute("COLOR_0", &[0.5, 1.0, 0.25, 1.0].repeat(3));
        let joints = file.accessor(5121, "VEC4", 3, &[0, 1, 0, 0, 0, 1, 0, 0, 1, 0, 0, 0]);
        file.attribute("WEIGHTS_0", &[0.75, 0.25, 0.0, 0.0].repeat(3));
        let up = file.floats("VEC3", &[0.0, 0.0, 2.0].repeat(3));
        let indices = file.accessor(5121, "SCALAR", 3, &[0, 1, 2]);
        let places = file.floats("VEC3", &[0.0, 0.0, 0.0, 3.0, 0.0, 0.0]);
        let times = file.floats("SCALAR", &[0.0, 1.0]);
        let vectors = file.floats("VEC3", &[0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.5, 0.0, 0.0].repeat(2));
        let turns = file.floats("VEC4", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0]);
        let primitive = file.primitive();
        primitive["attributes"]["JOINTS_0"] = json!(joints);
        primitive["targets"] = json!([{"POSITION": up, "NORMAL": up, "TANGENT": up, "COLOR_0": up}]);
        primitive["indices"] = json!(indices);
        let mappings = json!([{"material": 1, "variants": [0]}]);
        primitive["extensions"] = json!({"KHR_materials_variants": {"mappings": mappings}});
        let texture = |index: u32, set: u32| {
            let transform = json!({"scale": [2, 3], "texCoord": set});
            json!({"index": index, "extensions": {"KHR_texture_transform": transform}})
        };
        let json = &mut file.json;
        json["meshes"][0]["weights"] = json!([0.5]);
        json["extensions"] = json!({
            "KHR_materials_variants": {"variants": [{"name": "other"}]},
            "KHR_lights_punctual": {"lights": [{"type": "spot", "spot": {"innerConeAngle": 0.1}, "range": 9}]},
        });
        json["nodes"] = json!([
            {"mesh": 0, "skin": 0, "weights": [0.25]},
            {"translation": [0, 0, 5], "children": [2]},
            {"rotation": [0, 0, 1, 0], "extensions": {"KHR_lights_punctual": {"light": 0}}},
            {"mesh": 1, "camera": 0, "extensions": {
                "EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places}},
                "KHR_node_visibility": {"visible": true},
            }},
        ]);
        json["scenes"] = json!([{"name": "all", "nodes": [0, 1, 3]}]);
        let plain = json!({"primitives": [{"attributes": {"POSITION": 0}, "mode": 5}]});
        json["meshes"].as_array_mut().unwrap().push(plain);
        json["skins"] = json!([{"joints": [1, 2]}]);
        json["animations"] = json!([
            {
                "name": "turn",
                "channels": [
                    {"sampler": 0, "target": {"node": 1, "path": "translation"}},
                    {"sampler": 1, "target": {"node": 3, "path": "rotation"}},
                    {"sampler": 0, "target": {"node": 3, "path": "scale"}},
                ],
                "samplers": [
                    {"input": times, "output": vectors, "interpolation": "CUBICSPLINE"},
                    {"input": times, "output": turns},
                ],
            },
            {"channels": [
                {"sampler": 0, "target": {"path": "pointer", "extensions": {"KHR_animation_pointer": {
                    "pointer": "/extensions/KHR_lights_punctual/lights/0/intensity"}}}},
                {"sampler": 0, "target": {"path": "pointer", "extensions": {"KHR_animation_pointer": {
                    "pointer": "/nodes/3/extensions/KHR_node_visibility/visible"}}}},
            ], "samplers": [{"input": times, "output": times, "interpolation": "STEP"}]},
        ]);
        json["cameras"] = json!([{"type": "perspective", "perspective": {"yfov": 0.7}}]);
        json["samplers"] = json!([{"magFilter": 9728, "minFilter": 9985, "wrapS": 33071}]);
        json["textures"][1]["sampler"] = json!(0);
        json["materials"] = json!([
            {
                "alphaMode": "MASK", "alphaCutoff": 0.25,
                "pbrMetallicRoughness": {
                    "baseColorTexture": texture(0, 0), "metallicRoughnessTexture": texture(1, 1),
                    "metallicFactor": 0.5,
                },
                "normalTexture": texture(2, 0), "occlusionTexture": {"index": 1, "strength": 0.5},
                "emissiveTexture": texture(2, 1), "emissiveFactor": [1, 0, 0],
                "extensions": {
                    "KHR_materials_clearcoat": {"clearcoatFactor": 1, "clearcoatNormalTexture": texture(0, 1)},
                    "KHR_materials_sheen": {"sheenColorFactor": [1, 1, 1]},
                    "KHR_materials_specular": {"specularColorTexture": texture(1, 0)},
                    "KHR_materials_transmission": {"transmissionFactor": 0.25},
                    "KHR_materials_ior": {"ior": 1.25},
                },
            },
            {"extensions": {"KHR_materials_pbrSpecularGlossiness": {
                "specularGlossinessTexture": texture(1, 0), "glossinessFactor": 0.5,
            }}},
        ]);
        file
    }

    /// Adds an accessor.
    pub(crate) fn accessor(&mut self, component: u32, shape: &str, count: usize, bytes: &[u8]) -> usize {
        let (accessors, views) = (self.json["accessors"].as_array().unwrap(), &self.json["bufferViews"]);
        let (number, view) = (accessors.len(), views.as_array().unwrap().len());
        self.json["bufferViews"].as_array_mut().unwrap().push(json!({
            "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len(),
        }));
        self.bytes.extend(bytes);
        self.json["accessors"].as_array_mut().unwrap().push(json!({
            "bufferView": view, "componentType": component, "type": shape, "count": count,
        }));
        number
    }

    /// Adds an accessor of floats.
    pub(crate) fn floats(&mut self, shape: &str, values: &[f32]) -> usize {
        let width = match shape {
            "SCALAR" => 1,
            "MAT4" => 16,
            vector => usize::from(vector.as_bytes()[3] - b'0'),
        };
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.accessor(5126, shape, values.len() / width, &bytes)
    }

    /// Gives the first primitive an attribute of floats.
    pub(crate) fn attribute(&mut self, name: &str, values: &[f32]) -> usize {
        let shape = match name.split('_').next().unwrap() {
            "TEXCOORD" => "VEC2",
            "POSITION" | "NORMAL" => "VEC3",
            _ => "VEC4",
        };
        let accessor = self.floats(shape, values);
        self.primitive()["attributes"][name] = json!(accessor);
        accessor
    }

    pub(crate) fn primitive(&mut self) -> &mut Value {
        &mut self.json["meshes"][0]["primitives"][0]
    }

    /// Adds a picture of one texel, and returns the number of its texture.
    pub(crate) fn texture(&mut self, texel: [u8; 4]) -> usize {
        let mut png = std::io::Cursor::new(Vec::new());
        image::RgbaImage::from_pixel(1, 1, image::Rgba(texel)).write_to(&mut png, image::ImageFormat::Png).unwrap();
        let uri = format!("data:image/png;base64,{}", BASE64_STANDARD.encode(png.into_inner()));
        for name in ["textures", "images"] {
            if self.json[name].is_null() {
                self.json[name] = json!([]);
            }
        }
        let number = self.json["textures"].as_array().unwrap().len();
        self.json["images"].as_array_mut().unwrap().push(json!({"uri": uri}));
        self.json["textures"].as_array_mut().unwrap().push(json!({"source": number}));
        number
    }

    /// Returns the file, whole.
    pub(crate) fn text(&self) -> String {
        let mut json = self.json.clone();
        let uri = format!("data:application/octet-stream;base64,{}", BASE64_STANDARD.encode(&self.bytes));
        json["buffers"] = json!([{"byteLength": self.bytes.len(), "uri": uri}]);
        json.to_string()
    }

    pub(crate) fn load_with(&self, options: &LoadOptions) -> Result<(Scene, LoadReport), SceneError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.gltf");
        std::fs::write(&path, self.text()).unwrap();
        let loaded = Scene::load_with_report(&path, options);
        if let Ok((scene, _)) = &loaded {
            assert_eq!(scene.check(), Ok(()));
            assert!(Scene::unpack(&scene.pack().unwrap()).unwrap() == *scene, "it does not survive packing");
        }
        loaded
    }

    /// Loads the file, and returns what was mended, left out or not drawn, but for the default sun.
    pub(crate) fn load(&self) -> (Scene, String) {
        let (scene, report) = self.load_with(&LoadOptions::default()).unwrap();
        let told = report.all().into_iter().map(|it| it.to_string()).filter(|line| !line.contains("default sun"));
        (scene, told.collect::<Vec<_>>().join("\n"))
    }
}

/// Adds a channel with a sampler of its own to animation 0.
pub(crate) fn channel(file: &mut GltfFile, target: &Value, times: &[f32], shape: &str, values: &[f32]) {
    let (input, output) = (file.floats("SCALAR", times), file.floats(shape, values));
    let animation = &mut file.json["animations"][0];
    let samplers = animation["samplers"].as_array_mut().unwrap();
    samplers.push(json!({"input": input, "output": output}));
    let sampler = samplers.len() - 1;
    animation["channels"].as_array_mut().unwrap().push(json!({"sampler": sampler, "target": target}));
}
