//! Turns nodes, meshes, materials, pictures and lights into the scene.

mod accessor;
pub(crate) mod image;
pub(crate) mod light;
pub(crate) mod material;
pub(crate) mod meshes;
pub(crate) mod nodes;
mod primitive;
