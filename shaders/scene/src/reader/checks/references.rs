//! Checks that every index in the file is in range. Later code still looks indices up without panicking.

use gltf::json::{Accessor, Index, Root, mesh, root::Get};

use crate::{
    LoadReport,
    error::{SceneError, place},
    reader::json::{Document, source},
};

/// Errors with [`SceneError::Reference`] at the first index that points nowhere.
pub(crate) fn check(document: &Document, report: &mut LoadReport) -> Result<(), SceneError> {
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
        below(&here, "camera", node.camera.map(|camera| camera.value()), document.cameras.len())?;
        below(&here, "skin", node.skin.map(|skin| skin.value()), document.skins.len())?;
        let light = node.extensions.as_ref().and_then(|extensions| extensions.khr_lights_punctual.as_ref());
        below(&here, "light", light.map(|light| light.light.value()), document.lights.len())?;
    }
    for (index, mesh) in json.meshes.iter().enumerate() {
        let here = place("mesh", index, mesh.name.as_deref());
        if mesh.primitives.is_empty() {
            report.left_out("a mesh without primitives", &here);
        }
        for primitive in &mesh.primitives {
            check_primitive(document, &here, primitive)?;
        }
        for target in document.targets.get(index).into_iter().flatten().flatten() {
            for accessor in [target.position, target.normal, target.tangent, target.color] {
                inside::<Accessor>(json, &here, "accessor", accessor.map(Index::new))?;
            }
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
    for (index, material) in document.materials.iter().enumerate() {
        let here = place("material", index, material.name.as_deref());
        for info in material.infos() {
            below(&here, "texture", Some(info.index as usize), json.textures.len())?;
        }
    }
    for (index, skin) in document.skins.iter().enumerate() {
        let here = place("skin", index, None);
        for joint in &skin.joints {
            below(&here, "node", Some(*joint as usize), json.nodes.len())?;
        }
        inside::<Accessor>(json, &here, "accessor", skin.inverse_bind_matrices.map(Index::new))?;
    }
    for (index, texture) in json.textures.iter().enumerate() {
        let here = place("texture", index, None);
        inside(json, &here, "image", source(texture))?;
        inside(json, &here, "sampler", texture.sampler)?;
    }
    for (index, image) in json.images.iter().enumerate() {
        let here = place("image", index, image.name.as_deref());
        inside(json, &here, "buffer view", image.buffer_view)?;
        if image.uri.is_some() && image.buffer_view.is_some() {
            report.mended("an image with a uri and a buffer view: the view counts", &here);
        }
    }
    Ok(())
}

fn check_primitive(document: &Document, here: &str, primitive: &mesh::Primitive) -> Result<(), SceneError> {
    let json = &document.json;
    for accessor in primitive.attributes.values() {
        inside(json, here, "accessor", Some(*accessor))?;
    }
    inside::<Accessor>(json, here, "accessor", primitive.indices)?;
    below(here, "material", primitive.material.map(|material| material.value()), document.materials.len())
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
