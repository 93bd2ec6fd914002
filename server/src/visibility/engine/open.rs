//! Opens what traces: the back end that was chosen, on the adapter that was chosen.

use gnomon_scene::Scene;
use gnomon_shaders::gpu::GpuError;

use super::{
    handle::{BackendChoice, EngineOptions},
    worker::Backend,
};
use crate::visibility::backend::{
    BackendError,
    compute::{ComputeBackend, PictureLimit},
    cpu::CpuBackend,
    ray_query,
};

/// What an engine tells about its back end.
pub(super) struct About {
    pub(super) description: String,
    pub(super) limit: Option<PictureLimit>,
}

/// Takes as long as building the hierarchy and compiling the kernels.
///
/// # Errors
/// When the back end cannot be had for this scene.
pub(super) fn open_backend(scene: &Scene, options: &EngineOptions) -> Result<(Backend, About), BackendError> {
    let adapter = || options.adapter.clone();
    let on_device = |backend: ComputeBackend| {
        let about = About { description: backend.describe(), limit: Some(backend.picture_limit()) };
        (Backend::Compute(Box::new(backend)), about)
    };
    let cpu = || {
        let backend = CpuBackend::new(scene, options.threads)?;
        let about = About { description: backend.describe(), limit: None };
        Ok((Backend::Cpu(Box::new(backend)), about))
    };
    match options.backend {
        BackendChoice::RayQuery => ray_query::open(scene, adapter(), options.allow_software).map(on_device),
        BackendChoice::Compute => ComputeBackend::open(scene, adapter(), options.allow_software).map(on_device),
        BackendChoice::Cpu => cpu(),
        BackendChoice::Auto => match ray_query::open_preferred(scene, adapter(), false) {
            Ok(backend) => Ok(on_device(backend)),
            // Who names an adapter wants that one, or to hear that it is not there.
            Err(error @ BackendError::Gpu(GpuError::NoAdapter { wanted: Some(_), .. })) => Err(error),
            Err(BackendError::Gpu(error @ (GpuError::NoAdapter { .. } | GpuError::SoftwareOnly(_)))) => {
                tracing::info!(reason = %error, "tracing on the processor");
                cpu()
            }
            Err(error) => {
                tracing::warn!(reason = %error, "the graphics adapter cannot trace this scene: tracing on the processor");
                cpu()
            }
        },
    }
}
