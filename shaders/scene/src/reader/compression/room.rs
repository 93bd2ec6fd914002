//! Buffers and views that decompression adds to a document, and how much they may hold.

use gltf::json::{Buffer, Index, Root, buffer::View, validation::USize64};

use crate::{
    error::{SceneError, within},
    limits::MAX_BUFFER_BYTES,
    reader::file::buffers::Buffers,
};

/// Bytes that may still be decoded, and be decoded into. They bound time and memory: many views may name the same
/// bytes.
pub(super) struct Room {
    pub(super) encoded: u64,
    pub(super) decoded: u64,
}

impl Room {
    pub(super) fn take_encoded(&mut self, bytes: u64) -> Result<(), SceneError> {
        take(&mut self.encoded, bytes, "bytes of all compressed geometry")
    }

    pub(super) fn take_decoded(&mut self, bytes: u64) -> Result<(), SceneError> {
        take(&mut self.decoded, bytes, "bytes of all geometry after decompression")
    }
}

fn take(left: &mut u64, bytes: u64, what: &str) -> Result<(), SceneError> {
    let taken = (MAX_BUFFER_BYTES - *left).saturating_add(bytes);
    within(what, taken, MAX_BUFFER_BYTES)?;
    *left -= bytes;
    Ok(())
}

/// Appends a buffer with these bytes, or with the reason why there are none.
pub(super) fn add_buffer(
    json: &mut Root,
    buffers: &mut Buffers<'_>,
    bytes: Result<Vec<u8>, String>,
    length: u64,
) -> Index<Buffer> {
    let index = buffers.push(bytes);
    json.buffers.push(Buffer {
        byte_length: USize64(length),
        name: None,
        uri: None,
        extensions: None,
        extras: gltf::json::Extras::default(),
    });
    Index::new(u32::try_from(index).unwrap_or(u32::MAX))
}

/// Appends a buffer view of a buffer's first bytes.
pub(super) fn add_view(json: &mut Root, buffer: Index<Buffer>, length: u64) -> Index<View> {
    let index = json.buffer_views.len();
    json.buffer_views.push(View {
        buffer,
        byte_length: USize64(length),
        byte_offset: None,
        byte_stride: None,
        name: None,
        target: None,
        extensions: None,
        extras: gltf::json::Extras::default(),
    });
    Index::new(u32::try_from(index).unwrap_or(u32::MAX))
}
