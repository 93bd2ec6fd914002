//! Writes a binary glTF 2.0 file (glTF 2.0, §4.4): meshes, materials, pictures, lights, nodes and rigid animations; or
//! adds such parts to a file that there is.

use std::collections::BTreeSet;

use glam::{DQuat, DVec3, Vec3};
use serde_json::{Value, json};

use super::mesh::Mesh;

/// A mesh, material, picture, node or light of a [`Glb`], by its index.
pub(crate) type Id = usize;

#[derive(Debug, thiserror::Error)]
pub enum GlbError {
    #[error("the file's JSON cannot be written: {0}")]
    Json(#[from] serde_json::Error),
    /// A part is longer than the format's 32-bit lengths.
    #[error("{bytes} bytes do not fit a binary glTF file")]
    TooLong { bytes: usize },
}

/// The parts of a file, in the order in which they were added.
#[derive(Debug, Default)]
pub(crate) struct Glb {
    /// Index of the buffer that the parts' bytes go to.
    buffer: usize,
    binary: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    images: Vec<Value>,
    materials: Vec<Value>,
    meshes: Vec<Value>,
    lights: Vec<Value>,
    nodes: Vec<Value>,
    roots: Vec<Id>,
    animations: Vec<Value>,
    triangles: Vec<usize>,
}

/// A property of a node that moves: its path in glTF, and its values at the animation's times.
pub(crate) struct Channel {
    pub(crate) node: Id,
    pub(crate) path: &'static str,
    pub(crate) values: Vec<f32>,
}

pub(crate) struct Counts {
    pub(crate) meshes: usize,
    pub(crate) instances: usize,
    pub(crate) stored_triangles: usize,
    pub(crate) triangles: usize,
}

impl Glb {
    /// Adds a picture (`mime` is `image/png` or `image/jpeg`) and a texture of the same index that repeats.
    pub(crate) fn image(&mut self, name: &str, mime: &str, bytes: &[u8]) -> Id {
        let view = self.view(bytes, None);
        self.images.push(json!({ "name": name, "mimeType": mime, "bufferView": view }));
        self.images.len() - 1
    }

    pub(crate) fn material(&mut self, material: Value) -> Id {
        self.materials.push(material);
        self.materials.len() - 1
    }

    /// Adds a mesh: one primitive a part.
    pub(crate) fn mesh(&mut self, name: &str, parts: &[(Id, Mesh)]) -> Id {
        let primitives: Vec<Value> = parts
            .iter()
            .filter(|(_, mesh)| !mesh.indices.is_empty())
            .map(|(material, mesh)| self.primitive(*material, mesh))
            .collect();
        self.meshes.push(json!({ "name": name, "primitives": primitives }));
        self.triangles.push(parts.iter().map(|(_, mesh)| mesh.triangle_count()).sum());
        self.meshes.len() - 1
    }

    pub(crate) fn light(&mut self, light: Value) -> Id {
        self.lights.push(light);
        self.lights.len() - 1
    }

    /// Adds a node, a glTF node object without children, below `parent` or as a root.
    pub(crate) fn node(&mut self, parent: Option<Id>, node: Value) -> Id {
        self.nodes.push(node);
        let id = self.nodes.len() - 1;
        match parent.and_then(|parent| self.nodes.get_mut(parent)) {
            Some(parent) => match parent.get_mut("children").and_then(Value::as_array_mut) {
                Some(children) => children.push(json!(id)),
                None => parent["children"] = json!([id]),
            },
            None => self.roots.push(id),
        }
        id
    }

    /// Adds an animation of one node's rotation: key times in seconds, linear in between.
    pub(crate) fn rotation_animation(&mut self, name: &str, node: Id, keys: &[(f64, DQuat)]) {
        #[expect(clippy::cast_possible_truncation, reason = "rounded to the file's precision")]
        let times: Vec<f32> = keys.iter().map(|key| key.0 as f32).collect();
        let values = keys.iter().flat_map(|key| key.1.as_quat().to_array()).collect();
        self.animation(name, &times, &[Channel { node, path: "rotation", values }]);
    }

    /// Adds an animation of several properties with the same key times, in seconds; linear in between.
    pub(crate) fn animation(&mut self, name: &str, times: &[f32], channels: &[Channel]) {
        let view = self.view(bytemuck::cast_slice(times), None);
        let input = self.accessor(json!({ "bufferView": view, "componentType": 5126, "type": "SCALAR",
            "count": times.len(), "min": [times.first()], "max": [times.last()] }));
        let (mut samplers, mut targets) = (Vec::new(), Vec::new());
        for (sampler, channel) in channels.iter().enumerate() {
            let kind = if channel.path == "rotation" { "VEC4" } else { "VEC3" };
            let view = self.view(bytemuck::cast_slice(&channel.values), None);
            let output =
                self.accessor(json!({ "bufferView": view, "componentType": 5126, "type": kind, "count": times.len() }));
            samplers.push(json!({ "input": input, "output": output, "interpolation": "LINEAR" }));
            let target = json!({ "node": channel.node, "path": channel.path });
            targets.push(json!({ "sampler": sampler, "target": target }));
        }
        self.animations.push(json!({ "name": name, "samplers": samplers, "channels": targets }));
    }

