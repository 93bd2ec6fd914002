//! `--environment`: the light around the scene by name, or a Radiance picture.

use std::{
    fmt,
    path::{Path, PathBuf},
    str::FromStr,
    sync::Arc,
};

use glam::Vec3;
use gnomon_settings::files::read_small;
use image::{ImageDecoder as _, codecs::hdr::HdrDecoder};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::render::environment::{Environment, MAX_PIXELS, Panorama, PanoramaError};

/// Largest file that is read, in bytes: the largest picture, uncompressed.
const MAX_FILE_BYTES: u64 = (MAX_PIXELS as u64) * 4 + (1 << 20);

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum EnvironmentSpec {
    /// Computed from the scene's sun.
    #[default]
    Sky,
    Flat,
    None,
    File(PathBuf),
}

#[derive(Debug, Error)]
pub enum EnvironmentError {
    #[error("cannot read environment {}: {source}", file.display())]
    Read { file: PathBuf, source: std::io::Error },
    #[error("environment {} is no Radiance picture (.hdr): {source}", file.display())]
    Decode { file: PathBuf, source: image::ImageError },
    #[error("{}: {source}", file.display())]
    Picture { file: PathBuf, source: PanoramaError },
}

#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("must be sky, flat, none, or a Radiance picture (.hdr)")]
pub struct UnknownEnvironment;

impl FromStr for EnvironmentSpec {
    type Err = UnknownEnvironment;

    fn from_str(text: &str) -> Result<Self, UnknownEnvironment> {
        match text {
            "sky" => Ok(Self::Sky),
            "flat" => Ok(Self::Flat),
            "none" => Ok(Self::None),
            // A misspelt name is no file.
            file if Path::new(file).extension().is_some() => Ok(Self::File(file.into())),
            _ => Err(UnknownEnvironment),
        }
    }
}

impl fmt::Display for EnvironmentSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sky => f.write_str("sky"),
            Self::Flat => f.write_str("flat"),
            Self::None => f.write_str("none"),
            Self::File(file) => write!(f, "{}", file.display()),
        }
    }
}

impl TryFrom<String> for EnvironmentSpec {
    type Error = UnknownEnvironment;

    fn try_from(text: String) -> Result<Self, UnknownEnvironment> {
        text.parse()
    }
}

impl From<EnvironmentSpec> for String {
    fn from(spec: EnvironmentSpec) -> Self {
        spec.to_string()
    }
}

impl EnvironmentSpec {
    /// Reads the picture, if it is one.
    ///
    /// # Errors
    /// If the file cannot be read, is no Radiance picture, or has too many pixels.
    pub fn open(&self) -> Result<Environment, EnvironmentError> {
        match self {
            Self::Sky => Ok(Environment::Sky),
            Self::Flat => Ok(Environment::Flat),
            Self::None => Ok(Environment::None),
            Self::File(file) => panorama(file).map(|panorama| Environment::Panorama(Arc::new(panorama))),
        }
    }
}

fn panorama(file: &Path) -> Result<Panorama, EnvironmentError> {
    let path = || file.to_owned();
    let bytes = read_small(file, MAX_FILE_BYTES).map_err(|source| EnvironmentError::Read { file: path(), source })?;
    let decode = |source| EnvironmentError::Decode { file: path(), source };
    let picture = |source| EnvironmentError::Picture { file: path(), source };
    let decoder = HdrDecoder::new(bytes.as_slice()).map_err(decode)?;
    let (width, height) = decoder.dimensions();
    // Before the pixels are allocated.
    if width.checked_mul(height).is_none_or(|count| count > MAX_PIXELS) {
        return Err(picture(PanoramaError::Size(width, height)));
    }
    let decoded = image::DynamicImage::from_decoder(decoder).map_err(decode)?.into_rgb32f().into_raw();
    let pixels = decoded.as_chunks().0.iter().map(|rgb| Vec3::from_array(*rgb)).collect();
    Panorama::new(width, height, pixels).map_err(picture)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A Radiance picture without run lengths: a byte each of red, green, blue and exponent.
    fn radiance(width: u32, height: u32, pixels: &[[u8; 4]]) -> Vec<u8> {
        let head = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n");
        [head.as_bytes(), pixels.as_flattened()].concat()
    }

    #[test]
    fn names_and_files_are_told_apart() {
        for text in ["sky", "flat", "none", "a.hdr", "dir/b.hdr"] {
            assert_eq!(text.parse::<EnvironmentSpec>().unwrap().to_string(), text);
        }
        assert_eq!("skies".parse::<EnvironmentSpec>(), Err(UnknownEnvironment));
    }

    #[test]
    fn only_pictures_of_a_bearable_size_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.hdr");
        let open = |bytes: &[u8]| {
            std::fs::write(&file, bytes).unwrap();
            EnvironmentSpec::File(file.clone()).open().map_err(|error| error.to_string())
        };
        // An exponent of 129 makes 128 a 1.
        let whole = radiance(4, 2, &[[128, 64, 32, 129]; 8]);
        assert!(matches!(open(&whole), Ok(Environment::Panorama(_))));
        for (bytes, expected) in [
            (&b"no picture"[..], "no Radiance picture"),
            (&whole[..whole.len() - 3], "no Radiance picture"),
            (&radiance(1 << 20, 1 << 20, &[]), "at most"),
            (&radiance(0, 0, &[]), "environment"),
        ] {
            let error = open(bytes).unwrap_err();
            assert!(error.contains(expected) && error.contains("a.hdr"), "{error}");
        }
        std::fs::remove_file(&file).unwrap();
        assert!(matches!(EnvironmentSpec::File(file).open(), Err(EnvironmentError::Read { .. })));
    }
}
