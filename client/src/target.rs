//! What the command line names to be shown: a server's URL, or a scene's file.

use std::{
    fmt,
    path::{Path, PathBuf},
    str::FromStr,
};

use thiserror::Error;

use crate::link::url::{ServerUrl, UrlError};

/// Endings of files that are taken for scenes.
const SCENES: [&str; 3] = ["glb", "gltf", "gnomon"];

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Target {
    Server(ServerUrl),
    /// Opened with a server of its own on this machine.
    File(PathBuf),
}

#[derive(Debug, Error)]
pub enum TargetError {
    #[error(transparent)]
    Url(#[from] UrlError),
    #[error("{0:?} is neither a URL that a server printed, gnomon://HOST:PORT/?cert=SHA256, nor a file")]
    Neither(String),
}

impl FromStr for Target {
    type Err = TargetError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        if text.contains("://") {
            return Ok(Self::Server(text.parse()?));
        }
        let file = Path::new(text);
        let ending = file.extension().and_then(|ending| ending.to_str()).map(str::to_lowercase);
        // A scene that is missing is reported as such.
        if ending.is_some_and(|ending| SCENES.contains(&ending.as_str())) || file.is_file() {
            return Ok(Self::File(file.to_owned()));
        }
        Err(TargetError::Neither(text.chars().take(100).collect()))
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Server(url) => url.fmt(f),
            Self::File(file) => file.display().fmt(f),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn urls_and_files_are_told_apart() {
        assert!(matches!("gnomon+lab-udp://127.0.0.1:5".parse(), Ok(Target::Server(_))));
        assert!(matches!("http://x:1".parse::<Target>(), Err(TargetError::Url(_))));
        for text in ["room.glb", "a folder/ROOM.GLTF"] {
            assert!(matches!(text.parse(), Ok(Target::File(file)) if file.display().to_string() == text));
        }
        let file = tempfile::NamedTempFile::new().unwrap();
        assert!(matches!(file.path().display().to_string().parse(), Ok(Target::File(_))));
        assert!(matches!("room".parse::<Target>(), Err(TargetError::Neither(_))));
    }
}
