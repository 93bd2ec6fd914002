//! Checks that every index in the file is in range. Later code still looks indices up without panicking.

use gltf::json::{Accessor, Index, Root, mesh, root::Get};

use crate::{
    error::{SceneError, place},
    reader::json::{Document, TEXCOORDS, attribute, source},
};

/// Errors with [`SceneError::Reference`] at the first index that points nowhere.
pub(crate) fn check(document: &Document) -> Result<(), SceneError> {
    let json = &document.json;
    inside(json, "the file", "default scene", json.scene)?;
    for (index, scene) in json.scenes.iter().enumerate() {
        for node in &scene.nodes {
            inside(json, &place("scene", index, None), "node", Some(*node))?;
        }
    }
    for (index, node) in json.nodes.iter().enumerate() {
        let here = place("node", index, node.name.as_deref());
        for child in node.children.iter().flatten() {
            inside(json, &here, "node", Some(*child))?;
        }
        inside(json, &here, "mesh", node.mesh)?;
        let light = node.extensions.as_ref().and_then(|extensions| extensions.khr_lights_punctual.as_ref());
        below(&here, "light", light.map(|light| light.light.value()), document.lights.len())?;
    }
    for (index, mesh) in json.meshes.iter().enumerate() {
        let here = place("mesh", index, mesh.name.as_deref());
        if mesh.primitives.is_empty() {
            return Err(SceneError::invalid(here, "it has no primitives"));
        }
        for primitive in &mesh.primitives {
            check_primitive(json, &here, primitive)?;
        }
    }
    for (index, accessor) in json.accessors.iter().enumerate() {
        let here = place("accessor", index, None);
        inside(json, &here, "buffer view", accessor.buffer_view)?;
        if let Some(sparse) = &accessor.sparse {
            inside(json, &here, "buffer view", Some(sparse.indices.buffer_view))?;
            inside(json, &here, "buffer view", Some(sparse.values.buffer_view))?;
        }
    }
    for (index, view) in json.buffer_views.iter().enumerate() {
        inside(json, &place("buffer view", index, None), "buffer", Some(view.buffer))?;
    }
    for (index, material) in json.materials.iter().enumerate() {
        let here = place("material", index, material.name.as_deref());
        let texture = material.pbr_metallic_roughness.base_color_texture.as_ref();
        inside(json, &here, "texture", texture.map(|info| info.index))?;
    }
    for (index, texture) in json.textures.iter().enumerate() {
        let here = place("texture", index, None);
        inside(json, &here, "image", source(texture))?;
        inside(json, &here, "sampler", texture.sampler)?;
    }
    for (index, image) in json.images.iter().enumerate() {
        let here = place("image", index, image.name.as_deref());
        inside(json, &here, "buffer view", image.buffer_view)?;
        if image.uri.is_some() == image.buffer_view.is_some() {
            return Err(SceneError::invalid(here, "it must have either a uri or a buffer view"));
        }
    }
    Ok(())
}

fn check_primitive(json: &Root, here: &str, primitive: &mesh::Primitive) -> Result<(), SceneError> {
    let attributes = [mesh::Semantic::Positions, mesh::Semantic::Normals].into_iter();
    for semantic in attributes.chain(TEXCOORDS.map(mesh::Semantic::TexCoords)) {
        inside(json, here, "accessor", attribute(primitive, semantic))?;
    }
    inside::<Accessor>(json, here, "accessor", primitive.indices)?;
    inside(json, here, "material", primitive.material)
}

fn inside<T>(json: &Root, place: &str, target: &'static str, index: Option<Index<T>>) -> Result<(), SceneError>
where
    Root: Get<T> + AsRef<[T]>,
{
    below(place, target, index.map(|index| index.value()), AsRef::<[T]>::as_ref(json).len())
}

fn below(place: &str, target: &'static str, index: Option<usize>, count: usize) -> Result<(), SceneError> {
    match index {
        Some(index) if index >= count => Err(SceneError::Reference { place: place.to_owned(), target, index, count }),
        _ => Ok(()),
    }
}
