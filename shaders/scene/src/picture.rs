//! Decodes PNG and JPEG pictures. Their size is checked before their pixels take memory.

use std::io::Cursor;

use image::{ImageFormat, ImageReader, Limits};

use crate::{
    Image,
    limits::{MAX_IMAGE_BYTES, MAX_IMAGE_SCRATCH_BYTES, MAX_IMAGE_SIDE_PX},
};

/// Decodes a picture of at most `pixels_left` pixels.
/// Errors with a sentence if it is neither PNG nor JPEG, too large, or broken.
pub(super) fn decode(encoded: Vec<u8>, pixels_left: u64) -> Result<Image, String> {
    if encoded.len() as u64 > MAX_IMAGE_BYTES {
        return Err(format!("it has {} bytes; at most {MAX_IMAGE_BYTES} are read", encoded.len()));
    }
    let format = format(&encoded)?;
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_IMAGE_SIDE_PX);
    limits.max_image_height = Some(MAX_IMAGE_SIDE_PX);
    limits.max_alloc = Some(MAX_IMAGE_SCRATCH_BYTES);
    let reader = || {
        let mut reader = ImageReader::with_format(Cursor::new(&encoded), format);
        reader.limits(limits.clone());
        reader
    };
    let (width, height) = reader().into_dimensions().map_err(|error| error.to_string())?;
    if width == 0 || height == 0 || width > MAX_IMAGE_SIDE_PX || height > MAX_IMAGE_SIDE_PX {
        return Err(format!("it is {width}×{height} pixels; sides of 1 to {MAX_IMAGE_SIDE_PX} are read"));
    }
    if u64::from(width) * u64::from(height) > pixels_left {
        return Err(format!("its {width}×{height} pixels go beyond the {pixels_left} that the scene has left"));
    }
    let rgba = reader().decode().map_err(|error| error.to_string())?.into_rgba8();
    if rgba.dimensions() != (width, height) {
        return Err(format!("its head says {width}×{height} pixels, its body {:?}", rgba.dimensions()));
    }
    Ok(Image { encoded, width, height, rgba: rgba.into_raw() })
}

/// Tells the format from the first bytes, whatever the file's name or media type.
fn format(encoded: &[u8]) -> Result<ImageFormat, String> {
    match encoded {
        [0x89, b'P', b'N', b'G', ..] => Ok(ImageFormat::Png),
        [0xff, 0xd8, ..] => Ok(ImageFormat::Jpeg),
        [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => {
            Err("it is a WebP picture, which is not supported: only PNG and JPEG are".to_owned())
        }
        [0xab, b'K', b'T', b'X', ..] => {
            Err("it is a KTX picture, which is not supported: only PNG and JPEG are".to_owned())
        }
        [] => Err("it is empty".to_owned()),
        _ => Err("it is neither PNG nor JPEG".to_owned()),
    }
}
