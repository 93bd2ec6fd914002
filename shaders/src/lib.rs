//! Shared by the server's and the client's GPU: WGSL, the host types that it reads, and device set-up.
//!
//! The server's tracing kernels and the client's shading passes read the same [`gnomon_scene::Scene`], look through the
//! same [`gnomon_scene::camera::Camera`], and splice their WGSL from the same shared parts. So a pixel means the same
//! point at both ends.

pub mod device_failure;
pub mod edge_shares;
pub mod gpu;
pub mod host;
pub mod material;
pub mod shading;
pub mod splice;
#[cfg(test)]
mod tests;
pub mod uniforms;
