//! Camera paths from files.

use std::{fmt, io::Read as _, path::PathBuf, str::FromStr};

use thiserror::Error;

pub use gnomon_client_core::camera::path::{CameraPath, Keyframe};

/// Largest path file that is read, in bytes.
const MAX_FILE_BYTES: u64 = 16 << 20;

/// Stands for the scene instead of a file. `./scene` is a file.
const SCENE: &str = "scene";

/// A path on a command line: `FILE` or `FILE#NAME`, or `scene` or `scene#NAME` for a camera of the scene.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PathSpec {
    pub file: PathBuf,
    /// The path's name in the file.
    pub name: Option<String>,
}

#[derive(Debug, Error)]
pub enum PathError {
    #[error("cannot read camera path {}: {source}", file.display())]
    Read { file: PathBuf, source: std::io::Error },
    #[error("camera path {} has more than {MAX_FILE_BYTES} bytes", .0.display())]
    TooLarge(PathBuf),
    #[error("camera path {}: {source}", file.display())]
    Parse { file: PathBuf, source: gnomon_client_core::camera::path::PathError },
    #[error("--path {SCENE}: {0}")]
    Scene(#[from] gnomon_client_core::camera::of_scene::NoSuchCamera),
}

impl FromStr for PathSpec {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(match text.rsplit_once('#') {
            Some((file, name)) if !name.is_empty() => Self { file: file.into(), name: Some(name.to_owned()) },
            _ => Self { file: text.trim_end_matches('#').into(), name: None },
        })
    }
}

impl fmt::Display for PathSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file.display())?;
        self.name.as_ref().map_or(Ok(()), |name| write!(f, "#{name}"))
    }
}

impl PathSpec {
    /// Returns which of the scene's cameras is meant, if one is: its name or number, or the first without one.
    #[must_use]
    pub fn scene_camera(&self) -> Option<Option<&str>> {
        (self.file.as_os_str() == SCENE).then_some(self.name.as_deref())
    }

    /// Reads the path, unless it is a camera of the scene.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn load_file(&self) -> Result<Option<CameraPath>, PathError> {
        if self.scene_camera().is_some() { Ok(None) } else { self.load().map(Some) }
    }

    /// Reads the path.
    ///
    /// # Errors
    /// If the file cannot be read, is malformed, or has no such path.
    pub fn load(&self) -> Result<CameraPath, PathError> {
        let file = || self.file.clone();
        let read = |source| PathError::Read { file: file(), source };
        let mut text = String::new();
        let opened = std::fs::File::open(&self.file).map_err(read)?;
        let bytes = opened.take(MAX_FILE_BYTES + 1).read_to_string(&mut text).map_err(read)?;
        if bytes as u64 > MAX_FILE_BYTES {
            return Err(PathError::TooLarge(file()));
        }
        CameraPath::parse(&text, self.name.as_deref()).map_err(|source| PathError::Parse { file: file(), source })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_of_the_scene_are_no_files() {
        let of = |text: &str| text.parse::<PathSpec>().unwrap();
        assert_eq!((of("scene").scene_camera(), of("scene#Door").scene_camera()), (Some(None), Some(Some("Door"))));
        assert!(matches!(of("scene#2").load_file(), Ok(None)));
        assert_eq!(of("./scene").scene_camera(), None);
        assert!(matches!(of("no/scene").load_file(), Err(PathError::Read { .. })));
    }

    #[test]
    fn files_are_read_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("paths.json");
        let keys = r#"{"keyframes": [{"t": 0, "pos": [0, 0, 0], "target": [0, 0, -1]}]}"#;
        std::fs::write(&file, format!(r#"{{"camera_paths": {{"b": {keys}, "a": {keys}}}}}"#)).unwrap();
        let load = |name: &str| format!("{}{name}", file.display()).parse::<PathSpec>().unwrap().load();
        assert_eq!((load("").unwrap().name(), load("#b").unwrap().name()), ("a", "b"));
        assert!(load("#c").unwrap_err().to_string().ends_with("it has a, b"));
        std::fs::write(&file, "{}").unwrap();
        assert!(matches!(load(""), Err(PathError::Parse { .. })));
        std::fs::remove_file(&file).unwrap();
        assert!(matches!(load(""), Err(PathError::Read { .. })));
    }
}
