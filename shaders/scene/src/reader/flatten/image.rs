//! Reads and decodes the pictures of textures, and scales them down if they are too large together.

use std::{collections::HashMap, path::Path};

use gltf::json::{Index, Root};

use crate::{
    Image, LoadReport,
    error::{SceneError, place, within},
    file::{beneath, read_file},
    limits::{MAX_IMAGE_BYTES, MAX_IMAGES_BYTES, MAX_SOURCE_IMAGES_PIXELS},
    picture::{self, Source},
    reader::file::{
        buffers::Buffers,
        uri::{Target, resolve},
    },
};

/// Returns for each image the first one with the same bytes, as far as the JSON tells: a picture is read and counted
/// once.
pub(crate) fn originals(json: &Root) -> Vec<Index<gltf::json::Image>> {
    let mut first = HashMap::new();
    let images = json.images.iter().enumerate();
    images
        .map(|(index, image)| {
            let index = Index::new(u32::try_from(index).unwrap_or(u32::MAX));
            *first.entry((image.uri.as_deref(), image.buffer_view.map(|view| view.value()))).or_insert(index)
        })
        .collect()
}

/// Loads the images with the given indices, in that order.
/// Errors if one is missing, broken, or of a format that is not read, or if all together are too large.
pub(crate) fn load(
    json: &Root,
    buffers: &Buffers<'_>,
    folder: &Path,
    wanted: &[Index<gltf::json::Image>],
    report: &mut LoadReport,
) -> Result<Vec<Image>, SceneError> {
    let mut sources = Vec::with_capacity(wanted.len());
    let (mut bytes, mut pixels) = (0_u64, 0_u64);
    for index in wanted {
        let Some(image) = json.get(*index) else {
            return Err(SceneError::invalid(place("image", index.value(), None), "there is no such image"));
        };
        let here = place("image", index.value(), image.name.as_deref());
        let (encoded, name) = read(json, buffers, folder, image, &here)?;
        bytes += encoded.len() as u64;
        within("bytes of all pictures", bytes, MAX_IMAGES_BYTES)?;
        let fault = |fault| SceneError::Picture { place: here.clone(), name: name.clone(), fault };
        let source = Source::new(encoded).map_err(fault)?;
        pixels += picture::area(source.width, source.height);
        within("pixels of all pictures", pixels, MAX_SOURCE_IMAGES_PIXELS)?;
        sources.push((source, here, name));
    }
    let sizes: Vec<_> = sources.iter().map(|(source, ..)| (source.width, source.height)).collect();
    let halvings = picture::halvings(&sizes);
    report.scaled_pictures = halvings.iter().filter(|times| **times > 0).count() as u64;
    let mut images = Vec::with_capacity(sources.len());
    let mut bytes = 0_u64;
    for ((source, place, name), halvings) in sources.into_iter().zip(halvings) {
        let image = source.decode(halvings).map_err(|fault| SceneError::Picture { place, name, fault })?;
        bytes += image.encoded.len() as u64;
        within("bytes of all pictures as they travel", bytes, MAX_IMAGES_BYTES)?;
        images.push(image);
    }
    Ok(images)
}

/// Returns an image's bytes, and where they lie.
fn read(
    json: &Root,
    buffers: &Buffers<'_>,
    folder: &Path,
    image: &gltf::json::Image,
    here: &str,
) -> Result<(Vec<u8>, String), SceneError> {
    let inside = || "inside the file".to_owned();
    match (&image.uri, image.buffer_view) {
        (Some(uri), _) => match resolve(uri, folder).map_err(|fault| SceneError::invalid(here, fault))? {
            Target::Data(data) => Ok((data, inside())),
            Target::File(path) => {
                Ok((read_file(&beneath(&path, folder)?, MAX_IMAGE_BYTES)?, path.display().to_string()))
            }
        },
        (None, Some(view)) => {
            let view = buffers.view(json, view)?;
            within(format!("bytes of {here}"), view.len() as u64, MAX_IMAGE_BYTES)?;
            Ok((view.to_vec(), inside()))
        }
        (None, None) => Err(SceneError::invalid(here, "it has neither a uri nor a buffer view")),
    }
}
