//! Camera paths.

pub mod default_path;
pub mod path;
