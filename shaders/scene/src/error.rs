//! Why a scene could not be loaded.

use std::{io, path::PathBuf};

use thiserror::Error;

use crate::{limits::MAX_LIGHTS, pack::PackError};

/// Why a scene could not be loaded. Every message names the file or the object, and the numbers that are wrong.
#[derive(Debug, Error)]
pub enum SceneError {
    /// A file could not be opened or read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A file is larger than `limits` allows.
    #[error("{} has {bytes} bytes; at most {limit} are read", path.display())]
    FileTooLarge {
        /// The file.
        path: PathBuf,
        /// Its size.
        bytes: u64,
        /// The bound that it breaks.
        limit: u64,
    },
    /// The file is neither a `.glb` container nor glTF JSON.
    #[error("{} is not a glTF 2.0 file: {fault}", path.display())]
    NotGltf {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        fault: String,
    },
    /// The file is a packed scene that cannot be used.
    #[error("{}: {fault}", path.display())]
    Packed {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        #[source]
        fault: PackError,
    },
    /// A count goes beyond `limits`.
    #[error("{what}: {count}, but at most {limit} are allowed")]
    Limit {
        /// What was counted.
        what: String,
        /// How many there are.
        count: u64,
        /// The bound.
        limit: u64,
    },
    /// An index points nowhere.
    #[error("{place} names {target} {index}, but there are {count}")]
    Reference {
        /// Who points.
        place: String,
        /// To what.
        target: &'static str,
        /// The index.
        index: usize,
        /// How many there are.
        count: usize,
    },
    /// An object breaks a rule of glTF 2.0.
    #[error("{place}: {fault}")]
    Invalid {
        /// The object.
        place: String,
        /// The rule that it breaks.
        fault: String,
    },
    /// The file is legal, but uses something that Gnomon does not read.
    #[error("{place} uses {feature}, which is not supported")]
    Unsupported {
        /// The object.
        place: String,
        /// The feature.
        feature: String,
    },
    /// A base colour picture is missing or cannot be decoded.
    #[error("{place}: picture {name}: {fault}")]
    Picture {
        /// The image.
        place: String,
        /// The file, or where its bytes are.
        name: String,
        /// What is wrong with it.
        fault: String,
    },
    /// Nothing to render.
    #[error("the scene has no triangles ({dropped} zero-area triangles, {skipped} point and line primitives left out)")]
    NoTriangles {
        /// Zero-area triangles that were dropped.
        dropped: u64,
        /// Point and line primitives that were skipped.
        skipped: u64,
    },
    /// Neither the scene nor a lights file has a light.
    #[error("the scene has no lights of its own: pass --lights-from FILE.json")]
    NoLights,
    /// More lights than a mask has planes.
    #[error("{0} lights, but at most {MAX_LIGHTS} fit a visibility mask: pass --lights N to keep the first N")]
    TooManyLights(usize),
    /// `--lights N` cannot be met.
    #[error("--lights {asked}: must be 1 to {MAX_LIGHTS}, and at most the {there} lights that there are")]
    LightCount {
        /// N.
        asked: u32,
        /// Lights that there are.
        there: usize,
    },
    /// The lights file is wrong.
    #[error("lights file {}: {fault}", path.display())]
    LightsFile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        fault: String,
    },
}

impl SceneError {
    /// An object that breaks a rule.
    pub(super) fn invalid(place: impl Into<String>, fault: impl Into<String>) -> Self {
        Self::Invalid { place: place.into(), fault: fault.into() }
    }

    /// An object that uses something unsupported.
    pub(super) fn unsupported(place: impl Into<String>, feature: impl Into<String>) -> Self {
        Self::Unsupported { place: place.into(), feature: feature.into() }
    }
}

/// An object's kind, index and name, as messages show it: `node 3 "lamp"`.
pub(super) fn place(kind: &str, index: usize, name: Option<&str>) -> String {
    match name {
        Some(name) => {
            let short: String = name.chars().take(64).collect();
            format!("{kind} {index} {short:?}")
        }
        None => format!("{kind} {index}"),
    }
}

/// Fails when `count` goes beyond `limit`.
pub(super) fn within(what: impl Into<String>, count: u64, limit: u64) -> Result<(), SceneError> {
    if count <= limit { Ok(()) } else { Err(SceneError::Limit { what: what.into(), count, limit }) }
}
