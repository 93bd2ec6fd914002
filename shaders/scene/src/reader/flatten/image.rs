//! Reads and decodes the pictures of base colour textures.

use std::path::Path;

use gltf::json::{Index, Root};

use crate::{
    Image,
    error::{SceneError, place, within},
    file::{beneath, read_file},
    limits::{MAX_IMAGE_BYTES, MAX_IMAGES_BYTES, MAX_IMAGES_PIXELS},
    picture::decode,
    reader::file::{
        buffers::Buffers,
        uri::{Target, resolve},
    },
};

/// Loads the images with the given indices, in that order.
/// Errors if one is missing, broken, or of a format that is not read, or if all together are too large.
pub(crate) fn load(
    json: &Root,
    buffers: &Buffers<'_>,
    folder: &Path,
    wanted: &[Index<gltf::json::Image>],
) -> Result<Vec<Image>, SceneError> {
    let mut images = Vec::with_capacity(wanted.len());
    let (mut bytes, mut pixels_left) = (0_u64, MAX_IMAGES_PIXELS);
    for index in wanted {
        let Some(source) = json.get(*index) else {
            return Err(SceneError::invalid(place("image", index.value(), None), "there is no such image"));
        };
        let here = place("image", index.value(), source.name.as_deref());
        let mut name = "inside the file".to_owned();
        let encoded = match (&source.uri, source.buffer_view) {
            (Some(uri), _) => match resolve(uri, folder).map_err(|fault| SceneError::invalid(here.as_str(), fault))? {
                Target::Data(data) => data,
                Target::File(path) => {
                    name = path.display().to_string();
                    read_file(&beneath(&path, folder)?, MAX_IMAGE_BYTES)?
                }
            },
            (None, Some(view)) => {
                let view = buffers.view(json, view)?;
                within(format!("bytes of {here}"), view.len() as u64, MAX_IMAGE_BYTES)?;
                view.to_vec()
            }
            (None, None) => return Err(SceneError::invalid(here, "it has neither a uri nor a buffer view")),
        };
        bytes += encoded.len() as u64;
        within("bytes of all base colour pictures", bytes, MAX_IMAGES_BYTES)?;
        let image = decode(encoded, pixels_left).map_err(|fault| SceneError::Picture { place: here, name, fault })?;
        pixels_left -= u64::from(image.width) * u64::from(image.height);
        images.push(image);
    }
    Ok(images)
}
