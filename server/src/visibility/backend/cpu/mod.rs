//! The `cpu` back end: threads share the tiles, and rays are traced in groups of 64 as packets of eight.
//!
//! Steps of a tile: [`tile`] makes its 64 camera rays → [`group`] projects them to points of a plane → [`traverse`]
//! takes the group through the tree, testing eight boxes against all rays at once ([`frustum`]), then eight triangles
//! ([`leaf`]), then the packets near a triangle ([`outline`]) → [`surface`] computes points and normals → [`light`]
//! picks the lights that need shadow rays → [`regroup`] parts rays that end far apart → [`traverse`] again, from the
//! light.
//!
//! Each result depends only on its own ray and the triangles, so masks are the same in every run and for any number of
//! threads. They may differ in single bits between processors with and without AVX2 (see [`simd`]).

mod alpha;
mod backend;
mod count;
mod frustum;
mod group;
mod leaf;
mod light;
mod outline;
mod regroup;
mod rounding;
mod simd;
mod surface;
#[cfg(test)]
mod tests;
mod tile;
mod traverse;
mod vector;
mod world;

pub use self::{backend::CpuBackend, count::TraversalStats, world::Posed};
