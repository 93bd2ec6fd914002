//! What both of Gnomon's GPUs must agree on: WGSL, the host types that it reads, camera maths, and the scene.
//!
//! The server's tracing kernels and the client's shading passes read the same [`scene::Scene`], look through the same
//! [`camera::Camera`] and splice their WGSL from the same shared parts, so that a pixel means the same point at both ends.

pub mod camera;
#[doc(hidden)]
pub mod fuzzing;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod host;
pub mod motion;
pub mod scene;
pub mod shading;
pub mod splice;
