//! Every index of the JSON that Gnomon follows points to something. Checked for the whole file, once, so that the code
//! behind it may follow indices of any object; it still does so without panicking.

use crate::error::{SceneError, place};
use crate::reader::json::document::{Document, Primitive};

/// Fails on the first index that points nowhere.
///
/// # Errors
/// [`SceneError::Reference`] names both ends.
pub(crate) fn check(document: &Document<'_>) -> Result<(), SceneError> {
    let nodes = document.nodes.len();
    if let Some(scene) = document.scene {
        inside("the file", "default scene", Some(scene), document.scenes.len())?;
    }
    for (index, scene) in document.scenes.iter().enumerate() {
        for node in &scene.nodes {
            inside(&place("scene", index, None), "node", Some(*node), nodes)?;
        }
    }
    let lights = document.extensions.lights.as_ref().map_or(0, |lights| lights.lights.len());
    for (index, node) in document.nodes.iter().enumerate() {
        let here = place("node", index, node.name.as_deref());
        for child in &node.children {
            inside(&here, "node", Some(*child), nodes)?;
        }
        inside(&here, "mesh", node.mesh, document.meshes.len())?;
        inside(&here, "light", node.extensions.light.as_ref().map(|light| light.light), lights)?;
    }
    for (index, mesh) in document.meshes.iter().enumerate() {
        let here = place("mesh", index, mesh.name.as_deref());
        if mesh.primitives.is_empty() {
            return Err(SceneError::invalid(here, "it has no primitives"));
        }
        for primitive in &mesh.primitives {
            check_primitive(document, &here, primitive)?;
        }
    }
    let views = document.buffer_views.len();
    for (index, accessor) in document.accessors.iter().enumerate() {
        let here = place("accessor", index, None);
        inside(&here, "buffer view", accessor.buffer_view, views)?;
        if let Some(sparse) = &accessor.sparse {
            inside(&here, "buffer view", Some(sparse.indices.buffer_view), views)?;
            inside(&here, "buffer view", Some(sparse.values.buffer_view), views)?;
        }
    }
    for (index, view) in document.buffer_views.iter().enumerate() {
        inside(&place("buffer view", index, None), "buffer", Some(view.buffer), document.buffers.len())?;
    }
    for (index, material) in document.materials.iter().enumerate() {
        let here = place("material", index, material.name.as_deref());
        let texture = material.pbr_metallic_roughness.base_color_texture.as_ref().map(|info| info.index);
        inside(&here, "texture", texture, document.textures.len())?;
    }
    for (index, texture) in document.textures.iter().enumerate() {
        let here = place("texture", index, None);
        inside(&here, "image", texture.source, document.images.len())?;
        inside(&here, "sampler", texture.sampler, document.samplers.len())?;
    }
    for (index, image) in document.images.iter().enumerate() {
        let here = place("image", index, image.name.as_deref());
        inside(&here, "buffer view", image.buffer_view, views)?;
        if image.uri.is_some() == image.buffer_view.is_some() {
            return Err(SceneError::invalid(here, "it must have either a uri or a buffer view"));
        }
    }
    Ok(())
}

fn check_primitive(document: &Document<'_>, here: &str, primitive: &Primitive) -> Result<(), SceneError> {
    let accessors = document.accessors.len();
    let attributes = &primitive.attributes;
    for accessor in [attributes.position, attributes.normal, primitive.indices]
        .into_iter()
        .chain((0..4).map(|set| attributes.texcoord(set)))
    {
        inside(here, "accessor", accessor, accessors)?;
    }
    inside(here, "material", primitive.material, document.materials.len())
}

fn inside(place: &str, target: &'static str, index: Option<u32>, count: usize) -> Result<(), SceneError> {
    match index {
        Some(index) if index as usize >= count => {
            Err(SceneError::Reference { place: place.to_owned(), target, index, count })
        }
        _ => Ok(()),
    }
}
