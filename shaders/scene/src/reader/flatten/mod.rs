//! Turns nodes, meshes, materials, pictures, lights and cameras into the scene.

mod accessor;
pub(crate) mod animation;
mod append;
pub(crate) mod camera;
pub(crate) mod channels;
mod coordinates;
mod deform;
pub(crate) mod image;
mod instances;
pub(crate) mod light;
mod material;
pub(crate) mod materials;
pub(crate) mod meshes;
pub(crate) mod nodes;
mod pose;
mod primitive;
mod texture;

pub(crate) use append::finish;
