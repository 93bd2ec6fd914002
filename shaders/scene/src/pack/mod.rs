//! The packed form of a scene, which travels from server to client.

mod error;
mod format;
mod planes;

pub use error::PackError;
pub(crate) use format::{MAGIC, seal};
