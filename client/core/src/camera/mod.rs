//! Camera paths, and what cameras see.

pub mod default_path;
pub mod of_scene;
pub mod path;
mod viewpoint;

pub use viewpoint::Viewpoint;
