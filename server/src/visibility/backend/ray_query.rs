//! The `ray-query` back end: the frames, rules and kernels of `compute` with the adapter's own acceleration structure.
//!
//! wgpu calls ray queries experimental. Adapters without hardware for them do not offer them, except recent software
//! Vulkan, which the tests use.

use gnomon_scene::Scene;
use gnomon_shaders::gpu::Gpu;

use super::{
    BackendError,
    compute::{ComputeBackend, KernelOptions, Traversal},
};

/// Opens an adapter that has ray queries and uploads the scene. Builds the structure and compiles the kernels.
///
/// # Errors
/// If there is no such adapter, it lacks ray queries or other needs of the kernels, or the scene does not fit it.
pub fn open(scene: &Scene, adapter: Option<String>, allow_software: bool) -> Result<ComputeBackend, BackendError> {
    ComputeBackend::open_with(scene, adapter, allow_software, KernelOptions::new(Traversal::RayQuery))
}

/// Opens an adapter with ray queries if it has them and the scene fits, and with `compute` otherwise.
///
/// # Errors
/// If there is no such adapter, or it supports neither.
pub fn open_preferred(
    scene: &Scene,
    adapter: Option<String>,
    allow_software: bool,
) -> Result<ComputeBackend, BackendError> {
    match open(scene, adapter.clone(), allow_software) {
        Err(BackendError::Gpu(error)) => Err(error.into()),
        Err(error) => {
            tracing::info!(reason = %error, "tracing without ray queries");
            ComputeBackend::open(scene, adapter, allow_software)
        }
        backend => backend,
    }
}

/// As [`open`], on an open device.
///
/// # Errors
/// If the device lacks what the kernels need, or the scene does not fit it.
pub fn new(scene: &Scene, gpu: Gpu) -> Result<ComputeBackend, BackendError> {
    ComputeBackend::new_with(scene, gpu, KernelOptions::new(Traversal::RayQuery))
}
