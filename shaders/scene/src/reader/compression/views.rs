//! Buffer views that `EXT_meshopt_compression` or `KHR_meshopt_compression` compress.

use gltf::json::{Root, validation::USize64};
use serde::Deserialize;

use super::{
    meshopt::{self, Mode},
    room::{Room, add_buffer},
};
use crate::{
    error::{SceneError, place},
    reader::file::buffers::Buffers,
};

/// What the extension says.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Compressed {
    buffer: usize,
    #[serde(default)]
    byte_offset: u64,
    byte_length: u64,
    byte_stride: u64,
    mode: String,
    filter: Option<String>,
    count: u64,
}

/// Gives each compressed view whose own buffer has no bytes a buffer of its own.
/// Errors if all together are too large.
pub(super) fn expand(json: &mut Root, buffers: &mut Buffers<'_>, room: &mut Room) -> Result<(), SceneError> {
    for index in 0..json.buffer_views.len() {
        let Some(view) = json.buffer_views.get(index) else { break };
        let others = view.extensions.as_ref().map(|extensions| &extensions.others);
        let names = ["KHR_meshopt_compression", "EXT_meshopt_compression"];
        let Some(value) = others.and_then(|others| names.iter().find_map(|name| others.get(*name))) else { continue };
        if buffers.get(view.buffer.value()).is_ok() {
            continue;
        }
        let length = view.byte_length.0;
        let compressed = Compressed::deserialize(value);
        let here = format!("{}: its meshopt compression", place("buffer view", index, None));
        let compressed = compressed.map_err(|error| SceneError::invalid(here.as_str(), error.to_string()))?;
        room.take_encoded(compressed.byte_length)?;
        room.take_decoded(length)?;
        let bytes = decode(&compressed, buffers, length).map_err(|fault| format!("{here}: {fault}"));
        let buffer = add_buffer(json, buffers, bytes, length);
        if let Some(view) = json.buffer_views.get_mut(index) {
            view.buffer = buffer;
            view.byte_offset = None;
            view.byte_length = USize64(length);
        }
    }
    Ok(())
}

fn decode(compressed: &Compressed, buffers: &Buffers<'_>, length: u64) -> Result<Vec<u8>, String> {
    let mode = Mode::new(&compressed.mode, compressed.filter.as_deref())?;
    let data = buffers.get(compressed.buffer).map_err(|error| error.to_string())?;
    let start = usize::try_from(compressed.byte_offset).ok();
    let bytes = usize::try_from(compressed.byte_length).ok();
    let data = start.zip(bytes).and_then(|(start, bytes)| data.get(start..)?.get(..bytes));
    let data = data.ok_or("it reaches beyond its buffer")?;
    if compressed.count.checked_mul(compressed.byte_stride) != Some(length) {
        return Err(format!(
            "{} elements of {} bytes are not the view's {length} bytes",
            compressed.count, compressed.byte_stride
        ));
    }
    // Their product fits: it is the length of a view, which is bounded.
    let number = |value: u64| usize::try_from(value).map_err(|_| "it is too large".to_owned());
    Ok(meshopt::decode(mode, data, number(compressed.count)?, number(compressed.byte_stride)?)?)
}
