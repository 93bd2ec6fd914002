//! Camera paths: where the camera goes when nobody steers it.

pub mod default_path;
pub mod path;
