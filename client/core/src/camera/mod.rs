//! Camera paths.

pub mod default_path;
pub mod of_scene;
pub mod path;
