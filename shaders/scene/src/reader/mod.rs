//! Reads glTF 2.0, `.gltf` and `.glb`, into a [`Scene`](crate::Scene). No byte of the file is trusted.
//!
//! [`file`] splits a file into chunks and loads buffers; [`json`] parses its JSON into `gltf`'s model, within bounds;
//! [`checks`] refuses what cannot be drawn, and checks every index and offset; [`compression`] decompresses;
//! [`flatten`] walks the nodes and makes triangles, materials, pictures, lights and cameras. [`report`] keeps what was
//! mended, left out or not drawn.

mod checks;
mod compression;
mod file;
mod flatten;
mod json;
mod load;
mod report;

pub(crate) use load::load;
pub use report::{LoadReport, Warning, WarningKind};

/// Decoders alone, for the fuzz targets.
pub(crate) use compression::fuzzing as decoders;
