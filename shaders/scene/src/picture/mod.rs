//! Decodes pictures: PNG, JPEG and WebP, which travel as they are, and Basis Universal, which becomes WebP at load.
//!
//! Whatever the file's name or media type, the first bytes tell the format. Sizes are checked before pixels take
//! memory. Both ends decode with the same code, so their texels are equal.

mod area;
mod basis;
mod scale;
mod webp;

use std::io::Cursor;

use image::{ExtendedColorType, ImageEncoder as _, ImageFormat, ImageReader, Limits, codecs};

pub(crate) use self::{area::area, scale::halvings};

use crate::{
    Image,
    limits::{
        MAX_IMAGE_BYTES, MAX_IMAGE_SCRATCH_BYTES, MAX_IMAGE_SIDE_PX, MAX_SOURCE_IMAGE_PIXELS, MAX_SOURCE_IMAGE_SIDE_PX,
    },
};

/// Quality of a JPEG picture that had to be scaled down. Differences between neighbouring texels stay below what the
/// first encoding lost.
const SCALED_JPEG_QUALITY: u8 = 95;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Png,
    Jpeg,
    WebP,
    Basis,
}

/// A picture as it lies in a file, with its size in pixels.
pub(crate) struct Source {
    encoded: Vec<u8>,
    format: Format,
    pub(crate) width: u32,
    pub(crate) height: u32,
}

impl Source {
    /// Reads the head of a picture.
    /// Errors with a sentence if it is of no format that is read, has no pixels, or more than can be scaled down.
    pub(crate) fn new(encoded: Vec<u8>) -> Result<Self, String> {
        if encoded.len() as u64 > MAX_IMAGE_BYTES {
            return Err(format!("it has {} bytes; at most {MAX_IMAGE_BYTES} are read", encoded.len()));
        }
        let format = format(&encoded)?;
        let (width, height) = match format {
            Format::Basis => basis::size(&encoded)?,
            Format::WebP => webp::size(&encoded)?,
            Format::Png => size(&encoded, ImageFormat::Png)?,
            Format::Jpeg => size(&encoded, ImageFormat::Jpeg)?,
        };
        let sides = 1..=MAX_SOURCE_IMAGE_SIDE_PX;
        if !sides.contains(&width) || !sides.contains(&height) || area(width, height) > MAX_SOURCE_IMAGE_PIXELS {
            return Err(format!(
                "it is {width}×{height} pixels; sides of 1 to {MAX_SOURCE_IMAGE_SIDE_PX} and {MAX_SOURCE_IMAGE_PIXELS} \
                 pixels in all are read"
            ));
        }
        Ok(Self { encoded, format, width, height })
    }

    /// Decodes the picture, with its sides halved so many times.
    /// Errors with a sentence if it is broken.
    pub(crate) fn decode(self, halvings: u32) -> Result<Image, String> {
        let (level, rgba) = match self.format {
            Format::Basis => basis::decode(&self.encoded, self.width, self.height, halvings)?,
            format => (0, rgba(&self.encoded, format, self.width, self.height)?),
        };
        if halvings == 0 && self.format != Format::Basis {
            return Ok(Image { encoded: self.encoded, width: self.width, height: self.height, rgba });
        }
        let [width, height] = [self.width, self.height].map(|side| (side >> level).max(1));
        let (width, height, rgba) = scale::down(width, height, rgba, halvings - level);
        if self.format == Format::Jpeg {
            let encoded = jpeg(width, height, &rgba)?;
            let rgba = self::rgba(&encoded, Format::Jpeg, width, height)?;
            return Ok(Image { encoded, width, height, rgba });
        }
        Ok(Image { encoded: webp(width, height, &rgba)?, width, height, rgba })
    }
}

