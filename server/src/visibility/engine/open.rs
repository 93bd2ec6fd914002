//! Opens the chosen back end on the chosen adapter.

use gnomon_scene::Scene;
use gnomon_shaders::gpu::GpuError;

use super::{
    options::{BackendChoice, EngineOptions},
    tracer::Tracer,
};
use crate::visibility::backend::{
    BackendError,
    compute::{ComputeBackend, PictureLimit},
    cpu::CpuBackend,
    ray_query,
};

/// An engine's description of its back end.
pub(super) struct About {
    /// Back end and adapter, in readable form.
    pub(super) description: String,
    pub(super) limit: Option<PictureLimit>,
}

/// Opens the back end: builds the hierarchy and compiles the kernels. Errors if it cannot be opened for this scene.
pub(super) fn open_tracer(scene: &Scene, options: &EngineOptions) -> Result<(Tracer, About), BackendError> {
    let adapter = || options.adapter.clone();
    let on_device = |backend: ComputeBackend| {
        let about = About { description: backend.describe(), limit: Some(backend.picture_limit()) };
        (Tracer::on_device(backend), about)
    };
    let on_cpu = || {
        let backend = CpuBackend::new(scene, options.threads)?;
        let about = About { description: backend.describe(), limit: None };
        Ok((Tracer::on_cpu(backend), about))
    };
    match options.backend {
        BackendChoice::RayQuery => ray_query::open(scene, adapter(), options.allow_software).map(on_device),
        BackendChoice::Compute => ComputeBackend::open(scene, adapter(), options.allow_software).map(on_device),
        BackendChoice::Cpu => on_cpu(),
        BackendChoice::Auto => match ray_query::open_preferred(scene, adapter(), false) {
            Ok(backend) => Ok(on_device(backend)),
            // If a named adapter is missing, fail instead of tracing elsewhere.
            Err(error @ BackendError::Gpu(GpuError::NoAdapter { wanted: Some(_), .. })) => Err(error),
            Err(BackendError::Gpu(error @ (GpuError::NoAdapter { .. } | GpuError::SoftwareOnly(_)))) => {
                tracing::info!(reason = %error, "tracing on the processor");
                on_cpu()
            }
            Err(error) => {
                tracing::warn!(reason = %error, "the adapter cannot trace this scene: tracing on the processor");
                on_cpu()
            }
        },
    }
}