    /// Takes the parts of a glTF document, to which others are added. Their bytes make one more buffer.
    pub(crate) fn within(document: &Value) -> Self {
        let list = |name: &str| document[name].as_array().cloned().unwrap_or_default();
        let shown = usize::try_from(document["scene"].as_u64().unwrap_or_default()).unwrap_or_default();
        let roots = document["scenes"][shown]["nodes"].as_array();
        let roots = roots.into_iter().flatten().filter_map(|id| usize::try_from(id.as_u64()?).ok()).collect();
        let meshes = list("meshes");
        Self {
            buffer: list("buffers").len(),
            views: list("bufferViews"),
            accessors: list("accessors"),
            materials: list("materials"),
            nodes: list("nodes"),
            animations: list("animations"),
            // Those of the document are not counted.
            triangles: vec![0; meshes.len()],
            meshes,
            roots,
            ..Self::default()
        }
    }

    /// Puts the parts of [`Self::within`] back into their document. Returns the bytes of the new buffer, `uri`.
    pub(crate) fn put_back(self, document: &mut Value, uri: &str) -> Vec<u8> {
        let shown = usize::try_from(document["scene"].as_u64().unwrap_or_default()).unwrap_or_default();
        if let Some(scene) = document.get_mut("scenes").and_then(|scenes| scenes.get_mut(shown)) {
            scene["nodes"] = json!(self.roots);
        }
        let mut buffers = document["buffers"].as_array().cloned().unwrap_or_default();
        buffers.push(json!({ "byteLength": self.binary.len(), "uri": uri }));
        let parts = [
            ("buffers", buffers),
            ("bufferViews", self.views),
            ("accessors", self.accessors),
            ("materials", self.materials),
            ("nodes", self.nodes),
            ("animations", self.animations),
            ("meshes", self.meshes),
        ];
        for (name, list) in parts {
            document[name] = Value::Array(list);
        }
        self.binary
    }

    /// Returns the file. Errors if a part is longer than 4 GiB.
    pub(crate) fn finish(mut self, generator: &str) -> Result<Vec<u8>, GlbError> {
        let textures: Vec<Value> = (0..self.images.len()).map(|i| json!({ "source": i, "sampler": 0 })).collect();
        pad(&mut self.binary, 0);
        let mut json = serde_json::to_vec(&json!({
            "asset": { "version": "2.0", "generator": generator },
            "extensionsUsed": self.extensions(),
            "extensions": { "KHR_lights_punctual": { "lights": self.lights } },
            "scene": 0,
            "scenes": [{ "nodes": self.roots }],
            "nodes": self.nodes,
            "meshes": self.meshes,
            "materials": self.materials,
            "samplers": [{ "magFilter": 9729, "minFilter": 9987, "wrapS": 10497, "wrapT": 10497 }],
            "textures": textures,
            "images": self.images,
            "animations": self.animations,
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{ "byteLength": self.binary.len() }],
        }))?;
        pad(&mut json, b' ');
        let length = |bytes: usize| u32::try_from(bytes).map_err(|_| GlbError::TooLong { bytes });
        let total = length(12 + 8 + json.len() + 8 + self.binary.len())?;
        let mut file = b"glTF".to_vec();
        file.extend(2u32.to_le_bytes());
        file.extend(total.to_le_bytes());
        for (kind, chunk) in [(b"JSON", &json), (b"BIN\0", &self.binary)] {
            file.extend(length(chunk.len())?.to_le_bytes());
            file.extend(kind);
            file.extend(chunk);
        }
        Ok(file)
    }

    /// Names of the extensions that the file uses, in alphabetical order.
    fn extensions(&self) -> BTreeSet<&str> {
        let of_materials = self.materials.iter().filter_map(|material| material.get("extensions")?.as_object());
        let names = of_materials.flat_map(|extensions| extensions.keys().map(String::as_str));
        names.chain(["KHR_lights_punctual"]).collect()
    }

    /// Length of the binary part so far, in bytes.
    pub(crate) fn binary_bytes(&self) -> usize {
        self.binary.len()
    }

    pub(crate) fn counts(&self) -> Counts {
        let shown =
            self.nodes.iter().filter_map(|node| node.get("mesh")?.as_u64()).filter_map(|id| usize::try_from(id).ok());
        let shown: Vec<usize> = shown.filter_map(|id| self.triangles.get(id).copied()).collect();
        Counts {
            meshes: self.meshes.len(),
            instances: shown.len(),
            stored_triangles: self.triangles.iter().sum(),
            triangles: shown.iter().sum(),
        }
    }

