//! Reads glTF 2.0, `.gltf` and `.glb`, into a [`Scene`] without trusting a byte of it.
//!
//! The way of a file: `container` splits it, `json` and `document` parse its JSON into bounded lists, `features` refuses what is
//! not read, `references` and `layout` check every index and offset, `nodes` checks and walks the tree, `buffers` loads
//! bytes, `flatten` makes triangles of `primitive`s and `material`s, `image` decodes pictures, `light` reads lights.

mod checks;
mod file;
mod flatten;
mod json;
mod load;
mod report;

pub(crate) use load::load;
pub use report::LoadReport;
