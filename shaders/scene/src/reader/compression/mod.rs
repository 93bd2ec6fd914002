//! Decompresses what extensions compress, before geometry is read: the document then names ordinary buffer views.
//!
//! What a file also has uncompressed is read uncompressed, as a reader without the extension would.

mod draco;
pub(crate) mod fuzzing;
mod meshopt;
mod primitives;
mod room;
mod views;

use self::room::Room;
use super::{file::buffers::Buffers, json::Document};
use crate::{error::SceneError, limits::MAX_BUFFER_BYTES};

/// Replaces compressed buffer views and primitives of a checked document.
/// Errors if all together are too large, or a primitive's data are broken. Broken buffer views matter only if they are
/// read.
pub(crate) fn expand(document: &mut Document, buffers: &mut Buffers<'_>) -> Result<(), SceneError> {
    let mut room = Room { encoded: MAX_BUFFER_BYTES, decoded: MAX_BUFFER_BYTES };
    views::expand(&mut document.json, buffers, &mut room)?;
    primitives::expand(&mut document.json, buffers, &mut room)
}
