//! Why a scene could not be loaded.

use std::{io, path::PathBuf};

use thiserror::Error;

use crate::{LoadReport, limits::MAX_LIGHTS, pack::PackError};

/// Why a scene could not be loaded. Every message names the file or the object, and the rule that it breaks.
#[derive(Debug, Error)]
pub enum SceneError {
    #[error("cannot read {}: {source}", path.display())]
    Read { path: PathBuf, source: io::Error },
    /// A file is larger than [`limits`](crate::limits) allows.
    #[error("{} has {bytes} bytes; at most {limit} are read", path.display())]
    FileTooLarge { path: PathBuf, bytes: u64, limit: u64 },
    /// The file is neither a `.glb` container nor glTF JSON.
    #[error("{} is not a glTF 2.0 file: {fault}", path.display())]
    NotGltf { path: PathBuf, fault: String },
    /// The file is a packed scene that cannot be used.
    #[error("{}: {fault}", path.display())]
    Packed {
        path: PathBuf,
        #[source]
        fault: PackError,
    },
    /// A count goes beyond [`limits`](crate::limits).
    #[error("{what}: {count}, but at most {limit} are allowed")]
    Limit { what: String, count: u64, limit: u64 },
    /// An index is not below the number of its targets, `count`.
    #[error("{place} names {target} {index}, but there are {count}")]
    Reference { place: String, target: &'static str, index: usize, count: usize },
    /// An object breaks a rule of glTF 2.0.
    #[error("{place}: {fault}")]
    Invalid { place: String, fault: String },
    /// The file is legal, but uses a feature that Gnomon does not read.
    #[error("{place} uses {feature}, which is not supported")]
    Unsupported { place: String, feature: String },
    /// A base colour picture is missing or cannot be decoded.
    #[error("{place}: picture {name}: {fault}")]
    Picture {
        place: String,
        /// The file, or where its bytes lie.
        name: String,
        fault: String,
    },
    #[error("the scene has no triangles{}", reasons(report))]
    NoTriangles { dropped: u64, skipped: u64, report: Box<LoadReport> },
    /// Neither the scene nor a lights file has a light, and none is to be added.
    #[error("the scene has no lights of its own: pass --lights-from FILE.json, or --default-light on")]
    NoLights,
    /// The file has no scene or variant of the wanted name or number.
    #[error("there is no {kind} {wanted:?}; the file has: {names}")]
    NoSuch { kind: &'static str, wanted: String, names: String },
    #[error("--lights {requested}: must be 1 to {MAX_LIGHTS}, and at most the scene's {available} lights")]
    LightCount { requested: u32, available: usize },
    #[error("lights file {}: {fault}", path.display())]
    LightsFile { path: PathBuf, fault: String },
}

impl SceneError {
    pub(super) fn invalid(place: impl Into<String>, fault: impl Into<String>) -> Self {
        Self::Invalid { place: place.into(), fault: fault.into() }
    }

    pub(super) fn unsupported(place: impl Into<String>, feature: impl Into<String>) -> Self {
        Self::Unsupported { place: place.into(), feature: feature.into() }
    }
}

/// Returns what a load left out, as a part of a sentence.
fn reasons(report: &LoadReport) -> String {
    let warnings: Vec<String> = report.all().iter().map(ToString::to_string).collect();
    if warnings.is_empty() { String::new() } else { format!(" ({})", warnings.join("; ")) }
}

/// Returns an object's kind, index and name as messages show them: `node 3 "lamp"`.
pub(super) fn place(kind: &str, index: usize, name: Option<&str>) -> String {
    match name {
        Some(name) => {
            let short: String = name.chars().take(64).collect();
            format!("{kind} {index} {short:?}")
        }
        None => format!("{kind} {index}"),
    }
}

/// Errors with [`SceneError::Limit`] if `count` goes beyond `limit`.
pub(super) fn within(what: impl Into<String>, count: u64, limit: u64) -> Result<(), SceneError> {
    if count <= limit { Ok(()) } else { Err(SceneError::Limit { what: what.into(), count, limit }) }
}