/// Decodes a picture that a peer sent, of at most `pixels_left` pixels.
/// Errors with a sentence if it is not PNG, JPEG or WebP, too large, or broken.
pub(crate) fn decode(encoded: Vec<u8>, pixels_left: u64) -> Result<Image, String> {
    let source = Source::new(encoded)?;
    let Source { format, width, height, .. } = source;
    if format == Format::Basis {
        return Err("it is a KTX picture, which does not travel".to_owned());
    }
    if width.max(height) > MAX_IMAGE_SIDE_PX || area(width, height) > pixels_left {
        return Err(format!(
            "its {width}×{height} pixels go beyond {MAX_IMAGE_SIDE_PX} a side, or the {pixels_left} that the scene has \
             left"
        ));
    }
    source.decode(0)
}

fn format(encoded: &[u8]) -> Result<Format, String> {
    match encoded {
        [0x89, b'P', b'N', b'G', ..] => Ok(Format::Png),
        [0xff, 0xd8, ..] => Ok(Format::Jpeg),
        [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => Ok(Format::WebP),
        [0xab, b'K', b'T', b'X', b' ', b'2', b'0', ..] => Ok(Format::Basis),
        [0xab, b'K', b'T', b'X', ..] => Err("it is a KTX picture of version 1; version 2 is read".to_owned()),
        [] => Err("it is empty".to_owned()),
        _ => Err("it is none of PNG, JPEG, WebP and KTX2".to_owned()),
    }
}

fn reader(encoded: &[u8], format: ImageFormat) -> ImageReader<Cursor<&[u8]>> {
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SOURCE_IMAGE_SIDE_PX);
    limits.max_image_height = Some(MAX_SOURCE_IMAGE_SIDE_PX);
    limits.max_alloc = Some(MAX_IMAGE_SCRATCH_BYTES);
    let mut reader = ImageReader::with_format(Cursor::new(encoded), format);
    reader.limits(limits);
    reader
}

fn size(encoded: &[u8], format: ImageFormat) -> Result<(u32, u32), String> {
    reader(encoded, format).into_dimensions().map_err(|error| error.to_string())
}

fn rgba(encoded: &[u8], format: Format, width: u32, height: u32) -> Result<Vec<u8>, String> {
    let format = match format {
        Format::Png => ImageFormat::Png,
        Format::Jpeg => ImageFormat::Jpeg,
        Format::WebP => ImageFormat::WebP,
        Format::Basis => return Err("it is a KTX picture".to_owned()),
    };
    let rgba = reader(encoded, format).decode().map_err(|error| error.to_string())?.into_rgba8();
    if rgba.dimensions() != (width, height) {
        return Err(format!("its head says {width}×{height} pixels, its body {:?}", rgba.dimensions()));
    }
    Ok(rgba.into_raw())
}

/// Encodes RGBA without loss. WebP is smaller than PNG, and is written twenty times faster.
fn webp(width: u32, height: u32, rgba: &[u8]) -> Result<Vec<u8>, String> {
    let mut encoded = Vec::new();
    let encoder = codecs::webp::WebPEncoder::new_lossless(&mut encoded);
    let written = match opaque(rgba) {
        Some(rgb) => encoder.write_image(&rgb, width, height, ExtendedColorType::Rgb8),
        None => encoder.write_image(rgba, width, height, ExtendedColorType::Rgba8),
    };
    written.map(|()| encoded).map_err(|error| error.to_string())
}

fn jpeg(width: u32, height: u32, rgba: &[u8]) -> Result<Vec<u8>, String> {
    let mut encoded = Vec::new();
    let rgb: Vec<u8> = rgba.chunks_exact(4).flat_map(|texel| texel.iter().take(3).copied()).collect();
    codecs::jpeg::JpegEncoder::new_with_quality(&mut encoded, SCALED_JPEG_QUALITY)
        .write_image(&rgb, width, height, ExtendedColorType::Rgb8)
        .map(|()| encoded)
        .map_err(|error| error.to_string())
}

/// Returns RGB, if all of a picture is opaque.
fn opaque(rgba: &[u8]) -> Option<Vec<u8>> {
    let texels = || rgba.chunks_exact(4);
    let opaque = texels().all(|texel| texel.last() == Some(&255));
    opaque.then(|| texels().flat_map(|texel| texel.iter().take(3).copied()).collect())
}