    fn primitive(&mut self, material: Id, mesh: &Mesh) -> Value {
        let count = mesh.positions.len();
        let low = mesh.positions.iter().fold(Vec3::MAX, |low, p| low.min(*p)).to_array();
        let high = mesh.positions.iter().fold(Vec3::MIN, |high, p| high.max(*p)).to_array();
        let view = self.view(bytemuck::cast_slice(&mesh.positions), Some(34962));
        let position = self.accessor(json!({ "bufferView": view, "componentType": 5126, "type": "VEC3",
            "count": count, "min": low, "max": high }));
        let view = self.view(bytemuck::cast_slice(&mesh.normals), Some(34962));
        let normal =
            self.accessor(json!({ "bufferView": view, "componentType": 5126, "type": "VEC3", "count": count }));
        // 65,535 is not an index: it restarts primitives on some hardware (glTF 2.0, §3.7.2.1).
        let short: Option<Vec<u16>> =
            mesh.indices.iter().map(|&i| u16::try_from(i).ok().filter(|&i| i < u16::MAX)).collect();
        let (view, kind) = match short {
            Some(short) => (self.view(bytemuck::cast_slice(&short), Some(34963)), 5123),
            None => (self.view(bytemuck::cast_slice(&mesh.indices), Some(34963)), 5125),
        };
        let indices = self.accessor(
            json!({ "bufferView": view, "componentType": kind, "type": "SCALAR", "count": mesh.indices.len() }),
        );
        let mut attributes = json!({ "POSITION": position, "NORMAL": normal });
        // A plain colour needs no texture coordinates.
        if self.materials.get(material).is_some_and(reads_pictures) {
            let view = self.view(bytemuck::cast_slice(&mesh.uvs), Some(34962));
            attributes["TEXCOORD_0"] = json!(
                self.accessor(json!({ "bufferView": view, "componentType": 5126, "type": "VEC2", "count": count }))
            );
        }
        json!({ "material": material, "indices": indices, "attributes": attributes })
    }

    fn accessor(&mut self, accessor: Value) -> Id {
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn view(&mut self, bytes: &[u8], target: Option<u32>) -> Id {
        pad(&mut self.binary, 0);
        let mut view = json!({ "buffer": self.buffer, "byteOffset": self.binary.len(), "byteLength": bytes.len() });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.binary.extend_from_slice(bytes);
        self.views.push(view);
        self.views.len() - 1
    }
}

/// True if a material has a picture of any kind.
fn reads_pictures(material: &Value) -> bool {
    match material {
        Value::Object(parts) => parts.iter().any(|(key, part)| key.ends_with("Texture") || reads_pictures(part)),
        _ => false,
    }
}

/// A node that shows a mesh at its parent's place.
pub(crate) fn mesh_node(name: &str, mesh: Id) -> Value {
    json!({ "name": name, "mesh": mesh })
}

pub(crate) fn at(mut node: Value, translation: DVec3) -> Value {
    node["translation"] = json!(translation.as_vec3().to_array());
    node
}

pub(crate) fn turned(mut node: Value, turn_rad: f64) -> Value {
    node["rotation"] = json!(DQuat::from_rotation_y(turn_rad).as_quat().to_array());
    node
}

/// The same node, scaled; negative factors mirror.
pub(crate) fn scaled(mut node: Value, scale: DVec3) -> Value {
    node["scale"] = json!(scale.as_vec3().to_array());
    node
}

/// Chunks and views start at multiples of four bytes (glTF 2.0, §4.4.3.1).
fn pad(bytes: &mut Vec<u8>, with: u8) {
    while !bytes.len().is_multiple_of(4) {
        bytes.push(with);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_container_is_laid_out_as_the_specification_says() {
        let mut glb = Glb::default();
        let parent = glb.node(None, json!({ "name": "parent" }));
        let child = glb.node(Some(parent), json!({ "name": "child" }));
        glb.rotation_animation("turn", child, &[(0.0, DQuat::IDENTITY), (1.0, DQuat::from_rotation_y(1.0))]);
        let file = glb.finish("test").unwrap();
        assert_eq!(&file[..4], b"glTF");
        let word = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((word(4), word(8)), (2, file.len()));
        let json: Value = serde_json::from_slice(&file[20..20 + word(12)]).unwrap();
        assert_eq!(json["nodes"][0]["children"], json!([1]));
        assert_eq!(json["scenes"][0]["nodes"], json!([0]));
        let binary = 20 + word(12);
        assert_eq!((&file[binary + 4..binary + 8], word(binary)), (&b"BIN\0"[..], 2 * 4 + 2 * 16));
        assert_eq!(json["buffers"][0]["byteLength"], json!(40));
    }
}
