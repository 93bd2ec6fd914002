//! Reads and decodes the pictures of textures. One that is missing or broken is left out, with a warning.

use std::path::Path;

use gltf::json::Root;
use image::{ExtendedColorType, ImageEncoder as _, codecs::png::PngEncoder};

use super::texture::ImageSource;
use crate::{
    Image, LoadReport,
    error::{SceneError, place, within},
    file::{beneath, read_file},
    limits::{MAX_IMAGE_BYTES, MAX_IMAGES_BYTES, MAX_IMAGES_PIXELS, MAX_SOURCE_IMAGES_PIXELS},
    picture::{self, Source, decode},
    reader::file::{
        buffers::Buffers,
        uri::{Target, resolve},
    },
};

/// The images of a scene.
pub(crate) struct Loaded {
    pub(crate) images: Vec<Image>,
    /// For each wanted image, its index in `images`. `None` if it was left out.
    pub(crate) indices: Vec<Option<u32>>,
}

/// A picture before its pixels take memory.
enum Undecoded {
    Source(Source),
    /// Made of wanted image `image`.
    Roughness {
        image: usize,
        glossiness: f32,
        width: u32,
        height: u32,
    },
}

impl Undecoded {
    fn size(&self) -> (u32, u32) {
        match *self {
            Self::Source(ref source) => (source.width, source.height),
            Self::Roughness { width, height, .. } => (width, height),
        }
    }
}

/// Loads the wanted images, in that order, and scales them down if they are too large together.
/// Errors if even so they are.
pub(crate) fn load(
    json: &Root,
    buffers: &Buffers<'_>,
    folder: &Path,
    wanted: &[ImageSource],
    report: &mut LoadReport,
) -> Result<Loaded, SceneError> {
    let undecoded = undecoded(json, buffers, folder, wanted, report)?;
    let sizes: Vec<_> = undecoded.iter().flatten().map(Undecoded::size).collect();
    let mut halvings = picture::halvings(&sizes).into_iter();
    let mut loaded = Loaded { images: Vec::with_capacity(sizes.len()), indices: Vec::with_capacity(wanted.len()) };
    let (mut bytes, mut pixels_left) = (0_u64, MAX_IMAGES_PIXELS);
    for (source, undecoded) in wanted.iter().zip(undecoded) {
        let Some(undecoded) = undecoded else {
            loaded.indices.push(None);
            continue;
        };
        let halvings = halvings.next().unwrap_or(0);
        report.scaled_pictures += u64::from(halvings > 0);
        let image = match undecoded {
            Undecoded::Source(source) => source.decode(halvings),
            Undecoded::Roughness { image, glossiness, .. } => {
                let known = loaded.indices.get(image).copied().flatten();
                let known = known.and_then(|index| loaded.images.get(index as usize));
                let image = known.ok_or_else(|| "made of a picture that was left out".to_owned());
                image.and_then(|image| roughness(image, glossiness, pixels_left))
            }
        };
        match image {
            Ok(image) => {
                bytes += image.encoded.len() as u64;
                within("bytes of all pictures as they travel", bytes, MAX_IMAGES_BYTES)?;
                pixels_left = pixels_left.saturating_sub(picture::area(image.width, image.height));
                loaded.indices.push(u32::try_from(loaded.images.len()).ok());
                loaded.images.push(image);
            }
            Err(fault) => {
                unreadable(&format!("{}: {fault}", here(json, source)), report);
                loaded.indices.push(None);
            }
        }
    }
    Ok(loaded)
}

fn unreadable(fault: &str, report: &mut LoadReport) {
    report.left_out("a picture that cannot be read", fault);
}

fn here(json: &Root, source: &ImageSource) -> String {
    match *source {
        ImageSource::File(index) => {
            place("image", index.value(), json.get(index).and_then(|image| image.name.as_deref()))
        }
        ImageSource::Roughness { .. } => "roughness made of a glossiness picture".to_owned(),
    }
}

/// Reads the wanted images' heads. `None` for those that cannot be read.
/// Errors if all together are too large to be scaled down.
fn undecoded(
    json: &Root,
    buffers: &Buffers<'_>,
    folder: &Path,
    wanted: &[ImageSource],
    report: &mut LoadReport,
) -> Result<Vec<Option<Undecoded>>, SceneError> {
    let mut undecoded: Vec<Option<Undecoded>> = Vec::with_capacity(wanted.len());
    let (mut bytes, mut pixels) = (0_u64, 0_u64);
    for source in wanted {
        let read = match *source {
            ImageSource::File(index) => {
                let encoded = json.get(index).ok_or_else(|| "there is no such image".to_owned());
                let encoded = encoded.and_then(|image| read(json, buffers, folder, image));
                // Counted before it is looked at.
                bytes += encoded.as_ref().map_or(0, Vec::len) as u64;
                within("bytes of all pictures", bytes, MAX_IMAGES_BYTES)?;
                encoded.and_then(Source::new).map(Undecoded::Source)
            }
            ImageSource::Roughness { image, glossiness } => {
                let image = image as usize;
                let of = undecoded.get(image).and_then(Option::as_ref).map(Undecoded::size);
                of.map(|(width, height)| Undecoded::Roughness {
                    image,
                    glossiness: f32::from_bits(glossiness),
                    width,
                    height,
                })
                .ok_or_else(|| "made of a picture that was left out".to_owned())
            }
        };
        match &read {
            Ok(read) => {
                let (width, height) = read.size();
                pixels += picture::area(width, height);
                within("pixels of all pictures", pixels, MAX_SOURCE_IMAGES_PIXELS)?;
            }
            Err(fault) => unreadable(&format!("{}: {fault}", here(json, source)), report),
        }
        undecoded.push(read.ok());
    }
    Ok(undecoded)
}

/// Returns an image's encoded bytes.
/// Errors with a sentence if they cannot be read, or are too many.
fn read(json: &Root, buffers: &Buffers<'_>, folder: &Path, source: &gltf::json::Image) -> Result<Vec<u8>, String> {
    let fault = |error: SceneError| error.to_string();
    match (source.buffer_view, &source.uri) {
        (Some(view), _) => {
            let view = buffers.view(json, view).map_err(fault)?;
            within("bytes of the picture", view.len() as u64, MAX_IMAGE_BYTES).map_err(fault)?;
            Ok(view.to_vec())
        }
        (None, Some(uri)) => match resolve(uri, folder)? {
            Target::Data(data) => Ok(data),
            Target::File(path) => read_file(&beneath(&path, folder).map_err(fault)?, MAX_IMAGE_BYTES).map_err(fault),
        },
        (None, None) => Err("it has neither a uri nor a buffer view".to_owned()),
    }
}

/// Makes a picture with roughness in green of one with glossiness in alpha.
/// Errors with a sentence if it has no room.
fn roughness(image: &Image, glossiness: f32, pixels_left: u64) -> Result<Image, String> {
    if u64::from(image.width) * u64::from(image.height) > pixels_left {
        return Err(format!("its {}×{} pixels go beyond what the scene has left", image.width, image.height));
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "rounded, within 0 to 255")]
    let rough = |alpha: u8| (255.0 - f32::from(alpha) * glossiness).round().clamp(0.0, 255.0) as u8;
    let rgb: Vec<u8> = image.rgba.iter().skip(3).step_by(4).flat_map(|alpha| [0, rough(*alpha), 0]).collect();
    let mut encoded = Vec::new();
    let written = PngEncoder::new(&mut encoded).write_image(&rgb, image.width, image.height, ExtendedColorType::Rgb8);
    written.map_err(|error| error.to_string())?;
    decode(encoded, pixels_left)
}
