//! Loads a file's buffers (glTF 2.0, §3.6.1).

use std::{borrow::Cow, path::Path};

use gltf::json::{Index, Root, buffer::View};

use super::uri::{Target, resolve};
use crate::{
    error::{SceneError, place, within},
    file::{beneath, read_start},
    limits::MAX_BUFFER_BYTES,
    reader::checks::layout::view_range,
};

/// Buffers, each exactly as long as the JSON says.
pub(crate) struct Buffers<'a>(Vec<Content<'a>>);

enum Content<'a> {
    There(Cow<'a, [u8]>),
    /// Neither a URI nor a binary chunk. Legal if nothing reads it, or what does is compressed elsewhere.
    Missing,
    /// Compressed, and broken.
    Broken(String),
}

impl<'a> Buffers<'a> {
    /// Loads every buffer that has a URI. A first buffer without one is the `.glb`'s binary chunk.
    /// Errors if one cannot be read or is shorter than the JSON says, or if all together are too large.
    pub(crate) fn load(json: &Root, bin: Option<&'a [u8]>, folder: &Path) -> Result<Self, SceneError> {
        let total = json.buffers.iter().try_fold(0_u64, |sum, buffer| sum.checked_add(buffer.byte_length.0));
        within("bytes of all buffers", total.unwrap_or(u64::MAX), MAX_BUFFER_BYTES)?;
        let mut buffers = Vec::with_capacity(json.buffers.len());
        for (index, buffer) in json.buffers.iter().enumerate() {
            let here = || place("buffer", index, None);
            let data = match &buffer.uri {
                Some(uri) => match resolve(uri, folder).map_err(|fault| SceneError::invalid(here(), fault))? {
                    Target::Data(data) => Some(Cow::Owned(data)),
                    // Reads no more than the sum above counted: many buffers may name one large file.
                    Target::File(path) => Some(Cow::Owned(read_start(&beneath(&path, folder)?, buffer.byte_length.0)?)),
                },
                None if index == 0 => bin.map(Cow::Borrowed),
                None => None,
            };
            let data = match data {
                Some(data) => {
                    let there = data.len();
                    Content::There(prefix(data, buffer.byte_length.0).ok_or_else(|| {
                        let fault = format!("it says {} bytes, but has {there}", buffer.byte_length.0);
                        SceneError::invalid(here(), fault)
                    })?)
                }
                None => Content::Missing,
            };
            buffers.push(data);
        }
        Ok(Self(buffers))
    }

    /// Appends a buffer that was decompressed, or the reason why it could not be. Returns its index.
    pub(crate) fn push(&mut self, decompressed: Result<Vec<u8>, String>) -> usize {
        self.0.push(decompressed.map_or_else(Content::Broken, |bytes| Content::There(Cow::Owned(bytes))));
        self.0.len() - 1
    }

    /// Errors if the buffer has no bytes: neither a URI nor a binary chunk, or broken ones.
    pub(crate) fn get(&self, index: usize) -> Result<&[u8], SceneError> {
        let fault = match self.0.get(index) {
            Some(Content::There(bytes)) => return Ok(bytes),
            Some(Content::Broken(fault)) => fault,
            Some(Content::Missing) | None => "it has no uri, and there is no GLB chunk with its bytes",
        };
        Err(SceneError::invalid(place("buffer", index, None), fault))
    }

    /// Returns a buffer view's bytes.
    /// Errors as [`view_range`] and [`Self::get`].
    pub(crate) fn view(&self, json: &Root, index: Index<View>) -> Result<&[u8], SceneError> {
        let (buffer, start, bytes) = view_range(json, index.value())?;
        let data = self.get(buffer)?;
        let range = usize::try_from(start).ok().zip(usize::try_from(start + bytes).ok());
        range.and_then(|(start, end)| data.get(start..end)).ok_or_else(|| {
            SceneError::invalid(place("buffer view", index.value(), None), "it reaches beyond its buffer")
        })
    }
}

/// Returns the first `bytes` bytes, or `None` if there are fewer. A binary chunk may be padded.
fn prefix(data: Cow<'_, [u8]>, bytes: u64) -> Option<Cow<'_, [u8]>> {
    let bytes = usize::try_from(bytes).ok().filter(|bytes| *bytes <= data.len())?;
    Some(match data {
        Cow::Borrowed(data) => Cow::Borrowed(data.get(..bytes)?),
        Cow::Owned(mut data) => {
            data.truncate(bytes);
            Cow::Owned(data)
        }
    })
}
