//! Primitives that `KHR_draco_mesh_compression` compresses.

use std::collections::BTreeMap;

use gltf::json::{
    Accessor, Index, Root,
    accessor::{ComponentType, GenericComponentType, Type},
    mesh::{Mode, Semantic},
    validation::{Checked, USize64},
};
use serde::Deserialize;

use super::{
    draco,
    room::{Room, add_buffer, add_view},
};
use crate::{
    error::{SceneError, place},
    reader::{file::buffers::Buffers, json::attribute},
};

/// What the extension says.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Compressed {
    buffer_view: u32,
    /// Numbers of the attributes in the compressed data.
    attributes: BTreeMap<Checked<Semantic>, u32>,
}

/// Gives compressed primitives accessors of their own.
/// Errors if one is broken, or all together are too large.
pub(super) fn expand(json: &mut Root, buffers: &mut Buffers<'_>, room: &mut Room) -> Result<(), SceneError> {
    // Each view is decoded once, however many primitives name it.
    let mut by_view: BTreeMap<u32, Vec<(usize, usize, Compressed)>> = BTreeMap::new();
    for (mesh, number) in primitives(json) {
        if let Some(compressed) = compressed(json, buffers, mesh, number)? {
            by_view.entry(compressed.buffer_view).or_default().push((mesh, number, compressed));
        }
    }
    for (view, users) in by_view {
        let Some((mesh, number, _)) = users.first() else { continue };
        let invalid =
            |fault: String| SceneError::invalid(here(json, *mesh, *number), format!("its Draco data: {fault}"));
        let data = buffers.view(json, Index::new(view))?;
        room.take_encoded(data.len() as u64)?;
        let geometry = draco::decode(data, room.decoded).map_err(invalid)?;
        for (mesh, number, compressed) in users {
            replace(json, buffers, room, (mesh, number), &compressed, &geometry)?;
        }
    }
    Ok(())
}

fn primitives(json: &Root) -> Vec<(usize, usize)> {
    let meshes = json.meshes.iter().enumerate();
    meshes.flat_map(|(mesh, it)| (0..it.primitives.len()).map(move |number| (mesh, number))).collect()
}

fn here(json: &Root, mesh: usize, number: usize) -> String {
    let name = json.meshes.get(mesh).and_then(|mesh| mesh.name.as_deref());
    format!("{}, primitive {number}", place("mesh", mesh, name))
}

/// Returns what the extension says, if the primitive has it, and not also its positions uncompressed.
fn compressed(
    json: &Root,
    buffers: &Buffers<'_>,
    mesh: usize,
    number: usize,
) -> Result<Option<Compressed>, SceneError> {
    let Some(primitive) = json.meshes.get(mesh).and_then(|mesh| mesh.primitives.get(number)) else { return Ok(None) };
    let others = primitive.extensions.as_ref().map(|extensions| &extensions.others);
    let Some(value) = others.and_then(|others| others.get("KHR_draco_mesh_compression")) else { return Ok(None) };
    let there = |index: Index<Accessor>| {
        let view = json.get(index)?.buffer_view?;
        buffers.view(json, view).ok()
    };
    let indexed = primitive.indices.is_none_or(|indices| there(indices).is_some());
    if indexed && attribute(primitive, Semantic::Positions).and_then(there).is_some() {
        return Ok(None);
    }
    let compressed = Compressed::deserialize(value);
    compressed
        .map(Some)
        .map_err(|error| SceneError::invalid(here(json, mesh, number), format!("its Draco compression: {error}")))
}

fn replace(
    json: &mut Root,
    buffers: &mut Buffers<'_>,
    room: &mut Room,
    (mesh, number): (usize, usize),
    compressed: &Compressed,
    geometry: &draco::Geometry,
) -> Result<(), SceneError> {
    let here = here(json, mesh, number);
    let Some(primitive) = json.meshes.get(mesh).and_then(|mesh| mesh.primitives.get(number)) else { return Ok(()) };
    let mut attributes = primitive.attributes.clone();
    for (semantic, index) in &mut attributes {
        let Some(id) = compressed.attributes.get(semantic) else { continue };
        let Some(accessor) = json.get(*index) else { continue };
        let (Checked::Valid(component), Checked::Valid(shape)) = (accessor.component_type, accessor.type_) else {
            continue;
        };
        let bytes = geometry.points as u64 * shape.multiplicity() as u64 * component.0.size() as u64;
        room.take_decoded(bytes)?;
        let values = geometry.attribute(*id, shape.multiplicity(), component.0).ok_or_else(|| {
            SceneError::invalid(here.as_str(), format!("its Draco data have no attribute {id} as accessor {index} is"))
        })?;
        let accessor = accessor.clone();
        *index = add_accessor(json, buffers, accessor, geometry.points, values);
    }
    room.take_decoded(geometry.triangles.len() as u64 * 12)?;
    let corners: Vec<u8> = geometry.triangles.iter().flatten().flat_map(|corner| corner.to_le_bytes()).collect();
    let accessor = Accessor {
        buffer_view: None,
        byte_offset: None,
        count: USize64(0),
        component_type: Checked::Valid(GenericComponentType(ComponentType::U32)),
        extensions: None,
        extras: gltf::json::Extras::default(),
        type_: Checked::Valid(Type::Scalar),
        min: None,
        max: None,
        name: None,
        normalized: false,
        sparse: None,
    };
    let indices = add_accessor(json, buffers, accessor, geometry.triangles.len() * 3, corners);
    if let Some(primitive) = json.meshes.get_mut(mesh).and_then(|mesh| mesh.primitives.get_mut(number)) {
        primitive.attributes = attributes;
        primitive.indices = Some(indices);
        // Strips are decoded to a list.
        primitive.mode = Checked::Valid(Mode::Triangles);
    }
    Ok(())
}

/// Appends an accessor that is like another one, with these elements.
fn add_accessor(
    json: &mut Root,
    buffers: &mut Buffers<'_>,
    like: Accessor,
    count: usize,
    bytes: Vec<u8>,
) -> Index<Accessor> {
    let length = bytes.len() as u64;
    let buffer = add_buffer(json, buffers, Ok(bytes), length);
    let view = add_view(json, buffer, length);
    let index = json.accessors.len();
    json.accessors.push(Accessor { buffer_view: Some(view), byte_offset: None, count: USize64(count as u64), ..like });
    Index::new(u32::try_from(index).unwrap_or(u32::MAX))
}
