//! Nodes, meshes, materials, pictures and lights become the scene.

mod accessor;
pub(crate) mod image;
pub(crate) mod light;
pub(crate) mod material;
pub(crate) mod meshes;
pub(crate) mod nodes;
mod primitive;
