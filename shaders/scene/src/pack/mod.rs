//! The packed form of a scene, which travels from server to client and is named by its digest.

mod error;
mod format;
mod planes;
mod zstandard;

pub use error::PackError;
pub(crate) use format::{MAGIC, seal};
