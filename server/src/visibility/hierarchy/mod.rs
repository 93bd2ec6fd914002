//! Bounding volume hierarchies over a scene's triangles.

pub(crate) mod balance;
pub(crate) mod binary;
pub mod bvh;
pub mod moving;
